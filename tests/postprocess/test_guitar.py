"""A real capture as an elastic body that falls into water, on two ranks: is it still that guitar?

The last frame is drawn, and the capture from its own file, moved to where the particles are: as a
rigid body, then bent by squares of the place, since water makes a guitar of rubber swing by
millimetres. Both pictures must agree inside the guitar's outline; scrambled particles must not.
"""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from numpy.polynomial.polynomial import polyvander3d

from tests.support.launch import mpirun
from vgmpi.gaussians import spherical_harmonics
from vgmpi.gaussians.formats import ply
from vgmpi.io.run_reader import RunReader
from vgmpi.postprocess.commands.render import FrameRenderer
from vgmpi.postprocess.frames.appearance import Appearance
from vgmpi.postprocess.frames.render_config import load
from vgmpi.postprocess.raster import rasterize

ROOT = Path(__file__).resolve().parents[2]
GUITAR = ROOT.parent / "shared" / "data" / "guitar.compressed.ply"
FOLDER = ROOT / "runs" / "capture"
TURN = "{axis='z',angle='-110 deg'},{axis='y',angle='55 deg'},{axis='x',angle='-40 deg'}"
SETTINGS = (
    f"object.capture.gaussians={GUITAR}",
    "object.capture.up=-y",
    "object.capture.height='60 cm'",
    f"object.capture.rotation=[{TURN}]",
    "domain.cell='4 cm'",
    "time.end='0.1 s'",
    "time.frames=3",
    # as slow as it takes for a smoothly bent body to be a fair comparison
    "object.capture.velocity=[0, 0, '-1 m/s']",
)
BOUND = 25.0  # [dB] an error of .056 of full brightness, root mean square
WHITE = np.ones(3)

pytestmark = [pytest.mark.data, pytest.mark.mpi]


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    if not GUITAR.exists():
        pytest.skip(f"{GUITAR} is not here")
    out = tmp_path_factory.mktemp("guitar")
    flags = [word for setting in SETTINGS for word in ("--set", setting)]
    job = mpirun(2, "-m", "vgmpi", FOLDER / "scene.toml", "-q", "-o", out, *flags)
    assert job.returncode == 0, job.stderr
    return RunReader(out)


def number(run):
    return next(k for k, entry in enumerate(run.objects) if entry["name"] == "capture")


def frame_of(run, index):
    """The guitar's own rows of a frame."""
    frame = run.frame(index)
    here = frame["object"] == number(run)
    return {name: frame[name][here] for name in ("id", "positions", "velocity", "F")}


def rigid(x0, x):
    """Rotation R and shift t with the least |R x0 + t - x|^2 (Kabsch)."""
    middle0, middle = x0.mean(0), x.mean(0)
    u, _, vt = np.linalg.svd((x - middle).T @ (x0 - middle0))
    R = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    return R, middle - R @ middle0


def moved_capture(run, frame):
    """The capture from its own file, placed as the scene asked, then moved and bent with the
    particles."""
    transform = np.array(run.objects[number(run)]["transform"])
    scale = np.cbrt(np.linalg.det(transform[:3, :3]))
    cloud = ply.read(GUITAR).transformed(transform[:3, :3] / scale, scale, transform[:3, 3])
    x0, x = np.asarray(run.gaussians.x0)[frame["id"]], frame["positions"].astype(float)
    R, t = rigid(x0, x)
    cloud = cloud.transformed(R, 1.0, t)
    there, middle = x0 @ R.T + t, x.mean(0)
    bend = np.linalg.lstsq(squares(there - middle), x - there, rcond=None)[0]
    print(f"bent by {1e3 * np.abs(squares(there - middle) @ bend).max():.1f} mm at the most")
    return dataclasses.replace(cloud, x=cloud.x + squares(cloud.x - middle) @ bend)


def squares(x):
    """(n, 27): products of the coordinates of x (n, 3), each up to its square."""
    return polyvander3d(*x.T, (2, 2, 2))


def painter(run):
    """Of Gaussians as they are: light from elsewhere is no capture's."""
    return FrameRenderer(run, load(FOLDER / "render.toml").on_paper(), FOLDER)


def camera(run):
    return painter(run).camera(0.0)


def drawn(run, frame):
    """Picture (height, width, 3) of the guitar alone."""
    view = camera(run)
    return rasterize.render(Appearance(run).splats(frame, view.eye), view, WHITE)[0]


def expected(run, frame):
    """Picture of the moved capture, and where it is (height, width)."""
    view, cloud = camera(run), moved_capture(run, frame)
    color = spherical_harmonics.evaluate(cloud.sh, cloud.x - view.eye)
    splats = rasterize.ProjectableGaussians(cloud.x, cloud.cov(), cloud.opacity, color)
    picture, left = rasterize.render(splats, view, WHITE)
    return picture, left < 0.5


def psnr(a, b, where):
    """Peak signal to noise ratio [dB] of pictures 0..1, inside `where`."""
    return -10 * np.log10(np.mean((a[where] - b[where]) ** 2))


def test_it_fell_into_the_water(run):
    first, last = frame_of(run, 0), frame_of(run, -1)
    assert len(first["id"]) > 90_000
    assert 0.0 < last["positions"][:, 2].min() < 0.09 < 0.12 < first["positions"][:, 2].min()
    volume = np.asarray(run.gaussians.vol0)[last["id"]]
    speed = np.average(last["velocity"][:, 2], weights=volume)
    assert -1.9 < speed < 0.5, "it fell freely, or jumped"  # freely: -1 - 9.8 * 0.1


def test_it_is_recognisable(run):
    """The whole picture, as the video shows it: the water is there too."""
    picture, outline = expected(run, frame_of(run, -1))
    assert outline.mean() > 0.02, "the camera does not see it"
    shown = painter(run).draw(len(run) - 1) / 255.0
    reached = psnr(shown, picture, outline)
    print(f"guitar in the water against the capture: {reached:.1f} dB in {outline.sum()} pixels")
    assert reached > BOUND


@pytest.mark.parametrize("how", ["as it is", "scrambled", "blurred", "not moved", "not turned"])
def test_what_is_wrong_is_seen(run, how):
    """Particles that changed places, lie about 2 cm off, did not move, or do not turn with F."""
    frame = frame_of(run, -1)
    right = expected(run, frame)
    rng = np.random.default_rng(1)
    if how == "scrambled":
        frame["positions"] = rng.permutation(frame["positions"])
    elif how == "blurred":
        frame["positions"] = frame["positions"] + rng.normal(
            0, 0.02, frame["positions"].shape
        ).astype("f4")
    elif how == "not moved":
        frame["positions"] = np.asarray(run.gaussians.x0)[frame["id"]]
    elif how == "not turned":
        turn = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
        frame["F"] = (turn @ frame["F"].reshape(-1, 3, 3)).reshape(-1, 9)
    reached = psnr(drawn(run, frame), *right)
    print(f"{how}: {reached:.1f} dB")
    assert reached > BOUND if how == "as it is" else reached < BOUND - 1

"""The two commands on a run on disk, as a user calls them."""

import subprocess
import sys
from pathlib import Path

import imageio.v3 as iio
import numpy as np
import pytest

from tests.postprocess.test_video import read
from tests.support import drawn_runs
from vgmpi.gaussians.formats import ply
from vgmpi.io import file_layout, initial_state
from vgmpi.io.frames import Frames
from vgmpi.io.run_reader import RunError, RunReader
from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.postprocess.commands import render, view
from vgmpi.postprocess.frames import frame_renderer, image_io
from vgmpi.postprocess.frames.render_config import Settings
from vgmpi.postprocess.raster import rasterize

ROOT = Path(__file__).resolve().parents[2]
GUITAR = ROOT.parent / "shared" / "data" / "guitar.compressed.ply"
SMALL = "[picture]\nwidth = 96\nheight = 80\n"


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    return drawn_runs.write(tmp_path_factory.mktemp("run") / "out", frames=4)


def toml(folder, text=""):
    path = folder / "render.toml"
    path.write_text(drawn_runs.on_paper(SMALL + text))
    return str(path)


def reddest(picture):
    """Middle (row, column) of what is red, and how wide it is."""
    p = picture.astype(int)
    y, x = np.nonzero((p[..., 0] > 120) & (p[..., 1] < 90) & (p[..., 2] < 90))
    assert len(y) > 10
    return y.mean(), x.mean(), np.ptp(x)


def test_a_video_with_its_pictures(out, tmp_path, capsys):
    v = tmp_path / "v.mp4"
    argv = [str(out), toml(tmp_path, "[camera]\nazimuth = 0\n[video]\nfps = 5\n"), "-o", str(v)]
    assert render.main([*argv, "--frames", str(tmp_path / "png"), "-q"]) == 0
    assert capsys.readouterr().out.strip() == str(v)
    meta, got = read(v)
    assert len(got) == 4 and meta["fps"] == 5
    pictures = [iio.imread(p) for p in sorted((tmp_path / "png").iterdir())]
    assert len(pictures) == 4 and pictures[0].shape == (80, 96, 3)
    for picture, back in zip(pictures, got):
        assert np.abs(picture.astype(int) - back).mean() < 8
    # the bar lies across the view at first and points at the viewer at last
    assert reddest(pictures[0])[2] > 3 * reddest(pictures[3])[2]
    # red above, blue below it, and the corners show the background
    red = reddest(pictures[0])
    blue = np.nonzero(pictures[0][..., 2].astype(int) > pictures[0][..., 0].astype(int) + 60)
    assert red[0] < blue[0].mean()
    assert (pictures[0][0, 0] == 255).all()


def test_an_orbit_goes_round(out, tmp_path):
    argv = [str(out), toml(tmp_path, "[camera]\nrevolutions = 1\nazimuth = 0\n"), "-q"]
    assert render.main([*argv, "-o", str(tmp_path / "v.mp4"), "--frames", str(tmp_path / "p")]) == 0
    first, second = (iio.imread(tmp_path / "p" / f"frame_0000{k}.png") for k in (0, 3))
    still = [str(out), toml(tmp_path, "[camera]\nazimuth = 360\n"), "-q", "--frame", "3"]
    assert render.main([*still, "-o", str(tmp_path / "a.png")]) == 0
    # an orbit steps back as far as its widest view asks, so compare what is where, not pixels
    assert reddest(second)[2] == pytest.approx(reddest(iio.imread(tmp_path / "a.png"))[2], abs=6)
    assert (first != second).any()


def test_one_frame_as_a_picture_and_a_background(out, tmp_path):
    ground = np.zeros((80, 96, 3), np.uint8)
    ground[:, :48] = (0, 255, 0)
    iio.imwrite(tmp_path / "ground.png", ground)
    path = tmp_path / "a.png"
    file = toml(tmp_path, 'background = "ground.png"\n')
    assert render.main([str(out), file, "-o", str(path), "--frame", "1", "-q"]) == 0
    picture = iio.imread(path)
    assert tuple(picture[0, 0]) == (0, 255, 0) and tuple(picture[0, -1]) == (0, 0, 0)


def test_without_settings_the_whole_domain_is_in_view(out, tmp_path):
    (tmp_path / "r.toml").write_text(drawn_runs.on_paper(""))
    shown = [str(out), str(tmp_path / "r.toml"), "-o", str(tmp_path / "a.png"), "-q"]
    assert render.main(shown) == 0
    picture = iio.imread(tmp_path / "a.png")
    assert picture.shape == (800, 800, 3)
    edge = np.concatenate([picture[0], picture[-1], picture[:, 0], picture[:, -1]])
    assert (edge > 220).all()  # but for the soft rim of the floor
    assert (picture < 200).any(axis=2).mean() > 0.1
    # without a file, from the same place
    assert render.main([str(out), "-o", str(tmp_path / "b.png"), "-q"]) == 0
    studio = iio.imread(tmp_path / "b.png")
    assert studio.shape == picture.shape and np.ptp(studio[0].astype(int), axis=0).max() < 8
    paper, other = (bluest(one) for one in (picture, studio))
    np.testing.assert_allclose(paper, other, atol=20)  # of water that is faint on paper


def bluest(picture):
    """Middle (row, column) of the water."""
    p = picture.astype(int)
    y, x = np.nonzero(p[..., 2] > p[..., 0] + 60)
    assert len(y) > 1000
    return y.mean(), x.mean()


def test_a_run_without_a_domain_is_drawn_around_its_particles(tmp_path):
    out = drawn_runs.write(tmp_path / "out", frames=1, scene=False)
    assert render.main([str(out), toml(tmp_path), "-o", str(tmp_path / "a.png"), "-q"]) == 0
    assert (iio.imread(tmp_path / "a.png") < 200).any(axis=2).mean() > 0.1


@pytest.mark.parametrize(
    "argv, says",
    [
        (["{none}"], "no such folder"),
        (["{empty}"], "no frames"),
        (
            ["{out}", "-o", "v.avi"],
            "allowed: a name that ends in .mp4, .webm, .gif or .png, or a folder",
        ),
        (["{out}", "-o", "{tmp}/a.png", "--frame", "9"], "frames 0..3"),
        (["{out}", "{tmp}/none.toml"], "none.toml"),
        (["{out}", "{tmp}/bad.toml"], "bad.toml:1: camera: "),
        (["{out}", "{tmp}/late.toml"], "the run has the frames 0..3"),
        (["{out}", "{tmp}/wall.toml"], "none.png"),
    ],
)
def test_mistakes_end_with_code_2_and_one_line(out, tmp_path, capfd, argv, says):
    (tmp_path / "empty").mkdir()
    (tmp_path / "bad.toml").write_text('[camera]\nkind = "fixed"')
    (tmp_path / "late.toml").write_text("[frames]\nfirst = 7")
    (tmp_path / "wall.toml").write_text('[picture]\nbackground = "none.png"')
    places = {"none": tmp_path / "none", "empty": tmp_path / "empty", "out": out, "tmp": tmp_path}
    assert render.main([a.format(**places) for a in argv]) == 2
    text = capfd.readouterr().err.strip()
    assert says in text and "\n" not in text
    assert not (out / "video.mp4").exists()


SLOW = (  # to load, and of no use for one picture
    "imageio",
    "imageio_ffmpeg",
    "matplotlib",
    "mpi4py",
    "pyvista",
    "scipy.ndimage",
    "scipy.sparse",
    "scipy.spatial",
    "scipy.special",
    "tqdm",
    "vgmpi.materials.tensor_math",
    "vgmpi.parallel",
    "vgmpi.kernels",
    "vgmpi.scene",
    "vgmpi.solver",
)
PREVIEW = """
import gc, runpy, sys
sys.argv[1:] = ["render", *sys.argv[1:], "--preview"]
try:
    runpy.run_module("vgmpi", run_name="__main__")
except SystemExit as end:
    print(end.code, gc.get_freeze_count() > 10_000, *sys.modules)
"""


@pytest.mark.parametrize("preset", ["paper", "studio"])
def test_a_preview_loads_nothing_that_it_does_not_need(out, tmp_path, preset):
    (tmp_path / "r.toml").write_text(f'look.preset = "{preset}"\n')
    command = [sys.executable, "-c", PREVIEW, str(out), str(tmp_path / "r.toml")]
    ended = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    path, last = ended.stdout.splitlines()
    assert Path(path).name == "preview.png" and Path(path).is_file()
    code, frozen, *loaded = last.split()
    assert code == "0" and frozen == "True"
    # the last two: neighbors in the surfaces of shapes
    studio = "scipy.ndimage", "scipy.special", "scipy.sparse", "scipy.spatial"
    needed = studio if preset == "studio" else ()
    assert "numba" in loaded
    assert not [name for name in SLOW if name in loaded and name not in needed]


@pytest.mark.parametrize("color", ["J", "velocity", "velocity.z", "F.0", "object", "positions.x"])
def test_a_view_of_any_field(out, tmp_path, color, capsys):
    path = tmp_path / "new" / "a.png"
    argv = [str(out), "--frame", "1", "--color", color, "-o", str(path), "--size", "320", "240"]
    assert view.main(argv) == 0
    picture = iio.imread(path)[..., :3]
    assert picture.shape == (240, 320, 3)
    spread = np.ptp(picture.astype(int), axis=2)
    assert (spread > 40).mean() > 0.02  # colored particles and a color bar


def test_views_show_the_numbers_of_their_field():
    frame = {"J": np.arange(3.0), "velocity": np.array([[3.0, 4, 0], [0, 0, 2], [0, 0, -1]])}
    np.testing.assert_array_equal(view.scalars(frame, "J"), [0, 1, 2])
    np.testing.assert_array_equal(view.scalars(frame, "velocity"), [5, 2, 1])
    np.testing.assert_array_equal(view.scalars(frame, "velocity.z"), [0, 2, -1])
    with pytest.raises(RunError, match="^J.x: J has no components"):  # no flag: a page asks, too
        view.scalars(frame, "J.x")
    assert view.title("velocity.z") == "velocity.z [m/s]" and view.title("J") == "J"


@pytest.mark.parametrize(
    "argv, says",
    [
        (["--color", "pressure"], "--color: pressure: this frame has id, positions, "),
        (["--color", "J.x"], "no components"),
        (["--color", "velocity.w"], "velocity.x .. velocity.z"),
        (["--frame", "4"], "frames 0..3"),
        (["--frame", "-5"], "frames 0..3"),
        (["-o", "a.jpg"], ".png"),
        (["--size", "0", "100"], "--size"),
    ],
)
def test_mistakes_in_a_view(out, tmp_path, argv, says, capfd):
    assert view.main([str(out), "-o", str(tmp_path / "a.png"), *argv]) == 2
    text = capfd.readouterr().err.strip()
    assert says in text and "\n" not in text


@pytest.mark.data
def test_a_real_capture_is_recognisable_on_a_turning_body(tmp_path):
    """Falling and turning, it must look like the capture itself turned in the hand."""
    if not GUITAR.exists():
        pytest.skip(f"{GUITAR} is not here")
    c = ply.read(GUITAR)
    c = c.select(np.flatnonzero(c.opacity > 0.02)[::2])
    upright = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    size = 0.8 / np.ptp(np.quantile(c.x[:, 1], [0.005, 0.995]))
    c = c.transformed(upright, size)
    c = c.transformed(np.eye(3), 1.0, 0.5 - np.median(c.x, axis=0))
    n, R, shift = len(c), drawn_runs.rotation(1.1), np.array([0.05, -0.03, -0.05])
    rows = {
        "x0": c.x,
        "vol0": np.full(n, 1e-7),
        "object": np.zeros(n, "i4"),
        "cov0": c.cov().astype("f4"),
        "opacity": c.opacity.astype("f4"),
        "sh": c.sh,
    }
    initial_state.write(
        tmp_path / file_layout.GAUSSIANS,
        SerialCommunicator(),
        rows,
        [{"name": "guitar", "family": "solid"}],
        scene={"domain": {"size": [1.0, 1.0, 1.0]}},
    )
    middle = np.full(3, 0.5)
    x = (c.x - middle) @ R.T + middle + shift
    fields = {"positions": x.astype("f4"), "F": np.tile(R.reshape(9), (n, 1)).astype("f4")}
    Frames(tmp_path, SerialCommunicator(), n).write(0, 0.0, 0, np.arange(n), fields)
    file = tmp_path / "render.toml"
    file.write_text(drawn_runs.on_paper(""))
    assert render.main([str(tmp_path), str(file), "-o", str(tmp_path / "a.png"), "-q"]) == 0
    got = iio.imread(tmp_path / "a.png").astype(float)

    turned = c.transformed(np.eye(3), 1.0, -middle).transformed(R, 1.0, middle + shift)
    painter = render.FrameRenderer(
        render.RunReader(tmp_path), render.render_config.load(file), tmp_path
    )
    camera = painter.camera(0.0)
    splats = rasterize.ProjectableGaussians(turned.x, turned.cov(), turned.opacity, turned.rgb)
    image, _ = rasterize.render(splats, camera, (1.0, 1.0, 1.0))
    want = image_io.to_bytes(image).astype(float)
    assert 10 * np.log10(255**2 / np.mean((got - want) ** 2)) > 45  # dB
    still = rasterize.ProjectableGaussians(c.x, c.cov(), c.opacity, c.rgb)
    other, _ = rasterize.render(still, camera, (1.0, 1.0, 1.0))
    other = image_io.to_bytes(other).astype(float)
    assert 10 * np.log10(255**2 / np.mean((got - other) ** 2)) < 25  # the measure tells poses apart
    dark = (got < 200).any(axis=2)
    assert 0.01 < dark.mean() < 0.3


def test_a_tall_domain_does_not_make_the_subject_small(tmp_path):
    """The camera that nobody set looks at where Gaussians are, at whatever frame."""
    for height in (1.0, 20.0):
        made = drawn_runs.write(tmp_path / str(height), height=height)
        low, high = frame_renderer.visible_extent(RunReader(made))
        np.testing.assert_allclose(low, [0, 0, 0], atol=1e-6)
        np.testing.assert_allclose(high, [1, 1, 0.85], atol=0.06)
        picture = frame_renderer.FrameRenderer(RunReader(made), Settings(), made).draw(0)
        assert (picture < 250).any(axis=-1).mean() > 0.25

"""Depth of field and motion blur: means over points of a lens and over times.

Theory: a point at depth z, seen through a lens of radius a that is focused on depth f, becomes a
disc of radius focal a |1 / z - 1 / f| pixels. A particle of velocity v leaves a streak of shutter
times v times the time of a frame.
"""

import numpy as np
import pytest

from tests.postprocess.test_light import balls
from tests.support import drawn_runs
from vgmpi.gaussians.camera import look_at, thin_lens_sample
from vgmpi.io.run_reader import RunError, RunReader
from vgmpi.postprocess.commands import render
from vgmpi.postprocess.frames.frame_renderer import FrameRenderer
from vgmpi.postprocess.frames.render_config import load
from vgmpi.postprocess.raster import rasterize

CAMERA = look_at((0, -2.0, 0), (0, 0, 0), (0, 0, 1), 40, 201, 201)


def spread(depth, aperture, focus, samples=64):
    """Root of the mean square distance [pixels] of a point's images from their middle."""
    point = np.array([0.1, depth - 2.0, -0.05])
    seen = []
    for sample in range(samples):
        camera = thin_lens_sample(CAMERA, aperture, focus, sample, samples)
        local = camera.world_to_camera[:3, :3] @ point + camera.world_to_camera[:3, 3]
        seen.append(local[:2] / local[2] * camera.fx + [camera.cx, camera.cy])
    seen = np.array(seen)
    return np.sqrt(((seen - seen.mean(axis=0)) ** 2).sum(axis=1).mean())


@pytest.mark.parametrize("depth", [1.2, 2.0, 3.0])
def test_a_point_becomes_a_disc(depth):
    radius = CAMERA.fx * 0.05 * abs(1 / depth - 1 / 2.0)
    assert spread(depth, 0.05, 2.0) == pytest.approx(radius / np.sqrt(2), rel=0.03, abs=1e-9)


def test_the_mean_of_a_lens_is_wider_and_as_bright():
    far = balls((0, 1.0, 0), 0.01, (1, 1, 1))
    sharp = rasterize.render(far, CAMERA, (0, 0, 0))[0]
    lens = [thin_lens_sample(CAMERA, 0.05, 2.0, k, 32) for k in range(32)]
    blurred = np.mean([rasterize.render(far, one, (0, 0, 0))[0] for one in lens], axis=0)
    assert blurred.sum() == pytest.approx(sharp.sum(), rel=0.01)
    assert blurred.max() < 0.5 * sharp.max()


def painter(tmp_path, text):
    path = tmp_path / "render.toml"
    path.write_text(
        drawn_runs.on_paper("[picture]\nwidth = 96\nheight = 80\nblur_samples = 8\n" + text)
    )
    run = RunReader(drawn_runs.write(tmp_path / f"run{len(list(tmp_path.iterdir()))}", frames=3))
    return FrameRenderer(run, load(path), tmp_path)


FIXED = '[camera]\nkind = "fixed"\neye = [0.5, -2.5, 1.0]\ntarget = [0.5, 0.5, 0.5]\n'


def test_pictures_blur_where_asked(tmp_path):
    plain, lens, shutter = (
        painter(tmp_path, FIXED + more).draw(1).astype(int)
        for more in ("", "aperture = 0.1\nfocus = 1.0\n", "[video]\nshutter = 1.0\n")
    )
    steep = [np.abs(np.diff(picture, axis=0)).sum() for picture in (plain, lens)]
    assert steep[1] < 0.8 * steep[0] and (shutter != plain).any()


def test_particles_go_on_while_the_shutter_is_open(tmp_path):
    one = painter(tmp_path, FIXED + "[video]\nshutter = 0.5\n")
    frame = one.look.frame(1)
    step = one.run.times[2] - one.run.times[1]
    moved = one._moment(frame, 1, 6)["positions"] - frame["positions"]
    np.testing.assert_allclose(moved, 0.5 * step * 6 / 8 * frame["velocity"], atol=1e-7)
    assert np.abs(moved).max() > 0
    del frame["velocity"]
    with pytest.raises(RunError, match="output.fields"):
        one._moment(frame, 1, 1)


def test_an_aperture_without_focus(tmp_path, capsys):
    path = tmp_path / "render.toml"
    path.write_text("[camera]\naperture = 0.1\n")
    out = drawn_runs.write(tmp_path / "run", frames=2)
    assert render.main([str(out), str(path), "-q"]) == 2
    assert "needs focus" in capsys.readouterr().err

"""Frames of a scene of rigid bodies alone: they hold poses, and what draws them follows these."""

import numpy as np
import pytest

import vgmpi
from vgmpi.io.run_reader import RunReader
from vgmpi.postprocess.commands import view
from vgmpi.postprocess.frames.frame_renderer import visible_extent

SCENE = """
[domain]
size = [1, 0.4, 0.4]
cell = 0.02
gravity = [0, 0, 0]
[time]
end = 0.4
frames = 3
[material.oak]
kind = "elastic"
density = 700
youngs_modulus = "1 GPa"
[[object]]
name = "ball"
material = "oak"
rigid = true
velocity = [1.5, 0, 0]
shape = { sphere = { center = [0.2, 0.2, 0.2], radius = 0.1 } }
"""


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("alone")
    (folder / "scene.toml").write_text(SCENE)
    vgmpi.run(vgmpi.load(folder / "scene.toml"), folder=folder / "out")
    return RunReader(folder / "out")


def test_the_frames_hold_poses(run):
    frame = run.frame(2)
    assert len(frame["positions"]) == 0
    np.testing.assert_allclose(frame["poses"][0, :3, 3], [0.6, 0, 0], atol=1e-9)


def test_the_camera_sees_the_whole_way(run):
    """From the ball at the start to the ball at the end."""
    low, high = visible_extent(run)
    assert low[0] == pytest.approx(0.1, abs=0.02)
    assert high[0] == pytest.approx(0.9, abs=0.02)


def test_a_picture_of_particles_is_refused(run, capsys):
    assert view.main([str(run.folder), "--frame", "1"]) == 2
    assert "frame 1 has no particles; vgmpi render draws all else" in capsys.readouterr().err

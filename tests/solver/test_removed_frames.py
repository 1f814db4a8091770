"""Frames that somebody removes while a run goes on."""

import shutil

import numpy as np
import pytest

from tests.solver.test_run_folder import NUMPY, SCENE, run
from tests.support.small_scenes import write
from vgmpi.io import file_layout
from vgmpi.io.run_reader import RunReader
from vgmpi.solver.run import Runner


@pytest.fixture
def scene(tmp_path):
    return write(tmp_path, SCENE)


@pytest.mark.parametrize("gone", ["frame_00000.vtkhdf", ""])
@pytest.mark.parametrize("after", [1, 2])
def test_frames_that_are_removed_during_a_run_are_named(scene, capfd, monkeypatch, gone, after):
    """The run goes on, since its checkpoint is worth something; but it does not end as if whole."""
    original = Runner._write_frame

    def write_and_remove(self):
        original(self)
        if self.frame == after + 1:
            frames = self.options.folder / file_layout.FRAMES
            shutil.rmtree(frames) if not gone else (frames / gone).unlink()

    monkeypatch.setattr(Runner, "_write_frame", write_and_remove)
    out = scene.parent / "out"
    assert run(scene, *NUMPY) == 1
    err = capfd.readouterr().err
    assert "Traceback" not in err and "frames" in err.splitlines()[-1]
    if gone:
        assert "a frame was removed during the run: frame_00000.vtkhdf" in err
        assert np.isfinite(RunReader(out).times).sum() == 2
        assert list((out / "checkpoints").glob("*.json"))

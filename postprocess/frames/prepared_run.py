"""Prepared particles as a run of one frame, so that they can be looked at before the run."""

import functools
from pathlib import Path

import numpy as np

from vgmpi.io import file_layout
from vgmpi.io.run_reader import RunError, RunReader

from .frame_gaussians import moving


class PreparedRun(RunReader):
    """Files of a run without frames: frame 0 is the state at rest of gaussians.h5."""

    def refresh(self) -> None:
        """Find gaussians.h5. Raises RunError without it."""
        path = self.folder / file_layout.GAUSSIANS
        if not path.is_file():
            raise RunError(f"{path}: no such file")
        self.frames = {0: path}
        self._count = 1

    def path(self, i: int) -> Path:
        """Return the path of the file of frame i."""
        return self.folder / file_layout.GAUSSIANS

    @functools.cached_property
    def times(self) -> np.ndarray:
        """Simulated time of the frame, shape (1,) [s]."""
        return np.zeros(1)

    def time_and_step(self, i: int) -> tuple[float, int]:
        """Return the simulated time [s] and the step of the frame."""
        return 0.0, 0

    def particle_count(self, i: int) -> int:
        """Return the number of particles."""
        return len(self.gaussians.x0)

    def positions(self, i: int) -> np.ndarray:
        """Return the positions, shape (n, 3) [m]."""
        return np.asarray(self.gaussians.x0)

    def frame(self, i: int) -> dict[str, np.ndarray]:
        """Return the arrays of the state at rest by the names of file_layout.FRAME."""
        gaussians, count = self.gaussians, len(self.gaussians.x0)
        v = np.zeros((count, 3)) if gaussians.v0 is None else np.asarray(gaussians.v0)
        arrays = {
            "id": np.arange(count),
            "positions": np.asarray(gaussians.x0),
            "velocity": v.astype(np.float32),
            "F": np.tile(np.eye(3, dtype=np.float32).ravel(), (count, 1)),
            "J": np.ones(count, np.float32),
        }
        poses = len(moving(self.objects))
        return arrays | ({"poses": np.tile(np.eye(4), (poses, 1, 1))} if poses else {})


def open_run(folder: str | Path, prepared: bool = False) -> RunReader:
    """Open a run. Raises RunError.

    Args:
        folder: Folder of the run.
        prepared: Whether prepared particles are enough.
    """
    try:
        return RunReader(folder)
    except RunError:
        if prepared and (Path(folder) / file_layout.GAUSSIANS).is_file():
            return PreparedRun(folder)
        raise

"""Base class of targets: observed values and the subset that is held out."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from vgmpi.scene.sections import Time

from .run_renderer import Pictures


class Target:
    """Observed values to which a run is compared, in stages from coarse to fine.

    values: by stage, (n,). holdout_mask: by stage, (n,) bool, True if a value is not fitted.
    Residuals are relative to the magnitude of the target.
    """

    def __init__(self) -> None:
        self.preamble = ""  # text that is printed before any run
        self.values: list[np.ndarray] = []
        self.holdout_mask: list[np.ndarray] = []
        self.correlated_counts = [1.0]  # by stage: number of adjacent values with correlated errors
        self.loss_description = ""  # description of the loss for the report
        self.frames: list[int] = []  # numbers of the frames of a run that are compared
        self.pictures: Pictures | None = None  # renderer of runs for viewing, or None

    @property
    def stages(self) -> int:
        """Number of stages."""
        return len(self.values)

    def observe(self, folder: Path, stage: int) -> np.ndarray:
        """Return the values of a run, shape (n,). Raises RunError."""
        raise NotImplementedError

    def residual(self, folder: Path, stage: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the residuals of a run: of fitted values, and of held-out ones.

        The mean square of each is the squared loss.
        """
        residual, holdout_mask = (
            self.observe(folder, stage) - self.values[stage],
            self.holdout_mask[stage],
        )
        return residual[~holdout_mask], residual[holdout_mask]

    def images(self) -> np.ndarray:
        """Return images of the target at `frames`, shape (frames, height, width, 3) in [0, 1].

        They have the size that `pictures` draws. Raises RunError.
        """
        raise NotImplementedError

    def report_lines(self, folder: Path) -> list[str]:
        """Return further lines about a run for the report."""
        return []


def nearest_frames(
    time: Time, times: np.ndarray, candidates: Sequence[int]
) -> tuple[np.ndarray, np.ndarray]:
    """Find the frames of a scene that are nearest to given times.

    Args:
        time: Time settings of the scene.
        times: Times, shape (n,) [s].
        candidates: Numbers of the frames to choose from.

    Returns:
        Positions in `candidates`, shape (n,), and time differences, shape (n,) [frame intervals].
    """
    candidate_times = np.linspace(0, time.end, time.frames)[list(candidates)]
    nearest = np.abs(candidate_times[None, :] - times[:, None]).argmin(1)
    return nearest, np.abs(candidate_times[nearest] - times) * (time.frames - 1) / time.end


def held_out(number: np.ndarray, every: int) -> np.ndarray:
    """Return which of the numbered items are held out: one in `every`, never the first."""
    return number % every == every - 1 if every else np.zeros(len(number), bool)

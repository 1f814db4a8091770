"""What runs are held to: numbers, of a run the same ones, and which of them are held out."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..scene.settings import Time
from .pictures import Pictures


class Target:
    """stages: from coarse to fine. values: of each stage, (n,). held: (n,) of each stage, which are
    not fitted. Lengths of the residual are shares of the target."""

    def __init__(self) -> None:
        self.before = ""  # what is to be said before anything is run
        self.values: list[np.ndarray] = []
        self.held: list[np.ndarray] = []
        self.alike = [1.0]  # of each stage: how many of the numbers beside each other err together
        self.said = ""  # what the loss is
        self.frames: list[int] = []  # of a run: those that are compared
        self.pictures: Pictures | None = None  # as which runs are shown, where it is known

    @property
    def stages(self) -> int:
        return len(self.values)

    def of(self, folder: Path, stage: int) -> np.ndarray:
        """The numbers of a run (n,). Raises RunError."""
        raise NotImplementedError

    def off(self, folder: Path, stage: int) -> tuple[np.ndarray, np.ndarray]:
        """How far a run is off: where it is fitted, and where it is held out; of each the mean
        square is the loss squared."""
        off, held = self.of(folder, stage) - self.values[stage], self.held[stage]
        return off[~held], off[held]

    def shown(self) -> np.ndarray:
        """What is to be seen of the target at these frames, (frames, height, width, 3) of 0..1 as
        large as `pictures` draws. Raises RunError."""
        raise NotImplementedError

    def notes(self, folder: Path) -> list[str]:
        """What else is to be said of a run, for the report: lines."""
        return []


def frames_at(time: Time, at: np.ndarray, among: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
    """Of a scene's frames with these numbers those nearest to times `at` (n,) [s], as places in
    `among`; and how far they are off, over the time between frames."""
    own = np.linspace(0, time.end, time.frames)[list(among)]
    near = np.abs(own[None, :] - at[:, None]).argmin(1)
    return near, np.abs(own[near] - at) * (time.frames - 1) / time.end


def held_out(number: np.ndarray, every: int) -> np.ndarray:
    """Which of the numbered ones are held out: one in so many, never the first."""
    return number % every == every - 1 if every else np.zeros(len(number), bool)

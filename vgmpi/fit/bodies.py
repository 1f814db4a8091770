"""Frames of another run as the target: where its bodies are."""

from pathlib import Path

import numpy as np

from ..misspelt import nearest
from ..output.read import RunError
from ..study.errors import Outcome
from .pictures import SHOWN, Pictures
from .settings import FitFile
from .target import Target, frames_at, held_out

SAME_TIME = 1e-6  # of the time between frames


class Frames(Target):
    """Where bodies are in frames of another run: the share of each body in boxes of a lattice."""

    def __init__(self, file: FitFile):
        super().__init__()
        asked, self.scene = file.settings.target, file.scene
        self.said = "rms of what of a body is in another box, over the rms of what is in them"
        folder = file.folder / str(asked.frames)
        there = {o.name for o in self.scene.object if o.role == "body"}
        wanted = asked.bodies or tuple(sorted(there))
        for k, name in enumerate(wanted):
            if name not in there:
                said = f"there is no body '{name}'{nearest(name, there)}"
                raise file.wrong(("target", "bodies", k), f"{said}; known: {', '.join(there)}")
        try:
            other = Outcome(folder)
            names = [o["name"] for o in other.run.objects]
            missing = [name for name in wanted if name not in names]
            if missing:
                raise RunError(f"has no body '{missing[0]}'; it has {', '.join(names)}")
            if not np.allclose(other.size, self.scene.domain.size, rtol=1e-9):
                size = " x ".join(f"{x:g}" for x in other.size)
                raise RunError(f"is of another domain, {size} m")
            self.wanted, self.times = wanted, other.times
            raw = [self._shares(other, boxes, range(len(other.times))) for boxes in asked.boxes]
        except RunError as error:
            raise file.wrong(("target", "frames"), f"{error}; got '{asked.frames}'") from None
        self.boxes, self.alike = asked.boxes, [1.0] * len(asked.boxes)
        self.unit = [float(np.sqrt(np.mean(one**2))) for one in raw]
        self.values = [one.ravel() / unit for one, unit in zip(raw, self.unit)]
        held = held_out(np.arange(len(self.times)), asked.hold_out)
        self.held = [np.repeat(held, one[0].size) for one in raw]
        self._check_times(file)
        self.other = folder
        if asked.render is not None:
            self.pictures = Pictures(file.folder / asked.render, SHOWN)

    def _check_times(self, file: FitFile) -> None:
        """Frames are of the same times."""
        time = file.scene.time
        near, apart = frames_at(time, self.times, range(time.frames))
        off = apart > SAME_TIME
        if off.any():
            said = f"has a frame at {self.times[off][0]:g} s, of which the scene has none"
            raise file.wrong(("target", "frames"), f"{said}: its time.end and time.frames say when")
        self.frames = [int(k) for k in near]

    def shown(self) -> np.ndarray:
        assert self.pictures is not None
        return self.pictures.of(self.other, list(range(len(self.times))))

    def _shares(self, outcome: Outcome, boxes: int, frames) -> np.ndarray:
        """(frames, bodies, boxes), of each body's mass."""
        names = [o["name"] for o in outcome.run.objects]
        rows = [names.index(name) for name in self.wanted]
        whole = outcome.whole[rows]
        return np.stack([outcome.spread(int(k), boxes)[rows] / whole[:, None] for k in frames])

    def of(self, folder: Path, stage: int) -> np.ndarray:
        found = self._shares(Outcome(folder), self.boxes[stage], self.frames)
        return found.ravel() / self.unit[stage]

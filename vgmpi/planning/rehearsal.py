"""What a run in coarser cells has shown of where particles go, for the scene's own cells."""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ..scene.scene import Scene
from .features import step
from .pace import Pace
from .plan import Plan
from .surroundings import Surroundings

Known = Callable[[float], float]
STEP = 1e-4  # [s] of a step beside its kernels (`python -m vgmpi.bench.studies overhead`)


class Standing(NamedTuple):
    """How all stand at a moment."""

    time: float  # [s]
    steps: float  # since the moment before, in the scene's own cells
    number: tuple[int, ...]  # of particles, of each object and source, of the scene's own
    around: tuple[Surroundings, ...]  # of each, in the scene's own cells


class Rehearsal(NamedTuple):
    """A run of the scene in cells of `cell` [m]."""

    cell: float
    took: float  # [s]
    moments: tuple[Standing, ...]  # one after the other

    @property
    def steps(self) -> float:
        """In the scene's own cells."""
        return sum(one.steps for one in self.moments)

    def work(self, scene: Scene, plan: Plan, pace: Pace) -> np.ndarray:
        """Of all particles in the steps up to each moment, in time on one core (moments,) [ns]."""
        return np.array([
            one.steps * step(scene, replace(plan, count=one.number, surroundings=one.around), pace)
            for one in self.moments
        ])  # fmt: skip

    def ahead(self, scene: Scene, plan: Plan, pace: Pace) -> tuple[Known, Known]:
        """Of a time [s]: what a step costs then [ns], and how many there are in a second."""
        times = np.array([one.time for one in self.moments])
        steps = np.array([max(one.steps, 1e-9) for one in self.moments])
        each = self.work(scene, plan, pace) / steps + 1e9 * STEP
        spans = np.diff(times, prepend=0.0)
        often, middle = steps / spans, times - 0.5 * spans
        return (
            lambda time: float(np.interp(time, times, each)),
            lambda time: float(np.interp(time, middle, often)),
        )

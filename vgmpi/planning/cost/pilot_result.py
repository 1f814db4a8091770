"""Result of a pilot run in coarser cells: where particles go, for the scene's own cells."""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from vgmpi.planning.plan import Plan
from vgmpi.planning.proximity import Proximity
from vgmpi.scene.scene import Scene

from .feature_costs import step_ns
from .throughput import Throughput

TimeFunction = Callable[[float], float]
STEP_SECONDS = (
    1e-4  # [s] overhead of a step besides its kernels (`python -m tests.benchmarks overhead`)
)


class Snapshot(NamedTuple):
    """Snapshot of the particle distribution at a moment of a pilot run."""

    time: float  # [s]
    steps: float  # since the moment before, converted to the scene's own cells
    number: tuple[int, ...]  # particles of each object and inlet, converted to the scene's own
    around: tuple[Proximity, ...]  # proximity of each, converted to the scene's own cells


class PilotRun(NamedTuple):
    """Pilot run of the scene in cells of `cell` [m]."""

    cell: float
    wall_seconds: float  # [s] wall time of the pilot run
    moments: tuple[Snapshot, ...]  # in order of time

    @property
    def steps(self) -> float:
        """Number of steps in the scene's own cells."""
        return sum(m.steps for m in self.moments)

    def work(self, scene: Scene, plan: Plan, pace: Throughput) -> np.ndarray:
        """Return the work of all particles up to each moment on one core, shape (moments,) [ns].

        Args:
            scene: The scene.
            plan: Its plan.
            pace: Throughput of the processor.
        """
        return np.array([
            m.steps * step_ns(scene, replace(plan, count=m.number, surroundings=m.around), pace)
            for m in self.moments
        ])  # fmt: skip

    def ahead(
        self, scene: Scene, plan: Plan, pace: Throughput
    ) -> tuple[TimeFunction, TimeFunction]:
        """Return the cost of a step [ns] and the steps per second, as functions of time [s].

        Args:
            scene: The scene.
            plan: Its plan.
            pace: Throughput of the processor.
        """
        times = np.array([m.time for m in self.moments])
        steps = np.array([max(m.steps, 1e-9) for m in self.moments])
        each = self.work(scene, plan, pace) / steps + 1e9 * STEP_SECONDS
        spans = np.diff(times, prepend=0.0)
        often, middle = steps / spans, times - 0.5 * spans
        return (
            lambda time: float(np.interp(time, times, each)),
            lambda time: float(np.interp(time, middle, often)),
        )

"""Result of a pilot run in coarser cells: where particles go, for the scene's own cells."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from vgmpi.planning.plan import Plan
from vgmpi.planning.step_costs import Proximity
from vgmpi.scene.scene import Scene

from .feature_costs import STEP_SECONDS, step_ns
from .throughput import Throughput

TimeFunction = Callable[[float], float]


class CoarseStep(NamedTuple):
    """Mean step of a pilot run since the snapshot before: what it took, and what it has to do."""

    seconds: float = 0.0  # [s] processor time
    # particles, by the costs of the parts of a step in units of a fluid or elastic particle's
    fluid: float = 0.0
    elastic: float = 0.0

    def overhead(self, pace: Throughput) -> float:
        """Return the processor time [s] besides the particles, which finer cells have as well."""
        particles = 1e-9 * (self.fluid * pace.fluid + self.elastic * pace.elastic)
        return max(STEP_SECONDS, self.seconds - particles)


class Snapshot(NamedTuple):
    """Snapshot of the particle distribution at a moment of a pilot run."""

    time: float  # [s]
    steps: float  # since the moment before, converted to the scene's own cells
    number: tuple[int, ...]  # particles of each object and source, converted to the scene's own
    proximity: tuple[Proximity, ...]  # proximity of each, converted to the scene's own cells
    coarse: CoarseStep = CoarseStep()


class PilotRun(NamedTuple):
    """Pilot run of the scene in cells of `cell` [m]."""

    cell: float
    wall_seconds: float  # [s] wall time of the pilot run
    moments: tuple[Snapshot, ...]  # in order of time
    reached: float = math.inf  # [s] time of the scene up to which it was played; after it, the
    # last moment says what is expected

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
            m.steps * step_ns(scene, plan.with_particles(m.number, m.proximity), pace)
            for m in self.moments
        ])  # fmt: skip

    def overhead(self, pace: Throughput) -> np.ndarray:
        """Return the processor time of a step besides its particles, shape (moments,) [s].

        In the first interval code is loaded: the second stands for it.

        Args:
            pace: Throughput of the processor.
        """
        seconds = np.array([m.coarse.overhead(pace) for m in self.moments])
        if len(seconds) > 1:
            seconds[0] = min(seconds[0], seconds[1])
        return seconds

    def mean_overhead(self, pace: Throughput) -> float:
        """Return the mean over all steps of `overhead` [s]."""
        steps = np.array([m.steps for m in self.moments])
        return float((self.overhead(pace) * steps).sum() / self.steps)

    def remaining_cost(
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
        each = self.work(scene, plan, pace) / steps + 1e9 * self.overhead(pace)
        spans = np.diff(times, prepend=0.0)
        often, middle = steps / spans, times - 0.5 * spans
        return (
            lambda time: float(np.interp(time, times, each)),
            lambda time: float(np.interp(time, middle, often)),
        )

"""Estimate of the remaining wall time from the pace of the last steps."""

import math
from collections.abc import Callable

from vgmpi.planning.plan import Plan

# The averages smooth the disturbance of single steps on a shared machine; a change of pace shows
# after a fraction of the time that has passed.
MIN_MEMORY, MEMORY = 30.0, 0.3  # [s] of wall time, and fraction of the elapsed wall time
MIN_STEPS, STEPS = 20.0, 0.05  # number of time steps, and fraction of the steps so far


class RemainingTimeEstimator:
    """Estimator of the remaining wall time.

    Call `step` after every time step. The first call only sets the origin, because the first step
    includes loading and perhaps compilation. Older steps fade exponentially.
    """

    def __init__(
        self,
        work: Callable[[float], float] = lambda time: 1.0,
        steps_per_second: Callable[[float], float] = lambda time: 1.0,
    ):
        """Set up the estimator with what is known in advance of the steps at a time [s].

        Args:
            work: Work of one step at a time [s], in any unit.
            steps_per_second: Steps per second of simulated time at a time [s], in any unit.
        """
        self.work, self.steps_per_second = work, steps_per_second
        self.origin = self.wall = self.time = math.nan
        self.steps = 0
        # sums that fade: wall time [s], its steps and their work; predicted and completed steps
        self.weighted_wall_time = self.weighted_steps = self.weighted_work = 0.0
        self.predicted_steps = self.completed_steps = 0.0

    def step(self, wall: float, time: float) -> None:
        """Record the end of a step at simulated time `time` [s] and wall time `wall` [s]."""
        if math.isnan(self.wall):
            self.origin, self.wall, self.time = wall, wall, time
            return
        step_wall_time, dt = wall - self.wall, time - self.time
        self.wall, self.time, self.steps = wall, time, self.steps + 1
        # a step fades by the mean step, so that one long step does not wipe out the memory
        mean = (
            self.weighted_wall_time / self.weighted_steps if self.weighted_steps else step_wall_time
        )
        decay = math.exp(-mean / max(MIN_MEMORY, MEMORY * (wall - self.origin)))
        self.weighted_wall_time, self.weighted_steps = (
            decay * self.weighted_wall_time + step_wall_time,
            decay * self.weighted_steps + 1.0,
        )
        self.weighted_work = decay * self.weighted_work + self.work(time)
        decay = math.exp(-1.0 / max(MIN_STEPS, STEPS * self.steps))
        self.predicted_steps = decay * self.predicted_steps + self.steps_per_second(time) * dt
        self.completed_steps = decay * self.completed_steps + 1.0

    def eta(self, end: float) -> float:
        """Return the wall time [s] until simulated time `end` [s]; NaN before the second step."""
        if not self.weighted_work or not self.predicted_steps:
            return math.nan
        remaining, intervals = max(end - self.time, 0.0), 16
        times = [self.time + remaining * (k + 0.5) / intervals for k in range(intervals)]
        work = (
            remaining
            / intervals
            * sum(self.steps_per_second(time) * self.work(time) for time in times)
        )
        return (
            work
            * self.completed_steps
            / self.predicted_steps
            * self.weighted_wall_time
            / self.weighted_work
        )


def work_of(plan: Plan) -> Callable[[float], float]:
    """Return the work of a step as a function of time [s]: its particles, or 1 if unknown."""
    if not plan.has_sources or any(feature.removes_particles for feature in plan.features):
        return lambda time: 1.0

    def particles(time: float) -> float:
        """Return the particles of a step at a time [s]."""
        counts = dict(enumerate(plan.count))
        for feature in plan.features:
            counts |= feature.inserted_counts(time)
        return float(sum(counts.values()))

    return particles

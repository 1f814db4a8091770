"""How long a run has yet to take, by the pace of its last steps."""

import math
from collections.abc import Callable

from ..planning.plan import Plan

# what a machine shared with others does to single steps is averaged out; a change of pace is seen
# after a part of the time it took to come
LEAST_MEMORY, MEMORY = 30.0, 0.3  # of wall time: [s], and share of what has passed
LEAST_STEPS, STEPS = 20.0, 0.05  # of time steps: their number, and share of those made


class Left:
    """Told of every step. The first one counts as the start: it loads, and may compile."""

    def __init__(
        self,
        work: Callable[[float], float] = lambda time: 1.0,
        often: Callable[[float], float] = lambda time: 1.0,
    ):
        """What is known of steps at a time [s], in any unit: work(time), of one, and often(time),
        how many there are in a second."""
        self.work, self.often = work, often
        self.began = self.wall = self.time = math.nan
        self.steps = 0
        # what is old fades: wall time [s], with its steps and their work; steps foreseen and made
        self.spent = self.made = self.done = 0.0
        self.foreseen = self.latest = 0.0

    def step(self, wall: float, time: float) -> None:
        """A step has ended, at a time [s], when a clock on the wall said `wall` [s]."""
        if math.isnan(self.wall):
            self.began, self.wall, self.time = wall, wall, time
            return
        took, dt = wall - self.wall, time - self.time
        self.wall, self.time, self.steps = wall, time, self.steps + 1
        # fades by the steps that fit into the memory, so that one long step wipes out nothing
        mean = self.spent / self.made if self.made else took
        old = math.exp(-mean / max(LEAST_MEMORY, MEMORY * (wall - self.began)))
        self.spent, self.made = old * self.spent + took, old * self.made + 1.0
        self.done = old * self.done + self.work(time)
        old = math.exp(-1.0 / max(LEAST_STEPS, STEPS * self.steps))
        self.foreseen = old * self.foreseen + self.often(time) * dt
        self.latest = old * self.latest + 1.0

    def seconds(self, end: float) -> float:
        """Wall time [s] until the simulated time `end` [s]; nan before the second step."""
        if not self.done or not self.foreseen:
            return math.nan
        ahead, parts = max(end - self.time, 0.0), 16
        times = [self.time + ahead * (k + 0.5) / parts for k in range(parts)]
        work = ahead / parts * sum(self.often(time) * self.work(time) for time in times)
        return work * self.latest / self.foreseen * self.spent / self.done


def work_of(plan: Plan) -> Callable[[float], float]:
    """Particles that a step moves at a time [s], where it is known who comes; else 1."""
    if not plan.sources or plan.sinks:
        return lambda time: 1.0

    def particles(time: float) -> float:
        come = sum(len(source.mouth) * source.born_by(time) for source in plan.sources)
        return float(plan.starts_with + come)

    return particles

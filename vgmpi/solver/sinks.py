"""Particles that end: those inside a sink leave their groups, after every fourth step."""

import numpy as np

from ..domain.state import Group
from ..planning.inflow import SinkPlan
from ..planning.plan import Plan
from ..prepare.shapes import bulge, distance, reach
from .tally import Tally

EVERY = 4  # steps, by their numbers: a restart does not change when
STRAYS = 4.0  # cells from its block's middle that a particle keeps within before a sort


class _Region:
    """A sink, and the box that holds it."""

    def __init__(self, sink: SinkPlan):
        self.shape, self.since = sink.shape, sink.since
        axes = np.eye(3)
        more = bulge(sink.shape)
        self.low = np.array([-reach(sink.shape, -axis) for axis in axes]) - more
        self.high = np.array([reach(sink.shape, axis) for axis in axes]) + more

    def near(self, group: Group, dx: float) -> np.ndarray:
        """Which segments may have particles inside: (segments,)."""
        middle, room = (4 * group.block + 1.5) * dx, STRAYS * dx
        inside = (middle >= self.low - room) & (middle <= self.high + room)
        return np.asarray(inside.all(axis=1))


class Sinks:
    """The sinks of a run."""

    def __init__(self, plan: Plan, tally: Tally):
        self.plan, self.tally = plan, tally
        self.regions = [_Region(sink) for sink in plan.sinks]

    def take(self, groups: list[Group], step: int, time: float) -> bool:
        """Take away this rank's particles that are in a sink after step number `step`, at a time
        [s]. Returns
        whether there were any: then others of this rank have other places."""
        if step % EVERY:
            return False
        found = [self._of(group, g, time) for g, group in enumerate(groups)]
        return any(found)

    def _of(self, group: Group, g: int, time: float) -> bool:
        some = False
        for region in self.regions:
            if time < region.since:
                continue
            near = np.flatnonzero(region.near(group, self.plan.dx) & (group.count > 0))
            if not len(near):
                continue
            at = group.places(near)
            gone = distance(region.shape, group.positions_at(at)) < 0
            if gone.any():
                some = True
                self.tally.take(g, group.get("vol0", at[gone])[:, 0])
                remove(group, at[gone])
        return some


def remove(group: Group, places: np.ndarray) -> None:
    """Take the particles at `places` (n,) out of their segments; the others move up in order. What
    is free is as a sort leaves it, and segments stay until the next one, if with nothing in them:
    tables follow from segments, here and in a run that goes on from a checkpoint."""
    of = group.segment_of(places)
    segments = np.unique(of)
    at = group.places(segments)
    kept = at[~np.isin(at, places)]
    group.count = group.count - np.bincount(of, minlength=len(group.count))
    to = group.places(segments)
    free = np.setdiff1d(at, to, assume_unique=True)
    for rows, nothing in ((group.xi, 0), (group.f, 0), (group.ids[None], -1)):
        rows[:, to] = rows[:, kept]  # what is read is a copy
        rows[:, free] = nothing

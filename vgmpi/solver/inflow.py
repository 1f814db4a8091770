"""What sources bring in a run: layers that are born, are carried to the mouth, and let go.

Where a particle of a nozzle is follows from its id and the time alone (planning/inflow.py), so that
what is let go is right to a particle at any time, on any number of ranks and after a restart. Until
then a particle has the velocity of the flow and the state of rest, whatever the grid says. It is
let go a little before the mouth (EARLY of planning/inflow.py), so that its fall begins there.
"""

from typing import NamedTuple

import numpy as np

from ..domain.blocks import BITS, EDGE, MIDDLE
from ..domain.ranks import Alone
from ..domain.state import Group
from ..engines.base import Report
from ..gaussians.sh import dc_from_rgb
from ..planning.inflow import SourcePlan
from ..planning.plan import Plan
from .enter import Rows, bounds

OWN = ("vol0", "colour", "surface")  # what a particle keeps that is carried


class _Carried(NamedTuple):
    """Particles of this rank in the nozzle of a source, as of the last sort."""

    source: SourcePlan
    group: Group
    at: np.ndarray  # (n,) places
    block: np.ndarray  # (n, 3)
    ids: np.ndarray  # (n,)
    let_go: np.ndarray  # (n,) [s] when each is

    def after(self, time: float) -> "_Carried":
        """Those that are not let go up to a time [s]."""
        still = self.let_go > time
        if still.all():
            return self
        return self._replace(
            at=self.at[still],
            block=self.block[still],
            ids=self.ids[still],
            let_go=self.let_go[still],
        )


class Sources:
    """The sources of a run. `find` after every sort; `carry` after every step and `hold` after
    every step of no time; `bring` where `due`, before a sort."""

    def __init__(self, plan: Plan, ranks: Alone):
        self.plan, self.ranks = plan, ranks
        self.carried: list[_Carried] = []
        self.least = np.zeros(4)  # bounds as of enter.bounds while something comes
        for source in plan.sources:
            group, v = plan.groups[source.group], source.velocity[None]
            found = bounds(plan, group, [group.rest], v, np.zeros((1, 9)))
            self.least = np.maximum(self.least, found)
        self.last = max(source.passes(source.layers - 1) for source in plan.sources)

    def bound(self, found: np.ndarray, time: float) -> np.ndarray:
        """Maxima (rate, speed, turn, stress) over all particles, with those of what comes."""
        return np.maximum(found, self.least) if time <= self.last else found

    def find(self, groups: list[Group], time: float) -> None:
        """Where the particles in nozzles are now."""
        self.carried = []
        for source in self.plan.sources:
            n, group = len(source.mouth), groups[source.group]
            first = source.first + source.free_by(time) * n
            last = source.first + source.born_by(time) * n
            at = group.index()
            at = at[(group.ids[at] >= first) & (group.ids[at] < last)]
            block, ids = group.block[group.segment_of(at)], group.ids[at]
            let_go = source.let_go((ids - source.first) // n)
            self.carried.append(_Carried(source, group, at, block, ids, let_go))

    def carry(self, report: Report, time: float) -> Report:
        """Put what is carried where it is at `time` [s], the end of the step; let go whose time
        it is. Returns the report with how far it has come."""
        far = report.far
        for one in self.carried:
            if len(one.at):
                far = max(far, self._place(one, time))
        self.hold()
        self.carried = [one.after(time) for one in self.carried]
        return report._replace(far=far)

    def _place(self, one: _Carried, time: float) -> float:
        """Returns how far [cells] the farthest is from its block's middle."""
        bits, group = BITS[np.dtype(self.plan.real)], one.group
        x = one.source.places(one.ids, time) / self.plan.dx - (EDGE * one.block + MIDDLE)
        xi = np.rint(np.ldexp(x, bits)).astype(np.int64)
        group.xi[:, one.at] = xi.T.astype(group.xi.dtype)
        return float(np.ldexp(np.abs(xi).max().astype(float), -bits))

    def hold(self) -> None:
        """Give what is carried its velocity and the state of rest."""
        for one in self.carried:
            for channel in one.group.plan.channels if len(one.at) else ():
                if channel.name not in OWN:
                    one.group.f[channel.rows, one.at] = np.array(channel.rest)[:, None]
            if len(one.at):
                one.group.put("v", one.at, np.tile(one.source.velocity, (len(one.at), 1)))

    def due(self, before: float | None, time: float) -> bool:
        """Whether a layer is born after `before` [s], None: the start, up to and with `time`."""
        return any(first < last for first, last in self._layers(before, time))

    def _layers(self, before: float | None, time: float) -> list[tuple[int, int]]:
        return [
            (0 if before is None else source.born_by(before), source.born_by(time))
            for source in self.plan.sources
        ]

    def bring(self, before: float | None, time: float) -> list[Rows]:
        """The particles that are born then; all on one rank, from where a sort sends them."""
        if self.ranks.rank != 0:
            return []
        spans = zip(self.plan.sources, self._layers(before, time), strict=True)
        return [self._rows(one, *span, time) for one, span in spans if span[0] < span[1]]

    def _rows(self, source: SourcePlan, first: int, last: int, time: float) -> Rows:
        n = len(source.mouth)
        ids = source.first + np.arange(first * n, last * n)
        v = np.tile(source.velocity, (len(ids), 1))
        sh = np.zeros((len(ids), self._coefficients(), 3))
        sh[:, 0] = dc_from_rgb(np.array(source.colour)).astype(np.float32)  # as in files
        return Rows(
            source.places(ids, time),
            v,
            np.full(len(ids), source.volume),
            ids,
            np.full(len(ids), source.thing),
            sh=sh,
        )

    def _coefficients(self) -> int:
        return max(1, *(group.coefficients for group in self.plan.groups))

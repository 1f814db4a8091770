"""What each collider, each body that is driven and each wall has given to the others since the
start: impulse, its moment and work, the same bits on any number of ranks."""

import math
from collections.abc import Sequence

import numpy as np

from ..domain.driven import Driven
from ..domain.movers import Movers
from ..domain.ranks import Alone
from ..domain.state import Group
from ..kernels.given import NUMBERS, WALLS
from ..planning.plan import Plan

SPARE = 16.0  # of mass times a cell per step: what impulses of a step add up to, at the very most
BITS = 62  # of whole numbers


class Given:
    """totals: (rows, 7) impulse [kg m/s] on the bodies, its moment [kg m2/s] about the row's own
    point, work [J]; colliders in the scene's order, what is driven, then west, east, south, north,
    floor, roof.

    The point of a collider, or of a body that is driven, is what it turns about, where that is at
    the time; of one at rest the middle of its extent; of a wall its middle. mass:
    [kg] that bodies do not exceed.
    """

    def __init__(self, plan: Plan, colliders: Sequence, ranks: Alone):
        self.plan, self.ranks = plan, ranks
        self.colliders = [collider.name for collider in colliders]
        self.moving = [m for m, one in enumerate(colliders) if one.course is not None]
        driven = [one.about for one in plan.driven]
        self.points = np.array([*map(_point, colliders), *driven, *_middles(plan)])
        self.totals = np.zeros((len(self.points), NUMBERS))
        self.quanta = np.ones(NUMBERS)
        self.mass = 0.0

    def weigh(self, groups: list[Group]) -> None:
        """Find what the bodies' mass does not exceed, now and later. Collective."""
        most = np.zeros(len(groups))
        for g, group in enumerate(groups):
            most[g] = group.get("vol0", group.index()).max(initial=0.0)
        most = self.ranks.max(most)
        if self.plan.sources:  # none of their particles may be here yet
            most = np.maximum(most, self.plan.dx**3)
        self.mass = sum(
            n * float(most[g]) * self.plan.groups[g].density
            for n, g in zip(self.plan.count, self.plan.group_of, strict=True)
            if g >= 0
        )

    def begin(self, dt: float) -> None:
        """Choose what sums of a step of dt [s] are counted in. Nothing goes further than a cell in
        a step, so that they cannot leave their range."""
        plan = self.plan
        speed, far = plan.dx / dt, 2.0 * plan.dx * (max(plan.cells) + 2)
        most = self.mass * speed * (SPARE + 4.0 * plan.restores)
        one = _power(most) * 2.0**-BITS
        self.quanta[:3], self.quanta[3:6] = one, one * _power(far)
        self.quanta[6] = one * _power(4.0 * speed)

    def row(self, name: str, thing: int) -> int:
        """That of a collider by its name, or of a body that is driven by its number."""
        if name in self.colliders:
            return self.colliders.index(name)
        found = [k for k, one in enumerate(self.plan.driven) if thing in one.things]
        return len(self.colliders) + found[0]

    def take(self, counted: np.ndarray, movers: Movers | None, driven: Driven | None) -> None:
        """Add what a step gave on this rank, (rows, 7) whole numbers. Collective."""
        found = self.ranks.sum(counted) * self.quanta
        about = self.points.copy()
        if driven is not None:
            phases = [self.plan.groups[one.group].phase for one in self.plan.driven]
            about[driven.ways.row[phases]] = driven.ways.about[phases]
        if movers is not None:
            table = movers.table
            about[self.moving] = (table.about + table.move)[self.moving]
        (px, py, pz), (jx, jy, jz) = about.T, found[:, :3].T
        found[:, 3] -= py * jz - pz * jy
        found[:, 4] -= pz * jx - px * jz
        found[:, 5] -= px * jy - py * jx
        self.totals += found

    def saved(self) -> dict:
        """What a checkpoint keeps."""
        return {"mass": self.mass, "totals": self.totals.tolist()}

    def adopt(self, saved: dict) -> None:
        """Go on from that, if it is of as many colliders."""
        totals = np.array(saved["totals"], np.float64)
        if totals.shape == self.totals.shape:
            self.totals, self.mass = totals, float(saved["mass"])


def _power(value: float) -> float:
    """A power of two that is not below a number."""
    return 2.0 ** math.ceil(math.log2(value)) if value > 0.0 else 1.0


def _point(collider) -> tuple[float, float, float]:
    """What a collider turns about, at the start [m]."""
    if collider.course is not None:
        return tuple(collider.course.about)
    low, high = collider.ends()
    return tuple(0.5 * (low + high))


def _middles(plan: Plan) -> list[tuple[float, float, float]]:
    """The middle of each wall [m]."""
    size = np.array(plan.cells) * plan.dx
    found = []
    for wall in range(WALLS):
        middle = 0.5 * size
        middle[wall // 2] = wall % 2 * size[wall // 2]
        found.append(tuple(middle))
    return found

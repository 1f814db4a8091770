"""Colliders of which some move, as the grid sees them step by step."""

from collections.abc import Callable

import numpy as np

from ..scene.motion import Courses
from .blocks import EDGE, Lattice
from .sampled import Sampled, place
from .solids import REACH

FINE = 0.5  # cells between the points at which a collider's distance is known
STRAY = 1.0  # cells that a collider may go before the blocks near it are found anew
FAR = 0.3  # cells that one may go in a step
HALVES = 20  # times at which a step is shortened for that
_MOST = 500_000  # points looked at together


class Movers:
    """Distance, normal and velocity of the nearest collider, for the node blocks they can touch
    until one has gone STRAY cells. All know the same; nothing is sent.

    nodes: (n, 64, 4) outward normal and distance [m]; moves: (n, 64, 3) velocity [m/s]; whose: (n,
    64) number of the nearest, where that is `asked`, else (0, 64); blocks (n, 3). Colliders offer,
    at rest, distance(points) -> (m,) [m] and ends() -> its corners, and `course`, or None for one
    at rest.
    """

    def __init__(self, colliders: list, lattice: Lattice, real: np.dtype, asked: bool = False):
        self.dx, self.real, self.colliders = lattice.dx, real, colliders
        self.asked = asked
        self.table = _sampled(colliders, lattice.dx)
        self.moving = [m for m, collider in enumerate(colliders) if collider.course is not None]
        self.courses = Courses([colliders[m].course for m in self.moving])
        self.far = np.array([colliders[m].course.far(*colliders[m].ends()) for m in self.moving])
        self.since = 0.0  # [s] when blocks were found
        self.now = 0.0
        self.take(np.zeros((0, 3), np.int64))

    def __call__(self, block: np.ndarray) -> np.ndarray:
        """Numbers of those of the blocks (n, 3) that a collider is near, among these; else -1."""
        near = np.zeros(len(block), bool)
        for m in range(len(self.colliders)):
            near[self._near(m, block)] = True
        return np.where(near, np.cumsum(near) - 1, -1)

    def _near(self, m: int, block: np.ndarray) -> np.ndarray:
        """Which of the blocks (n, 3) a collider is near."""
        collider, table = self.colliders[m], self.table
        limit = (0.5 * np.sqrt(3.0) * (EDGE - 1) + REACH + STRAY) * self.dx
        x = (EDGE * block - 1 + (EDGE - 1) / 2) * self.dx - table.about[m] - table.move[m]
        r = table.rotation[m]
        # written out: all ranks must agree, and a matrix product's rounding may differ
        own = x[:, :1] * r[0] + x[:, 1:2] * r[1] + x[:, 2:] * r[2] + table.about[m]
        low, high = collider.ends()
        out = np.maximum(np.maximum(low - own, own - high), 0.0)
        close = np.flatnonzero((out**2).sum(axis=1) < limit**2)
        return close[collider.distance(own[close]) < limit]

    def take(self, blocks: np.ndarray) -> None:
        """The blocks (n, 3) of this rank that a collider is near, in the order of their numbers."""
        self.blocks, self.since = np.ascontiguousarray(blocks), self.now
        near = [self._near(m, self.blocks) for m in range(len(self.colliders))]
        at = np.concatenate(near)
        order = np.argsort(at, kind="stable")
        who = np.repeat(np.arange(len(near)), [len(each) for each in near])[order]
        self.near = np.searchsorted(at[order], np.arange(len(blocks) + 1)), who
        self.nodes = np.zeros((len(blocks), 64, 4), self.real)
        self.moves = np.zeros((len(blocks), 64, 3), self.real)
        self.whose = np.zeros((len(blocks) * self.asked, 64), np.int64)

    def stand(self, time: float) -> None:
        """Colliders stand where they are at a time [s]."""
        self.now, table = time, self.table
        table.rotation[self.moving], table.move[self.moving] = self.courses.poses(time)

    def go(self, time: float, end: float, dt: float) -> None:
        """Where they are at a time [s], and how they move until `end`, dt [s] later."""
        self.stand(time)
        table = self.table
        table.rotation_end[self.moving], table.move_end[self.moving] = self.courses.poses(end)
        place(self.blocks, *self.near, table, dt, self.dx, self.nodes, self.moves, self.whose)

    def poses(self, time: float) -> np.ndarray:
        """Place at the start -> place at a time [s], of those that move: (m, 4, 4) [m]."""
        return self.courses.matrices(time)

    def travels(self, t0: float, t1: float) -> float:
        """How far a point of one goes between two times [s], at the most [cells]."""
        return float(self.courses.travels(t0, t1, self.far).max()) / self.dx

    def rate(self, time: float, rate: float) -> float:
        """1 / dt [1/s], `rate` or more, of a step in which none goes farther than it may."""
        return shortened(self.travels, time, rate)

    def strayed(self, time: float) -> bool:
        """Whether the blocks near them have to be found anew."""
        return self.travels(self.since, time) > STRAY / 2


def shortened(travels: Callable[[float, float], float], time: float, rate: float) -> float:
    """1 / dt [1/s], `rate` or more, of a step in which what moves goes no more than FAR.
    travels(t0, t1): how far it goes [cells]."""
    for _ in range(HALVES):
        gone = travels(time, time + 1.0 / rate)
        if gone <= FAR:
            break
        rate *= max(1.1, gone / FAR)
    return rate


def _sampled(colliders: list, dx: float) -> Sampled:
    """The signed distances of colliders at rest, each on a lattice around it."""
    values, shapes, starts, spacing = [], [], [], FINE * dx
    for collider in colliders:
        low, high = collider.ends()
        start = low - (REACH + 1) * dx
        shape = np.ceil((high - low + 2 * (REACH + 1) * dx) / spacing).astype(np.int64) + 1
        values.append(_on_lattice(collider, start, shape, spacing))
        shapes.append(shape)
        starts.append(start)
    m = len(colliders)
    about = [c.course.about if c.course is not None else (0.0, 0.0, 0.0) for c in colliders]
    first = np.concatenate([[0], np.cumsum([len(v) for v in values])[:-1]]).astype(np.int64)
    turned = np.tile(np.eye(3), (m, 1, 1))
    return Sampled(
        np.concatenate(values), first, np.array(shapes), np.array(starts), spacing,
        np.array(about), turned, np.zeros((m, 3)), turned.copy(), np.zeros((m, 3)),
    )  # fmt: skip


def _on_lattice(collider, start: np.ndarray, shape: np.ndarray, spacing: float) -> np.ndarray:
    out = np.empty(int(np.prod(shape)))
    for low in range(0, len(out), _MOST):
        index = np.stack(np.unravel_index(np.arange(low, min(low + _MOST, len(out))), shape), -1)
        out[low : low + _MOST] = collider.distance(start + spacing * index)
    return out

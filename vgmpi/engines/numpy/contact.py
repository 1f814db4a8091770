"""Contact of phases, node by node: who touches whom, and the impulses that keep them apart.

The rule is docs/theory.md's: surfaces of solids are known, those of others are found from the
volumes and mean offsets of a phase's particles; impulses of all pairs of a node are found together,
by accumulated Jacobi sweeps.
"""

import numpy as np

from ...couplings.base import CONTACT
from ...device.limits import TOUCHING
from ...domain.driven import NOTHING
from ...domain.solids import REACH
from ...kernels.contact import (
    AHEAD,
    CLOSE,
    EASE,
    FLOWING,
    LARGEST,
    LAYER,
    SOFT,
    SPRING,
    SURE,
    SWEEPS,
    TOUCH,
)
from ...kernels.given import WALLS
from ...planning.plan import Plan
from .dense import Dense
from .given import Given

NOBODY = None, np.zeros(3), np.zeros(4), 1.0  # who is rigid where two phases meet


def outside(m: float) -> float:
    """Distance [cells] of a node outside a half space of particles that lie m cells off on average:
    the fit by which the rule is defined."""
    if m >= 0.75:
        return min((m - 0.375) / 0.75, 1.5)
    if m <= 0.0:
        return -1.5
    s = np.cbrt(m)
    return -1.5 + 1.524778 * s + 0.998001 * s**2 - 1.124705 * s**3 + 0.933773 * s**4


class Contact:
    """Who touches whom."""

    def __init__(self, plan: Plan, dense: Dense):
        self.plan, self.dx, self.shape = plan, plan.dx, dense.shape
        self.collider, self.moves = np.zeros((0, 4)), np.zeros((*dense.shape, 3))
        self.friction = np.zeros((0, 0))
        self.near = np.zeros(dense.shape, bool)  # to a collider
        self.planes, self.there = np.zeros(dense.shape, int), plan.planes
        self._lay()
        self.least = np.array([TOUCHING * phase.least for phase in plan.phases])
        self.walls = dense
        self.whose = np.zeros(dense.shape, int)
        self.ways = NOTHING  # of what is driven
        self.given: Given | None = None  # where somebody asks what rigid things give

    def meet(
        self, collider: np.ndarray, whose: np.ndarray, moves: np.ndarray | None = None
    ) -> None:
        """collider: outward normal and distance [m] of the nearest at all nodes, (n, 4); whose: its
        number (n,); moves: its velocity [m/s] (n, 3), or None where all are at rest."""
        rows = np.array(self.plan.friction)[len(self.plan.phases) :]
        self.friction = rows[np.minimum(whose, len(rows) - 1)].reshape(*self.shape, -1)
        self.collider = collider.reshape(*self.shape, 4)
        self.whose = whose.reshape(self.shape)
        self.near = self.collider[..., 3] < REACH * self.dx
        if moves is not None:
            self.moves = moves.reshape(*self.shape, 3)

    def open(self, axis: int, side: int) -> None:
        """A wall has vanished."""
        self.there = tuple(one for one in self.there if (one.axis, one.side) != (axis, side))
        self._lay()

    def _lay(self) -> None:
        """On how many planes, of walls that push, each node lies."""
        self.planes[:] = 0
        for plane in self.there:
            np.moveaxis(self.planes, plane.axis, 0)[plane.node + 1] += 1

    def along_walls(self, offset: np.ndarray) -> None:
        """The mirror image cancels what lies across a mirroring wall. offset: (phases, ..., 3)."""
        for axis, kind, _, wall, _, _ in self.walls.ends():
            if kind != "separate":
                np.moveaxis(offset, axis + 1, 0)[wall, ..., axis] = 0.0

    def act(
        self, v: np.ndarray, mass: np.ndarray, heavy: np.ndarray, offset: np.ndarray,
        volume: np.ndarray, slope: np.ndarray, dt: float,
    ) -> int:  # fmt: skip
        """Change velocities v (phases, ..., 3) where phases touch. heavy: mass, beyond all measure
        of what is driven; offset, volume: of phases whose
        surfaces are known, mass times normal and mass times distance; slope: change of v per cell
        along such a surface's normal, 0 of others; dt [s]. Returns at how many nodes one acted on
        another."""
        here = mass > self.least[:, None, None, None]
        several = here.sum(0) + self.near + self.planes > 1
        acted = 0
        for node in map(tuple, np.argwhere(several & here.any(0))):
            at = (slice(None), *node)
            sides = [
                _Side(self.dx, phase.surface, phase.least, X, V, m)
                for phase, X, V, m in zip(self.plan.phases, offset[at], volume[at], mass[at],
                                          strict=True)
            ]  # fmt: skip
            there, u, m = np.flatnonzero(here[at]), v[at], heavy[at]
            alone = len(there) + self.near[node] + self.planes[node] == 2
            change, pairs = np.zeros_like(u), []
            for a, b, n, one, other, friction, stiff, rigid in self._meetings(
                node, there, sides, u
            ):
                both = {b: other} if a is None else {a: one, b: other}  # that move
                known = all(sides[k].known for k in both)
                sure = any(sides[k].known for k in both)
                sure = sure and all(sides[k].sure for k in both if sides[k].known)
                r = (u[a] if a is not None else rigid[1]) - u[b]
                if sure:
                    slides = r + other * slope[at][b]
                    if a is not None:
                        slides = slides - one * slope[at][a]
                    share = min(sides[k].share(far) for k, far in both.items())
                    gap = one + other + (EASE if known else -AHEAD)
                    push = _push(
                        r, slides, m, a, b, n, gap, one - other, share * stiff, friction, dt,
                        self.dx,
                    )  # fmt: skip
                    acted += bool(push.any())
                    self._tell(node, rigid, push)
                    if a is not None:
                        change[a] -= push / m[a]
                    change[b] += push / m[b]
                if _touching(one, other, known, sure) and not (alone and r @ n <= 0):
                    pairs.append((-1 if a is None else a, b, n, friction, rigid))
            u += change
            if pairs:
                for pair, push in zip(pairs, _resolve(u, m, pairs), strict=True):
                    self._tell(node, pair[-1], push)
                acted += 1
        return acted

    def _tell(self, node: tuple, rigid: tuple, push: np.ndarray) -> None:
        """An impulse (3,) at a node, by one of `_meetings`."""
        row, speed, surface, sign = rigid
        if self.given is not None and row is not None:
            at = self.given.points[node] - surface[3] * surface[:3]
            self.given.add(row, at, sign * push, sign * float(push @ speed))

    def _by(self, a: int, b: int, u: np.ndarray) -> tuple:
        """Of two phases with velocities u (phases, 3) the one that is driven, as of `_meetings`."""
        for one, sign in ((a, 1.0), (b, -1.0)):
            if len(self.ways.driven) and self.ways.driven[one]:
                return int(self.ways.row[one]), u[one].copy(), np.zeros(4), sign
        return NOBODY

    def _meetings(self, node, there, sides, u):
        """Who may touch at a node: (a or None for what is rigid, b, normal of a, distances from
        both [cells], friction, stiffness [Pa], of what is rigid or driven its row in Given,
        velocity [m/s], normal and distance [m], and 1 where it is a, or rigid, else -1). u:
        velocities (phases, 3)."""
        plan, rules = self.plan, self.plan.rules
        for q, one in enumerate(there):
            for other in there[q + 1 :]:
                if rules is not None and rules.pair[one, other] != CONTACT:
                    continue
                if plan.phases[one].driven and plan.phases[other].driven:
                    continue
                first = plan.phases[one].mastery < plan.phases[other].mastery
                a, b = (one, other) if first else (other, one)
                n = _normal(sides[a], sides[b])
                if n is not None:
                    stiff = 1.0 / (1.0 / plan.stiff[a] + 1.0 / plan.stiff[b])
                    far = sides[a].distance(n), sides[b].distance(-n)
                    yield a, b, n, *far, plan.friction[one][other], stiff, self._by(a, b, u)
        rigid = []
        if self.near[node]:
            own = int(self.whose[node]), self.moves[node], self.collider[node], 1.0
            rigid = [(*self.collider[node], self.friction[node], True, own)]
        for plane in self.there:
            if node[plane.axis] == plane.node + 1:
                n = np.zeros(3)
                n[plane.axis] = 1.0 - 2.0 * plane.side
                own = 2 * plane.axis + plane.side - WALLS, np.zeros(3), np.zeros(4), 1.0
                rigid.append((*n, 0.0, [plane.friction] * len(sides), False, own))
        for *n, far, friction, flows, own in rigid:
            for b in there:
                if plan.phases[b].driven:
                    continue
                if sides[b].there and (flows or sides[b].known):
                    out = np.array(n)
                    yield (
                        None, b, out, far / self.dx, sides[b].distance(-out), friction[b],
                        plan.stiff[b], own,
                    )  # fmt: skip


class _Side:
    """What a node knows of a phase there."""

    def __init__(self, dx: float, known: bool, full: float, X: np.ndarray, V: float, mass: float):
        self.dx, self.known, self.X, self.V, self.mass, self.full = dx, known, X, V, mass, full
        self.there = bool(X.any()) if known else V > 0

    @property
    def sure(self) -> bool:
        """Whether its particles agree where the surface is."""
        return self.known and self.there and float(np.linalg.norm(self.X / self.mass)) > SURE

    def distance(self, n: np.ndarray) -> float:
        """Of the node outside the phase [cells], whose normal there is n."""
        if self.known:
            return self.V / (self.mass * self.dx)
        return outside(-(self.X @ n) / (self.V * self.dx))

    def share(self, distance: float) -> float:
        """Of a cell's face that is the node's."""
        return min(self.mass / (self.full * max(filled(distance), 1e-3)), LARGEST)


def filled(D: float) -> float:
    """Share of a cell's mass at a node D cells outside a half space (quadratic B-splines)."""
    if abs(D) >= 1.5:
        return float(D < 0)
    if abs(D) <= 0.5:
        return 0.5 - 0.75 * D + D**3 / 3.0
    tail = (1.5 - abs(D)) ** 3 / 6.0
    return tail if D > 0 else 1.0 - tail


def _push(r, slides, mass, a, b, n, gap, lean, stiff, friction, dt, dx) -> np.ndarray:
    """Impulse (3,) [kg m/s] on b of an elastic layer, with friction. r: velocity of a less b's;
    slides: that of their surfaces; gap: sum of the distances from both [cells] less where it
    begins; lean: their difference."""
    deep, middle = min(-gap, SOFT), abs(lean) / 2
    if deep <= 0.0 or middle >= 1.0:
        return np.zeros(3)
    reduced = mass[b] if a is None else mass[a] * mass[b] / (mass[a] + mass[b])
    push = dt * SPRING * stiff * deep * (1.0 - middle) * dx**2
    push = min(push, reduced * (max(r @ n, 0.0) + 0.5 * deep * dx / dt))
    slide = slides - (slides @ n) * n
    size = float(np.linalg.norm(slide))
    rub = friction * push / size if size * reduced > friction * push else reduced
    return push * n + rub * slide


def _normal(a: _Side, b: _Side):
    """Outward normal of a, None where there is none."""
    if not (a.there and b.there):
        return None
    if a.known or b.known:
        n = np.zeros(3)
        for side, sign in ((a, 1.0), (b, -1.0)):
            if side.known:
                mean = side.X / side.mass
                n += sign * (mean @ mean) ** 16 * mean
        size = np.linalg.norm(n)
        return n / size if size > 0 else None
    for side, sign in ((a, -1.0), (b, 1.0)):
        size = np.linalg.norm(side.X)
        if size > 1e-6 * side.dx * side.V:
            return sign * side.X / size
    return None


def _touching(one: float, other: float, known: bool, sure: bool) -> bool:
    """Whether surfaces may not approach, from which a node is so far [cells]; known: both are;
    sure: one is, and all that are agree."""
    if known:
        return one + other <= (-SOFT if sure else CLOSE) and abs(one - other) <= 2 * LAYER
    return one + other <= (-FLOWING if sure else TOUCH)


def _resolve(v: np.ndarray, mass: np.ndarray, pairs: list[tuple]) -> list[np.ndarray]:
    """Change the velocities (phases, 3) of a node so that no touching pair approaches. Returns
    the impulse of each pair on its second."""
    touches = np.zeros(len(mass), int)
    for a, b, *_ in pairs:
        touches[b] += 1
        if a >= 0:
            touches[a] += 1
    relax = 1.0 / touches.max()
    normal, slide = np.zeros(len(pairs)), np.zeros((len(pairs), 3))
    for _ in range(SWEEPS if len(pairs) > 1 else 1):
        change, pushes = 0.0, []
        for q, (a, b, n, friction, (_, base, *_)) in enumerate(pairs):
            r = (v[a] if a >= 0 else base) - v[b]
            reduced = mass[a] * mass[b] / (mass[a] + mass[b]) if a >= 0 else mass[b]
            approach = r @ n
            total = max(0.0, normal[q] + relax * reduced * approach)
            t = slide[q] + relax * reduced * (r - approach * n)
            size = np.linalg.norm(t)
            if size > friction * total:
                t = t * (friction * total / size)
            pushes.append((total - normal[q]) * n + (t - slide[q]))
            change = max(change, abs(total - normal[q]) / reduced)
            normal[q], slide[q] = total, t
        for (a, b, *_), push in zip(pairs, pushes, strict=True):
            if a >= 0:
                v[a] -= push / mass[a]
            v[b] += push / mass[b]
        if change < 1e-13:
            break
    return [normal[q] * pair[2] + slide[q] for q, pair in enumerate(pairs)]

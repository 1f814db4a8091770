"""Contact of phases, node by node: who touches whom, and the impulses that keep them apart.

The rule is docs/theory.md's: surfaces of solids are known, those of others are found from the
volumes and mean offsets of a phase's particles; impulses of all pairs of a node are found together,
by accumulated Jacobi sweeps.
"""

import numpy as np

from ...couplings.base import CONTACT
from ...device.limits import TOUCHING
from ...domain.solids import REACH
from ...kernels.contact import CLOSE, LAYER, SWEEPS, TOUCH
from ...planning.plan import Plan
from .dense import Dense


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
    """collider: outward normal and distance [m] at all nodes, (n, 4), or None."""

    def __init__(self, plan: Plan, dense: Dense, collider: np.ndarray | None):
        self.plan, self.dx, self.collider = plan, plan.dx, np.zeros((0, 4))
        self.near = np.zeros(dense.shape, bool)  # to a collider
        if collider is not None:
            self.collider = collider.reshape(*dense.shape, 4)
            self.near = self.collider[..., 3] < REACH * plan.dx
        # walls that push what has a surface: (axis, side, node, friction)
        self.pushing = [
            (axis, int(node > 0), node, plan.walls[2 * axis + int(node > 0)][1])
            for axis, node in plan.planes
        ]
        self.planes = np.zeros(dense.shape, int)  # on how many of them a node lies
        for axis, _, node, _ in self.pushing:
            np.moveaxis(self.planes, axis, 0)[node + 1] += 1
        self.least = np.array([TOUCHING * phase.least for phase in plan.phases])
        self.walls = dense

    def along_walls(self, offset: np.ndarray) -> None:
        """The mirror image cancels what lies across a mirroring wall. offset: (phases, ..., 3)."""
        for axis, kind, _, wall, _, _ in self.walls.ends():
            if kind != "separate":
                np.moveaxis(offset, axis + 1, 0)[wall, ..., axis] = 0.0

    def act(self, v: np.ndarray, mass: np.ndarray, offset: np.ndarray, volume: np.ndarray) -> int:
        """Change velocities v (phases, ..., 3) where phases touch and approach. offset, volume: of
        phases whose surfaces are known, mass times normal and mass times distance. Returns at how
        many nodes."""
        here = mass > self.least[:, None, None, None]
        several = here.sum(0) + self.near + self.planes > 1
        acted = 0
        for node in map(tuple, np.argwhere(several & here.any(0))):
            at = (slice(None), *node)
            sides = [
                _Side(self.dx, phase.surface, X, V, m)
                for phase, X, V, m in zip(self.plan.phases, offset[at], volume[at], mass[at],
                                          strict=True)
            ]  # fmt: skip
            pairs = self._pairs(node, np.flatnonzero(here[at]), v[at], sides)
            if pairs:
                _resolve(v[at], mass[at], pairs)
                acted += 1
        return acted

    def _pairs(self, node, there, v, sides) -> list[tuple]:
        """(master or -1, other, normal of the master, friction) of the pairs that touch. One that
        is alone at its node and parts is left out."""
        plan, rules = self.plan, self.plan.rules
        solid = self.collider[node] if self.near[node] else None
        alone = len(there) + (solid is not None) + self.planes[node] == 2
        found = []
        for q, one in enumerate(there):
            if solid is not None and sides[one].there:
                friction = plan.friction[len(plan.phases)][one]
                self._rigid(found, alone, one, v[one], sides[one], solid, friction)
            for other in there[q + 1 :]:
                if rules is not None and rules.pair[one, other] != CONTACT:
                    continue
                first = plan.phases[one].mastery < plan.phases[other].mastery
                a, b = (one, other) if first else (other, one)
                n = _normal(sides[a], sides[b])
                if n is None or (alone and (v[a] - v[b]) @ n <= 0):
                    continue
                if _touching(sides[a].distance(n), sides[b].distance(-n),
                             sides[a].known and sides[b].known):  # fmt: skip
                    found.append((a, b, n, plan.friction[one][other]))
        for axis, side, number, friction in self.pushing:
            if node[axis] == number + 1:
                wall = np.zeros(4)
                wall[axis] = 1.0 - 2.0 * side
                for one in there:
                    if sides[one].known and sides[one].there:
                        self._rigid(found, alone, one, v[one], sides[one], wall, friction)
        return found

    def _rigid(self, found, alone, one, v, side, surface, friction) -> None:
        """Note that a phase touches what does not move: surface: (4,) normal and distance [m]."""
        n, distance = surface[:3], surface[3] / self.dx
        if not (alone and v @ n >= 0) and _touching(distance, side.distance(-n), side.known):
            found.append((-1, one, n, friction))


class _Side:
    """What a node knows of a phase there."""

    def __init__(self, dx: float, known: bool, X: np.ndarray, V: float, mass: float):
        self.dx, self.known, self.X, self.V, self.mass = dx, known, X, V, mass
        self.there = bool(X.any()) if known else V > 0

    def distance(self, n: np.ndarray) -> float:
        """Of the node outside the phase [cells], whose normal there is n."""
        if self.known:
            return self.V / (self.mass * self.dx)
        return outside(-(self.X @ n) / (self.V * self.dx))


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


def _touching(one: float, other: float, known: bool) -> bool:
    """Whether surfaces touch, from which a node is so far [cells]; known: both are."""
    if known:
        return one + other <= CLOSE and abs(one - other) <= 2 * LAYER
    return one + other <= TOUCH


def _resolve(v: np.ndarray, mass: np.ndarray, pairs: list[tuple]) -> None:
    """Change the velocities (phases, 3) of a node so that no touching pair approaches."""
    touches = np.zeros(len(mass), int)
    for a, b, _, _ in pairs:
        touches[b] += 1
        if a >= 0:
            touches[a] += 1
    relax = 1.0 / touches.max()
    normal, slide = np.zeros(len(pairs)), np.zeros((len(pairs), 3))
    for _ in range(SWEEPS if len(pairs) > 1 else 1):
        change, pushes = 0.0, []
        for q, (a, b, n, friction) in enumerate(pairs):
            r = (v[a] if a >= 0 else 0.0) - v[b]
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
        for (a, b, _, _), push in zip(pairs, pushes, strict=True):
            if a >= 0:
                v[a] -= push / mass[a]
            v[b] += push / mass[b]
        if change < 1e-13:
            break

"""Contact between velocity fields on dense arrays, node by node, in plain NumPy.

Finds the pairs of phases in contact and the impulses that keep them apart. The rule is that of
docs/explanation/contact.md: the surfaces of solids are known, other surfaces are found from the
volumes and mean offsets of a phase's particles. The impulses of all pairs at a node are found
together, by accumulated Jacobi sweeps.
"""

from typing import Any

import numpy as np

from vgmpi.kernels.colliders.static_colliders import SDF_BAND_CELLS
from vgmpi.kernels.grid.contact_impulses import (
    FULL_CONTACT_DISTANCE,
    GAP_RESOLVED,
    GAP_UNRESOLVED,
    LAYER_GAP_FLUID,
    LAYER_HALF_WIDTH,
    LAYER_MAX_OVERLAP,
    LAYER_OFFSET,
    LAYER_STIFFNESS,
    MAX_FACE_FRACTION,
    MAX_OVERLAP_FLUID,
    NO_CONTACT_DISTANCE,
    NORMAL_RELIABILITY_MIN,
    OVERLAP_HALF_WIDTH,
    SWEEPS,
    WALL_ALIGNMENT_MIN,
    WALL_OVERLAP_ROUND,
)
from vgmpi.kernels.kernel_arguments import CONTACT_MASS_FLOOR
from vgmpi.kernels.reaction_impulses import WALLS
from vgmpi.kernels.rigid.prescribed_motion import NO_PRESCRIBED_BODIES
from vgmpi.materials.couplings.interaction import CONTACT
from vgmpi.planning.plan import Plan

from .dense_grid import PUSHING, Dense
from .reaction_impulses import ReactionSums

NO_CONTACT = None, np.zeros(3), np.zeros(4), 1.0  # no rigid body takes part in a pair of phases


def outside(m: float) -> float:
    """Return the distance of a node outside a half space of particles [cells].

    This fit defines the rule.

    Args:
        m: Mean offset of the particles from the node [cells].
    """
    if m >= 0.75:
        return min((m - 0.375) / 0.75, 1.5)
    if m <= 0.0:
        return -1.5
    s = np.cbrt(m)
    return -1.5 + 1.524778 * s + 0.998001 * s**2 - 1.124705 * s**3 + 0.933773 * s**4


class Contact:
    """Contact detection and contact impulses at all nodes."""

    def __init__(self, plan: Plan, dense: Dense):
        self.plan, self.dx, self.shape = plan, plan.dx, dense.shape
        self.collider, self.moves = np.zeros((0, 4)), np.zeros((*dense.shape, 3))
        self.friction = np.zeros((0, 0))
        self.near_collider = np.zeros(
            dense.shape, bool
        )  # nodes close to a collider that is no free body
        self.is_free = np.zeros(0, bool)  # of the colliders, or empty
        self.reserved: np.ndarray | None = None  # (phases, ...) bool: features attach it
        self.division: Any = None  # what divides nodes between phases, see `ActiveFeature`
        self.planes, self.active_planes = np.zeros(dense.shape, int), plan.planes
        self._count_planes()
        self.contact_mass = np.array(
            [CONTACT_MASS_FLOOR * phase.min_cell_mass for phase in plan.phases]
        )
        self.walls = dense
        self.collider_number = np.zeros(dense.shape, int)
        self.motions = NO_PRESCRIBED_BODIES  # motion of prescribed bodies
        self.reactions: ReactionSums | None = None  # set where reactions are requested

    def set_rigid(
        self, collider: np.ndarray, collider_number: np.ndarray, moves: np.ndarray | None = None
    ) -> None:
        """Set the nearest collider at all nodes.

        Args:
            collider: Outward normal and distance [m], shape (n, 4).
            collider_number: Index of the collider, shape (n,).
            moves: Velocity of the collider [m/s], shape (n, 3), or None if all are at rest.
        """
        rows = np.array(self.plan.contact.friction)[len(self.plan.phases) :]
        self.friction = rows[np.minimum(collider_number, len(rows) - 1)].reshape(*self.shape, -1)
        self.collider = collider.reshape(*self.shape, 4)
        self.collider_number = collider_number.reshape(self.shape)
        self.near_collider = self.collider[..., 3] < SDF_BAND_CELLS * self.dx
        if len(self.is_free):  # free bodies couple after all others
            self.near_collider &= ~self.is_free[self.collider_number]
        if moves is not None:
            self.moves = moves.reshape(*self.shape, 3)

    def open(self, axis: int, side: int) -> None:
        """Remove a wall that has vanished."""
        planes = self.active_planes
        self.active_planes = tuple(p for p in planes if (p.axis, p.side) != (axis, side))
        self._count_planes()

    def _count_planes(self) -> None:
        """Count the walls that only push at each node of their planes and a cell beyond."""
        self.planes[:] = 0
        for plane in self.active_planes:
            nodes = [plane.node + 1, plane.node + 2 * plane.side]
            np.moveaxis(self.planes, plane.axis, 0)[nodes] += 1

    def along_walls(self, offset: np.ndarray) -> None:
        """Remove the offset across mirroring walls, which the mirror image cancels.

        Args:
            offset: Sums of offsets (in/out), shape (phases, ..., 3).
        """
        for p in range(len(offset)):
            for axis, kind, _, wall, _, _ in self.walls.wall_planes(p):
                if kind not in PUSHING:
                    np.moveaxis(offset[p], axis, 0)[wall, ..., axis] = 0.0

    def apply(
        self, v: np.ndarray, mass: np.ndarray, heavy: np.ndarray, offset: np.ndarray,
        volume: np.ndarray, slope: np.ndarray, dt: float,
    ) -> int:  # fmt: skip
        """Apply contact impulses to the velocities where phases touch.

        Args:
            v: Velocities (in/out), shape (phases, ..., 3) [m/s].
            mass: Masses, shape (phases, ...) [kg].
            heavy: Masses for collisions, huge for prescribed bodies [kg].
            offset, volume: Mass times normal and distance of known surfaces, else offsets, volumes.
            slope: Change of v per cell along the normal of a known surface, 0 elsewhere.
            dt: Length of the step [s].

        Returns:
            Number of nodes with contact.
        """
        present = mass > self.contact_mass[:, None, None, None]
        several, acted = present.sum(0) + self.near_collider + self.planes > 1, 0
        for node in map(tuple, np.argwhere(several & present.any(0))):
            index = (slice(None), *node)
            sides = [
                _PhaseAtNode(self.dx, phase.surface, phase.min_cell_mass, X, V, m)
                for phase, X, V, m in zip(self.plan.phases, offset[index], volume[index],
                                          mass[index], strict=True)
            ]  # fmt: skip
            phases, u, m = np.flatnonzero(present[index]), v[index], heavy[index]
            is_pair = len(phases) + self.near_collider[node] + self.planes[node] == 2
            change, pairs = np.zeros_like(u), []
            for a, b, n, d_a, d_b, friction, stiff, rigid in self._pairs(node, phases, sides, u):
                distances = {b: d_b} if a is None else {a: d_a, b: d_b}  # of moving ones
                resolved = [sides[k] for k in distances if sides[k].has_surface]
                all_known = len(resolved) == len(distances)
                is_sure = bool(resolved) and all(side.is_sure for side in resolved)
                slip = (u[a] if a is not None else rigid[1]) - u[b]
                if is_sure:
                    motion_of_a = 0.0 if a is None else d_a * slope[index][a]
                    surface_slip = slip + d_b * slope[index][b] - motion_of_a
                    fraction = min(sides[k].face_fraction(d) for k, d in distances.items())
                    gap = d_a + d_b + (LAYER_OFFSET if all_known else -LAYER_GAP_FLUID)
                    push = _push(
                        slip, surface_slip, m, a, b, n, gap, d_a - d_b,
                        fraction * stiff, friction, dt, self.dx,
                    )  # fmt: skip
                    acted += bool(push.any())
                    self._record(node, rigid, push)
                    if a is not None:
                        change[a] -= push / m[a]
                    change[b] += push / m[b]
                part = _contact_fraction(d_a, all_known or not (a is None or sides[a].has_surface))
                separates = is_pair and slip @ n <= 0
                faces = a is None and rigid[0] < 0 and sides[b].faces(n)  # a wall
                if part > 0 and not separates and _touching(d_a, d_b, all_known, is_sure, faces):
                    pairs.append((-1 if a is None else a, b, n, friction, part, rigid))
            u += change
            if pairs:
                for pair, push in zip(pairs, _resolve(u, m, pairs), strict=True):
                    self._record(node, pair[-1], push)
                acted += 1
        return acted

    def _record(self, node: tuple, rigid: tuple, push: np.ndarray) -> None:
        """Record the reaction to an impulse (3,) at a node; rigid: last entry of `_pairs`."""
        row, speed, surface, sign = rigid
        if self.reactions is not None and row is not None:
            position = self.reactions.points[node] - surface[3] * surface[:3]
            self.reactions.add(row, position, sign * push, sign * float(push @ speed))

    def _prescribed_of(self, a: int, b: int, u: np.ndarray) -> tuple:
        """Return the prescribed body of two phases as in `_pairs`; u: (phases, 3) [m/s]."""
        for phase, sign in ((a, 1.0), (b, -1.0)):
            if len(self.motions.driven) and self.motions.driven[phase]:
                return int(self.motions.row[phase]), u[phase].copy(), np.zeros(4), sign
        return NO_CONTACT

    def _pairs(self, node, phases, sides, u):
        """Yield the pairs that may touch at a node; u: velocities, shape (phases, 3) [m/s].

        A pair holds a (None for a rigid body), b, normal of a, distances from both [cells],
        friction, stiffness [Pa], and a rigid or prescribed body: its reaction row, velocity [m/s],
        normal and distance [m], and 1 where it is a or rigid, else -1.
        """
        plan, pair_rules = self.plan, self.plan.pair_rules
        for q, p in enumerate(phases):
            for p_other in phases[q + 1 :]:
                if pair_rules is not None and pair_rules[p, p_other] != CONTACT:
                    continue
                if plan.phases[p].driven and plan.phases[p_other].driven:
                    continue
                if self.division is not None and self.division.are_apart(p, p_other, node):
                    continue
                first = plan.phases[p].contact_priority < plan.phases[p_other].contact_priority
                a, b = (p, p_other) if first else (p_other, p)
                n = _normal(sides[a], sides[b])
                if n is not None:
                    stiffness = 1.0 / (
                        1.0 / plan.contact.stiffness[a] + 1.0 / plan.contact.stiffness[b]
                    )
                    distance = sides[a].distance(n), sides[b].distance(-n)
                    yield (
                        a,
                        b,
                        n,
                        *distance,
                        plan.contact.friction[p][p_other],
                        stiffness,
                        self._prescribed_of(a, b, u),
                    )
        rigid = []
        if self.near_collider[node]:
            body = int(self.collider_number[node]), self.moves[node], self.collider[node], 1.0
            rigid = [(*self.collider[node], self.friction[node], True, body)]
        for plane in self.active_planes:
            inward = 1.0 - 2.0 * plane.side
            depth = inward * (plane.node + 1 - node[plane.axis])
            if 0 <= depth <= 1:
                n = np.zeros(4)
                n[plane.axis], n[3] = inward, -depth * self.dx
                body = 2 * plane.axis + plane.side - WALLS, np.zeros(3), n, 1.0
                rigid.append((*n, [plane.friction] * len(sides), False, body))
        for *n, distance, friction, acts_on_fluid, body in rigid:
            for b in phases:
                if plan.phases[b].driven:
                    continue
                if acts_on_fluid and self.reserved is not None and self.reserved[b, *node]:
                    continue  # colliders do not touch bodies there
                if sides[b].is_present and (acts_on_fluid or plan.phases[b].meets_walls_by_contact):
                    outward, depth = np.array(n), distance
                    if acts_on_fluid and self.division is not None:
                        outward, depth = self.division.face(b, node, outward, distance)
                    yield (
                        None, b, outward, depth / self.dx, sides[b].distance(-outward),
                        friction[b], plan.contact.stiffness[b], body,
                    )  # fmt: skip


class _PhaseAtNode:
    """Surface of one phase at a node."""

    def __init__(
        self, dx: float, has_surface: bool, full_mass: float, X: np.ndarray, V: float, mass: float
    ):
        self.dx, self.has_surface, self.full_mass = dx, has_surface, full_mass
        self.X, self.V, self.mass = X, V, mass
        self.is_present = bool(X.any()) if has_surface else V > 0

    @property
    def is_sure(self) -> bool:
        """Tell if the particles agree on the position of the surface."""
        return (
            self.has_surface
            and self.is_present
            and float(np.linalg.norm(self.X / self.mass)) > NORMAL_RELIABILITY_MIN
        )

    def distance(self, n: np.ndarray) -> float:
        """Return the distance of the node outside the phase [cells]; n: normal there."""
        if self.has_surface:
            return self.V / (self.mass * self.dx)
        return outside(-(self.X @ n) / (self.V * self.dx))

    def faces(self, n: np.ndarray) -> bool:
        """Return whether the mean normal is opposite to that of a wall, n."""
        return bool(-self.X @ n > WALL_ALIGNMENT_MIN * np.linalg.norm(self.X))

    def face_fraction(self, distance: float) -> float:
        """Return the fraction of a cell face that belongs to the node."""
        return min(self.mass / (self.full_mass * max(filled(distance), 1e-3)), MAX_FACE_FRACTION)


def filled(D: float) -> float:
    """Return the fraction of a cell's mass at a node D cells outside a half space (B-splines)."""
    if abs(D) >= 1.5:
        return float(D < 0)
    if abs(D) <= 0.5:
        return 0.5 - 0.75 * D + D**3 / 3.0
    tail = (1.5 - abs(D)) ** 3 / 6.0
    return tail if D > 0 else 1.0 - tail


def _push(r, surface_slip, mass, a, b, n, gap, lean, stiffness, friction, dt, dx) -> np.ndarray:
    """Return the impulse of an elastic layer with friction on b, shape (3,) [kg m/s].

    r: velocity of a minus that of b; surface_slip: slip of their surfaces; gap: sum of both
    distances [cells] minus the gap at which the layer begins; lean: difference of the distances.
    """
    overlap, eccentricity = min(-gap, LAYER_MAX_OVERLAP), abs(lean) / 2
    if overlap <= 0.0 or eccentricity >= 1.0:
        return np.zeros(3)
    reduced_mass = mass[b] if a is None else mass[a] * mass[b] / (mass[a] + mass[b])
    impulse = dt * LAYER_STIFFNESS * stiffness * overlap * (1.0 - eccentricity) * dx**2
    impulse = min(impulse, reduced_mass * (max(r @ n, 0.0) + 0.5 * overlap * dx / dt))
    tangential = surface_slip - (surface_slip @ n) * n
    slip_speed = float(np.linalg.norm(tangential))
    friction_factor = (
        friction * impulse / slip_speed
        if slip_speed * reduced_mass > friction * impulse
        else reduced_mass
    )
    return impulse * n + friction_factor * tangential


def _normal(a: _PhaseAtNode, b: _PhaseAtNode):
    """Return the outward normal of a, None where there is none."""
    if not (a.is_present and b.is_present):
        return None
    if a.has_surface or b.has_surface:
        n = np.zeros(3)
        for side, sign in ((a, 1.0), (b, -1.0)):
            if side.has_surface:
                mean = side.X / side.mass
                n += sign * (mean @ mean) ** 16 * mean
        size = np.linalg.norm(n)
        return n / size if size > 0 else None
    for side, sign in ((a, -1.0), (b, 1.0)):
        size = np.linalg.norm(side.X)
        if size > 1e-6 * side.dx * side.V:
            return sign * side.X / size
    return None


def _touching(d_a: float, d_b: float, both_known: bool, is_sure: bool, faces_wall: bool) -> bool:
    """Tell if two surfaces may not approach at a node.

    d_a, d_b: distances of the node from both [cells]; both_known: both surfaces are known; is_sure:
    one is known, and all known ones agree; faces_wall: a is a wall, which b faces.
    """
    if both_known:
        gap = -LAYER_MAX_OVERLAP if is_sure else GAP_RESOLVED
        is_deep = is_sure or (faces_wall and d_a + d_b <= -WALL_OVERLAP_ROUND)
        half_width = OVERLAP_HALF_WIDTH if is_deep else LAYER_HALF_WIDTH
        return d_a + d_b <= gap and abs(d_a - d_b) <= 2 * half_width
    return d_a + d_b <= (-MAX_OVERLAP_FLUID if is_sure else GAP_UNRESOLVED)


def _contact_fraction(distance: float, is_whole: bool = False) -> float:
    """Return the fraction of its approach that a flow loses outside a known surface [cells]."""
    if is_whole:
        return 1.0
    part = (NO_CONTACT_DISTANCE - distance) / (NO_CONTACT_DISTANCE - FULL_CONTACT_DISTANCE)
    return float(np.clip(part, 0.0, 1.0))


def _resolve(v: np.ndarray, mass: np.ndarray, pairs: list[tuple]) -> list[np.ndarray]:
    """Change the velocities (phases, 3) of a node so that no touching pair approaches.

    Returns the impulse of each pair on its second body.
    """
    touches = np.zeros(len(mass), int)
    for a, b, *_ in pairs:
        touches[b] += 1
        if a >= 0:
            touches[a] += 1
    relax = 1.0 / touches.max()
    normal, slide = np.zeros(len(pairs)), np.zeros((len(pairs), 3))
    residual_slip = [
        (1.0 - part) * ((v[a] if a >= 0 else base) - v[b])
        for a, b, _, _, part, (_, base, *_) in pairs
    ]
    for _ in range(SWEEPS if len(pairs) > 1 else 1):
        change, pushes = 0.0, []
        for q, (a, b, n, friction, _, (_, base, *_)) in enumerate(pairs):
            r = (v[a] if a >= 0 else base) - v[b] - residual_slip[q]
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

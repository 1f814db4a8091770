"""Contact of phases at one node: surface distances and contact impulses.

Solids store their resolved surface at the nodes: its normal and the distance from it, averaged over
the particles (nodal_fields/surface_distance.py), so that neighboring nodes agree and sliding bodies
do not stick. Where the normals are reliable, bodies meet through an elastic penalty layer; at
edges, and in contact with fluids and granular phases, impulses prevent any approach. Phases that
flow store the volume V and the mean offset X / V of their particles at the nodes: for a half space
this gives the distance of the node from it (`distance_from_mean_offset`). The velocity alone would
act 1.2 to 2 cells too early. Next to a known surface, what flows loses all of its approach at the
surface and less of it farther outside (`contact_fraction`): a cell away, a flow may turn before it
gets there. The impulses of all pairs of a node are computed together (accumulated
Jacobi from the same velocities): a sweep of one pair after the other would depend on the numbering
of the phases.
"""

from typing import NamedTuple

import numpy as np

from vgmpi.kernels.reaction_impulses import ReactionSums
from vgmpi.runtime.jit import always_inline, device_function

GAP_UNRESOLVED = 0.25  # [cells] gap below which two surfaces touch if one of the phases flows
GAP_RESOLVED = 0.02  # [cells] gap below which two resolved surfaces touch
# [cells] distance from the middle between two resolved surfaces to the nodes that separate them:
# forces that act deeper have a shorter arm, and press in front of the point of contact
LAYER_HALF_WIDTH = 0.75
NORMAL_RELIABILITY_MIN = 0.9  # [-] length of a mean normal above which it counts as reliable
# [cells] distance outside a known surface up to which a phase that flows loses all of its approach,
# and from which it loses none
FULL_CONTACT_DISTANCE, NO_CONTACT_DISTANCE = 0.25, 1.05
LAYER_OFFSET = (
    0.01  # [cells] overlap from which the layer pushes: bodies that just touch may separate
)
LAYER_STIFFNESS = (
    0.4  # [-] stiffness of the layer relative to a cell's: it is two and a half cells thick
)
LAYER_MAX_OVERLAP = 0.25  # [cells] largest overlap that the elastic layer takes up
# [cells] half width of the layer beyond that overlap: the nodes a cell inside the other surface
# carry half of what has come so far
OVERLAP_HALF_WIDTH = 1.0
# [cells] overlap with a wall beyond which it stops the nodes a cell beyond it too, where a body has
# no reliable normals but faces it: the lowest particles of a round body follow these nodes
WALL_OVERLAP_ROUND = 0.05
WALL_ALIGNMENT_MIN = 0.97  # [-] cosine between normals from which a body faces a wall
LAYER_GAP_FLUID = (
    0.15  # [cells] gap from which the layer pushes phases that flow, whose surface is vaguer
)
MAX_OVERLAP_FLUID = 0.05  # [cells] overlap beyond which such a phase may not approach
MAX_FACE_FRACTION = 1.5  # [-] upper bound of the fraction of a cell face per node
RESIDUAL_SLIP = 7  # column of a pair's normal and scratch where the slip that it keeps begins
SWEEPS = 16  # Jacobi iterations of a node with several pairs
# indices, counted from the end, of the rigid rows of velocities: walls (at rest) and the collider
WALL_ROW, COLLIDER_ROW = -1, -2
# two thirds of the exponent's bias, adjusted so that a third of the bits is closest (fdlibm)
_EXPONENT_OFFSET = 715094163 << 32


@device_function
def distance_from_mean_offset(m):
    """Return the distance [cells] of a node outside a half space of particles.

    The formula is a fit to quadratic B-splines, accurate to 0.003; below 0 the node is deep inside,
    above 0.75 it sees only the far side.

    Args:
        m: Mean offset of the particles into the half space [cells].
    """
    if m >= 0.75:
        return min((m - 0.375) / 0.75, 1.5)
    if m <= 0.0:
        return -1.5
    s = cube_root(m)
    return -1.5 + s * (1.524778 + s * (0.998001 + s * (-1.124705 + s * 0.933773)))


@device_function
def has_surface(side, is_resolved):
    """Return whether a phase has any surface at a node; side: (4,) of the offset field."""
    if is_resolved:
        return side[0] != 0.0 or side[1] != 0.0 or side[2] != 0.0
    return side[3] > 0.0


@device_function
def surface_normal(normal, a, b, mass_a, mass_b, resolved_a, resolved_b, dx):
    """Compute the unit normal from phase a to phase b; return False if there is none.

    If both surfaces are resolved, the normal is their mean, weighted by how well the particles of
    each agree, as they do on a face. Otherwise it is the normal of the resolved surface, or else of
    the first phase whose particles lie to one side.

    Args:
        normal: Unit normal out of a (out), shape (3,).
        a: Nodal values of the offset field of phase a, shape (4,).
        b: Nodal values of the offset field of phase b, shape (4,).
        mass_a: Nodal mass of phase a [kg].
        mass_b: Nodal mass of phase b [kg].
        resolved_a: Whether the values of a describe a resolved surface.
        resolved_b: Whether the values of b describe a resolved surface.
        dx: Cell size [m].
    """
    if resolved_a or resolved_b:
        wa = _normal_agreement_weight(a, mass_a) if resolved_a else 0.0
        wb = _normal_agreement_weight(b, mass_b) if resolved_b else 0.0
        for c in range(3):
            normal[c] = wa * a[c] - wb * b[c]
        return normalize(normal, 0.0)
    for c in range(3):
        normal[c] = -a[c]
    if normalize(normal, 1e-6 * dx * a[3]):
        return True
    for c in range(3):
        normal[c] = b[c]
    return normalize(normal, 1e-6 * dx * b[3])


@device_function
def _normal_agreement_weight(side, mass):
    """Return the weight of a surface normal, a high power of its mean length over the mass.

    The power is 1 on a face and small at an edge, whose direction is that of neither face.
    """
    long2 = _squared_length(side, mass)
    long8 = long2 * long2 * long2 * long2
    return long8 * long8 * long8 * long8 / mass


@device_function
def normal_is_reliable(side, mass):
    """Return whether the particles at a node agree on the direction of their surface.

    Args:
        side: Nodal values of a resolved surface, shape (4,).
        mass: Nodal mass [kg].
    """
    return _squared_length(side, mass) > NORMAL_RELIABILITY_MIN * NORMAL_RELIABILITY_MIN


@device_function
def _squared_length(side, mass):
    """Return the squared length of the mean normal."""
    x, y, z = side[0] / mass, side[1] / mass, side[2] / mass
    return x * x + y * y + z * z


@device_function
def normalize(n, min_length):
    """Scale a vector (3,) to length 1; return False if it is not longer than `min_length`."""
    size = np.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
    if not size > min_length:
        return False
    for c in range(3):
        n[c] /= size
    return True


@device_function
def distance(n, sign, side, mass, is_resolved, dx):
    """Return the distance [cells] of a node outside a phase.

    Args:
        n: Unit normal, shape (3,).
        sign: 1 or -1: `sign * n` is the outward normal of the phase at the node.
        side: Nodal values of the offset field of the phase, shape (4,).
        mass: Nodal mass [kg].
        is_resolved: Whether the surface of the phase is resolved.
        dx: Cell size [m].
    """
    if is_resolved:
        return side[3] / (mass * dx)
    along = side[0] * n[0] + side[1] * n[1] + side[2] * n[2]
    return distance_from_mean_offset(-sign * along / (side[3] * dx))


class ContactPair(NamedTuple):
    """Contact pair of two phases at a node; the first may be a rigid body."""

    a: int  # phase at the node, or WALL_ROW or COLLIDER_ROW
    b: int  # phase at the node
    distance_a: float  # [cells] distance of the node outside a
    distance_b: float  # [cells] distance of the node outside b
    both_resolved: bool  # whether both surfaces are resolved
    one_resolved: bool  # whether that of a is resolved
    normals_reliable: (
        bool  # whether a surface is resolved and the normals of all resolved ones are reliable
    )
    share: float  # [-] fraction of a cell face that belongs to the node, if reliable
    stiff: float  # [Pa] modulus of the two materials in series
    friction: float  # [-] Coulomb coefficient
    faces_wall: bool  # whether a is a wall, which the surface of b faces


@device_function
def faces_wall(n, side):
    """Return whether the mean normal of a resolved surface is opposite to that of a wall.

    Args:
        n: Unit normal of the wall, shape (3,).
        side: Nodal values of the surface, shape (4,).
    """
    along = side[0] * n[0] + side[1] * n[1] + side[2] * n[2]
    cosine2 = WALL_ALIGNMENT_MIN * WALL_ALIGNMENT_MIN
    return along < 0.0 and along * along > cosine2 * _squared_length(side, 1.0)


@device_function
def in_contact(m):
    """Return whether the surfaces of a contact pair are too close to approach further."""
    gap = m.distance_a + m.distance_b
    if m.both_resolved:
        if m.normals_reliable:
            nearest, half_width = -LAYER_MAX_OVERLAP, OVERLAP_HALF_WIDTH
        else:
            nearest, half_width = GAP_RESOLVED, LAYER_HALF_WIDTH
            if m.faces_wall and gap <= -WALL_OVERLAP_ROUND:
                half_width = OVERLAP_HALF_WIDTH
        return gap <= nearest and abs(m.distance_a - m.distance_b) <= 2.0 * half_width
    return gap <= (-MAX_OVERLAP_FLUID if m.normals_reliable else GAP_UNRESOLVED)


@device_function
def contact_fraction(m):
    """Return the fraction of their approach that the phases of a contact pair lose at a node.

    It is less than 1 where a phase that flows is at some distance from a known surface. A sharp
    bound would make contact stronger or weaker as a surface moves through the cells.
    """
    if m.both_resolved or not m.one_resolved:
        return 1.0
    width = NO_CONTACT_DISTANCE - FULL_CONTACT_DISTANCE
    return min(max((NO_CONTACT_DISTANCE - m.distance_a) / width, 0.0), 1.0)


@device_function
def half_space_fraction(D):
    """Return the fraction of a cell's mass at a node D cells outside a half space.

    The fraction is that of quadratic B-splines.
    """
    if D >= 0.5:
        remainder = max(1.5 - D, 0.0)
        return remainder * remainder * remainder / 6.0
    if D >= -0.5:
        return 0.5 - 0.75 * D + D * D * D / 3.0
    remainder = max(1.5 + D, 0.0)
    return 1.0 - remainder * remainder * remainder / 6.0


@device_function
def face_fraction(mass, full, D):
    """Return the fraction of a cell face that belongs to a node D cells outside a body.

    It is less than 1 at the edges of the body.

    Args:
        mass: Nodal mass [kg].
        full: Mass of a cell full of the body [kg].
        D: Distance of the node outside the body [cells].
    """
    return min(mass / (full * max(half_space_fraction(D), 1e-3)), MAX_FACE_FRACTION)


@device_function
def apply_penalty_layer(change, v, slope, mass, m, n, dt, dx):
    """Apply the elastic penalty layer and Coulomb friction of one contact pair at a node.

    The layer is two and a half cells of the two materials, under the faces of the nodes. Because it
    stores energy, falling bodies rebound, rolling ones are pressed as much behind as in front, and
    small errors of the normal do not brake sliding. A node of vanishing mass is not thrown: in a
    step the overlap is reduced by at most one half.

    Args:
        change: Velocity increments of the phases (in/out), shape (count, 3) [m/s].
        v: Velocities, shape (count + 2, 3) [m/s]; the last two rows are those of rigid bodies.
        slope: Velocity change per cell along the normal of a resolved surface, shape (count, 3)
            [m/s]; it gives the slip at the surface instead of at the node.
        mass: Nodal masses, shape (count,) [kg].
        m: Contact pair.
        n: Unit normal out of phase a, shape (3,).
        dt: Time step [s].
        dx: Cell size [m].
    """
    offset = LAYER_OFFSET if m.both_resolved else -LAYER_GAP_FLUID
    overlap, asymmetry = (
        min(-m.distance_a - m.distance_b - offset, LAYER_MAX_OVERLAP),
        0.5 * abs(m.distance_a - m.distance_b),
    )
    if not (overlap > 0.0 and asymmetry < 1.0):
        return
    r0, r1, r2 = v[m.a, 0] - v[m.b, 0], v[m.a, 1] - v[m.b, 1], v[m.a, 2] - v[m.b, 2]
    reduced = mass[m.b]
    if m.a >= 0:
        reduced = mass[m.a] * mass[m.b] / (mass[m.a] + mass[m.b])
    rn = r0 * n[0] + r1 * n[1] + r2 * n[2]
    push = dt * LAYER_STIFFNESS * m.stiff * overlap * m.share * (1.0 - asymmetry) * dx * dx
    push = min(push, reduced * (max(rn, 0.0) + 0.5 * overlap * dx / dt))
    r0, r1, r2 = (
        r0 + m.distance_b * slope[m.b, 0],
        r1 + m.distance_b * slope[m.b, 1],
        r2 + m.distance_b * slope[m.b, 2],
    )  # fmt: skip
    if m.a >= 0:
        r0, r1, r2 = (
            r0 - m.distance_a * slope[m.a, 0],
            r1 - m.distance_a * slope[m.a, 1],
            r2 - m.distance_a * slope[m.a, 2],
        )  # fmt: skip
    rn = r0 * n[0] + r1 * n[1] + r2 * n[2]
    r0, r1, r2 = r0 - rn * n[0], r1 - rn * n[1], r2 - rn * n[2]
    size = np.sqrt(r0 * r0 + r1 * r1 + r2 * r2)
    max_friction = m.friction * push
    drag = max_friction / size if size * reduced > max_friction else reduced
    i0, i1, i2 = push * n[0] + drag * r0, push * n[1] + drag * r1, push * n[2] + drag * r2
    if m.a >= 0:
        _add(change[m.a], i0, i1, i2, -1.0 / mass[m.a])
    _add(change[m.b], i0, i1, i2, 1.0 / mass[m.b])


@device_function
def _add(target, x, y, z, k):
    """Add k (x, y, z) to the vector `target`."""
    target[0] += k * x
    target[1] += k * y
    target[2] += k * z


@device_function
def _store_residual_slip(v, fraction, a, b, n):
    """Store the part of their slip that a pair of phases keeps behind its normal."""
    for c in range(3):
        n[RESIDUAL_SLIP + c] = (1.0 - fraction) * (v[a, c] - v[b, c])


@device_function
def _slip(v, a, b, n):
    """Return the slip of a pair that its impulses remove, from velocities and `n`."""
    return (
        v[a, 0] - v[b, 0] - n[RESIDUAL_SLIP],
        v[a, 1] - v[b, 1] - n[RESIDUAL_SLIP + 1],
        v[a, 2] - v[b, 2] - n[RESIDUAL_SLIP + 2],
    )


@device_function
def solve_contact_impulses(
    v, mass, count, normals, friction, fraction, pair_a, pair_b, pairs, share, impulse
):
    """Compute the contact impulses of a node, so that no touching pair approaches.

    A pair whose fraction is less than 1 keeps the rest of its slip. Momentum is exact.

    Args:
        v: Velocities (in/out), shape (count + 2, 3) [m/s]; the last two rows are of rigid bodies.
        mass: Nodal masses, shape (count,) [kg].
        count: Number of phases at the node.
        normals: Outward normals of the first phase of each pair, then scratch, shape (pairs, 10).
        friction: Friction coefficients, shape (pairs,).
        fraction: Fractions of the slip that the pairs lose, see `contact_fraction`, shape (pairs,).
        pair_a, pair_b: Phases of each pair; the first one (master) may be a collider or wall.
        pairs: Number of pairs.
        share: Largest number of pairs of any one phase.
        impulse: Normal and tangential impulses so far (out), shape (pairs, 4) [kg m/s].
    """
    for q in range(pairs):
        for c in range(4):
            impulse[q, c] = 0
        _store_residual_slip(v, fraction[q], pair_a[q], pair_b[q], normals[q])
    relax = 1.0 / share
    for _ in range(SWEEPS if pairs > 1 else 1):
        change = 0.0
        for q in range(pairs):
            a, b, n = pair_a[q], pair_b[q], normals[q]
            r0, r1, r2 = _slip(v, a, b, n)
            reduced = mass[b]
            if a >= 0:
                reduced = mass[a] * mass[b] / (mass[a] + mass[b])
            rn = r0 * n[0] + r1 * n[1] + r2 * n[2]
            total = max(0.0, impulse[q, 0] + relax * reduced * rn)
            k = relax * reduced
            t0 = impulse[q, 1] + k * (r0 - rn * n[0])
            t1 = impulse[q, 2] + k * (r1 - rn * n[1])
            t2 = impulse[q, 3] + k * (r2 - rn * n[2])
            size = np.sqrt(t0 * t0 + t1 * t1 + t2 * t2)
            max_friction = friction[q] * total
            if size > max_friction:
                slide = max_friction / size
                t0, t1, t2 = t0 * slide, t1 * slide, t2 * slide
            normals[q, 3] = total - impulse[q, 0]
            normals[q, 4], normals[q, 5], normals[q, 6] = (
                t0 - impulse[q, 1],
                t1 - impulse[q, 2],
                t2 - impulse[q, 3],
            )
            impulse[q, 0], impulse[q, 1], impulse[q, 2], impulse[q, 3] = total, t0, t1, t2
            change = max(change, abs(normals[q, 3]) / reduced)
        for q in range(pairs):
            a, b, n = pair_a[q], pair_b[q], normals[q]
            for c in range(3):
                push = n[3] * n[c] + n[4 + c]
                if a >= 0:
                    v[a, c] -= push / mass[a]
                v[b, c] += push / mass[b]
        if change < 1e-13:
            break


class ContactWorkspace(NamedTuple):
    """Scratch of one thread for contact at one node.

    It serves n phases, a collider and walls, and m pairs.
    """

    v: np.ndarray  # (n + 2, 3) [m/s] velocities, the last two of the collider and of walls
    mass: np.ndarray  # (n,) [kg]
    effective_mass: np.ndarray  # (n,) [kg] effective mass, huge for phases with prescribed motion
    node_block: np.ndarray  # (n,) node block of each phase at the node
    slope: np.ndarray  # (n, 3) [m/s per cell] velocity slope along a resolved surface's normal
    change: np.ndarray  # (n, 3) [m/s] velocity increments by elastic layers
    normals: np.ndarray  # (m, 10) normal, and scratch of the solver
    impulse: np.ndarray  # (m, 4) [kg m/s] normal and tangential
    friction: np.ndarray  # (m,) [-]
    fraction: np.ndarray  # (m,) [-] fraction of the slip that a pair loses
    master: np.ndarray  # (m,) first phase of each pair
    other: np.ndarray  # (m,) second phase of each pair
    pair_count: np.ndarray  # (n,) number of pairs of each phase
    plane: np.ndarray  # (4,) normal of a wall, and distance of the node from it [m]
    row: np.ndarray  # (n,) [-] friction of a wall
    reactions: ReactionSums | None = None  # reaction sums, if requested


def contact_workspace(n: int) -> ContactWorkspace:
    """Allocate contact scratch for n phases."""
    m = n * (n + 1) // 2 + 3 * n
    return ContactWorkspace(
        v=np.zeros((n + 2, 3)), slope=np.zeros((n, 3)), change=np.zeros((n, 3)), mass=np.zeros(n),
        effective_mass=np.zeros(n), node_block=np.zeros(n, np.int64),
        normals=np.zeros((m, 10)), impulse=np.zeros((m, 4)), friction=np.zeros(m),
        fraction=np.zeros(m),
        master=np.zeros(m, np.int64), other=np.zeros(m, np.int64), pair_count=np.zeros(n, np.int64),
        plane=np.zeros(4), row=np.zeros(n),
    )  # fmt: skip


@always_inline
def cube_root(x):
    """Return the cube root of a positive number, to a rounding or two.

    Halley's iteration, which cubes the error in each step, starts from a third of the exponent,
    which is within 4 %.
    """
    x = np.float64(x)
    t = np.int64(x.view(np.int64) // 3 + _EXPONENT_OFFSET).view(np.float64)
    for _ in range(3):
        r = x / (t * t)
        t = t + t * ((r - t) / (t + t + r))
    return t

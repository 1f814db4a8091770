"""Contact of phases at one node: where their surfaces are, and the impulses that keep them apart.

Of solids the nodes know the surface itself: its normal and their distance from it, means of what
the particles carry (layers/offsets.py), so that neighbouring nodes agree and what slides is not
glued. Where they are sure of it bodies meet by an elastic layer (`press`); at edges, and with what
flows, by impulses that let nothing approach. Of what flows the nodes know the volume V and the mean
offset X / V of the particles: for a half space that tells how far outside it the node lies
(`outside`). Velocity alone would act 1.2 to 2 cells too early. Impulses of all pairs of a node are
found together (accumulated Jacobi from the same velocities): a sweep one pair after the other would
depend on how phases are numbered.
"""

from typing import NamedTuple

import numpy as np

from ..device.jit import inline
from ..device.root import cube_root

TOUCH = 0.25  # gap [cells] below which two surfaces touch, one of them of what flows
CLOSE = 0.02  # the same of surfaces that are both known
# from the middle between two known surfaces [cells] to the nodes that keep them apart: forces that
# act deeper have a shorter arm, and press ahead of where bodies meet
LAYER = 0.75
SURE = 0.9  # length of a mean normal above which the particles of a node agree on it
EASE = 0.01  # overlap [cells] from which an elastic layer pushes: bodies that just touch may part
SPRING = 0.4  # stiffness of the layer, over a cell's: that of two and a half cells
SOFT = 0.25  # overlap [cells] that an elastic layer takes up
AHEAD = 0.15  # gap [cells] from which the layer pushes what flows, of which less is sure
FLOWING = 0.05  # overlap [cells] beyond which that comes no nearer
LARGEST = 1.5  # share of a cell's face that one node may have
SWEEPS = 16
# rows of velocities, from their end, of what is rigid: of walls, which rest, and of the collider
RESTS, GOES = -1, -2


@inline
def outside(m):
    """Distance [cells] of a node outside a half space of particles whose mean offset into it is m
    [cells].

    A fit to quadratic B-splines, good to .003; below 0 the node is deep inside, above .75 it only
    sees the far side.
    """
    if m >= 0.75:
        return min((m - 0.375) / 0.75, 1.5)
    if m <= 0.0:
        return -1.5
    s = cube_root(m)
    return -1.5 + s * (1.524778 + s * (0.998001 + s * (-1.124705 + s * 0.933773)))


@inline
def surface_normal(normal, a, b, mass_a, mass_b, known_a, known_b, dx):
    """Outward normal of phase a, towards b, into normal (3,); False where there is none.

    a, b: (4,) of the layer of offsets; mass [kg]; known: whether these are of a surface. Of two
    known ones the mean, in which counts more whose particles agree more, as on a face; else the
    known one's, else the first one's with particles to one side.
    """
    if known_a or known_b:
        wa = _agreement(a, mass_a) if known_a else 0.0
        wb = _agreement(b, mass_b) if known_b else 0.0
        for c in range(3):
            normal[c] = wa * a[c] - wb * b[c]
        return _normalise(normal, 0.0)
    for c in range(3):
        normal[c] = -a[c]
    if _normalise(normal, 1e-6 * dx * a[3]):
        return True
    for c in range(3):
        normal[c] = b[c]
    return _normalise(normal, 1e-6 * dx * b[3])


@inline
def _agreement(side, mass):
    """Over its mass, a high power of the length of a mean normal: 1 on a face, little at an edge,
    whose direction is that of neither face."""
    long2 = _long2(side, mass)
    long8 = long2 * long2 * long2 * long2
    return long8 * long8 * long8 * long8 / mass


@inline
def sure(side, mass):
    """Whether the particles at a node agree where the surface is. side: (4,) of known ones."""
    return _long2(side, mass) > SURE * SURE


@inline
def _long2(side, mass):
    """Squared length of the mean normal."""
    x, y, z = side[0] / mass, side[1] / mass, side[2] / mass
    return x * x + y * y + z * z


@inline
def _normalise(n, least):
    """A vector (3,) to length 1; False where it is not longer than least."""
    size = np.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
    if not size > least:
        return False
    for c in range(3):
        n[c] /= size
    return True


@inline
def distance(n, sign, side, mass, known, dx):
    """Distance [cells] of a node outside a phase, whose outward normal there is sign n (3,)."""
    if known:
        return side[3] / (mass * dx)
    along = side[0] * n[0] + side[1] * n[1] + side[2] * n[2]
    return outside(-sign * along / (side[3] * dx))


class Meeting(NamedTuple):
    """Two phases at a node, the first may be a rigid body."""

    a: int  # or RESTS or GOES
    b: int
    one: float  # distance [cells] of the node outside a
    other: float  # outside b
    known: bool  # both surfaces are
    sure: bool  # there is a known one, and all that are agree on their normals
    share: float  # of a cell's face that is the node's, where they are sure
    stiff: float  # [Pa] of the two in series
    friction: float


@inline
def touching(m):
    """Whether a Meeting's surfaces are so near that they may not approach."""
    gap = m.one + m.other
    if m.known:
        return gap <= (-SOFT if m.sure else CLOSE) and abs(m.one - m.other) <= 2.0 * LAYER
    return gap <= (-FLOWING if m.sure else TOUCH)


@inline
def filled(D):
    """Share of a cell's mass that a node has D cells outside a half space (quadratic B-splines)."""
    if D >= 0.5:
        far = max(1.5 - D, 0.0)
        return far * far * far / 6.0
    if D >= -0.5:
        return 0.5 - 0.75 * D + D * D * D / 3.0
    far = max(1.5 + D, 0.0)
    return 1.0 - far * far * far / 6.0


@inline
def share_of(mass, full, D):
    """Share of a cell's face that belongs to a node D cells outside a body: less than 1 at its
    edges. mass [kg] of the node; full [kg] of a cell full of the body."""
    return min(mass / (full * max(filled(D), 1e-3)), LARGEST)


@inline
def press(change, v, slope, mass, m, n, dt, dx):
    """What the elastic layer of a Meeting does in dt [s], and its friction, added to change (count,
    3) of the velocities v (count + 2, 3), behind which stand those of rigid bodies. slope (count,
    3): how these change per cell along the normal of a known surface, so that what rubs is told how
    fast the surfaces slide, and not the node.

    The layer is two and a half cells of the two materials, under the nodes' faces; along n (3,),
    which points out of a. It has an energy: what falls jumps off again, what rolls is pressed as
    much behind as ahead, and a normal that is a bit wrong brakes nothing. A node that has hardly
    any mass is not thrown: in a step it parts by half the overlap at the most.
    """
    begins = EASE if m.known else -AHEAD
    deep, middle = min(-m.one - m.other - begins, SOFT), 0.5 * abs(m.one - m.other)
    if not (deep > 0.0 and middle < 1.0):
        return
    r0, r1, r2 = v[m.a, 0] - v[m.b, 0], v[m.a, 1] - v[m.b, 1], v[m.a, 2] - v[m.b, 2]
    reduced = mass[m.b]
    if m.a >= 0:
        reduced = mass[m.a] * mass[m.b] / (mass[m.a] + mass[m.b])
    rn = r0 * n[0] + r1 * n[1] + r2 * n[2]
    push = dt * SPRING * m.stiff * deep * m.share * (1.0 - middle) * dx * dx
    push = min(push, reduced * (max(rn, 0.0) + 0.5 * deep * dx / dt))
    r0, r1, r2 = (
        r0 + m.other * slope[m.b, 0], r1 + m.other * slope[m.b, 1], r2 + m.other * slope[m.b, 2],
    )  # fmt: skip
    if m.a >= 0:
        r0, r1, r2 = (
            r0 - m.one * slope[m.a, 0], r1 - m.one * slope[m.a, 1], r2 - m.one * slope[m.a, 2],
        )  # fmt: skip
    rn = r0 * n[0] + r1 * n[1] + r2 * n[2]
    r0, r1, r2 = r0 - rn * n[0], r1 - rn * n[1], r2 - rn * n[2]
    size = np.sqrt(r0 * r0 + r1 * r1 + r2 * r2)
    most = m.friction * push
    rub = most / size if size * reduced > most else reduced
    i0, i1, i2 = push * n[0] + rub * r0, push * n[1] + rub * r1, push * n[2] + rub * r2
    if m.a >= 0:
        _add(change[m.a], i0, i1, i2, -1.0 / mass[m.a])
    _add(change[m.b], i0, i1, i2, 1.0 / mass[m.b])


@inline
def _add(to, x, y, z, k):
    to[0] += k * x
    to[1] += k * y
    to[2] += k * z


@inline
def resolve(v, mass, count, normals, friction, pair_a, pair_b, pairs, share, impulse):
    """Change the velocities v (count + 2, 3) of the phases of a node, behind which stand those of
    rigid bodies, so that no touching pair approaches.

    pair_a is the master (or RESTS or GOES); normals: (pairs, 3) its outward normals;
    friction: (pairs,); share: most pairs that touch one phase; impulse: scratch (pairs, 4), normal
    and tangential impulse so far [kg m/s]. Momentum is exact: what one phase gains the other loses.
    """
    for q in range(pairs):
        for c in range(4):
            impulse[q, c] = 0
    relax = 1.0 / share
    for _ in range(SWEEPS if pairs > 1 else 1):
        change = 0.0
        for q in range(pairs):
            a, b, n = pair_a[q], pair_b[q], normals[q]
            r0, r1, r2 = v[a, 0] - v[b, 0], v[a, 1] - v[b, 1], v[a, 2] - v[b, 2]
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
            most = friction[q] * total
            if size > most:
                t0, t1, t2 = t0 * (most / size), t1 * (most / size), t2 * (most / size)
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

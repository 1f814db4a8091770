"""Contact of phases at one node: where their surfaces are, and the impulses that keep them apart.

Criterion and normal come from the volume V and the mean offset X / V of a phase's particles from
the node: for a half space the offset tells how far outside it the node lies (`outside`). Velocity
alone would act 1.2 to 2 cells too early. Impulses of all pairs of a node are found together
(accumulated Jacobi from the same velocities): a sweep one pair after the other would depend on how
phases are numbered.
"""

import numpy as np

from ..device.jit import inline

TOUCH = 0.25  # gap [cells] below which two surfaces touch
SWEEPS = 16


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
    s = np.cbrt(m)
    return -1.5 + s * (1.524778 + s * (0.998001 + s * (-1.124705 + s * 0.933773)))


@inline
def surface_normal(normal, master, other, dx):
    """Outward normal of `master` into normal (3,); False where there is none.

    master, other: (4,) offset sums [m4] and volume [m3].
    """
    size = np.sqrt(master[0] * master[0] + master[1] * master[1] + master[2] * master[2])
    sign, source = -1.0, master
    if not size > 1e-6 * dx * master[3]:
        size = np.sqrt(other[0] * other[0] + other[1] * other[1] + other[2] * other[2])
        sign, source = 1.0, other
        if not size > 1e-6 * dx * other[3]:
            return False
    for c in range(3):
        normal[c] = sign * source[c] / size
    return True


@inline
def gap(normal, master, other, dx):
    """Distance [cells] between two phases' surfaces along the master's normal."""
    a = -(master[0] * normal[0] + master[1] * normal[1] + master[2] * normal[2]) / (master[3] * dx)
    b = (other[0] * normal[0] + other[1] * normal[1] + other[2] * normal[2]) / (other[3] * dx)
    return outside(a) + outside(b)


@inline
def collider_gap(normal, distance, other, dx):
    """As `gap`, for a rigid collider whose outward normal and distance [m] at the node are
    known.
    """
    b = (other[0] * normal[0] + other[1] * normal[1] + other[2] * normal[2]) / (other[3] * dx)
    return distance / dx + outside(b)


@inline
def resolve(v, mass, count, normals, friction, pair_a, pair_b, pairs, share, impulse):
    """Change the velocities v (count, 3) of the phases of a node so that no touching pair
    approaches.

    pair_a is the master (-1: a rigid collider at rest); normals: (pairs, 3) its outward normals;
    friction: (pairs,); share: most pairs that touch one phase; impulse: scratch (pairs, 4), normal
    and tangential impulse so far [kg m/s]. Momentum is exact: what one phase gains the other loses.
    """
    impulse[:pairs] = 0
    relax = 1.0 / share
    for _ in range(SWEEPS if pairs > 1 else 1):
        change = 0.0
        for q in range(pairs):
            a, b, n = pair_a[q], pair_b[q], normals[q]
            if a >= 0:
                r0, r1, r2 = v[a, 0] - v[b, 0], v[a, 1] - v[b, 1], v[a, 2] - v[b, 2]
                reduced = mass[a] * mass[b] / (mass[a] + mass[b])
            else:
                r0, r1, r2 = -v[b, 0], -v[b, 1], -v[b, 2]
                reduced = mass[b]
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

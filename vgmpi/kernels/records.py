"""Records: what the transfers need of each particle, 16 numbers side by side.

Formulas are evaluated for 16 particles at a time; transposed, each particle's numbers lie together
and meet its nine rows of nodes (p2g.py, g2p.py). A batch of records stays in the first level cache.

Channels of a group's float array: velocity 0-2 [m/s], velocity gradient C 3-11 [1/s], rest volume
12 [m3], the law's state 13-, and behind it the porosity of fluids that flow through sand.
"""

from typing import NamedTuple

import numpy as np

from ..device.jit import inline, within
from ..lanes.lanes import load, store
from ..lanes.laws import lane_state, stress, volume_ratio
from ..lanes.rows import (
    QUARTERS,
    cell_offset,
    diagonal,
    fourth,
    fraction,
    largest,
    spread,
    store_quarter,
    store_records,
    store_whole,
)
from .walls import SIDE

AFFINE, VOLUME, STATE = 3, 12, 13
BATCH = 128
ROW = SIDE * 4  # numbers of a patch from one (i, j) to (i, j + 1)
PLANE = SIDE * ROW
PATCH = SIDE * PLANE
SCRATCH = BATCH * 16  # numbers a batch of records takes
EXTRA = 5 * BATCH  # numbers set aside per batch
ROOM = 2 * SCRATCH + PATCH + 16 + EXTRA  # what a transfer's scratch holds, see `parts`


class Numbers(NamedTuple):
    """What the transfers are told of a group, in the precision of the run."""

    density: float  # [kg/m3] of a particle's rest volume
    share: float  # of the rest volume that the material takes up itself
    affine: float  # 1: particles carry the velocity's gradient (APIC), 0: they do not
    splines: float  # 1: strains and forces by gradients of the B-splines, 0: by moments
    stiff: float  # [m2/s2] squared speed of waves that sand in the same space adds
    dense: float  # density relative to that sand's grains, at least 1
    relax: float  # [1/s] rate at which a fluid gives way where there is more volume than space
    counted: float  # 1 where phases share space, so that nodes must know volumes
    porosity: float  # channel of the fluid's share of space, or -1
    dx: float  # [m]


@inline
def parts(scratch):
    """A transfer's scratch (ROOM,) in parts: weights and records of a batch, a patch with 16 places
    behind it, and five numbers per particle of a batch."""
    weights, records = scratch[:SCRATCH], scratch[SCRATCH : 2 * SCRATCH]
    behind = ROOM - EXTRA
    return weights, records, scratch[2 * SCRATCH : behind], scratch[behind:ROOM]


@inline
def reach(count, at, cap, xi, like, box):
    """First and last nodes that `count` particles from `at` touch, along each axis, into box (6,):
    x 0-1, y 2-3, z 4-5, the last one exclusive.
    """
    for a in range(3):
        low, high = spread(like, 5.0), spread(like, 0.0)
        for n in range(0, count, 16):
            cell = cell_offset(xi, a * cap + at + n, 1)
            low, high = np.minimum(low, cell), np.maximum(high, cell)
        box[2 * a] = -np.int64(largest(-low))
        box[2 * a + 1] = np.int64(largest(high)) + 3


@inline
def touched(count, at, cap, xi, like, mirror, box):
    """Nodes of its patch that a segment touches (see records.reach); all of them at a wall."""
    for a in range(3):
        box[2 * a], box[2 * a + 1] = 0, SIDE
    if not mirror.any():
        reach(count, at, cap, xi, like, box)


@inline
def weigh(count, at, cap, xi, like, base, weights):
    """Weights and base rows of `count` particles from `at`: records of weights, base (count,).

    A record holds per axis the three weights and the base node minus the particle [cells]:
    x 0-3, y 4-7, z 8-10 and 12.
    """
    zero = spread(like, 0.0)
    for n in range(0, count, 16):
        p, m = at + n, 16 * n
        if QUARTERS:  # no more at once than the registers hold
            store_quarter(weights, m, splines(fraction(xi, p)))
            store_quarter(weights, m + 4, splines(fraction(xi, cap + p)))
            a, b, c, d = splines(fraction(xi, 2 * cap + p))
            store_quarter(weights, m + 8, (a, b, c, zero))
            store_quarter(weights, m + 12, (d, zero, zero, zero))
            _note_rows(n, p, cap, xi, base)
        else:
            x, y, z = fraction(xi, p), fraction(xi, cap + p), fraction(xi, 2 * cap + p)
            _note_rows(n, p, cap, xi, base)
            a, b, c, d = splines(z)
            last = (a, b, c, zero, d, zero, zero, zero)
            store_records(weights, m, splines(x) + splines(y) + last)


@within
def _note_rows(n, p, cap, xi, base):
    """Where 16 particles' base rows begin in a patch."""
    row = cell_offset(xi, p, PLANE) + cell_offset(xi, cap + p, ROW)
    store_whole(base, n, row + cell_offset(xi, 2 * cap + p, 4))


@within
def splines(x):
    """Weights of particles at x in their cells on an axis, and their base nodes minus them
    [cells]."""
    a, c = 1.0 - x, x - 0.5
    return 0.5 * a * a, 0.75 - c * c, 0.5 * x * x, -0.5 - x


@inline
def momenta(law, count, at, cap, f, records, density, affine, dx, dt):
    """Records of momentum and mass: value at the particle 0-3, its slope per cell along x 4-7, y
    8-11, z 12-15. The stress's impulse over dt is part of the slopes (MLS, Hu 2018).

    affine: 1 for APIC, 0 where a particle carries its velocity alone (PIC, FLIP).
    """
    zero = spread(f, 0.0)
    four = dt * 4.0 / (dx * dx)
    for n in range(0, count, 16):
        p = at + n
        q = p + AFFINE * cap
        c0, c1, c2 = load(f, q), load(f, q + cap), load(f, q + 2 * cap)
        c3, c4, c5 = load(f, q + 3 * cap), load(f, q + 4 * cap), load(f, q + 5 * cap)
        c6, c7, c8 = load(f, q + 6 * cap), load(f, q + 7 * cap), load(f, q + 8 * cap)
        L = (c0, c1, c2, c3, c4, c5, c6, c7, c8)
        t00, t11, t22, t01, t02, t12 = stress(law, lane_state(law, f, p + STATE * cap, cap), L)
        volume = load(f, p + VOLUME * cap)
        mass = density * volume
        k, m = dx * four * volume, affine * dx * mass
        store_records(
            records,
            16 * n,
            (
                mass * load(f, p), mass * load(f, p + cap), mass * load(f, p + 2 * cap), mass,
                m * c0 - k * t00, m * c3 - k * t01, m * c6 - k * t02, zero,
                m * c1 - k * t01, m * c4 - k * t11, m * c7 - k * t12, zero,
                m * c2 - k * t02, m * c5 - k * t12, m * c8 - k * t22, zero,
            ),
        )  # fmt: skip


@inline
def inertia(count, at, cap, f, records, density, affine, dx):
    """As `momenta`, without the stress."""
    zero = spread(f, 0.0)
    for n in range(0, count, 16):
        p = at + n
        q = p + AFFINE * cap
        mass = density * load(f, p + VOLUME * cap)
        m = affine * dx * mass
        c0, c1, c2 = m * load(f, q), m * load(f, q + cap), m * load(f, q + 2 * cap)
        c3, c4, c5 = m * load(f, q + 3 * cap), m * load(f, q + 4 * cap), m * load(f, q + 5 * cap)
        c6, c7, c8 = m * load(f, q + 6 * cap), m * load(f, q + 7 * cap), m * load(f, q + 8 * cap)
        v0, v1, v2 = load(f, p), load(f, p + cap), load(f, p + 2 * cap)
        store_records(
            records,
            16 * n,
            (
                mass * v0, mass * v1, mass * v2, mass,
                c0, c3, c6, zero, c1, c4, c7, zero, c2, c5, c8, zero,
            ),
        )  # fmt: skip


@inline
def impulses(law, count, at, cap, f, numbers, records, dt):
    """Records of the stress's impulse over dt alone, in the form of `momenta`, and of the volume
    [m3] as it is now where phases share space."""
    porosity, dx = np.int64(numbers.porosity), numbers.dx
    zero = spread(f, 0.0)
    four = dt * 4.0 / dx
    for n in range(0, count, 16):
        p = at + n
        q = p + AFFINE * cap
        c0, c1, c2 = load(f, q), load(f, q + cap), load(f, q + 2 * cap)
        c3, c4, c5 = load(f, q + 3 * cap), load(f, q + 4 * cap), load(f, q + 5 * cap)
        c6, c7, c8 = load(f, q + 6 * cap), load(f, q + 7 * cap), load(f, q + 8 * cap)
        L = (c0, c1, c2, c3, c4, c5, c6, c7, c8)
        state = lane_state(law, f, p + STATE * cap, cap)
        t00, t11, t22, t01, t02, t12 = stress(law, state, L)
        volume = load(f, p + VOLUME * cap)
        k = -four * volume
        now = volume * volume_ratio(law, state) if numbers.counted > 0.0 else zero
        if porosity >= 0:
            k = k / load(f, p + porosity * cap)
        a, b, c = k * t01, k * t02, k * t12
        store_records(
            records,
            16 * n,
            (
                zero, zero, zero, now, k * t00, a, b, zero,
                a, k * t11, c, zero, b, c, k * t22, zero,
            ),
        )  # fmt: skip


@inline
def present(law, count, at, cap, f, volumes):
    """Volumes [m3] of `count` particles as they are now, into volumes (BATCH,)."""
    for n in range(0, count, 16):
        p = at + n
        J = volume_ratio(law, lane_state(law, f, p + STATE * cap, cap))
        store(volumes, n, J * load(f, p + VOLUME * cap))


@inline
def offsets(count, volumes, first, share, records, dx):
    """Records of sum V (x_p - x_i) and V, in the form of `momenta`; V is `share` of the particle's
    volume, volumes[first...]. All are one pattern times a volume."""
    pattern = share * (fourth(records) - dx * diagonal(records))
    for n in range(count):
        store(records, 16 * n, volumes[first + n] * pattern)

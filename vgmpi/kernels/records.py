"""Records: what the transfers need of each particle, 16 numbers side by side.

Formulas are evaluated for 16 particles at a time; transposed, each particle's numbers lie together
and meet its nine rows of nodes (transfer.py). A batch of records stays in the first level cache.

Channels of a group's float array: velocity 0-2 [m/s], APIC matrix C 3-11 [1/s], rest volume 12
[m3], the law's state 13-.
"""

import numpy as np

from ..device.jit import inline
from .lanes import load, store
from .laws import lane_state, stress
from .rows import (
    cell_offset,
    diagonal,
    fourth,
    fraction,
    largest,
    spread,
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
def weigh(count, at, cap, xi, like, base, weights):
    """Weights and base rows of `count` particles from `at`: records of weights, base (count,).

    A record holds per axis the three weights and the base node minus the particle [cells]:
    x 0-3, y 4-7, z 8-10 and 12.
    """
    zero = spread(like, 0.0)
    for n in range(0, count, 16):
        p = at + n
        x, y, z = fraction(xi, p), fraction(xi, cap + p), fraction(xi, 2 * cap + p)
        row = cell_offset(xi, p, PLANE) + cell_offset(xi, cap + p, ROW)
        store_whole(base, n, row + cell_offset(xi, 2 * cap + p, 4))
        ax, ay, az = 1.0 - x, 1.0 - y, 1.0 - z
        cx, cy, cz = x - 0.5, y - 0.5, z - 0.5
        store_records(
            weights,
            16 * n,
            (
                0.5 * ax * ax, 0.75 - cx * cx, 0.5 * x * x, -0.5 - x,
                0.5 * ay * ay, 0.75 - cy * cy, 0.5 * y * y, -0.5 - y,
                0.5 * az * az, 0.75 - cz * cz, 0.5 * z * z, zero,
                -0.5 - z, zero, zero, zero,
            ),
        )  # fmt: skip


@inline
def momenta(law, count, at, cap, f, records, density, dx, dt):
    """Records of momentum and mass: value at the particle 0-3, its slope per cell along x 4-7, y
    8-11, z 12-15. The stress's impulse over dt is part of the slopes (MLS, Hu 2018)."""
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
        k, m = dx * four * volume, dx * mass
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
def offsets(count, at, cap, f, records, dx):
    """Records of sum V0 (x_p - x_i) and V0, in the form of `momenta`: contact asks for them. All
    are one pattern times the particle's volume."""
    pattern = fourth(records) - dx * diagonal(records)
    for n in range(count):
        store(records, 16 * n, f[at + n + VOLUME * cap] * pattern)

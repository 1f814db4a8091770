"""Records: what the transfers need of each particle, 16 numbers side by side.

Formulas are evaluated for 16 particles at a time; transposed, each particle's numbers lie together
and meet its nine rows of nodes (p2g.py, g2p.py). A batch of records stays in the first level cache.

What all particles have stands at fixed places of a group's floats, as planning.channels.HEAD says:
velocity [m/s], its gradient C [1/s], rest volume [m3]; behind them the law's state, and what else
the plan names.
"""

from typing import NamedTuple

import numpy as np

from ..device.jit import inline, within
from ..device.memory import aligned
from ..lanes.lanes import load
from ..lanes.rows import (
    QUARTERS,
    cell_offset,
    fraction,
    largest,
    spread,
    store_quarter,
    store_records,
    store_whole,
)
from ..planning.channels import HEAD
from .walls import SIDE

AFFINE, VOLUME, STATE = (sum(width for _, width, _ in HEAD[: k + 1]) for k in range(3))
BATCH = 128
ROW = SIDE * 4  # numbers of a patch from one (i, j) to (i, j + 1)
PLANE = SIDE * ROW
PATCH = SIDE * PLANE
SCRATCH = BATCH * 16  # numbers a batch of records takes
EXTRA = 8 * BATCH  # numbers set aside per batch
MORE = PATCH + 16  # a patch, and the vector that its last row may be read with
ROOM = 2 * SCRATCH + MORE + EXTRA  # numbers of a transfer with one patch, see `parts`


class Scratch(NamedTuple):
    """What one thread writes to while it transfers a segment."""

    real: np.ndarray  # (ROOM + more * MORE,) see `parts` and `patch_of`
    whole: np.ndarray  # (BATCH + 16 + 6,) int32: base rows of a batch, and behind them a box
    peak: np.ndarray  # (16,) largest squared stress over density so far [m4/s4], in 16 parts


def scratch(real: np.dtype, more: int) -> Scratch:
    """Scratch for a patch of velocities and `more` patches that are gathered beside it."""
    whole = np.zeros(BATCH + 16 + 6, np.int32)
    return Scratch(aligned(ROOM + more * MORE, real), whole, aligned(16, real))


@inline
def parts(real):
    """A transfer's numbers in parts: weights and records of a batch, a patch with 16 places behind
    it, and eight numbers per particle of a batch."""
    behind = ROOM - EXTRA
    weights, records = real[:SCRATCH], real[SCRATCH : 2 * SCRATCH]
    return weights, records, real[2 * SCRATCH : behind], real[behind:ROOM]


@inline
def patch_of(real, k):
    """The patch of what is gathered beside velocity: k = 0, 1, ..."""
    return real[ROOM + k * MORE : ROOM + (k + 1) * MORE]


@inline
def box_of(whole):
    """First and last nodes of a segment's particles, see `reach`: (6,)."""
    return whole[BATCH + 16 :]


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
def nine(f, p, cap):
    """A tensor of 16 particles from p on, row by row, of which f (channels * cap,) holds the first
    number there."""
    return (
        load(f, p), load(f, p + cap), load(f, p + 2 * cap),
        load(f, p + 3 * cap), load(f, p + 4 * cap), load(f, p + 5 * cap),
        load(f, p + 6 * cap), load(f, p + 7 * cap), load(f, p + 8 * cap),
    )  # fmt: skip


@within
def splines(x):
    """Weights of particles at x in their cells on an axis, and their base nodes minus them
    [cells]."""
    a, c = 1.0 - x, x - 0.5
    return 0.5 * a * a, 0.75 - c * c, 0.5 * x * x, -0.5 - x


@inline
def rest(count, records):
    """Nothing in the records behind the last one, up to a whole vector: unused places stay so."""
    for m in range(16 * count, 16 * ((count + 15) & ~15)):
        records[m] = 0


@inline
def columns(count, records, out, first, stride):
    """The first three numbers of each record into rows of out, `stride` numbers apart."""
    for n in range(count):
        for c in range(3):
            out[first + c * stride + n] = records[16 * n + c]

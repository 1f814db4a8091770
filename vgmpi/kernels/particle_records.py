"""Records and patches: the numbers that a transfer needs of each particle, and of the nodes around.

Formulas are evaluated for 16 particles at a time; transposed, the 16 contiguous numbers of each
particle, its record, lie together and meet its nine rows of nodes (kernels/transfer/p2g.py,
kernels/transfer/g2p.py). A batch of records stays in the first level cache.

A patch is the 8^3 nodes around a block, as a segment writes and reads them. A row of a patch, eight
nodes along z, is two vectors; it lies across three node blocks, each of which has one vector per
row.

The common channels stand at fixed positions of a group's array, as COMMON_CHANNELS of
planning/particle_channels.py defines: velocity [m/s], its gradient C [1/s], rest volume [m3].
Behind them stand the law's state and the optional channels of the plan.
"""

from typing import NamedTuple

import numpy as np

from vgmpi.kernels.simd.row_ops import (
    QUARTERS,
    broadcast,
    cell_fraction,
    horizontal_max,
    slide_back,
    stencil_offset,
    store_int32,
    store_quarter,
    store_records,
)
from vgmpi.kernels.simd.vector16 import load, prefetch, store
from vgmpi.planning.particle_channels import COMMON_CHANNELS
from vgmpi.runtime.aligned_arrays import aligned_zeros
from vgmpi.runtime.jit import always_inline, array_function, device_function

from .wall_boundary import SIDE

AFFINE, VOLUME, STATE = (sum(width for _, width, _ in COMMON_CHANNELS[: k + 1]) for k in range(3))
BATCH = 128
ROW = SIDE * 4  # numbers in a patch from one (i, j) to (i, j + 1)
PLANE = SIDE * ROW
PATCH = SIDE * PLANE
SCRATCH = BATCH * 16  # numbers in a batch of records
AUXILIARY_SIZE = 8 * BATCH  # auxiliary numbers per batch
PADDED_PATCH = PATCH + 16  # numbers in a patch, plus the vector with which its last row may be read
SCRATCH_SIZE = (
    2 * SCRATCH + PADDED_PATCH + AUXILIARY_SIZE
)  # numbers for a transfer with one patch, see `split_scratch`


class Scratch(NamedTuple):
    """Scratch memory of one thread during the transfer of a segment."""

    real: np.ndarray  # (SCRATCH_SIZE + more * PADDED_PATCH,) see `split_scratch` and `patch_of`
    integers: np.ndarray  # (BATCH + 16 + 6,) int32: base rows of a batch, then a node range
    peak: np.ndarray  # (16,) [m4/s4] maximum squared stress over density so far, by lane


def scratch(real: np.dtype, more: int) -> Scratch:
    """Allocate scratch for a velocity patch and `more` auxiliary patches."""
    integers = np.zeros(BATCH + 16 + 6, np.int32)
    return Scratch(
        aligned_zeros(SCRATCH_SIZE + more * PADDED_PATCH, real), integers, aligned_zeros(16, real)
    )


@array_function
def split_scratch(real):
    """Return views of a transfer's scratch.

    Returns:
        Weights and records of a batch, a patch with 16 numbers of padding, and eight numbers per
        particle of a batch.
    """
    extra_start = SCRATCH_SIZE - AUXILIARY_SIZE
    weights, records = real[:SCRATCH], real[SCRATCH : 2 * SCRATCH]
    return weights, records, real[2 * SCRATCH : extra_start], real[extra_start:SCRATCH_SIZE]


@array_function
def velocity_patch_of(real):
    """Return the patch of velocities of the scratch, with its padding."""
    return real[2 * SCRATCH : 2 * SCRATCH + PADDED_PATCH]


@array_function
def patch_of(real, k):
    """Return auxiliary patch k = 0, 1, ... of the scratch."""
    return real[SCRATCH_SIZE + k * PADDED_PATCH : SCRATCH_SIZE + (k + 1) * PADDED_PATCH]


@array_function
def box_of(integers):
    """Return the node range of a segment's particles, shape (6,), see `node_range`."""
    return integers[BATCH + 16 :]


@device_function
def node_range(count, offset, cap, xi, like, box):
    """Compute the range of nodes that some particles touch, along each axis.

    Args:
        count: Number of particles.
        offset: Index of the first particle.
        cap: Stride of channels.
        xi: Fixed-point positions, flat.
        like: Array whose dtype is the working precision.
        box: Node range (out), shape (6,): x 0-1, y 2-3, z 4-5, the last one exclusive.
    """
    for a in range(3):
        low, high = broadcast(like, 5.0), broadcast(like, 0.0)
        for n in range(0, count, 16):
            cell = stencil_offset(xi, a * cap + offset + n, 1)
            low, high = np.minimum(low, cell), np.maximum(high, cell)
        box[2 * a] = -np.int64(horizontal_max(-low))
        box[2 * a + 1] = np.int64(horizontal_max(high)) + 3


@device_function
def node_range_with_walls(count, offset, cap, xi, like, mirror, box):
    """Compute the range of patch nodes that a segment touches: all of them at a wall.

    Args:
        count, offset, cap, xi, like: See `node_range`.
        mirror: Wall codes of the segment, shape (3, 2).
        box: Node range (out), shape (6,).
    """
    for a in range(3):
        box[2 * a], box[2 * a + 1] = 0, SIDE
    if not mirror.any():
        node_range(count, offset, cap, xi, like, box)


@device_function
def compute_weights(count, offset, cap, xi, like, base, weights):
    """Compute the weights and base rows of some particles.

    A record holds per axis the three weights and the base node minus the particle [cells]: x 0-3, y
    4-7, z 8-10 and 12.

    Args:
        count, offset, cap, xi, like: See `node_range`.
        base: Base rows (out), shape (count,).
        weights: Records of weights (out).
    """
    zero = broadcast(like, 0.0)
    for n in range(0, count, 16):
        p, m = offset + n, 16 * n
        if QUARTERS:  # the registers hold no more at once
            store_quarter(weights, m, splines(cell_fraction(xi, p)))
            store_quarter(weights, m + 4, splines(cell_fraction(xi, cap + p)))
            a, b, c, d = splines(cell_fraction(xi, 2 * cap + p))
            store_quarter(weights, m + 8, (a, b, c, zero))
            store_quarter(weights, m + 12, (d, zero, zero, zero))
            _store_base_rows(n, p, cap, xi, base)
        else:
            x, y, z = (
                cell_fraction(xi, p),
                cell_fraction(xi, cap + p),
                cell_fraction(xi, 2 * cap + p),
            )
            _store_base_rows(n, p, cap, xi, base)
            a, b, c, d = splines(z)
            last = (a, b, c, zero, d, zero, zero, zero)
            store_records(weights, m, splines(x) + splines(y) + last)


@device_function
def compute_base_rows(count, offset, cap, xi, base):
    """Compute the base rows of some particles alone, see `compute_weights`.

    Args:
        count, offset, cap, xi: See `node_range`.
        base: Base rows (out), shape (count,).
    """
    for n in range(0, count, 16):
        _store_base_rows(n, offset + n, cap, xi, base)


@always_inline
def _store_base_rows(n, p, cap, xi, base):
    """Store the offsets of 16 particles' base rows in a patch."""
    row = stencil_offset(xi, p, PLANE) + stencil_offset(xi, cap + p, ROW)
    store_int32(base, n, row + stencil_offset(xi, 2 * cap + p, 4))


@always_inline
def load_tensor(f, p, cap):
    """Load a tensor of 16 particles, row by row, from flat channels; p: its first number."""
    return (
        load(f, p), load(f, p + cap), load(f, p + 2 * cap),
        load(f, p + 3 * cap), load(f, p + 4 * cap), load(f, p + 5 * cap),
        load(f, p + 6 * cap), load(f, p + 7 * cap), load(f, p + 8 * cap),
    )  # fmt: skip


@always_inline
def splines(x):
    """Return the weights of particles along one axis, and their base nodes minus them [cells].

    x is the position within the cell.
    """
    a, c = 1.0 - x, x - 0.5
    return 0.5 * a * a, 0.75 - c * c, 0.5 * x * x, -0.5 - x


@device_function
def zero_padding(count, records):
    """Set the records behind the last one to zero, up to a whole vector: unused slots stay zero."""
    for m in range(16 * count, 16 * ((count + 15) & ~15)):
        records[m] = 0


@device_function
def scatter_columns(count, records, out, first, stride):
    """Scatter the first three numbers of each record into rows of an array.

    Args:
        count: Number of records.
        records: Records.
        out: Array (out).
        first: Offset of the first row.
        stride: Distance between rows.
    """
    for n in range(count):
        for c in range(3):
            out[first + c * stride + n] = records[16 * n + c]


@device_function
def prefetch_channels(channels, count, cap, first):
    """Prefetch a batch of all channels, for the processor's own prefetching cannot follow so many.

    Args:
        channels: Channels, flat.
        count: Number of channels.
        cap: Stride of channels.
        first: Index of the batch's first particle.
    """
    for c in range(count):
        for n in range(0, BATCH, 16):
            prefetch(channels, c * cap + first + n)


@device_function
def clear(patch, box):
    """Set the rows of a patch (2048,) within a box to zero."""
    none = broadcast(patch, 0.0)
    for i in range(box[0], box[1]):
        for j in range(box[2], box[3]):
            target = (i * SIDE + j) * SIDE * 4
            store(patch, target, none)
            store(patch, target + 16, none)


@always_inline
def row_of(i, j):
    """Return the position of row (i, j) of a patch in the node blocks around it.

    Returns:
        The first of the three node blocks that the row crosses, among the 27 around, and the offset
        of the row in each of them.
    """
    gi, gj = i + 3, j + 3
    return (gi >> 2) * 9 + (gj >> 2) * 3, ((gi & 3) * 16 + (gj & 3) * 4) * 4


@device_function
def load_patch(patch, grid, blocks, box):
    """Load the nodes of a box of a patch from the 27 node blocks around it.

    Args:
        patch: Patch (out), shape (2048,).
        grid: Nodal numbers, shape (node blocks, 256).
        blocks: The 27 node blocks.
        box: First and last nodes along x, y, z, shape (6,).
    """
    for i in range(box[0], box[1]):
        for j in range(box[2], box[3]):
            row, offset = row_of(i, j)
            target = (i * SIDE + j) * SIDE * 4
            middle = load(grid[blocks[row + 1]], offset)
            store(patch, target, slide_back(load(grid[blocks[row]], offset), middle))
            store(patch, target + 16, slide_back(middle, load(grid[blocks[row + 2]], offset)))


@device_function
def prefetch_patch(grid, blocks):
    """Prefetch what `load_patch` is going to read; grid: (256 node blocks,) as a pointer."""
    for i in range(SIDE):
        for j in range(SIDE):
            row, offset = row_of(i, j)
            for k in range(3):
                prefetch(grid, 256 * blocks[row + k] + offset)

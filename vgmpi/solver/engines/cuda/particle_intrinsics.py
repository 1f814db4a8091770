"""Scalar replacements of vector functions for a thread that has one particle.

Vectors become numbers, `count` is 1, and records, weights and stored values are arrays of the
thread, so that those of the next particle begin at 0.
"""

import numpy as np
from numba import cuda

from vgmpi.kernels import (
    cell_stencil_sums,
    particle_records,
    stencil_sums,
)
from vgmpi.kernels.nodal_fields import surface_distance
from vgmpi.kernels.rigid import prescribed_transfer
from vgmpi.kernels.simd import cooperative as lanes_team
from vgmpi.kernels.simd import partial_rows, row_ops, vector16
from vgmpi.kernels.transfer import auxiliary_gather, g2p

from . import thread_block
from .scalar_math import PLAIN
from .translation_types import TranslationMode, constants

PATCH = particle_records.PATCH
FASTEST, STRAY, QUICK, STRETCHING, CARRIED, TURNING = range(6)  # columns of a thread's maxima
REAL = None


def load(row, index):
    """Return the number at an index."""
    return row[index]


def store(row, index, value):
    """Store a number at an index."""
    row[index] = value


def place(array):
    """Return the array itself."""
    return array


def broadcast(like, value):
    """Return a number in the precision of the run."""
    return REAL(value)


def first_n(value, count):
    """Return the value; the thread's particle exists."""
    return value


def horizontal_max(value):
    """Return the value of the single lane."""
    return value


def in_range_mask(value, low, high, count):
    """Return 1 if low < value < high, else 0.

    Args:
        value, low, high, count: Number, bounds, and 1.
    """
    return 1 if value > low and value < high else 0


def masked(mask, value):
    """Return the value if the mask is set, else 0."""
    return value if mask & 1 else REAL(0.0)


def store_records(array, index, numbers):
    """Store the 16 numbers of a record."""
    array[index], array[index + 1], array[index + 2], array[index + 3] = numbers[:4]
    array[index + 4], array[index + 5], array[index + 6], array[index + 7] = numbers[4:8]
    array[index + 8], array[index + 9], array[index + 10], array[index + 11] = numbers[8:12]
    array[index + 12], array[index + 13], array[index + 14], array[index + 15] = numbers[12:]


def load_records(array, index):
    """Return the 16 numbers of a record."""
    first = (
        array[index], array[index + 1], array[index + 2], array[index + 3],
        array[index + 4], array[index + 5], array[index + 6], array[index + 7],
    )  # fmt: skip
    second = (
        array[index + 8], array[index + 9], array[index + 10], array[index + 11], array[index + 12],
        array[index + 13], array[index + 14], array[index + 15],
    )  # fmt: skip
    return first + second


def store_int32(array, index, value):
    """Store a number as int32."""
    array[index] = np.int32(value)


def offsets_record(kind, count, volumes, first, record):
    """Write the record of offsets, one pattern times a volume (surface_distance.py).

    Args:
        kind: Kind of the contribution.
        count: 1.
        volumes: Volumes.
        first: Index of the particle.
        record (out): 16 numbers.
    """
    volume = volumes[first]
    for k in range(16):
        fourth = 1.0 if k == 3 else 0.0
        diagonal = 1.0 if k == 4 or k == 9 or k == 14 else 0.0
        record[k] = volume * (kind.share * (fourth - kind.dx * diagonal))


def repeat(array, index, like):
    """Return the number of a node, of its four, that belongs to this thread."""
    return array[index + (thread_block.rank() & 3)]


# ---- a row of a patch: one number of one node, with index `o` -----------------------------------


def part_load(array, index, like):
    """Return the number at an index."""
    return array[index]


def nothing(array, node, nodes):
    """Return 0."""
    return REAL(0.0)


def steps(array, node, nodes):
    """Return the index of a node."""
    return REAL(node)


def middle(array, node, nodes):
    """Return a quarter of the B-spline slope of a node at offset 0 [1/cell]."""
    return -0.375 if node == 0 else (0.5 if node == 1 else -0.125)


def mean(array, node, nodes):
    """Return twice the weight of a node in the means of cells at offset 0."""
    return 1.5 if node == 0 else (1.0 if node == 1 else -0.5)


def mean_slope(array, node, nodes):
    """Return the change of `mean` with the offset of the base node."""
    return 1.0 if node == 0 else (0.0 if node == 1 else -1.0)


def change(array, node, nodes):
    """Return the change of `middle` with the offset of the base node."""
    return 0.5 if node == 1 else -0.25


def _gathers(name, quantities):
    """Return the stencil sum of a record by the source of its three nodes.

    Args:
        name: Name of the stencil function.
        quantities: Number of its sums, of four numbers each.
    """
    source = stencil_sums.STENCIL_FUNCTIONS[name][1]
    first, second, third = source(0, 1), source(1, 1), source(2, 1)

    def sums(count, record, weights, base, patch):
        """Gather the sums of a record.

        Args:
            count: 1.
            record (out): Sums.
            weights: Weights of the particle.
            base, patch: Base row (1,), and flat patch.
        """
        for c in range(4):
            o = base[0] + c
            a = first(weights, 0, patch, o)
            b = second(weights, 0, patch, o)
            d = third(weights, 0, patch, o)
            for q in range(quantities):
                record[4 * q + c] = (a[q] + b[q]) + d[q]

    return sums


def gather(patch, grid, blocks, box):
    """Copy the nodes of a patch from the 27 node blocks around it; a team shares the work.

    Args:
        patch (out): Flat patch.
        grid: Nodal values by block.
        blocks: 27 node blocks.
        box: Not used on the GPU.
    """
    for q in thread_block.each(PATCH):
        i, j, n = (q >> 8) + 3, ((q >> 5) & 7) + 3, ((q >> 2) & 7) + 3
        nb = blocks[(i >> 2) * 9 + (j >> 2) * 3 + (n >> 2)]
        patch[q] = grid[256 * nb + (i & 3) * 64 + (j & 3) * 16 + (n & 3) * 4 + (q & 3)]
    thread_block.meet()


def flat(array):
    """Return the array; on the GPU arrays are flat."""
    return array


def velocity_patch_of(real):
    """Return the patch of velocities."""
    return real[:PATCH]


def patch_of(real, k):
    """Return the patch of an auxiliary field."""
    return real[(k + 1) * PATCH : (k + 2) * PATCH]


def note(report, number, reason):
    """Store the lowest id of the failed particles, with the reason.

    Args:
        report: Maxima, and the lowest id times 8 plus reason.
        number: Id.
        reason: Code of g2p.
    """
    _, lowest = report
    if number * 8 + reason < lowest[0]:
        lowest[0] = number * 8 + reason


def record_maxima(report, fastest, stray, quick, stretching, carried, turning, motion, dx):
    """Update the maxima of a thread; the host converts them to rates.

    Args:
        report: Maxima, shape (6,) (in/out), and the lowest failed id.
        fastest: Speed with waves [m/s].
        stray: Distance from the block center [cells].
        quick: Speed [m/s].
        stretching: Volumetric strain rate [1/s].
        carried: Displacement by the particle's own velocity [cells].
        turning: Squared norm of the velocity gradient [1/s^2].
        motion, dx: Not used on the GPU.
    """
    maxima, _ = report
    maxima[FASTEST] = max(maxima[FASTEST], fastest)
    maxima[STRAY] = max(maxima[STRAY], stray)
    maxima[QUICK] = max(maxima[QUICK], quick)
    maxima[STRETCHING] = max(maxima[STRETCHING], stretching)
    maxima[CARRIED] = max(maxima[CARRIED], carried)
    maxima[TURNING] = max(maxima[TURNING], turning)


def record_prescribed(report, stray, speed, squared):
    """Update the maxima by a particle with prescribed motion.

    Args:
        report: Maxima, shape (6,) (in/out), and the lowest failed id.
        stray: Distance from the block center [cells].
        speed: Speed [m/s].
        squared: Squared norm of the velocity gradient [1/s^2].
    """
    maxima, _ = report
    cuda.atomic.max(maxima, STRAY, stray)
    cuda.atomic.max(maxima, CARRIED, speed)
    cuda.atomic.max(maxima, TURNING, squared)


TEAMWORK = {
    lanes_team.strided_range: thread_block.each, lanes_team.sync_threads: thread_block.meet,
    lanes_team.atomic_add_int: thread_block.count_up,
    lanes_team.flat_pointer: flat,
}  # fmt: skip
VIEWS = frozenset({patch_of, velocity_patch_of, flat})
PARTICLE = TranslationMode(
    "particle",
    PLAIN | TEAMWORK | {
        vector16.load: load, vector16.store: store, vector16.pointer: place,
        row_ops.broadcast: broadcast,
        vector16.first_n: first_n, row_ops.horizontal_max: horizontal_max,
        vector16.in_range_mask: in_range_mask, vector16.masked: masked,
        row_ops.store_records: store_records, row_ops.load_records: load_records,
        row_ops.store_int32: store_int32, surface_distance._offsets: offsets_record,
        partial_rows.load: part_load, partial_rows.store: store, partial_rows.tile: repeat,
        partial_rows.zeros_like_row: nothing,
        partial_rows.node_numbers: steps, partial_rows.broadcast_per_node: part_load,
        partial_rows.slope_middle: middle, partial_rows.slope_change: change,
        partial_rows.mean_middle: mean, partial_rows.mean_change: mean_slope,
        stencil_sums.gather_affine: _gathers("gather_affine", 4),
        stencil_sums.gather_gradient: _gathers("gather_gradient", 4),
        stencil_sums.gather_value: _gathers("gather_value", 1), particle_records.load_patch: gather,
        cell_stencil_sums.gather_cell_slopes: _gathers("gather_cell_slopes", 3),
        particle_records.patch_of: patch_of, particle_records.velocity_patch_of: velocity_patch_of,
        g2p.keep_lowest_id: note, g2p.record_step_bounds: record_maxima,
        prescribed_transfer.record_prescribed_bounds: record_prescribed,
    },
    # the batch of a thread is one particle
    constants({"BATCH": 1, "CHANGE": 5, "QUARTERS": False}, particle_records, auxiliary_gather,
    stencil_sums),
    VIEWS,
)  # fmt: skip

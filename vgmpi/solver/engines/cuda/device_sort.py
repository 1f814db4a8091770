"""Particle sort on the GPU, the counterpart of parallel/sort_kernels.py, in passes over particles.

The order within a cell is that of ids, so that nothing depends on the order of threads: places
within a cell are assigned as threads arrive, then the few particles of each cell are ordered.
"""

import numpy as np
from numba import cuda

from vgmpi.parallel.sort_kernels import CELLS_PER_BLOCK

from .particle_intrinsics import TEAMWORK
from .scalar_math import PLAIN
from .thread_block import each, meet, number, rank
from .translation_types import TranslationMode

BITS = 29
WHOLE = None

SORT = TranslationMode("sort", PLAIN | TEAMWORK, {})


def tag(start, count, xi, cap, tags, leaps):
    """Move each particle to the block of its base node; a team has a segment.

    Args:
        start, count: First particle and number of particles of each segment.
        xi (in/out): Fixed-point positions, axis after axis.
        cap: Number of particles from one axis to the next.
        tags (out): Neighbor block and cell of each particle.
        leaps (out): Particles per segment and neighbor, shape (segments, 27).
    """
    counts = cuda.shared.array(27, np.int64)
    s = number()
    for k in each(27):
        counts[k] = 0
    meet()
    for n in each(count[s]):
        p, target = start[s] + n, 0
        for axis in range(3):
            c = (xi[axis * cap + p] >> BITS) + 2
            shift = c >> 2
            x = np.int64(xi[axis * cap + p]) - np.int64(shift) * np.int64(4 << BITS)
            xi[axis * cap + p] = WHOLE(x)
            block_stride, cell_stride = (
                (576, 16) if axis == 0 else ((192, 4) if axis == 1 else (64, 1))
            )
            target += block_stride * (shift + 1) + cell_stride * (c & 3)
        tags[p] = target
        cuda.atomic.add(counts, target >> 6, 1)
    meet()
    for k in each(27):
        leaps[s, k] = counts[k]


def aim(start, count, tags, place, targets):
    """Convert tags to targets, -1 where a particle leaves this rank, and count them.

    Args:
        start, count: First particle and number of particles of each segment.
        tags (in/out): Tag, then target of each particle.
        place: Target segment by segment and neighbor, -1 for another rank.
        targets (in/out): Number of particles per target.
    """
    s = number()
    for n in each(count[s]):
        p = start[s] + n
        target = place[s, tags[p] >> 6]
        if target >= 0:
            target = target * CELLS_PER_BLOCK + (tags[p] & (CELLS_PER_BLOCK - 1))
            cuda.atomic.add(targets, target, 1)
        tags[p] = target


def leaving(start, count, tags, place, leavers, total):
    """List the particles that leave this rank, in any order.

    Args:
        start, count: First particle and number of particles of each segment.
        tags: Tags as before `aim`.
        place: Target segment by segment and neighbor, -1 for another rank.
        leavers (out): Indices of the particles.
        total (in/out): Number of particles, shape (1,).
    """
    s = number()
    for n in each(count[s]):
        p = start[s] + n
        if place[s, tags[p] >> 6] < 0:
            leavers[cuda.atomic.add(total, 0, 1)] = p


def append_targets(targets, first, tags, number_of_target):
    """Append the targets of received particles to the tags, and count them.

    Args:
        targets: Target of each received particle.
        first: Index of the first of them.
        tags (in/out): Target of each particle.
        number_of_target (in/out): Number of particles per target.
    """
    n = cuda.blockIdx.x * cuda.blockDim.x + cuda.threadIdx.x
    if n < len(targets):
        tags[first + n] = targets[n]
        cuda.atomic.add(number_of_target, targets[n], 1)


def add_cells(targets, sizes):
    """Sum the particles of each new segment; a team has a segment.

    Args:
        targets: Number of particles per target.
        sizes (out): Number of particles of each segment.
    """
    s = number()
    if rank() == 0:
        total = 0
        for c in range(CELLS_PER_BLOCK):
            total += targets[s * CELLS_PER_BLOCK + c]
        sizes[s] = total


def place_cells(start, targets, begin):
    """Find the first place of each target; a team has a segment.

    Args:
        start: First particle of each new segment.
        targets: Number of particles per target.
        begin (out): First place of each target.
    """
    s = number()
    for c in each(CELLS_PER_BLOCK):
        place = start[s]
        for k in range(c):
            place += targets[s * CELLS_PER_BLOCK + k]
        begin[s * CELLS_PER_BLOCK + c] = place


def put(start, count, tags, begin, source):
    """Assign particles to places of their targets, in any order.

    Args:
        start, count: First particle and number of particles of each segment.
        tags: Target of each particle, -1 if it leaves.
        begin (in/out): First place of each target, then its end.
        source (out): Particle at each place.
    """
    s = number()
    for n in each(count[s]):
        p = start[s] + n
        if tags[p] >= 0:
            source[cuda.atomic.add(begin, tags[p], 1)] = p


def order(count, end, targets, ids, source):
    """Order the particles of each target by id; they are few.

    Args:
        count: Number of targets.
        end: End of the places of each target.
        targets: Number of particles per target.
        ids: Ids of the particles.
        source (in/out): Particle at each place.
    """
    c = cuda.blockIdx.x * cuda.blockDim.x + cuda.threadIdx.x
    if c < count:
        first = end[c] - targets[c]
        for k in range(1, targets[c]):
            q, p = first + k, source[first + k]
            while q > first and ids[source[q - 1]] > ids[p]:
                source[q] = source[q - 1]
                q -= 1
            source[q] = p


def carry(start, count, ends, source, old, new, rows, fill):
    """Set rows[new + q] = rows[old + source[q]] for all places of segments; a team has a segment.

    Args:
        start, count: First particle and number of particles of each segment.
        ends: End of the places of each segment.
        source: Particle at each place.
        old: First number of the channel before the sort.
        new: First number of the channel after the sort.
        rows (in/out): Channels, and a spare one.
        fill: Value of places without a particle.
    """
    s = number()
    for q in range(start[s] + rank(), ends[s], cuda.blockDim.x):
        rows[new + q] = rows[old + source[q]] if q < start[s] + count[s] else fill


def pick_up(index, rows, channels, cap, packed, first):
    """Copy channels of particles into columns of packed, from `first` on.

    Args:
        index: Indices of the particles.
        rows: Channels, each of `cap` numbers.
        channels: Number of channels.
        cap: Number of particles from one channel to the next.
        packed (out): Rows of the message.
        first: First column.
    """
    q = cuda.blockIdx.x * cuda.blockDim.x + cuda.threadIdx.x
    if q < len(index) * channels:
        n, c = q // channels, q % channels
        packed[n, first + c] = rows[c * cap + index[n]]


def put_down(packed, first, channels, rows, cap, begin):
    """Copy columns of packed into channels of new particles, the inverse of `pick_up`.

    Args:
        packed: Rows of the message.
        first: First column.
        channels: Number of channels.
        rows (out): Channels, each of `cap` numbers.
        cap: Number of particles from one channel to the next.
        begin: Index of the first new particle.
    """
    q = cuda.blockIdx.x * cuda.blockDim.x + cuda.threadIdx.x
    if q < len(packed) * channels:
        n, c = q // channels, q % channels
        rows[c * cap + begin + n] = packed[n, first + c]

"""A sort on a card: what domain/sorting.py does, in passes over particles.

The order within a cell is that of ids, so that nothing depends on which thread comes first: places
within a cell are taken as threads come, then each cell's few particles are put in order.
"""

import numpy as np
from numba import cuda

from ...domain.sorting import CELLS
from .numbers import PLAIN
from .particle import TEAMWORK
from .team import each, meet, number, rank
from .words import Mode

BITS = 29
WHOLE = None

SORT = Mode("sort", PLAIN | TEAMWORK, {})


def tag(start, count, xi, cap, tags, leaps):
    """Move each particle to the block its base node lies in: sorting.tag. A team has a segment."""
    here = cuda.shared.array(27, np.int64)
    s = number()
    for k in each(27):
        here[k] = 0
    meet()
    for n in each(count[s]):
        p, to = start[s] + n, 0
        for axis in range(3):
            c = (xi[axis * cap + p] >> BITS) + 2
            shift = c >> 2
            x = np.int64(xi[axis * cap + p]) - np.int64(shift) * np.int64(4 << BITS)
            xi[axis * cap + p] = WHOLE(x)
            far, near = (576, 16) if axis == 0 else ((192, 4) if axis == 1 else (64, 1))
            to += far * (shift + 1) + near * (c & 3)
        tags[p] = to
        cuda.atomic.add(here, to >> 6, 1)
    meet()
    for k in each(27):
        leaps[s, k] = here[k]


def aim(start, count, tags, place, targets):
    """Tags to targets, -1 where a particle leaves this rank; counts them: sorting.aim."""
    s = number()
    for n in each(count[s]):
        p = start[s] + n
        to = place[s, tags[p] >> 6]
        if to >= 0:
            to = to * CELLS + (tags[p] & (CELLS - 1))
            cuda.atomic.add(targets, to, 1)
        tags[p] = to


def leaving(start, count, tags, place, gone, found):
    """Places of the particles whose target is -1, in any order: sorting.leaving. tags: as before
    `aim`; found: (1,) how many, counted on."""
    s = number()
    for n in each(count[s]):
        p = start[s] + n
        if place[s, tags[p] >> 6] < 0:
            gone[cuda.atomic.add(found, 0, 1)] = p


def put(start, count, tags, begin, taken, source):
    """Particles to their targets' places, in any order. begin: (targets,) first place of each;
    taken: (targets,) how many have come."""
    s = number()
    for n in each(count[s]):
        p = start[s] + n
        if tags[p] >= 0:
            source[begin[tags[p]] + cuda.atomic.add(taken, tags[p], 1)] = p


def order(begin, taken, ids, source):
    """By id within each target: they are few."""
    c = cuda.blockIdx.x * cuda.blockDim.x + cuda.threadIdx.x
    if c < len(begin):
        first = begin[c]
        for k in range(1, taken[c]):
            q, p = first + k, source[first + k]
            while q > first and ids[source[q - 1]] > ids[p]:
                source[q] = source[q - 1]
                q -= 1
            source[q] = p


def carry(start, count, ends, source, first, old, new, fill):
    """new[q] = old[first + source[q]] for the places of all segments, `fill` up to the next one's
    beginning; a team has a segment. ends: (segments,)."""
    s = number()
    for q in range(start[s] + rank(), ends[s], cuda.blockDim.x):
        new[q] = old[first + source[q]] if q < start[s] + count[s] else fill


def put_back(new, first, old, end):
    """old[first + q] = new[q] for q below `end`."""
    q = cuda.blockIdx.x * cuda.blockDim.x + cuda.threadIdx.x
    if q < end:
        old[first + q] = new[q]


def pick_up(gone, rows, channels, cap, packed, first):
    """Channels of particles into columns first .. of packed: sorting.pick_up."""
    q = cuda.blockIdx.x * cuda.blockDim.x + cuda.threadIdx.x
    if q < len(gone) * channels:
        n, c = q // channels, q % channels
        packed[n, first + c] = rows[c * cap + gone[n]]


def put_down(packed, first, channels, rows, cap, begin):
    """The other way: sorting.put_down."""
    q = cuda.blockIdx.x * cuda.blockDim.x + cuda.threadIdx.x
    if q < len(packed) * channels:
        n, c = q // channels, q % channels
        rows[c * cap + begin + n] = packed[n, first + c]

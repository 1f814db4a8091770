"""Kernels of the particle sort: passes over tags of 4 bytes, then one pass per channel."""

import numpy as np

from vgmpi.runtime.jit import kernel

CELLS_PER_BLOCK = 64  # [cells] per block


@kernel
def assign_tags(start, count, xi, bits, tags, leaps):
    """Move each particle to the block of its base node, at most one block away.

    Args:
        start: First particle of each segment, shape (segments,) int64.
        count: Particles of each segment, shape (segments,) int64.
        xi: Fixed-point positions (in/out), shape (3, cap); changed if the block changes.
        bits: Fractional bits of a position.
        tags: 64 times the number 0 to 26 of the new block around the old one, plus the cell 0 to 63
            within it (out), shape (cap,) int32.
        leaps: Particles by block around each segment (out), shape (segments, 27).
    """
    for s in range(len(start)):
        a, b = start[s], start[s] + count[s]
        segment_tags, leap = tags[a:b], leaps[s]
        segment_tags[:] = 0
        for axis in range(3):
            x, block_factor, cell_factor = (
                xi[axis, a:b],
                CELLS_PER_BLOCK * 3 ** (2 - axis),
                4 ** (2 - axis),
            )
            for p in range(b - a):
                c = (x[p] >> bits) + 2
                shift = c >> 2
                x[p] -= shift * (4 << bits)
                segment_tags[p] += block_factor * (shift + 1) + cell_factor * (c & 3)
        for p in range(b - a):
            leap[segment_tags[p] >> 6] += 1


@kernel
def assign_targets(start, count, tags, place, number):
    """Replace tags by targets: 64 times the segment after the sort, plus the cell; -1 if leaving.

    Args:
        start: First particle of each segment, shape (segments,).
        count: Particles of each segment, shape (segments,).
        tags: Tags of `assign_tags`, then targets (in/out), shape (cap,) int32.
        place: New segment for each block around a segment, or -1, shape (segments, 27).
        number: Particles of each target, increased (in/out), shape (new segments * 64,).
    """
    for s in range(len(start)):
        segment_tags, places = tags[start[s] : start[s] + count[s]], place[s]
        for p in range(len(segment_tags)):
            to = places[segment_tags[p] >> 6]
            if to >= 0:
                to = to * CELLS_PER_BLOCK + (segment_tags[p] & (CELLS_PER_BLOCK - 1))
                number[to] += 1
            segment_tags[p] = to


@kernel
def collect_leaving(start, count, tags, place, block, indices, to, cell):
    """List the particles whose target is -1.

    Args:
        start: First particle of each segment, shape (segments,).
        count: Particles of each segment, shape (segments,).
        tags: Tags of `assign_tags`, before `assign_targets`, shape (cap,).
        place: New segment for each block around a segment, or -1, shape (segments, 27).
        block: Value for `to` of each block around a segment, shape (segments, 27).
        indices: Indices of the particles (out), shape (n,).
        to: `block` of their targets (out), shape (n,).
        cell: Their cells (out), shape (n,).
    """
    n = 0
    for s in range(len(start)):
        if n == len(indices):
            break  # the list is complete
        places = place[s]
        for p in range(start[s], start[s] + count[s]):
            k = tags[p] >> 6
            if places[k] < 0:
                indices[n], to[n], cell[n] = p, block[s, k], tags[p] & (CELLS_PER_BLOCK - 1)
                n += 1


@kernel
def pack_particles(places, rows, packed, first):
    """Pack channels of particles into columns of a message with one row per particle.

    Args:
        places: Indices of the particles, shape (n,).
        rows: Channels, shape (m, cap).
        packed: Message (out), shape (n, columns).
        first: First of the m columns.
    """
    for c in range(len(rows)):
        row = rows[c]
        for n in range(len(places)):
            packed[n, first + c] = row[places[n]]


@kernel
def unpack_particles(packed, first, rows, begin):
    """Unpack columns of a message into channels of consecutive particles.

    Args:
        packed: Message, shape (n, columns).
        first: First of the m columns.
        rows: Channels (out), shape (m, cap).
        begin: Index of the first particle.
    """
    for c in range(len(rows)):
        row = rows[c]
        for n in range(len(packed)):
            row[begin + n] = packed[n, first + c]


@kernel
def counting_sort(start, count, targets, ids, number, lanes, new_start, source):
    """Order particles by (segment, cell, id), such that source[new] = old index.

    Segments begin at multiples of `lanes`.

    Args:
        start: First particle of each old segment, shape (segments,).
        count: Particles of each old segment, shape (segments,).
        targets: Targets of `assign_targets`, shape (cap,).
        ids: Particle ids, shape (cap,).
        number: Particles of each target; overwritten (in/out), shape (new segments * 64,).
        lanes: Alignment of segments.
        new_start: First particle of each new segment (out), shape (new segments,).
        source: Old index of each new one (out), uint32.

    Returns:
        End of the last segment.
    """
    offset = 0
    begin = np.empty_like(number)
    for b in range(len(new_start)):
        new_start[b] = offset
        for c in range(CELLS_PER_BLOCK * b, CELLS_PER_BLOCK * (b + 1)):
            cell_count = number[c]
            number[c] = offset
            begin[c] = offset
            offset += cell_count
        offset = (offset + lanes - 1) // lanes * lanes
    for s in range(len(start)):
        segment_targets = targets[start[s] : start[s] + count[s]]
        names = ids[start[s] : start[s] + count[s]]
        for p in range(len(segment_targets)):
            to = segment_targets[p]
            if to >= 0:
                q = number[to]
                number[to] = q + 1
                # Insertion sort by id among the particles placed in this cell: they are few.
                first = begin[to]
                while q > first and ids[source[q - 1]] > names[p]:
                    source[q] = source[q - 1]
                    q -= 1
                source[q] = start[s] + p
    return offset


@kernel
def gather_rows(new_start, new_count, source, old, new, fill):
    """Gather new[q] = old[source[q]] for all segments, and write `fill` between them.

    Args:
        new_start: First particle of each segment, shape (segments,).
        new_count: Particles of each segment, shape (segments,).
        source: Old indices; unsigned, so that no index is tested for counting from the end.
        old: Values of one channel.
        new: Gathered values (out).
        fill: Value of the padding.
    """
    for s in range(len(new_start)):
        a = new_start[s]
        b = a + new_count[s]
        segment, place = new[a:b], source[a:b]
        for q in range(b - a):
            segment[q] = old[place[q]]
        end = new_start[s + 1] if s + 1 < len(new_start) else (b + 15) // 16 * 16
        new[b:end] = fill

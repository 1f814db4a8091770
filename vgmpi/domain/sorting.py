"""Loops over particles that a sort needs: passes over tags of 4 bytes, then one per channel."""

import numpy as np

from ..device.jit import kernel

CELLS = 64  # of a block


@kernel
def tag(start, count, xi, bits, tags, leaps):
    """Move each particle to the block its base node lies in, at most one away.

    xi: (3, cap), changed where the block changes; tags: (cap,) int32 out, 64 times the new block's
    number 0..26 around the old one, plus the cell 0..63 within it; leaps: (segments, 27) out,
    particles by block.
    """
    for s in range(len(start)):
        a, b = start[s], start[s] + count[s]
        here, leap = tags[a:b], leaps[s]
        here[:] = 0
        for axis in range(3):
            x, far, near = xi[axis, a:b], CELLS * 3 ** (2 - axis), 4 ** (2 - axis)
            for p in range(b - a):
                c = (x[p] >> bits) + 2
                shift = c >> 2
                x[p] -= shift * (4 << bits)
                here[p] += far * (shift + 1) + near * (c & 3)
        for p in range(b - a):
            leap[here[p] >> 6] += 1


@kernel
def aim(start, count, tags, place, number):
    """Tags to targets: 64 times the particle's segment after the sort, plus its cell; -1 where it
    leaves this rank.

    place: (segments, 27) new segment or -1; number: (new segments * 64,) particles of each target,
    counted on.
    """
    for s in range(len(start)):
        here, places = tags[start[s] : start[s] + count[s]], place[s]
        for p in range(len(here)):
            to = places[here[p] >> 6]
            if to >= 0:
                to = to * CELLS + (here[p] & (CELLS - 1))
                number[to] += 1
            here[p] = to


@kernel
def leaving(start, count, tags, place, block, gone, to, cell):
    """Particles whose target is -1: their places into gone, `block` of their segment's target into
    to, and their cells.

    tags: as before `aim`; place: as for `aim`; block: (segments, 27).
    """
    n = 0
    for s in range(len(start)):
        if n == len(gone):
            break  # all are found
        places = place[s]
        for p in range(start[s], start[s] + count[s]):
            k = tags[p] >> 6
            if places[k] < 0:
                gone[n], to[n], cell[n] = p, block[s, k], tags[p] & (CELLS - 1)
                n += 1


@kernel
def pick_up(places, rows, packed, first):
    """Channels (m, cap) of the particles at `places` into columns first .. first + m of packed,
    a row per particle."""
    for c in range(len(rows)):
        row = rows[c]
        for n in range(len(places)):
            packed[n, first + c] = row[places[n]]


@kernel
def put_down(packed, first, rows, begin):
    """The other way: columns of packed to channels of the particles from `begin` on."""
    for c in range(len(rows)):
        row = rows[c]
        for n in range(len(packed)):
            row[begin + n] = packed[n, first + c]


@kernel
def arrange(start, count, targets, ids, number, lanes, new_start, source):
    """Order by (segment, cell, id): source[new] = old index; segments begin at multiples of
    `lanes`.

    number: (new segments * 64,) particles of each target on entry, scratch on return; new_start:
    (new segments,) out; source: uint32. Returns the end of the last segment.
    """
    at = 0
    begin = np.empty_like(number)
    for b in range(len(new_start)):
        new_start[b] = at
        for c in range(CELLS * b, CELLS * (b + 1)):
            here = number[c]
            number[c] = at
            begin[c] = at
            at += here
        at = (at + lanes - 1) // lanes * lanes
    for s in range(len(start)):
        here = targets[start[s] : start[s] + count[s]]
        names = ids[start[s] : start[s] + count[s]]
        for p in range(len(here)):
            to = here[p]
            if to >= 0:
                q = number[to]
                number[to] = q + 1
                # insertion by id among those of the cell already placed: they are few
                first = begin[to]
                while q > first and ids[source[q - 1]] > names[p]:
                    source[q] = source[q - 1]
                    q -= 1
                source[q] = start[s] + p
    return at


@kernel
def gather_rows(new_start, new_count, source, old, new, fill):
    """new[q] = old[source[q]] for the places of all segments; `fill` up to the next segment.

    source: unsigned, so that no index is tested for counting from the end.
    """
    for s in range(len(new_start)):
        a = new_start[s]
        b = a + new_count[s]
        here, place = new[a:b], source[a:b]
        for q in range(b - a):
            here[q] = old[place[q]]
        end = new_start[s + 1] if s + 1 < len(new_start) else (b + 15) // 16 * 16
        new[b:end] = fill

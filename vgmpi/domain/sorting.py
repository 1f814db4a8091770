"""Loops over particles that a sort needs."""

import numpy as np

from ..device.jit import kernel


@kernel
def rebin(start, count, block, xi, bits, shape, code, cell):
    """Move each particle to the block its base node lies in.

    block: (segments, 3); xi: (3, cap), changed where the block changes; code, cell: (cap,) out, the
    block's code and the cell 0..63 within it. Returns how many changed block. Unused places keep
    what they held.
    """
    changed = 0
    for s in range(len(start)):
        for p in range(start[s], start[s] + count[s]):
            number = 0
            inside = 0
            moved = False
            for a in range(3):
                c = (xi[a, p] >> bits) + 2
                shift = c >> 2
                if shift != 0:
                    xi[a, p] -= shift * (4 << bits)
                    moved = True
                number = number * shape[a] + block[s, a] + shift
                inside = inside * 4 + (c & 3)
            code[p] = number
            cell[p] = inside
            changed += moved
    return changed


@kernel
def distinct(start, count, code, out):
    """Codes of particles that differ from the code before them, into out; returns how many (repeats
    are possible).
    """
    n = 0
    last = -1
    for s in range(len(start)):
        for p in range(start[s], start[s] + count[s]):
            if code[p] != last:
                last = code[p]
                out[n] = last
                n += 1
    return n


@kernel
def locate(start, count, code, codes, places, place):
    """place[p] = places[i] where codes[i] == code[p]; codes ascending."""
    last = -1
    at = 0
    for s in range(len(start)):
        for p in range(start[s], start[s] + count[s]):
            if code[p] != last:
                last = code[p]
                at = places[np.searchsorted(codes, last)]
            place[p] = at


@kernel
def leaving(start, count, place, out):
    """Indices of particles whose place is -1, into out; returns how many."""
    n = 0
    for s in range(len(start)):
        for p in range(start[s], start[s] + count[s]):
            if place[p] < 0:
                out[n] = p
                n += 1
    return n


@kernel
def arrange(start, count, place, cell, ids, number, lanes, new_start, source):
    """Order by (place, cell, id): source[new] = old index; segments begin at multiples of `lanes`.

    number: (places, 64) particles per place and cell on entry, scratch on return. new_start:
    (places,) out. Returns the end of the last segment.
    """
    at = 0
    begin = np.empty_like(number)
    for b in range(len(number)):
        new_start[b] = at
        for c in range(64):
            here = number[b, c]
            number[b, c] = at
            begin[b, c] = at
            at += here
        at = (at + lanes - 1) // lanes * lanes
    for s in range(len(start)):
        for p in range(start[s], start[s] + count[s]):
            if place[p] >= 0:
                q = number[place[p], cell[p]]
                number[place[p], cell[p]] = q + 1
                # insertion by id among those of the cell already placed: they are few
                first = begin[place[p], cell[p]]
                while q > first and ids[source[q - 1]] > ids[p]:
                    source[q] = source[q - 1]
                    q -= 1
                source[q] = p
    return at


@kernel
def tally(start, count, place, cell, number):
    """Particles per (place, cell)."""
    for s in range(len(start)):
        for p in range(start[s], start[s] + count[s]):
            if place[p] >= 0:
                number[place[p], cell[p]] += 1


@kernel
def gather_rows(new_start, new_count, source, old, new, fill):
    """new[q] = old[source[q]] for the places of all segments; `fill` up to the next segment."""
    for s in range(len(new_start)):
        a = new_start[s]
        for q in range(a, a + new_count[s]):
            new[q] = old[source[q]]
        end = new_start[s + 1] if s + 1 < len(new_start) else (a + new_count[s] + 15) // 16 * 16
        for q in range(a + new_count[s], min(end, len(new))):
            new[q] = fill

"""Sums over the nine rows of nodes of each record: of records into a patch, and of a patch's nodes
into records (see p2g.py and g2p.py, records.py).

A row is taken whole, or some of its nodes at a time, as the processor's registers ask for
(device/processor.py): what is summed, in which order and with which rounding is the same. The
fourth node has weight 0 and is left out where rows are taken in parts.
"""

import numpy as np
from numba import njit
from numba.extending import overload

from ..device.jit import within
from ..device.processor import vector_bytes
from ..lanes.parts import (
    load,
    nothing,
    repeat,
    slope_change,
    slope_middle,
    steps,
    store,
    store_sums,
    stretch,
)
from .records import PLANE, ROW

# rows as parts (first node, nodes), by how many nodes fit a register
WAYS = {4: ((0, 4),), 2: ((0, 2), (2, 1)), 1: ((0, 1), (1, 1), (2, 1))}

# not kept by itself, since it is made of functions made here; what calls it is kept
_inline = njit(nogil=True, error_model="numpy")


@within
def _add(patch, o, a, b, c):
    """Add to three rows."""
    store(patch, o, load(patch, o, a) + a)
    store(patch, o + ROW, load(patch, o + ROW, b) + b)
    store(patch, o + 2 * ROW, load(patch, o + 2 * ROW, c) + c)


@within
def _row_terms(records, weights, m, k, w):
    """What a record adds to the rows of the first plane, over the weight along x, and how much that
    changes from plane to plane. k: numbers of the nodes, w: their weights."""
    along_x, along_y, along_z = (
        repeat(records, m + 4, w),
        repeat(records, m + 8, w),
        repeat(records, m + 12, w),
    )
    a = repeat(records, m, w) + weights[m + 3] * along_x + weights[m + 7] * along_y
    a = (a + (k + weights[m + 12]) * along_z) * w
    along_x, along_y = w * along_x, w * along_y
    b = a + along_y
    c = b + along_y
    w0, w1, w2 = weights[m + 4], weights[m + 5], weights[m + 6]
    return w0 * a, w1 * b, w2 * c, w0 * along_x, w1 * along_x, w2 * along_x


def _scatter(node, nodes):
    """`scatter` of records first, ..., last - 1, all with base row o, to some nodes of each row."""

    @within
    def go(first, last, records, weights, patch, o):
        k, zero = steps(patch, node, nodes), nothing(patch, node, nodes)
        r0, r1, r2, r3, r4, r5, r6, r7, r8 = zero, zero, zero, zero, zero, zero, zero, zero, zero
        for n in range(first, last):
            m = 16 * n
            w = stretch(weights, m + 8 + node, zero)
            a, b, c, da, db, dc = _row_terms(records, weights, m, k, w)
            u = weights[m]
            r0, r1, r2 = r0 + u * a, r1 + u * b, r2 + u * c
            a, b, c = a + da, b + db, c + dc
            u = weights[m + 1]
            r3, r4, r5 = r3 + u * a, r4 + u * b, r5 + u * c
            a, b, c = a + da, b + db, c + dc
            u = weights[m + 2]
            r6, r7, r8 = r6 + u * a, r7 + u * b, r8 + u * c
        o += 4 * node
        _add(patch, o, r0, r1, r2)
        _add(patch, o + PLANE, r3, r4, r5)
        _add(patch, o + 2 * PLANE, r6, r7, r8)

    return go


def _scatter_slopes(node, nodes):
    """`scatter_slopes` of one record, as `_scatter`."""

    @within
    def go(n, last, records, weights, patch, o):
        middle = slope_middle(patch, node, nodes)
        change, zero = slope_change(patch, node, nodes), nothing(patch, node, nodes)
        m = 16 * n
        o += 4 * node
        w = stretch(weights, m + 8 + node, zero)
        a = repeat(records, m, w) * w
        a = a + repeat(records, m + 12, w) * (middle + change * weights[m + 12])
        bx, by = repeat(records, m + 4, w) * w, repeat(records, m + 8, w) * w
        x, y = weights[m + 3], weights[m + 7]
        y0, y1, y2 = -0.25 * (1.5 + y), 0.5 * (1.0 + y), -0.25 * (0.5 + y)
        w0, w1, w2 = weights[m + 4], weights[m + 5], weights[m + 6]
        a0, a1, a2 = w0 * a + y0 * by, w1 * a + y1 * by, w2 * a + y2 * by
        b0, b1, b2 = w0 * bx, w1 * bx, w2 * bx
        u, g = weights[m], -0.25 * (1.5 + x)
        _add(patch, o, u * a0 + g * b0, u * a1 + g * b1, u * a2 + g * b2)
        u, g = weights[m + 1], 0.5 * (1.0 + x)
        _add(patch, o + PLANE, u * a0 + g * b0, u * a1 + g * b1, u * a2 + g * b2)
        u, g = weights[m + 2], -0.25 * (0.5 + x)
        _add(patch, o + 2 * PLANE, u * a0 + g * b0, u * a1 + g * b1, u * a2 + g * b2)

    return go


def _moments(node, nodes):
    """What `moments` sums over some nodes of each row."""

    @within
    def go(weights, m, patch, o):
        k, zero = steps(patch, node, nodes), nothing(patch, node, nodes)
        o += 4 * node
        w0, w1, w2 = weights[m + 4], weights[m + 5], weights[m + 6]
        last = w2 * load(patch, o + 2 * ROW, zero)
        y = w1 * load(patch, o + ROW, zero) + last
        t = w0 * load(patch, o, zero) + y
        y = y + last
        u = weights[m]
        total, total_y = u * t, u * y
        o += PLANE
        last = w2 * load(patch, o + 2 * ROW, zero)
        y = w1 * load(patch, o + ROW, zero) + last
        t = w0 * load(patch, o, zero) + y
        y = y + last
        u = weights[m + 1]
        total_x = u * t
        total, total_y = total + total_x, total_y + u * y
        o += PLANE
        last = w2 * load(patch, o + 2 * ROW, zero)
        y = w1 * load(patch, o + ROW, zero) + last
        t = w0 * load(patch, o, zero) + y
        y = y + last
        u = weights[m + 2]
        far = u * t
        total, total_x, total_y = total + far, total_x + far + far, total_y + u * y
        w = stretch(weights, m + 8 + node, zero)
        total = total * w
        x, y = weights[m + 3] * total, weights[m + 7] * total
        return total, total_x * w + x, total_y * w + y, total * (k + weights[m + 12])

    return go


def _slopes(node, nodes):
    """What `slopes` sums over some nodes of each row."""

    @within
    def go(weights, m, patch, o):
        middle = slope_middle(patch, node, nodes)
        change, zero = slope_change(patch, node, nodes), nothing(patch, node, nodes)
        o += 4 * node
        x, y = weights[m + 3], weights[m + 7]
        y0, y1, y2 = -0.25 * (1.5 + y), 0.5 * (1.0 + y), -0.25 * (0.5 + y)
        w0, w1, w2 = weights[m + 4], weights[m + 5], weights[m + 6]
        total, gx, gy = zero, zero, zero
        for i in range(3):
            a, b = load(patch, o, zero), load(patch, o + ROW, zero)
            c = load(patch, o + 2 * ROW, zero)
            t = w0 * a + w1 * b + w2 * c
            u = weights[m + i]
            g = -0.25 * (1.5 + x) if i == 0 else (0.5 * (1.0 + x) if i == 1 else -0.25 * (0.5 + x))
            total, gx = total + u * t, gx + g * t
            gy = gy + u * (y0 * a + y1 * b + y2 * c)
            o += PLANE
        w = stretch(weights, m + 8 + node, zero)
        return total * w, gx * w, gy * w, total * (middle + change * weights[m + 12])

    return go


def _values(node, nodes):
    """What `values` sums over some nodes of each row."""

    @within
    def go(weights, m, patch, o):
        o += 4 * node
        w0, w1, w2 = weights[m + 4], weights[m + 5], weights[m + 6]
        zero = nothing(patch, node, nodes)
        total = zero
        for i in range(3):
            t = w0 * load(patch, o, zero) + w1 * load(patch, o + ROW, zero)
            t = t + w2 * load(patch, o + 2 * ROW, zero)
            total = total + weights[m + i] * t
            o += PLANE
        return (total * stretch(weights, m + 8 + node, zero),)

    return go


# ---- parts put together -------------------------------------------------------------------------


def _in_turn(parts):
    """A function that calls each of one to three in turn."""
    first, second, last = parts[0], parts[-2 % len(parts)], parts[-1]

    @within
    def one(n, end, records, weights, patch, o):
        last(n, end, records, weights, patch, o)

    @within
    def two(n, end, records, weights, patch, o):
        first(n, end, records, weights, patch, o)
        last(n, end, records, weights, patch, o)

    @within
    def three(n, end, records, weights, patch, o):
        first(n, end, records, weights, patch, o)
        second(n, end, records, weights, patch, o)
        last(n, end, records, weights, patch, o)

    return (one, two, three)[len(parts) - 1]


def runs(some, parts):
    """A function that sums runs of records with one base row and adds the sums to the patch, in the
    order of the runs: part by part, so that each part has registers for its sums."""
    if len(parts) == 1:
        return _runs_whole
    add = _in_turn([some(node, nodes) for node, nodes in parts])

    @_inline
    def go(count, records, weights, base, patch):
        n = 0
        while n < count:
            here, end = base[n], n + 1
            while end < count and base[end] == here:
                end += 1
            add(n, end, records, weights, patch, np.int64(here))
            n = end

    return go


@_inline
def _runs_whole(count, records, weights, base, patch):
    """As `runs` of whole rows makes it, in one loop, where registers suffice."""
    k, zero = steps(patch, 0, 4), nothing(patch, 0, 4)
    r0, r1, r2, r3, r4, r5, r6, r7, r8 = zero, zero, zero, zero, zero, zero, zero, zero, zero
    here = base[0]
    for n in range(count + 1):
        if n == count or base[n] != here:
            o = np.int64(here)
            _add(patch, o, r0, r1, r2)
            _add(patch, o + PLANE, r3, r4, r5)
            _add(patch, o + 2 * PLANE, r6, r7, r8)
            r0, r1, r2, r3, r4 = zero, zero, zero, zero, zero
            r5, r6, r7, r8 = zero, zero, zero, zero
            if n == count:
                break
            here = base[n]
        m = 16 * n
        w = stretch(weights, m + 8, zero)
        a, b, c, da, db, dc = _row_terms(records, weights, m, k, w)
        u = weights[m]
        r0, r1, r2 = r0 + u * a, r1 + u * b, r2 + u * c
        a, b, c = a + da, b + db, c + dc
        u = weights[m + 1]
        r3, r4, r5 = r3 + u * a, r4 + u * b, r5 + u * c
        a, b, c = a + da, b + db, c + dc
        u = weights[m + 2]
        r6, r7, r8 = r6 + u * a, r7 + u * b, r8 + u * c


def one_by_one(some, parts):
    """A function that adds every record to the patch."""
    add = _in_turn([some(node, nodes) for node, nodes in parts])

    @_inline
    def go(count, records, weights, base, patch):
        for n in range(count):
            add(n, n + 1, records, weights, patch, np.int64(base[n]))

    return go


def together(some, parts):
    """A function that fills records, each from all parts of its rows."""
    made = [some(node, nodes) for node, nodes in parts]
    first, second, last = made[0], made[-2 % len(made)], made[-1]
    if len(made) == 1:

        @within
        def sums(weights, m, patch, o):
            return (first(weights, m, patch, o),)
    elif len(made) == 2:

        @within
        def sums(weights, m, patch, o):
            return first(weights, m, patch, o), last(weights, m, patch, o)
    else:

        @within
        def sums(weights, m, patch, o):
            a, b = first(weights, m, patch, o), second(weights, m, patch, o)
            return a, b, last(weights, m, patch, o)

    @_inline
    def go(count, records, weights, base, patch):
        for n in range(count):
            m = 16 * n
            store_sums(records, m, sums(weights, m, patch, np.int64(base[n])))

    return go


SUMS = {  # how parts are put together, and what they are made of
    "scatter": (runs, _scatter),
    "scatter_slopes": (one_by_one, _scatter_slopes),
    "moments": (together, _moments),
    "slopes": (together, _slopes),
    "values": (together, _values),
}


def way(name: str, register: int, bits: int) -> int:
    """Which of WAYS a function takes with registers of so many bytes and numbers of so many bits.

    Processors with registers of 64 bytes have 32 of them: enough for whole rows. A function that
    keeps no sums is in no need before a row takes four.
    """
    fit = register * 8 // (4 * bits)
    if register == 64 or (SUMS[name][0] is one_by_one and fit == 2):
        return 4
    return max(fit, 1)


def _choose(name):
    """Define `name` for the precision of its patch."""
    put, some = SUMS[name]
    made = {nodes: put(some, parts) for nodes, parts in WAYS.items()}

    def choose(count, records, weights, base, patch):
        go = made[way(name, vector_bytes(), patch.dtype.bitwidth)]
        return lambda count, records, weights, base, patch: go(count, records, weights, base, patch)

    overload(globals()[name], strict=False)(choose)


def scatter(count, records, weights, base, patch):
    """Add records to the patch, nine rows each; particles with one base row are summed first."""


def scatter_slopes(count, records, weights, base, patch):
    """As `scatter`, with the gradients of the B-splines in place of weight times offset."""


def moments(count, records, weights, base, patch):
    """Records of velocity 0-2 and of its moments with the offset along x 4-6, y 8-10, z 12-14."""


def slopes(count, records, weights, base, patch):
    """As `moments`, with the gradients of the B-splines in place of weight times offset."""


def values(count, records, weights, base, patch):
    """Records of what is gathered alone, without its moments: 0-2."""


for _name in SUMS:
    _choose(_name)

"""Stencil sums over the nine rows of nodes of each record.

Records are scattered to a patch, and a patch's nodes are gathered into records (see
kernels/transfer/p2g.py, kernels/transfer/g2p.py and particle_records.py). A row is processed at
once or in parts of some nodes, depending on the processor's registers (runtime/cpu_features.py):
terms, their order and their rounding are the same. The fourth node has weight 0 and is left out
where rows are split.
"""

import numpy as np
from numba import njit

from vgmpi.kernels.simd.partial_rows import (
    broadcast_per_node,
    load,
    node_numbers,
    slope_change,
    slope_middle,
    store,
    store_sums,
    tile,
    zeros_like_row,
)
from vgmpi.runtime.cpu_features import vector_bytes
from vgmpi.runtime.jit import always_inline, overload

from .particle_records import PLANE, ROW

# parts of a row (first node, number of nodes), by the number of nodes that fit a register
ROW_SPLITS = {4: ((0, 4),), 2: ((0, 2), (2, 1)), 1: ((0, 1), (1, 1), (2, 1))}

# not cached by itself, since it is built from closures of this file; its callers are cached
_inline = njit(nogil=True, error_model="numpy")


@always_inline
def _add(patch, o, a, b, c):
    """Add to three rows."""
    store(patch, o, load(patch, o, a) + a)
    store(patch, o + ROW, load(patch, o + ROW, b) + b)
    store(patch, o + 2 * ROW, load(patch, o + 2 * ROW, c) + c)


@always_inline
def _row_terms(records, weights, m, k, w):
    """Return a record's terms for the rows of the first plane, and their increments per plane.

    The weight along x is left out. k: numbers of the nodes, w: their weights.
    """
    along_x, along_y, along_z = (
        tile(records, m + 4, w),
        tile(records, m + 8, w),
        tile(records, m + 12, w),
    )
    a = tile(records, m, w) + weights[m + 3] * along_x + weights[m + 7] * along_y
    a = (a + (k + weights[m + 12]) * along_z) * w
    along_x, along_y = w * along_x, w * along_y
    b = a + along_y
    c = b + along_y
    w0, w1, w2 = weights[m + 4], weights[m + 5], weights[m + 6]
    return w0 * a, w1 * b, w2 * c, w0 * along_x, w1 * along_x, w2 * along_x


def _scatter(node, nodes):
    """Make `scatter` for records of one base row o, on some nodes of each row."""

    @always_inline
    def _stencil(first, last, records, weights, patch, o):
        k, zero = node_numbers(patch, node, nodes), zeros_like_row(patch, node, nodes)
        r0, r1, r2, r3, r4, r5, r6, r7, r8 = zero, zero, zero, zero, zero, zero, zero, zero, zero
        for n in range(first, last):
            m = 16 * n
            w = broadcast_per_node(weights, m + 8 + node, zero)
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

    return _stencil


def _scatter_slopes(node, nodes):
    """Make `scatter_slopes` for one record, on some nodes of each row."""

    @always_inline
    def _stencil(n, last, records, weights, patch, o):
        middle = slope_middle(patch, node, nodes)
        change, zero = slope_change(patch, node, nodes), zeros_like_row(patch, node, nodes)
        m = 16 * n
        o += 4 * node
        w = broadcast_per_node(weights, m + 8 + node, zero)
        a = tile(records, m, w) * w
        a = a + tile(records, m + 12, w) * (middle + change * weights[m + 12])
        bx, by = tile(records, m + 4, w) * w, tile(records, m + 8, w) * w
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

    return _stencil


def _moments(node, nodes):
    """Make the sums of `gather_affine` over some nodes of each row."""

    @always_inline
    def _stencil(weights, m, patch, o):
        k, zero = node_numbers(patch, node, nodes), zeros_like_row(patch, node, nodes)
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
        outer = u * t
        total, total_x, total_y = total + outer, total_x + outer + outer, total_y + u * y
        w = broadcast_per_node(weights, m + 8 + node, zero)
        total = total * w
        x, y = weights[m + 3] * total, weights[m + 7] * total
        return total, total_x * w + x, total_y * w + y, total * (k + weights[m + 12])

    return _stencil


def _slopes(node, nodes):
    """Make the sums of `gather_gradient` over some nodes of each row."""

    @always_inline
    def _stencil(weights, m, patch, o):
        middle = slope_middle(patch, node, nodes)
        change, zero = slope_change(patch, node, nodes), zeros_like_row(patch, node, nodes)
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
        w = broadcast_per_node(weights, m + 8 + node, zero)
        return total * w, gx * w, gy * w, total * (middle + change * weights[m + 12])

    return _stencil


def _values(node, nodes):
    """Make the sums of `gather_value` over some nodes of each row."""

    @always_inline
    def _stencil(weights, m, patch, o):
        o += 4 * node
        w0, w1, w2 = weights[m + 4], weights[m + 5], weights[m + 6]
        zero = zeros_like_row(patch, node, nodes)
        total = zero
        for i in range(3):
            t = w0 * load(patch, o, zero) + w1 * load(patch, o + ROW, zero)
            t = t + w2 * load(patch, o + 2 * ROW, zero)
            total = total + weights[m + i] * t
            o += PLANE
        return (total * broadcast_per_node(weights, m + 8 + node, zero),)

    return _stencil


# ---- parts put together -------------------------------------------------------------------------


def in_turn(parts):
    """Return a function that calls each of one to three functions in turn."""
    first, second, last = parts[0], parts[-2 % len(parts)], parts[-1]

    @always_inline
    def _two_parts(n, end, records, weights, patch, o):
        first(n, end, records, weights, patch, o)
        last(n, end, records, weights, patch, o)

    @always_inline
    def _three_parts(n, end, records, weights, patch, o):
        first(n, end, records, weights, patch, o)
        second(n, end, records, weights, patch, o)
        last(n, end, records, weights, patch, o)

    return (last, _two_parts, _three_parts)[len(parts) - 1]


def by_runs(make_part, parts):
    """Return a function that scatters runs of records with one base row."""
    return _runs_whole if len(parts) == 1 else runs_in_parts(make_part, parts)


def runs_in_parts(make_part, parts):
    """Return a function that scatters runs of records with one base row, part by part."""
    add = in_turn([make_part(node, nodes) for node, nodes in parts])

    @_inline
    def _stencil(count, records, weights, base, patch):
        n = 0
        while n < count:
            base_row, end = base[n], n + 1
            while end < count and base[end] == base_row:
                end += 1
            add(n, end, records, weights, patch, np.int64(base_row))
            n = end

    return _stencil


@_inline
def _runs_whole(count, records, weights, base, patch):
    """Scatter runs in one loop over complete rows, where registers suffice; see `by_runs`."""
    k, zero = node_numbers(patch, 0, 4), zeros_like_row(patch, 0, 4)
    r0, r1, r2, r3, r4, r5, r6, r7, r8 = zero, zero, zero, zero, zero, zero, zero, zero, zero
    base_row = base[0]
    for n in range(count + 1):
        if n == count or base[n] != base_row:
            o = np.int64(base_row)
            _add(patch, o, r0, r1, r2)
            _add(patch, o + PLANE, r3, r4, r5)
            _add(patch, o + 2 * PLANE, r6, r7, r8)
            r0, r1, r2, r3, r4 = zero, zero, zero, zero, zero
            r5, r6, r7, r8 = zero, zero, zero, zero
            if n == count:
                break
            base_row = base[n]
        m = 16 * n
        w = broadcast_per_node(weights, m + 8, zero)
        a, b, c, da, db, dc = _row_terms(records, weights, m, k, w)
        u = weights[m]
        r0, r1, r2 = r0 + u * a, r1 + u * b, r2 + u * c
        a, b, c = a + da, b + db, c + dc
        u = weights[m + 1]
        r3, r4, r5 = r3 + u * a, r4 + u * b, r5 + u * c
        a, b, c = a + da, b + db, c + dc
        u = weights[m + 2]
        r6, r7, r8 = r6 + u * a, r7 + u * b, r8 + u * c


def per_record(make_part, parts):
    """Return a function that adds every record to the patch."""
    add = in_turn([make_part(node, nodes) for node, nodes in parts])

    @_inline
    def _stencil(count, records, weights, base, patch):
        for n in range(count):
            add(n, n + 1, records, weights, patch, np.int64(base[n]))

    return _stencil


def per_row(make_part, parts):
    """Return a function that fills records, each from all parts of its rows."""
    functions = [make_part(node, nodes) for node, nodes in parts]
    first, second, last = functions[0], functions[-2 % len(functions)], functions[-1]
    if len(functions) == 1:

        @always_inline
        def _sums(weights, m, patch, o):
            return (first(weights, m, patch, o),)
    elif len(functions) == 2:

        @always_inline
        def _sums(weights, m, patch, o):
            return first(weights, m, patch, o), last(weights, m, patch, o)
    else:

        @always_inline
        def _sums(weights, m, patch, o):
            a, b = first(weights, m, patch, o), second(weights, m, patch, o)
            return a, b, last(weights, m, patch, o)

    @_inline
    def _stencil(count, records, weights, base, patch):
        for n in range(count):
            m = 16 * n
            store_sums(records, m, _sums(weights, m, patch, np.int64(base[n])))

    return _stencil


STENCIL_FUNCTIONS: dict = {}  # name: (how parts are combined, how one part is made)


def row_split_for(name: str, register: int, bits: int) -> int:
    """Return the key of `ROW_SPLITS` for a function, by bytes of a register and bits of a number.

    Processors with registers of 64 bytes have 32 of them: enough for complete rows. A function
    without running sums needs no split before a row takes four registers.
    """
    fit = register * 8 // (4 * bits)
    if register == 64 or (STENCIL_FUNCTIONS[name][0] is per_record and fit == 2):
        return 4
    return max(fit, 1)


def define_stencil_function(stub, combine, make_part):
    """Define the function `stub` for the precision of its patch.

    Its parts, by `make_part(node, nodes)`, are combined by `by_runs`, `per_record` or `per_row`.
    """
    name = stub.__name__
    STENCIL_FUNCTIONS[name] = combine, make_part
    functions = {nodes: combine(make_part, parts) for nodes, parts in ROW_SPLITS.items()}

    def _implementation(count, records, weights, base, patch):
        _stencil = functions[row_split_for(name, vector_bytes(), patch.dtype.bitwidth)]
        return lambda count, records, weights, base, patch: _stencil(
            count, records, weights, base, patch
        )

    overload(stub)(_implementation)


def scatter(count, records, weights, base, patch):
    """Add records to the patch, nine rows each; particles with one base row are summed first.

    Args:
        count: Number of records.
        records: Value 0-3 and slopes per cell 4-15 of each; the gathering functions write it.
        weights, base: Records of weights; base rows, shape (count,).
        patch: Patch (in/out), shape (2048,).
    """


def scatter_slopes(count, records, weights, base, patch):
    """Add records along the gradients of the B-splines instead of weight times offset.

    Args:
        count, records, weights, base, patch: See `scatter`.
    """


def gather_affine(count, records, weights, base, patch):
    """Gather velocity 0-2 and its moments with the offset: x 4-6, y 8-10, z 12-14.

    Args:
        count, records, weights, base, patch: See `scatter`.
    """


def gather_gradient(count, records, weights, base, patch):
    """Gather like `gather_affine`, with B-spline gradients instead of weight times offset.

    Args:
        count, records, weights, base, patch: See `scatter`.
    """


def gather_value(count, records, weights, base, patch):
    """Gather the value alone, without its moments: 0-2.

    Args:
        count, records, weights, base, patch: See `scatter`.
    """


define_stencil_function(scatter, by_runs, _scatter)
define_stencil_function(scatter_slopes, per_record, _scatter_slopes)
define_stencil_function(gather_affine, per_row, _moments)
define_stencil_function(gather_gradient, per_row, _slopes)
define_stencil_function(gather_value, per_row, _values)


def _scatter_values(node, nodes):
    """Make `scatter_values` for records of one base row o, on some nodes of each row."""

    @always_inline
    def _stencil(first, last, records, weights, patch, o):
        zero = zeros_like_row(patch, node, nodes)
        r0, r1, r2, r3, r4, r5, r6, r7, r8 = zero, zero, zero, zero, zero, zero, zero, zero, zero
        for n in range(first, last):
            m = 16 * n
            a = tile(records, m, zero) * broadcast_per_node(weights, m + 8 + node, zero)
            b, c, a = weights[m + 5] * a, weights[m + 6] * a, weights[m + 4] * a
            u = weights[m]
            r0, r1, r2 = r0 + u * a, r1 + u * b, r2 + u * c
            u = weights[m + 1]
            r3, r4, r5 = r3 + u * a, r4 + u * b, r5 + u * c
            u = weights[m + 2]
            r6, r7, r8 = r6 + u * a, r7 + u * b, r8 + u * c
        o += 4 * node
        _add(patch, o, r0, r1, r2)
        _add(patch, o + PLANE, r3, r4, r5)
        _add(patch, o + 2 * PLANE, r6, r7, r8)

    return _stencil


def scatter_values(count, records, weights, base, patch):
    """Add values to the patch as `stencil_sums.scatter` adds records whose slopes are 0.

    Args:
        count: Number of records.
        records: Four values of each, 16 numbers apart.
        weights, base: Records of weights; base rows, shape (count,).
        patch: Patch (in/out), shape (2048,).
    """


define_stencil_function(scatter_values, runs_in_parts, _scatter_values)

"""Scatter of particle values without slopes to the nine rows of nodes of each record."""

from vgmpi.kernels.simd.partial_rows import broadcast_per_node, tile, zeros_like_row
from vgmpi.runtime.jit import always_inline

from .particle_records import PLANE
from .stencil_sums import _add, define_stencil_function, runs_in_parts


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

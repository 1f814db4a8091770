"""Stencil sums by the means of cells, for the dilatation of liquids.

The mean divergence of each of the eight cells between a particle's 27 nodes is interpolated
linearly to the particle, and a pressure acts on the nodes by the adjoint of that. Along an axis,
with the fraction r of the particle between the centers of the cells, a derivative has the weights
-(1 - r), 1 - 2 r, r of a B-spline's slope; the two other axes have the weights (1 - r) / 2, 1 / 2,
r / 2 of the means in place of the B-spline. The code takes a quarter of the slopes and twice the
means. See stencil_sums.py and docs/explanation/transfer-schemes.md.
"""

from vgmpi.kernels.simd.partial_rows import (
    load,
    mean_change,
    mean_middle,
    slope_change,
    slope_middle,
    tile,
    zeros_like_row,
)
from vgmpi.runtime.jit import always_inline

from .particle_records import PLANE, ROW
from .stencil_sums import _add, define_stencil_function, per_record, per_row


def scatter_by_cells(node, nodes):
    """Make `scatter_cell_pressure` for one record, on some nodes of each row."""

    @always_inline
    def _stencil(n, last, records, weights, patch, o):
        slope, change = slope_middle(patch, node, nodes), slope_change(patch, node, nodes)
        mean, mean_slope = mean_middle(patch, node, nodes), mean_change(patch, node, nodes)
        zero = zeros_like_row(patch, node, nodes)
        m = 16 * n
        o += 4 * node
        x, y, z = weights[m + 3], weights[m + 7], weights[m + 12]
        w = mean + mean_slope * z
        # sums with zero: no later sum can round the products otherwise than these do
        along_x, along_y = (
            zero + tile(records, m + 4, zero) * w,
            zero + tile(records, m + 8, zero) * w,
        )
        along_z = zero + tile(records, m + 12, zero) * (slope + change * z)
        # the slopes of the outer nodes are their means over four, with the sign of their side
        t0, t2 = along_z - 0.25 * along_y, along_z + 0.25 * along_y
        t1 = along_z + (0.5 * (1.0 + y)) * along_y
        y0, y2 = 1.5 + y, -0.5 - y
        u, s = 1.5 + x, -0.25 * along_x
        _add(patch, o, u * (y0 * (t0 + s)), u * (t1 + s), u * (y2 * (t2 + s)))
        s = (0.5 * (1.0 + x)) * along_x
        _add(patch, o + PLANE, y0 * (t0 + s), t1 + s, y2 * (t2 + s))
        u, s = -0.5 - x, 0.25 * along_x
        _add(patch, o + 2 * PLANE, u * (y0 * (t0 + s)), u * (t1 + s), u * (y2 * (t2 + s)))

    return _stencil


def gather_by_cells(node, nodes):
    """Make the sums of `gather_cell_slopes` over some nodes of each row."""

    @always_inline
    def _stencil(weights, m, patch, o):
        slope, change = slope_middle(patch, node, nodes), slope_change(patch, node, nodes)
        mean, mean_slope = mean_middle(patch, node, nodes), mean_change(patch, node, nodes)
        zero = zeros_like_row(patch, node, nodes)
        o += 4 * node
        x, y, z = weights[m + 3], weights[m + 7], weights[m + 12]
        a0, b0 = 1.5 + y, -0.25 * (1.5 + y)
        b1 = 0.5 * (1.0 + y)
        a2, b2 = -0.5 - y, -0.25 * (0.5 + y)
        total, along_x, along_y = zero, zero, zero
        for i in range(3):
            p, q = load(patch, o, zero), load(patch, o + ROW, zero)
            r = load(patch, o + 2 * ROW, zero)
            t = a0 * p + q + a2 * r
            u = 1.5 + x if i == 0 else (1.0 + 0.0 * x if i == 1 else -0.5 - x)
            g = -0.25 * (1.5 + x) if i == 0 else (0.5 * (1.0 + x) if i == 1 else -0.25 * (0.5 + x))
            total, along_x = total + u * t, along_x + g * t
            along_y = along_y + u * (b0 * p + b1 * q + b2 * r)
            o += PLANE
        w = mean + mean_slope * z
        return along_x * w, along_y * w, total * (slope + change * z)

    return _stencil


def scatter_cell_pressure(count, records, weights, base, patch):
    """Add the slopes of records along the gradients of the cells' means.

    Args:
        count, records, weights, base, patch: See `stencil_sums.scatter`.
    """


def gather_cell_slopes(count, records, weights, base, patch):
    """Gather the slopes per cell by the means of cells: x 0-3, y 4-7, z 8-11.

    Args:
        count, records, weights, base, patch: See `stencil_sums.scatter`.
    """


define_stencil_function(scatter_cell_pressure, per_record, scatter_by_cells)
define_stencil_function(gather_cell_slopes, per_row, gather_by_cells)

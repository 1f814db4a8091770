"""Sweeps over the nodes of a liquid: Chebyshev's iteration for (M + dt K) v = M v*.

K is the stiffness of trilinear cells for the stress 2 mu dev D (kernels/grid/cell_stiffness.py).
"""

from typing import NamedTuple

import numpy as np

from vgmpi.kernels.grid.cell_stiffness import CELLS, multiply_block, stiffness_scratch
from vgmpi.kernels.grid.phase_nodes import PATCH, gather_patch
from vgmpi.kernels.simd.vector16 import load, pointer, store
from vgmpi.runtime.aligned_arrays import aligned_zeros
from vgmpi.runtime.jit import always_inline, kernel

MAX_EIGENVALUE = 8.0  # [nu dt / dx2] of dt M^-1 K where no cell is fuller than its nodes
TRACE = 2.0 / 3.0  # of a deviator, see cell_stiffness.py


class ViscousFields(NamedTuple):
    """Numbers of the nodes and cells of a liquid in blocks, flat, in the working precision.

    A block has 192 numbers of nodes in three directions, axis after axis, or 64 of nodes.
    """

    star: np.ndarray  # velocities before [m/s]
    inverse: np.ndarray  # inverse masses, relative to a full cell's, 0 where a node is held
    fill: np.ndarray  # filled share of the space around a node
    step: np.ndarray  # last change of the velocities [m/s]
    normal: np.ndarray  # unit vectors along which colliders hold nodes, or 0; or without numbers
    cells: np.ndarray  # dt K of the 5 x 5 x 5 cells of a block, in its patch, PATCH numbers


def viscous_fields(blocks: int, with_normals: bool, real: np.dtype) -> ViscousFields:
    """Return fields of zeros for some blocks and the row of no block."""
    sizes = (192, 192, 64, 192, 192 * with_normals, PATCH)
    return ViscousFields(*(aligned_zeros((blocks + 1) * size, real) for size in sizes))


@kernel
def set_cells(rows, neighbors, is_cell, scale, full, fields, wet):
    """Set the cells of some blocks: each as full as its emptiest node, relative to `full`.

    Args:
        rows: Blocks to process, shape (n,).
        neighbors: Rows of the 27 blocks around each, flat.
        is_cell: See `cells_of_patch`.
        scale: nu dt / dx2.
        full: Inverse of the share from which on a node counts as full.
        fields: ViscousFields (in/out).
        wet: Whether a block has cells with liquid, shape (blocks,) (out).
    """
    real = fields.fill.dtype.type
    patch = np.zeros(PATCH, fields.fill.dtype)
    source, marks, cells = pointer(patch), pointer(is_cell), pointer(fields.cells)
    for b in rows:
        gather_patch(fields.fill, 64, 0, neighbors, b, patch, 0)
        for c in range(0, CELLS, 16):
            low = np.minimum(
                np.minimum(_lower_of_pair(source, c), _lower_of_pair(source, c + 6)),
                np.minimum(_lower_of_pair(source, c + 36), _lower_of_pair(source, c + 42)),
            )
            share = np.minimum(full * low, 0.0 * low + 1.0)
            store(cells, PATCH * b + c, scale * load(marks, c) * share)
        fullest = real(0)
        for c in range(PATCH * b, PATCH * b + CELLS):
            fullest = max(fullest, fields.cells[c])
        wet[b] = fullest > 0


@always_inline
def _lower_of_pair(fill, c):
    """Return the smaller of the numbers of nodes and those above them."""
    return np.minimum(load(fill, c), load(fill, c + 1))


@always_inline
def _project(step, normal, b):
    """Remove the steps of the nodes of a block along the normals of colliders."""
    for n in range(192 * b, 192 * b + 64):
        x, y, z = normal[n], normal[n + 64], normal[n + 128]
        along = x * step[n] + y * step[n + 64] + z * step[n + 128]
        step[n] -= along * x
        step[n + 64] -= along * y
        step[n + 128] -= along * z


@kernel
def sweep(rows, neighbors, weight, inertia, has_normals, fields, before, after):
    """Make a sweep over the nodes of some blocks.

    Args:
        rows: Blocks to process, shape (n,).
        neighbors: Rows of the 27 blocks around each, flat.
        weight, inertia: Factors of the residual and of the last step.
        has_normals: Whether colliders hold nodes of a block, shape (blocks,).
        fields: ViscousFields (in/out).
        before: Velocities [m/s], flat.
        after: The same after the sweep (out).
    """
    scratch, trace = stiffness_scratch(before.dtype), before.dtype.type(TRACE)
    for b in rows:
        multiply_block(before, neighbors, b, fields.cells, trace, scratch)
        _relax(b, weight, inertia, pointer(scratch.product), fields, pointer(before))
        if has_normals[b]:
            _project(fields.step, fields.normal, b)
        own, step, result = pointer(before), pointer(fields.step), pointer(after)
        for n in range(192 * b, 192 * (b + 1), 16):
            store(result, n, load(own, n) + load(step, n))


@always_inline
def _relax(b, weight, inertia, product, fields, before):
    """Set the steps of the nodes of a block from the product dt K v."""
    star, inverse, step = pointer(fields.star), pointer(fields.inverse), pointer(fields.step)
    for q in range(0, 192, 16):
        n = 192 * b + q
        response = load(inverse, n)
        residual = (load(star, n) - load(before, n)) - response * load(product, q)
        store(step, n, weight * residual + inertia * load(step, n))

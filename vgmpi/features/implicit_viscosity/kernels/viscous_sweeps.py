"""Sweeps over the nodes of a liquid: Chebyshev's iteration for (M + dt K) v = M v*.

K is the stiffness of trilinear cells for the stress 2 mu dev D, integrated exactly. A block of 4 x
4 x 4 nodes gathers the nodes around it, multiplies its 5 x 5 x 5 cells, and sums them at its own
nodes in one order: the result does not depend on ranks and threads.

The eight values of a cell are taken apart into their sums with signs along x, y, z, yz, zx, xy and
xyz. These modes are orthogonal, so that a cell's K is a few products.
"""

from typing import NamedTuple

import numpy as np

from vgmpi.kernels.simd.vector16 import load, pointer, store
from vgmpi.runtime.aligned_arrays import aligned_zeros
from vgmpi.runtime.jit import always_inline, kernel

EDGE = 6  # nodes along the edge of a patch: those of a block, and one around it
PATCH = 224  # numbers of a patch, a multiple of 16 with all that a vector of its last cell loads
CELLS, OWN = 176, 144  # numbers from the first cell, and from the first own node, to the last one
FIRST_OWN = EDGE * EDGE + EDGE + 1
MAX_EIGENVALUE = 8.0  # [nu dt / dx2] of dt M^-1 K where no cell is fuller than its nodes
# weights of the squared modes of a cell: 1, 1/2 and 1 of their value, and the integrals of squares
LINEAR, BILINEAR, TRILINEAR = 1.0 / 16.0, 1.0 / 48.0, 1.0 / 144.0
TRACE = 2.0 / 3.0


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


def cells_of_patch(real: np.dtype) -> np.ndarray:
    """Return 1 for the places of a patch that are cells, 0 for others, shape (PATCH,)."""
    is_cell = np.zeros((EDGE,) * 3)
    is_cell[:-1, :-1, :-1] = 1
    result = aligned_zeros(PATCH, real)
    result[: EDGE**3] = is_cell.reshape(-1)
    return result


@always_inline
def _gather_patch(values, size, first, neighbors, b, patch, start):
    """Copy the nodes in and around a block into a patch.

    Args:
        values: Nodal numbers, flat.
        size, first: Numbers of a block, and offset of the first one that is copied.
        neighbors: Rows of the 27 blocks around each, flat.
        b: Block.
        patch, start: Patch (out), and offset of its first number.
    """
    for i in range(EDGE):
        x, row = (i + 3) % 4, 27 * b + 9 * ((i + 3) // 4)
        for j in range(EDGE):
            line = row + 3 * ((j + 3) // 4)
            place, node = start + EDGE * (EDGE * i + j), first + 16 * x + 4 * ((j + 3) % 4)
            patch[place] = values[size * neighbors[line] + node + 3]
            own = size * neighbors[line + 1] + node
            for k in range(4):
                patch[place + 1 + k] = values[own + k]
            patch[place + 5] = values[size * neighbors[line + 2] + node]


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
        _gather_patch(fields.fill, 64, 0, neighbors, b, patch, 0)
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
def _modes(patch, c):
    """Return the modes x, y, z, yz, zx, xy, xyz of the values at the nodes of cells."""
    a, b = load(patch, c), load(patch, c + 1)
    s00, d00 = b + a, b - a
    a, b = load(patch, c + 6), load(patch, c + 7)
    s01, d01 = b + a, b - a
    a, b = load(patch, c + 36), load(patch, c + 37)
    s10, d10 = b + a, b - a
    a, b = load(patch, c + 42), load(patch, c + 43)
    s11, d11 = b + a, b - a
    low_y, high_y, low_z, high_z = s01 - s00, s11 - s10, d01 + d00, d11 + d10
    low_yz, high_yz = d01 - d00, d11 - d10
    x = (s11 + s10) - (s01 + s00)
    return (
        x, high_y + low_y, high_z + low_z, high_yz + low_yz, high_z - low_z, high_y - low_y,
        high_yz - low_yz,
    )  # fmt: skip


@always_inline
def _turned(modes):
    """Return modes with y in the place of x, z of y, and x of z."""
    x, y, z, yz, zx, xy, xyz = modes
    return y, z, x, zx, xy, yz, xyz


@always_inline
def _forces(u, v, w):
    """Return the forces on the modes of the component along x, per mu and volume.

    Args:
        u, v, w: Modes of the components along x, y and z.
    """
    ux, uy, uz, uyz, uzx, uxy, uxyz = u
    vx, vy, _, vyz, vzx, _, _ = v
    wx, _, wz, wyz, _, wxy, _ = w
    return (
        LINEAR * (2.0 * ux - TRACE * (ux + (vy + wz))),
        LINEAR * (uy + vx),
        LINEAR * (uz + wx),
        BILINEAR * (2.0 * uyz + (vzx + wxy)),
        BILINEAR * (3.0 * uzx - TRACE * (uzx + vyz)),
        BILINEAR * (3.0 * uxy - TRACE * (uxy + wyz)),
        TRILINEAR * (4.0 - TRACE) * uxyz,
    )


@always_inline
def _store_corners(modes, cell, forces, start, c):
    """Store the forces of cells on their nodes.

    Args:
        modes: Forces on the modes.
        cell: Factor of each cell.
        forces: Forces at the corners 000, 001, .. of cells, each 3 PATCH numbers (out).
        start: Offset of the component.
        c: First cell.
    """
    x, y, z, yz, zx, xy, xyz = modes
    corner, size = start + c, 3 * PATCH
    a, b, s, d = cell * (x - zx), cell * (y - yz), cell * z, cell * (xy - xyz)
    p, q = d - s, d + s
    store(forces, corner, p - (a + b))
    store(forces, corner + 2 * size, (b - a) - q)
    store(forces, corner + 4 * size, (a - b) - q)
    store(forces, corner + 6 * size, p + (a + b))
    a, b, d = cell * (x + zx), cell * (y + yz), cell * (xy + xyz)
    p, q = s + d, s - d
    store(forces, corner + size, p - (a + b))
    store(forces, corner + 3 * size, q + (b - a))
    store(forces, corner + 5 * size, q + (a - b))
    store(forces, corner + 7 * size, p + (a + b))


@always_inline
def _sum_corners(forces, n):
    """Return the forces on nodes of the eight cells around them."""
    size = 3 * PATCH
    low = load(forces, n) + load(forces, n - 1 + size)
    low = low + (load(forces, n - 6 + 2 * size) + load(forces, n - 7 + 3 * size))
    high = load(forces, n - 36 + 4 * size) + load(forces, n - 37 + 5 * size)
    return low + (high + (load(forces, n - 42 + 6 * size) + load(forces, n - 43 + 7 * size)))


@always_inline
def _multiply(cells, b, patch, forces, sums):
    """Store the product of dt K and the velocities of a patch at the nodes of a block.

    Args:
        cells: Factors of cells, pointer.
        b: Block.
        patch: Velocities, three patches, pointer.
        forces: Scratch, pointer.
        sums: Products at the nodes of a patch, three of them, pointer (out).
    """
    for c in range(0, CELLS, 16):
        cell = load(cells, PATCH * b + c)
        u, v, w = _modes(patch, c), _modes(patch, c + PATCH), _modes(patch, c + 2 * PATCH)
        _store_corners(_forces(u, v, w), cell, forces, 0, c)
        # v takes the part of u where y takes that of x, and two more turns lead back
        along = _forces(_turned(v), _turned(w), _turned(u))
        _store_corners(_turned(_turned(along)), cell, forces, PATCH, c)
        along = _forces(_turned(_turned(w)), _turned(_turned(u)), _turned(_turned(v)))
        _store_corners(_turned(along), cell, forces, 2 * PATCH, c)
    for a in range(0, 3 * PATCH, PATCH):
        for n in range(FIRST_OWN, FIRST_OWN + OWN, 16):
            store(sums, a + n, _sum_corners(forces, a + n))


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
    real = before.dtype
    patch, forces = np.zeros(3 * PATCH, real), np.zeros(24 * PATCH, real)
    sums, product = np.zeros(3 * PATCH, real), np.zeros(192, real)
    for b in rows:
        for a in range(3):
            _gather_patch(before, 192, 64 * a, neighbors, b, patch, PATCH * a)
        _multiply(pointer(fields.cells), b, pointer(patch), pointer(forces), pointer(sums))
        for a in range(3):
            for i in range(4):
                for j in range(4):
                    place = PATCH * a + FIRST_OWN + EDGE * (EDGE * i + j)
                    for k in range(4):
                        product[64 * a + 16 * i + 4 * j + k] = sums[place + k]
        _relax(b, weight, inertia, pointer(product), fields, pointer(before))
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

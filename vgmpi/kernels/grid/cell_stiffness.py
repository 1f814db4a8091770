"""Stiffness of trilinear cells, integrated exactly: K of an isotropic stress of nodal velocities.

The stress is 2 mu (eps - r tr eps), with r = 1/3 for a viscous liquid, and - lambda / (2 mu) for an
elastic solid. A block of 4 x 4 x 4 nodes gathers the nodes around it, multiplies its 5 x 5 x 5
cells, and sums them at its own nodes in one order: the result does not depend on ranks and threads.

The eight values of a cell are taken apart into their sums with signs along x, y, z, yz, zx, xy and
xyz. These modes are orthogonal, so that a cell's K is a few products.
"""

from typing import NamedTuple

import numpy as np

from vgmpi.kernels.simd.vector16 import load, pointer, store
from vgmpi.runtime.jit import always_inline

from .phase_nodes import EDGE, PATCH, gather_patch

CELLS, OWN = 176, 144  # numbers from the first cell, and from the first own node, to the last one
FIRST_OWN = EDGE * EDGE + EDGE + 1
# weights of the squared modes of a cell: 1, 1/2 and 1 of their value, and the integrals of squares
LINEAR, BILINEAR, TRILINEAR = 1.0 / 16.0, 1.0 / 48.0, 1.0 / 144.0


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
def _forces(u, v, w, trace, corner):
    """Return the forces on the modes of the component along x, per mu and volume.

    Args:
        u, v, w: Modes of the components along x, y and z.
        trace, corner: Twice r, and 4 less that.
    """
    ux, uy, uz, uyz, uzx, uxy, uxyz = u
    vx, vy, _, vyz, vzx, _, _ = v
    wx, _, wz, wyz, _, wxy, _ = w
    return (
        LINEAR * (2.0 * ux - trace * (ux + (vy + wz))),
        LINEAR * (uy + vx),
        LINEAR * (uz + wx),
        BILINEAR * (2.0 * uyz + (vzx + wxy)),
        BILINEAR * (3.0 * uzx - trace * (uzx + vyz)),
        BILINEAR * (3.0 * uxy - trace * (uxy + wyz)),
        TRILINEAR * corner * uxyz,
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
def _multiply_patch(cells, b, patch, forces, sums, trace, corner):
    """Store the product of K and the velocities of a patch at the nodes of a block.

    Args:
        cells: Factors of cells, pointer.
        b: Block.
        patch: Velocities, three patches, pointer.
        forces: Scratch, pointer.
        sums: Products at the nodes of a patch, three of them, pointer (out).
        trace, corner: See `_forces`.
    """
    for c in range(0, CELLS, 16):
        cell = load(cells, PATCH * b + c)
        u, v, w = _modes(patch, c), _modes(patch, c + PATCH), _modes(patch, c + 2 * PATCH)
        _store_corners(_forces(u, v, w, trace, corner), cell, forces, 0, c)
        # v takes the part of u where y takes that of x, and two more turns lead back
        along = _forces(_turned(v), _turned(w), _turned(u), trace, corner)
        _store_corners(_turned(_turned(along)), cell, forces, PATCH, c)
        along = _forces(
            _turned(_turned(w)), _turned(_turned(u)), _turned(_turned(v)), trace, corner
        )
        _store_corners(_turned(along), cell, forces, 2 * PATCH, c)
    for a in range(0, 3 * PATCH, PATCH):
        for n in range(FIRST_OWN, FIRST_OWN + OWN, 16):
            store(sums, a + n, _sum_corners(forces, a + n))


class StiffnessScratch(NamedTuple):
    """Scratch of `multiply_block`, and its result."""

    patch: np.ndarray  # values of three patches
    forces: np.ndarray  # at the corners of cells
    sums: np.ndarray  # at the nodes of three patches
    product: np.ndarray  # at the nodes of a block, 192


@always_inline
def stiffness_scratch(real):
    """Return scratch for numbers of a type."""
    return StiffnessScratch(
        np.zeros(3 * PATCH, real), np.zeros(24 * PATCH, real), np.zeros(3 * PATCH, real),
        np.zeros(192, real),
    )  # fmt: skip


@always_inline
def multiply_block(values, neighbors, b, cells, trace, scratch):
    """Multiply K and values at the nodes of a block, into the product of the scratch.

    Args:
        values: Nodal vectors, flat, 192 of a block.
        neighbors: Rows of the 27 blocks around each, flat.
        b: Block.
        cells: Factors of cells, flat, PATCH of a block.
        trace: Twice r.
        scratch: StiffnessScratch (in/out).
    """
    for a in range(3):
        gather_patch(values, 192, 64 * a, neighbors, b, scratch.patch, PATCH * a)
    _multiply_patch(
        pointer(cells), b, pointer(scratch.patch), pointer(scratch.forces), pointer(scratch.sums),
        trace, values.dtype.type(4) - trace,
    )  # fmt: skip
    for a in range(3):
        for i in range(4):
            for j in range(4):
                place = PATCH * a + FIRST_OWN + EDGE * (EDGE * i + j)
                for k in range(4):
                    scratch.product[64 * a + 16 * i + 4 * j + k] = scratch.sums[place + k]

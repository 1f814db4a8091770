"""Patches: the 8^3 nodes around a block, as a segment writes and reads them.

A row of a patch, eight nodes along z, is two vectors; it lies across three node blocks, each of
which has one vector per row.
"""

from vgmpi.kernels.simd.row_ops import broadcast, slide_back
from vgmpi.kernels.simd.vector16 import load, prefetch, store
from vgmpi.runtime.jit import always_inline, device_function

from .wall_boundary import SIDE


@device_function
def clear(patch, box):
    """Set the rows of a patch (2048,) within a box to zero."""
    none = broadcast(patch, 0.0)
    for i in range(box[0], box[1]):
        for j in range(box[2], box[3]):
            target = (i * SIDE + j) * SIDE * 4
            store(patch, target, none)
            store(patch, target + 16, none)


@always_inline
def row_of(i, j):
    """Return the position of row (i, j) of a patch in the node blocks around it.

    Returns:
        The first of the three node blocks that the row crosses, among the 27 around, and the offset
        of the row in each of them.
    """
    gi, gj = i + 3, j + 3
    return (gi >> 2) * 9 + (gj >> 2) * 3, ((gi & 3) * 16 + (gj & 3) * 4) * 4


@device_function
def load_patch(patch, grid, blocks, box):
    """Load the nodes of a box of a patch from the 27 node blocks around it.

    Args:
        patch: Patch (out), shape (2048,).
        grid: Nodal numbers, shape (node blocks, 256).
        blocks: The 27 node blocks.
        box: First and last nodes along x, y, z, shape (6,).
    """
    for i in range(box[0], box[1]):
        for j in range(box[2], box[3]):
            row, offset = row_of(i, j)
            target = (i * SIDE + j) * SIDE * 4
            middle = load(grid[blocks[row + 1]], offset)
            store(patch, target, slide_back(load(grid[blocks[row]], offset), middle))
            store(patch, target + 16, slide_back(middle, load(grid[blocks[row + 2]], offset)))


@device_function
def prefetch_patch(grid, blocks):
    """Prefetch what `load_patch` is going to read; grid: (256 node blocks,) as a pointer."""
    for i in range(SIDE):
        for j in range(SIDE):
            row, offset = row_of(i, j)
            for k in range(3):
                prefetch(grid, 256 * blocks[row + k] + offset)

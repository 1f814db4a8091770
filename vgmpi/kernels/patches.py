"""Patches: the 8^3 nodes around a block, as a segment writes and reads them.

A row of a patch, eight nodes along z, is two vectors; it lies across three node blocks, where a row
is one.
"""

from ..device.jit import inline, within
from ..lanes.lanes import ahead, load, store
from ..lanes.rows import slide_back, spread
from .walls import SIDE


@inline
def clear(patch, box):
    """Zeros in the rows of a patch (2048,) that a box touches."""
    none = spread(patch, 0.0)
    for i in range(box[0], box[1]):
        for j in range(box[2], box[3]):
            to = (i * SIDE + j) * SIDE * 4
            store(patch, to, none)
            store(patch, to + 16, none)


@within
def row_of(i, j):
    """Of the row i, j of a patch: the first of the three node blocks it lies across, among the 27
    around, and where it begins in each of them."""
    gi, gj = i + 3, j + 3
    return (gi >> 2) * 9 + (gj >> 2) * 3, ((gi & 3) * 16 + (gj & 3) * 4) * 4


@inline
def nodes_of(patch):
    """A patch by nodes: (8, 8, 8, 4)."""
    return patch[: SIDE * SIDE * SIDE * 4].reshape((SIDE, SIDE, SIDE, 4))


@inline
def gather(patch, grid, blocks, box):
    """The nodes of a box of a patch (2048,) from the 27 node blocks around it.

    box: (6,) first and last nodes along x, y, z; grid: (node blocks, 256).
    """
    for i in range(box[0], box[1]):
        for j in range(box[2], box[3]):
            row, at = row_of(i, j)
            to = (i * SIDE + j) * SIDE * 4
            here = load(grid[blocks[row + 1]], at)
            store(patch, to, slide_back(load(grid[blocks[row]], at), here))
            store(patch, to + 16, slide_back(here, load(grid[blocks[row + 2]], at)))


@inline
def expect(grid, blocks):
    """Begin to fetch what `gather` is going to read. grid: (256 node blocks,) by its place."""
    for i in range(SIDE):
        for j in range(SIDE):
            row, at = row_of(i, j)
            for k in range(3):
                ahead(grid, 256 * blocks[row + k] + at)

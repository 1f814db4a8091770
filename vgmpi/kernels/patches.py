"""Between patches and node blocks: the sum of patches into a block, and a patch read from blocks.

A row of a patch, eight nodes along z, is two vectors; it lies across three node blocks, where a row
is one.
"""

from ..device.jit import inline, kernel
from ..lanes.lanes import load, store
from ..lanes.rows import slide_back, slide_node, spread
from .walls import SIDE


@inline
def pull(grid, nb, first, last, patch_of, code_of, slots, patches):
    """Sum into node block nb the overlapping parts of patches first..last of the pull list.

    All arrays by their places. grid: (256 node blocks,); patch_of, code_of: of the list; code: 9
    (di + 1) + 3 (dj + 1) + dk + 1, the node block's place relative to the patch's block; slots:
    (patches,); patches: (2048 slots,).
    """
    none, to = spread(grid, 0.0), 256 * nb
    for c in range(to, to + 256, 16):
        store(grid, c, none)
    for q in range(first, last):
        slot = slots[patch_of[q]]
        if slot < 0:
            continue
        code = code_of[q]
        di, dj, dk = code // 9 - 1, code // 3 % 3 - 1, code % 3 - 1
        # a patch begins one node before its block and ends two after it
        for i in range(3 if di < 0 else 0, 3 if di > 0 else 4):
            for j in range(3 if dj < 0 else 0, 3 if dj > 0 else 4):
                at = (16 * i + 4 * j) * 4
                row = (((slot * SIDE + 4 * di + 1 + i) * SIDE) + 4 * dj + 1 + j) * SIDE * 4
                if dk == 0:
                    part = load(patches, row + 4)
                elif dk < 0:
                    part = slide_node(none, load(patches, row))
                else:
                    part = slide_node(load(patches, row + 16), none)
                store(grid, to + at, load(grid, to + at) + part)


@kernel
def zero(grid, rows):
    """Zeros in some rows of the grid (node blocks, 256)."""
    for nb in rows:
        grid[nb, :] = 0


@inline
def clear(patch, box):
    """Zeros in the rows of a patch (2048,) that a box touches."""
    none = spread(patch, 0.0)
    for i in range(box[0], box[1]):
        for j in range(box[2], box[3]):
            to = (i * SIDE + j) * SIDE * 4
            store(patch, to, none)
            store(patch, to + 16, none)


@inline
def push(patch, grid, blocks, box):
    """Add the nodes of a box of a patch to the 27 node blocks around it, where these are not -1.

    box: (6,) first and last nodes along x, y, z; grid: (node blocks, 256).
    """
    none = spread(patch, 0.0)
    for i in range(box[0], box[1]):
        gi = i + 3
        for j in range(box[2], box[3]):
            gj = j + 3
            row = (gi >> 2) * 9 + (gj >> 2) * 3
            at = ((gi & 3) * 16 + (gj & 3) * 4) * 4
            to = (i * SIDE + j) * SIDE * 4
            below, here, above = blocks[row], blocks[row + 1], blocks[row + 2]
            left, right = load(patch, to), load(patch, to + 16)
            if below >= 0 and box[4] < 1:
                nodes = grid[below]
                store(nodes, at, load(nodes, at) + slide_node(none, left))
            if here >= 0:
                nodes = grid[here]
                store(nodes, at, load(nodes, at) + slide_node(left, right))
            if above >= 0 and box[5] > 5:
                nodes = grid[above]
                store(nodes, at, load(nodes, at) + slide_node(right, none))


@inline
def gather(patch, grid, blocks, box):
    """The nodes of a box of a patch (2048,) from the 27 node blocks around it.

    box: (6,) first and last nodes along x, y, z; grid: (node blocks, 256).
    """
    for i in range(box[0], box[1]):
        gi = i + 3
        for j in range(box[2], box[3]):
            gj = j + 3
            row = (gi >> 2) * 9 + (gj >> 2) * 3
            at = ((gi & 3) * 16 + (gj & 3) * 4) * 4
            to = (i * SIDE + j) * SIDE * 4
            here = load(grid[blocks[row + 1]], at)
            store(patch, to, slide_back(load(grid[blocks[row]], at), here))
            store(patch, to + 16, slide_back(here, load(grid[blocks[row + 2]], at)))

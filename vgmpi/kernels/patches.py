"""Between patches and node blocks: the sum of patches into a block, and a patch read from blocks.

Rows along z move in pieces of fixed length, which compiles to a few vector operations.
"""

from ..device.jit import inline
from .walls import SIDE


@inline
def pull(nodes, first, last, patch_of, code_of, slots, patches):
    """Sum into nodes (256,) the overlapping parts of patches first..last of the pull list.

    code_of: 9 (di + 1) + 3 (dj + 1) + dk + 1, the node block's place relative to the patch's block;
    patches: (slots, 2048).
    """
    nodes[:] = 0
    for q in range(first, last):
        slot = slots[patch_of[q]]
        if slot < 0:
            continue
        patch = patches[slot]
        code = code_of[q]
        di, dj, dk = code // 9 - 1, code // 3 % 3 - 1, code % 3 - 1
        # a patch begins one node before its block and ends two after it
        for i in range(3 if di < 0 else 0, 3 if di > 0 else 4):
            for j in range(3 if dj < 0 else 0, 3 if dj > 0 else 4):
                at = (16 * i + 4 * j) * 4
                row = ((4 * di + 1 + i) * SIDE + 4 * dj + 1 + j) * SIDE * 4
                if dk == 0:
                    for c in range(16):
                        nodes[at + c] += patch[row + 4 + c]
                elif dk < 0:
                    for c in range(4):
                        nodes[at + 12 + c] += patch[row + c]
                else:
                    for c in range(12):
                        nodes[at + c] += patch[row + 20 + c]


@inline
def gather(patch, grid, blocks):
    """The 8^3 nodes -1..6 of a block into patch (2048,), from the 27 node blocks around it.

    grid: (node blocks, 256).
    """
    for i in range(SIDE):
        gi = i + 3
        for j in range(SIDE):
            gj = j + 3
            row = (gi >> 2) * 9 + (gj >> 2) * 3
            at = ((gi & 3) * 16 + (gj & 3) * 4) * 4
            to = (i * SIDE + j) * SIDE * 4
            below, here, above = grid[blocks[row]], grid[blocks[row + 1]], grid[blocks[row + 2]]
            for c in range(4):
                patch[to + c] = below[at + 12 + c]
            for c in range(16):
                patch[to + 4 + c] = here[at + c]
            for c in range(12):
                patch[to + 20 + c] = above[at + c]

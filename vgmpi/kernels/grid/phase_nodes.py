"""Nodes of one phase in blocks: where their numbers are, and what walls do to them."""

from functools import cache
from typing import NamedTuple

import numpy as np

from vgmpi.kernels.wall_boundary import RELEASING, SEPARATE, SLIP, STICK
from vgmpi.runtime.aligned_arrays import aligned_zeros
from vgmpi.runtime.jit import always_inline

EDGE = 6  # nodes along the edge of a patch: those of a block, and one around it
PATCH = 224  # numbers of a patch, a multiple of 16 with all that a vector of its last cell loads


class PhaseNodes(NamedTuple):
    """Blocks of nodes of a phase, and where their numbers are."""

    node_block: np.ndarray  # (n,) row of each among the node blocks of the rank
    solid: np.ndarray  # (n,) row of each among the blocks of colliders, or -1
    block: np.ndarray  # (n, 3) block coordinates
    region: np.ndarray  # (n, 64) bool, nodes that this rank computes


@always_inline
def node_index_of(block, q, axis):
    """Return the index of a node of a block along an axis."""
    step = q // 16 if axis == 0 else (q // 4 % 4 if axis == 1 else q % 4)
    return 4 * block[axis] - 1 + step


@always_inline
def count_images(block, q, kinds, cells):
    """Return how many images the mass of a node stands for, and whether it is in the domain.

    Args:
        block, q: Block of the node, shape (3,), and its number in it.
        kinds, cells: See `is_held_at_wall`.
    """
    images, is_inside = 1, True
    for a in range(3):
        node = node_index_of(block, q, a)
        is_inside = is_inside and 0 <= node <= cells[a]
        for side in range(2):
            kind = kinds[a, side]
            mirrors = kind == STICK or kind == SLIP or kind == RELEASING
            if node == side * cells[a] and mirrors:
                images *= 2
    return images, is_inside


@always_inline
def is_held_at_wall(block, q, axis, speed, kinds, cells):
    """Return whether a wall holds a node along an axis.

    Args:
        block: Block of the node, shape (3,).
        q: Number of the node in its block.
        axis: The axis.
        speed: Velocity along it [m/s].
        kinds: Kinds of the walls, shape (3, 2).
        cells: Cells of the domain, shape (3,).
    """
    for a in range(3):
        node = node_index_of(block, q, a)
        for side in range(2):
            kind = kinds[a, side]
            if node == side * cells[a]:
                leaves = speed > 0 if side == 0 else speed < 0
                stops = (kind == SEPARATE or kind == RELEASING) and not leaves
                if kind == STICK or (a == axis and (kind == SLIP or stops)):
                    return True
    return False


@always_inline
def gather_patch(values, size, first, neighbors, b, patch, start):
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


@cache
def cells_of_patch(real: np.dtype) -> np.ndarray:
    """Return 1 for the places of a patch that are cells, 0 for others, shape (PATCH,)."""
    is_cell = np.zeros((EDGE,) * 3)
    is_cell[:-1, :-1, :-1] = 1
    result = aligned_zeros(PATCH, real)
    result[: EDGE**3] = is_cell.reshape(-1)
    return result

"""Lattices of blocks with neighbors, and coarser ones above the blocks of all ranks.

A coarse block covers two finer ones along each axis: its cells are 2 x 2 x 2 cells of these. All
ranks hold all coarse blocks, in the same order.
"""

from typing import NamedTuple

import numpy as np

from .communicator import SerialCommunicator
from .node_overlap import NEIGHBORS

CHILDREN = np.stack(np.unravel_index(np.arange(64), (4, 4, 4)), 1) - 1


class Lattice(NamedTuple):
    """Blocks of cells and their neighbors; the last row of all values is that of no block.

    Tables of eight neighbors: bit 2 of the index steps along x, bit 1 along y, bit 0 along z.
    """

    block: np.ndarray  # (n, 3) block coordinates
    low: np.ndarray  # (8 n,) blocks at and below each
    high: np.ndarray  # (8 n,) blocks at and above each
    neighbors: np.ndarray  # (27 n,) blocks around each

    def cells_at(self, is_marked: np.ndarray) -> np.ndarray:
        """Return the blocks of the cells around the nodes of marked blocks (n,)."""
        return np.flatnonzero(np.append(is_marked, False)[self.high.reshape(-1, 8)].any(1))


class CoarseBlocks(NamedTuple):
    """Blocks of the coarse levels in one table, level after level."""

    lattice: Lattice
    children: np.ndarray  # (64 m,) the 4 x 4 x 4 blocks of the finer level, from one before on
    parent: np.ndarray  # (m,) block of the next level; m for none
    parent_of_finest: np.ndarray  # (n,) coarse block of each block of this rank
    first: np.ndarray  # (levels + 1,) first block of each coarse level
    sizes: np.ndarray  # (levels + 1, 3) cells along each axis, with one before the domain


def lattice_of(block: np.ndarray, neighbors: np.ndarray) -> Lattice:
    """Return the lattice of blocks (n, 3), of which neighbors (n, 27) are the rows around each."""
    grid = neighbors.reshape(-1, 3, 3, 3)
    low, high = grid[:, 1::-1, 1::-1, 1::-1], grid[:, 1:, 1:, 1:]
    return Lattice(block, low.reshape(-1), high.reshape(-1), neighbors.reshape(-1))


class _BlockRows:
    """Rows of blocks by their coordinates, on a dense map with a margin of one block."""

    def __init__(self, block: np.ndarray, first: int, none: int):
        """Take blocks (n, 3), the row of the first, and the row of no block."""
        self.low = block.min(0, initial=0) - 1
        self.shape = block.max(0, initial=0) + 2 - self.low
        self.row_of = np.full(tuple(self.shape), none)
        self.row_of[tuple((block - self.low).T)] = np.arange(first, first + len(block))

    def rows(self, block: np.ndarray) -> np.ndarray:
        """Return the rows of blocks (..., 3)."""
        x, y, z = np.moveaxis(np.clip(block - self.low, 0, self.shape - 1), -1, 0)
        return self.row_of[x, y, z]


def find_coarse_blocks(
    block: np.ndarray, cells: tuple[int, int, int], ranks: SerialCommunicator
) -> CoarseBlocks:
    """Return the coarse blocks above the blocks of all ranks. Collective.

    The last level has at most 4 cells along each axis. Blocks begin one cell before the domain.

    Args:
        block: Blocks of this rank, shape (n, 3).
        cells: Cells of the domain.
        ranks: Communicator.
    """
    sizes = [np.array(cells) + 1]
    is_inside = ((block >= 0) & (4 * block < sizes[0])).all(1)
    sizes.append((sizes[0] + 1) // 2)
    occupied = np.zeros(-(-sizes[-1] // 4), bool)
    occupied[tuple((block[is_inside] // 2).T)] = True
    occupied.reshape(-1)[ranks.all_rows(np.flatnonzero(occupied))] = True
    blocks = [np.argwhere(_with_upper(occupied))]
    while (sizes[-1] > 4).any():
        sizes.append((sizes[-1] + 1) // 2)
        occupied = np.zeros(-(-sizes[-1] // 4), bool)
        occupied[tuple((blocks[-1] // 2).T)] = True
        blocks.append(np.argwhere(_with_upper(occupied)))
    first = np.cumsum([0, *map(len, blocks)])
    count = int(first[-1])
    finest = _BlockRows(block, 0, len(block))
    coarse = [_BlockRows(b, f, count) for b, f in zip(blocks, first[:-1], strict=True)]
    children = [
        finer.rows(2 * own[:, None] + CHILDREN)
        for finer, own in zip([finest, *coarse[:-1]], blocks, strict=True)
    ]
    parents = [coarser.rows(own // 2) for own, coarser in zip(blocks[:-1], coarse[1:], strict=True)]
    neighbors = [
        level.rows(own[:, None] + NEIGHBORS) for own, level in zip(blocks, coarse, strict=True)
    ]
    return CoarseBlocks(
        lattice_of(np.concatenate(blocks), np.concatenate(neighbors)),
        np.concatenate(children).reshape(-1),
        np.concatenate([*parents, np.full(len(blocks[-1]), count)]),
        np.where(is_inside, coarse[0].rows(block // 2), count),
        first, np.array(sizes),
    )  # fmt: skip


def _with_upper(occupied: np.ndarray) -> np.ndarray:
    """Return the map of blocks and those above them along each axis."""
    for axis in range(3):
        blocks = np.moveaxis(occupied, axis, 0)
        wider = blocks.copy()
        wider[1:] |= blocks[:-1]
        occupied = np.moveaxis(wider, 0, axis)
    return occupied

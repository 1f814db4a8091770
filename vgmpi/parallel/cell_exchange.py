"""Exchange of cell values between ranks: cells that patches of one rank cover, next to another's.

A rank computes the cells of which all eight nodes lie in patches of its own particles: there its
nodal sums are complete. Cells that two ranks compute have the same bits on both. A rank receives
the cells around its own that others compute. All lists follow from the block directory, in the same
order on both sides.
"""

from typing import NamedTuple

import numpy as np

from .block_lattice import BLOCK_EDGE, BlockLattice
from .block_ownership import BlockDirectory
from .communicator import PersistentExchange, SerialCommunicator
from .exchange_topology import ExchangeTopology
from .node_overlap import NEIGHBORS

MARGIN = 2  # [blocks] around this rank's own blocks
# cells or nodes of a patch outside of its block: (place in the block, step to that block) along an
# axis. A patch has the cells -1 to 5 and the nodes -1 to 6
CELLS_OF_PATCH = ((0, 1), (1, 1), (3, -1))
NODES_OF_PATCH = ((0, 1), (1, 1), (2, 1), (3, -1))
Reach = tuple[tuple[int, int], ...]


class CellTopology(NamedTuple):
    """Cells of the node blocks of a rank."""

    neighbors: np.ndarray  # (n, 27) rows of the blocks around each block, n for none
    region: np.ndarray  # (n, 64) bool, cells that this rank computes
    counted: np.ndarray  # (n, 64) bool, those of them that no lower rank computes
    sends: dict[int, np.ndarray]  # rank -> flat indices of the cells to send
    receives: dict[int, np.ndarray]  # rank -> flat indices of the cells to receive


def _spread_along(values: np.ndarray, axis: int, reach: Reach) -> np.ndarray:
    """Return which cells along one axis are in the patches of blocks that are True."""
    blocks = np.moveaxis(values, axis, 0)
    cells = np.repeat(blocks, BLOCK_EDGE, axis=0)
    for cell, block_step in reach:
        shifted = np.roll(blocks, block_step, axis=0)  # the margin is empty
        cells[cell::BLOCK_EDGE] |= shifted
    return np.moveaxis(cells, 0, axis)


def patch_cells(blocks: np.ndarray, reach: Reach = CELLS_OF_PATCH) -> np.ndarray:
    """Return the map of the cells in the patches of blocks, four times as long along each axis."""
    for axis in range(3):
        blocks = _spread_along(blocks, axis, reach)
    return blocks


def _with_neighbors(cells: np.ndarray) -> np.ndarray:
    """Return the map of cells and the cells around them."""
    for axis in range(3):
        cells = cells | np.roll(cells, 1, axis) | np.roll(cells, -1, axis)
    return cells


def cell_topology(
    tables: ExchangeTopology, census: BlockDirectory, lattice: BlockLattice, rank: int,
    reach: Reach = CELLS_OF_PATCH,
) -> CellTopology:  # fmt: skip
    """Return the cells of a rank, and those that it exchanges with others.

    With NODES_OF_PATCH nodes take the place of cells: a rank computes those of its patches.

    Args:
        tables: Topology of this rank.
        census: Segments of this rank and nearby ones.
        lattice: Lattice of the blocks.
        rank: This rank.
        reach: CELLS_OF_PATCH or NODES_OF_PATCH.
    """
    count = len(tables.coordinates)
    if not count:
        none = np.zeros((0, 64), bool)
        return CellTopology(np.zeros((0, 27), np.int64), none, none, {}, {})
    block = lattice.block(census.code)
    own = block[census.owner == rank]
    low = own.min(0) - MARGIN
    shape = tuple(own.max(0) + MARGIN + 1 - low)
    row_of = np.full(shape, count)
    row_of[tuple((tables.coordinates - low).T)] = np.arange(count)
    places = np.clip(tables.coordinates[:, None] - low + NEIGHBORS, 0, np.array(shape) - 1)
    neighbors = row_of[places[..., 0], places[..., 1], places[..., 2]]

    def _map_of(blocks: np.ndarray) -> np.ndarray:
        """Return the cells in the patches of some blocks (n, 3)."""
        occupied = np.zeros(shape, bool)
        occupied[tuple((blocks - low).T)] = True
        return patch_cells(occupied, reach)

    def _index_of(cells: np.ndarray) -> np.ndarray:
        """Return the flat indices of cells on the map, in the order of their places."""
        place = np.nonzero(cells)
        row = row_of[tuple(p // BLOCK_EDGE for p in place)]
        i, j, k = (p % BLOCK_EDGE for p in place)
        return 64 * row + 16 * i + 4 * j + k

    def _marks_of(cells: np.ndarray) -> np.ndarray:
        """Return True for cells on the map, shape (n, 64)."""
        marks = np.zeros((count, 64), bool)
        marks.reshape(-1)[_index_of(cells)] = True
        return marks

    mine = _map_of(own)
    counted = mine.copy()
    inside = ((block >= low) & (block < low + shape)).all(1)
    sends, receives = {}, {}
    surroundings = _with_neighbors(mine)
    for other in np.unique(census.owner[inside & (census.owner != rank)]):
        theirs = _map_of(block[inside & (census.owner == other)])
        if other < rank:
            counted &= ~theirs
        sent, received = mine & _with_neighbors(theirs) & ~theirs, theirs & surroundings & ~mine
        if sent.any():
            sends[int(other)] = _index_of(sent)
        if received.any():
            receives[int(other)] = _index_of(received)
    return CellTopology(neighbors, _marks_of(mine), _marks_of(counted), sends, receives)


class CellExchange:
    """Message buffers of the values of cells; rebuilt with the topology."""

    def __init__(self, ranks: SerialCommunicator, cells: CellTopology, real: np.dtype):
        """Allocate the buffers of all neighbors.

        Args:
            ranks: Communicator.
            cells: Cells of this rank.
            real: Type of the values.
        """
        self.sends = [(index, np.zeros(len(index), real)) for index in cells.sends.values()]
        self.receives = [(index, np.zeros(len(index), real)) for index in cells.receives.values()]
        self.link: PersistentExchange = ranks.link(
            [(rank, part[1]) for rank, part in zip(cells.sends, self.sends, strict=True)],
            [(rank, part[1]) for rank, part in zip(cells.receives, self.receives, strict=True)],
        )

    @property
    def has_neighbors(self) -> bool:
        """Return whether this rank sends or receives values."""
        return bool(self.sends or self.receives)

    def exchange(self, values: np.ndarray) -> None:
        """Send the values of cells, and store those of other ranks, flat (in/out)."""
        if not self.has_neighbors:
            return
        for index, buffer in self.sends:
            np.take(values, index, out=buffer)
        self.link.start()
        self.link.wait()
        for index, buffer in self.receives:
            values[index] = buffer

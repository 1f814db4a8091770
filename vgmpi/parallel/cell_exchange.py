"""Exchange of cell values between ranks: cells that patches of one rank cover, next to another's.

A rank computes the cells of which all eight nodes lie in patches of its own particles: there its
nodal sums are complete. Cells that two ranks compute have the same bits on both. A rank receives
the cells around its own that others compute. All lists follow from the block directory, in the same
order on both sides.
"""

from collections.abc import Sequence
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
    size: int  # flat indices from here on are those of no block


def patch_cells(blocks: np.ndarray, reach: Reach = CELLS_OF_PATCH) -> np.ndarray:
    """Return the map of the cells in the patches of blocks, four times as long along each axis.

    Args:
        blocks: Map of blocks, False at its margin, shape (x, y, z) bool.
        reach: CELLS_OF_PATCH or NODES_OF_PATCH.
    """
    shape = BLOCK_EDGE * np.array(blocks.shape)
    for axis in range(3):
        # a cell is in the patch of its own block, and of one beside it that reaches so far
        cells = np.repeat(np.expand_dims(blocks, 2 * axis + 1), BLOCK_EDGE, 2 * axis + 1)
        own = np.moveaxis(cells, 2 * axis + 1, 0)
        for cell, step in reach:
            own[cell] |= np.roll(blocks, step, 2 * axis)
        blocks = cells
    return blocks.reshape(shape)


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
    block = lattice.block(census.code)
    own = block[census.owner == rank]
    if not len(own):
        none = np.zeros((0, 64), bool)
        return CellTopology(np.zeros((0, 27), np.int64), none, none, {}, {}, 0)
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

    def _marks_of(cells: np.ndarray) -> np.ndarray:
        """Return True for cells on the map, shape (n, 64)."""
        by_block = cells.reshape([size for length in shape for size in (length, BLOCK_EDGE)])
        x, y, z = (tables.coordinates - low).T
        return by_block[x, :, y, :, z].reshape(count, 64)

    def _index_of(cells: np.ndarray) -> np.ndarray:
        """Return the flat indices of cells on the map, in the order of their places."""
        place = np.nonzero(cells)
        row = row_of[tuple(p // BLOCK_EDGE for p in place)]
        i, j, k = (p % BLOCK_EDGE for p in place)
        return 64 * row + 16 * i + 4 * j + k

    mine = counted = _map_of(own)
    inside = ((block >= low) & (block < low + shape)).all(1)
    sends, receives = {}, {}
    others = np.unique(census.owner[inside & (census.owner != rank)])
    surroundings = _with_neighbors(mine) if len(others) else mine
    for other in others:
        theirs = _map_of(block[inside & (census.owner == other)])
        if other < rank:
            counted = counted & ~theirs
        sent, received = mine & _with_neighbors(theirs) & ~theirs, theirs & surroundings & ~mine
        if sent.any():
            sends[int(other)] = _index_of(sent)
        if received.any():
            receives[int(other)] = _index_of(received)
    region = _marks_of(mine)
    of_none_else = region if counted is mine else _marks_of(counted)
    return CellTopology(neighbors, region, of_none_else, sends, receives, 64 * count)


class PhaseTopology(NamedTuple):
    """Blocks of nodes of a phase that the particles of a rank reach."""

    rows: np.ndarray  # (n,) row of each among the node blocks of the rank
    block_of: np.ndarray  # (n,) row of each among the blocks of the rank
    block: np.ndarray  # (n, 3) block coordinates
    nodes: CellTopology  # their nodes, one number of each
    vectors: CellTopology  # the same with three numbers, axis after axis


def phase_topology(
    tables: ExchangeTopology, census: BlockDirectory, lattice: BlockLattice, rank: int, phase: int,
    is_own_group: np.ndarray,
) -> PhaseTopology:  # fmt: skip
    """Return the nodes of a phase.

    Args:
        tables: Topology of this rank.
        census: Segments of this rank and nearby ones.
        lattice: Lattice of the blocks.
        rank: This rank.
        phase: The phase.
        is_own_group: Whether each group is of the phase, shape (groups,) bool.
    """
    own = is_own_group[census.group]
    census = census._replace(
        code=census.code[own], group=census.group[own], owner=census.owner[own]
    )
    block_of = np.repeat(np.arange(len(tables.coordinates)), np.diff(tables.first))
    is_reached = blocks_around(lattice.block(census.code[census.owner == rank]),
                               tables.coordinates[block_of])  # fmt: skip
    rows = np.flatnonzero((tables.phase == phase) & is_reached)
    block = tables.coordinates[block_of[rows]]
    nodes = cell_topology(tables._replace(coordinates=block), census, lattice, rank, NODES_OF_PATCH)
    vectors = nodes._replace(
        sends={rank: of_axes(index) for rank, index in nodes.sends.items()},
        receives={rank: of_axes(index) for rank, index in nodes.receives.items()},
        size=3 * nodes.size,
    )
    return PhaseTopology(rows, block_of[rows], block, nodes, vectors)


def join_topologies(parts: Sequence[PhaseTopology]) -> PhaseTopology:
    """Return the nodes of several phases as one topology, phase after phase.

    The numbers that two ranks exchange of all phases travel in one message. No block is a neighbor
    of one of another phase.

    Args:
        parts: Topologies of the phases on a rank, the same phases on all ranks.
    """
    if len(parts) == 1:
        return parts[0]
    return PhaseTopology(
        np.concatenate([part.rows for part in parts]),
        np.concatenate([part.block_of for part in parts]),
        np.concatenate([part.block for part in parts]),
        _join_cells([part.nodes for part in parts]),
        _join_cells([part.vectors for part in parts]),
    )


def _join_cells(parts: Sequence[CellTopology]) -> CellTopology:
    """Return the cells of several topologies as one."""
    firsts = np.cumsum([0, *(len(part.region) for part in parts)])
    sizes = np.cumsum([0, *(part.size for part in parts)])
    count, size = firsts[-1], sizes[-1]
    neighbors = [
        np.where(part.neighbors < len(part.region), part.neighbors + first, count)
        for part, first in zip(parts, firsts[:-1], strict=True)
    ]

    def _join_indices(dicts: list[dict[int, np.ndarray]]) -> dict[int, np.ndarray]:
        """Return the indices by rank; those of no block stay so."""
        joined: dict[int, list[np.ndarray]] = {}
        for own, first, part in zip(dicts, sizes[:-1], parts, strict=True):
            for rank, index in own.items():
                moved = np.where(index < part.size, index + first, size)
                joined.setdefault(rank, []).append(moved)
        return {rank: np.concatenate(joined[rank]) for rank in sorted(joined)}

    return CellTopology(
        np.concatenate(neighbors),
        np.concatenate([part.region for part in parts]),
        np.concatenate([part.counted for part in parts]),
        _join_indices([part.sends for part in parts]),
        _join_indices([part.receives for part in parts]),
        int(size),
    )


def blocks_around(blocks: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return which of other blocks (m, 3) are at most one block from some blocks (n, 3)."""
    if not len(blocks):
        return np.zeros(len(others), bool)
    neighbors = (blocks[:, None] + NEIGHBORS).reshape(-1, 3)
    low = neighbors.min(0)
    shape = neighbors.max(0) + 1 - low
    is_near = np.zeros(tuple(shape + 1), bool)  # the last place is that of all blocks far away
    is_near[tuple((neighbors - low).T)] = True
    place = others - low
    place = np.where(((place >= 0) & (place < shape)).all(1)[:, None], place, shape)
    return is_near[tuple(place.T)]


def of_axes(index: np.ndarray) -> np.ndarray:
    """Return the places of three numbers of nodes, given those of one number of each (n,)."""
    first = 192 * (index // 64) + index % 64
    return (first[:, None] + np.array([0, 64, 128])).reshape(-1)


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
        # what another rank knows and this one has no block for is left out
        self.valid = [np.flatnonzero(index < cells.size) for index, _ in self.receives]
        self.places = [
            index[valid] for (index, _), valid in zip(self.receives, self.valid, strict=True)
        ]
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
        for (_, buffer), valid, place in zip(self.receives, self.valid, self.places, strict=True):
            values[place] = buffer[valid]

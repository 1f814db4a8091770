"""Block directory: blocks that hold particles and their owners, as far as a rank needs them.

A rank knows its own blocks and two rings of blocks around them, however many blocks there are.

The owner of a block follows from its key and the cuts alone, so a rank finds without a table the
ranks to which it must report its particles. Three numbers of every rank are known to all: its work,
and the longest stretch without particles of its piece of the curve. Without this stretch, the owner
of the air above a pool would receive messages from all ranks at the surface.
"""

from typing import NamedTuple

import numpy as np

from vgmpi.runtime.jit import kernel

from . import load_balance
from .block_lattice import BlockLattice
from .communicator import SerialCommunicator

HALO_BLOCKS = 2  # [blocks] width of the neighborhood of its own blocks that a rank knows
SAMPLES = 8  # places on the curve that each rank reports of its particles before the first cuts


class BlockDirectory(NamedTuple):
    """Segments of this rank's blocks and of those at most RINGS away, ascending by (key, group)."""

    key: np.ndarray  # (n,) place of the block on the Hilbert curve
    code: np.ndarray  # (n,) code of the block
    group: np.ndarray  # (n,) number of the group
    particles: np.ndarray  # (n,) number of particles
    owner: np.ndarray  # (n,) rank that owns the block
    load: np.ndarray  # (ranks,) work of each rank, see load_balance.predicted_work

    def has_segments_of(self, other: "BlockDirectory") -> bool:
        """Return whether another directory has the same segments with the same owners."""
        return (
            np.array_equal(self.code, other.code)
            and np.array_equal(self.group, other.group)
            and np.array_equal(self.owner, other.owner)
        )


def build_block_directory(
    rows: np.ndarray, lattice: BlockLattice, ranks: SerialCommunicator, costs: np.ndarray,
    cut: np.ndarray | None,
    steps: int, pace: float = 1.0,
) -> tuple[BlockDirectory, np.ndarray]:  # fmt: skip
    """Merge the rows of all ranks, and cut the curve anew if that pays. Collective.

    Args:
        rows: Key, code, group and count of the particles that this rank holds, wherever they
            belong, shape (n, 4).
        lattice: Lattice of the blocks.
        ranks: Communicator.
        costs: Work per particle by group, shape (groups,).
        cut: Present cuts; None at the start.
        steps: Steps since the last sort.
        pace: Measured over predicted work of this rank (load_balance.RankPace).

    Returns:
        The Census and the cuts from now on.
    """
    first = cut is None
    if cut is None:
        cut = _initial_cuts(rows, ranks, costs)
    rows = _route_to_owner(rows, cut, ranks)
    summaries = ranks.each(_rank_summary(rows, cut, ranks.rank, costs, pace))
    if first or load_balance.should_rebalance(summaries[:, 0], steps):
        mine = _by_block(rows, costs, pace)
        old, cut = cut, _recut(mine, summaries[:, 0], ranks, cut, steps, first)
        if cut is not old:
            rows = _route_to_owner(rows, cut, ranks)
            summaries = ranks.each(_rank_summary(rows, cut, ranks.rank, costs, pace))
    key, code, group, particles = _with_rings(rows, lattice, ranks, cut, summaries[:, 1:]).T
    return BlockDirectory(
        key, code, group, particles, load_balance.owners(key, cut), summaries[:, 0]
    ), cut


def _initial_cuts(rows: np.ndarray, ranks: SerialCommunicator, costs: np.ndarray) -> np.ndarray:
    """Return cuts from a sample, so that no rank has to merge much more than its part."""
    key, work, _ = _by_block(rows[np.argsort(rows[:, 0], kind="stable")], costs)
    ends = np.cumsum(work)
    # Ranks that hold the same blocks report different places.
    fraction = (np.arange(SAMPLES) + ranks.rank * 0.6180339887 % 1.0) / SAMPLES
    index = np.searchsorted(ends, fraction * ends[-1]) if len(key) else np.zeros(0, np.int64)
    samples = np.stack([key[index], np.full(len(index), work.sum() // SAMPLES)], 1)
    samples = ranks.all_rows(samples)
    samples = samples[np.argsort(samples[:, 0], kind="stable")]
    key, work, _ = load_balance.by_block(samples[:, 0], samples[:, 1], samples[:, 1])
    return load_balance.partition(key, work, ranks.size, None)


def _route_to_owner(rows: np.ndarray, cut: np.ndarray, ranks: SerialCommunicator) -> np.ndarray:
    """Route rows to the owners of their blocks.

    Returns the merged rows of this rank's blocks, ascending by (key, group).
    """
    rows = ranks.sparse_exchange(rows, load_balance.owners(rows[:, 0], cut))
    if (load_balance.owners(rows[:, 0], cut) != ranks.rank).any():
        raise RuntimeError("ranks disagree on who owns a block")
    rows = rows[np.lexsort((rows[:, 2], rows[:, 0]))]
    new = np.ones(len(rows), bool)
    new[1:] = (rows[1:, [0, 2]] != rows[:-1, [0, 2]]).any(1)
    first = np.flatnonzero(new)
    merged = rows[first]
    if len(first):
        merged[:, 3] = np.add.reduceat(rows[:, 3], first)
    return merged


def _by_block(
    rows: np.ndarray, costs: np.ndarray, pace: float = 1.0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return keys, work and particles of the blocks of rows that ascend by key."""
    work = load_balance.predicted_work(rows[:, 3], costs[rows[:, 2]], pace)
    return load_balance.by_block(rows[:, 0], work, rows[:, 3])


def _rank_summary(
    rows: np.ndarray, cut: np.ndarray, rank: int, costs: np.ndarray, pace: float
) -> np.ndarray:
    """Return the summary of this rank that all ranks receive, shape (3,).

    It holds the work, and the first key and the end of the longest stretch of its piece of the
    curve that is empty.
    """
    low = int(cut[rank - 1]) if rank > 0 else 0
    high = int(cut[rank]) if rank < len(cut) else np.iinfo(np.int64).max
    keys = rows[(rows[:, 0] >= low) & (rows[:, 0] < high), 0]
    begin, end = np.append(low, keys + 1), np.append(keys, high)
    longest = np.argmax(end - begin)
    work = int(load_balance.predicted_work(rows[:, 3], costs[rows[:, 2]], pace).sum())
    return np.array([work, begin[longest], end[longest]], np.int64)


def _recut(
    blocks: tuple[np.ndarray, np.ndarray, np.ndarray], load, ranks, cut, steps, first
) -> np.ndarray:
    """Return the present cuts or new ones; the result is equal on all ranks.

    `blocks` holds key, work and particles of the rank's blocks, see `_by_block`.
    """
    before = int(load[: ranks.rank].sum())
    mine = load_balance.candidate_cuts(*blocks, before, int(load.sum()), ranks.size)
    key, work, count = ranks.all_rows(mine).T
    return load_balance.rebalance(key, work, count, ranks.size, None if first else cut, steps)


def _with_rings(rows, lattice: BlockLattice, ranks: SerialCommunicator, cut, empty) -> np.ndarray:
    """Return this rank's rows and those of nearby blocks of other ranks, ascending by (key, group).

    `empty` (ranks, 2) holds first key and end of a stretch without particles of each rank.
    """
    if ranks.size == 1:
        return rows
    wide = _Wide(lattice)
    first = np.flatnonzero(np.diff(rows[:, 0], prepend=-1))
    codes = wide.code(lattice.block(rows[first, 1]))
    nearby = wide.neighbors(codes)
    owner = wide.owner(nearby, cut, empty)
    targets = np.empty((2, (2 * HALO_BLOCKS + 1) ** 3 * len(codes)), np.int64)
    n = _pairs_with_other_ranks(codes, nearby, owner, ranks.rank, *wide.step[:2], targets)
    block, rank = targets[:, :n]
    segments = np.diff(np.append(first, len(rows)))[block]
    row = np.repeat(first[block] - np.cumsum(segments) + segments, segments) + np.arange(
        segments.sum()
    )
    received = ranks.sparse_exchange(rows[row], np.repeat(rank, segments))
    # The senders know this rank's piece of the curve, not its blocks.
    place = wide.code(lattice.block(received[:, 1]))
    if len(nearby):
        received = received[
            nearby[np.minimum(np.searchsorted(nearby, place), len(nearby) - 1)] == place
        ]
    else:
        received = received[:0]
    rows = np.concatenate([rows, received])
    return rows[np.lexsort((rows[:, 2], rows[:, 0]))]


class _Wide:
    """Lattice with a margin of RINGS blocks.

    A step from a block to a nearby one is a constant step of its code.
    """

    def __init__(self, lattice: BlockLattice):
        self.lattice = lattice
        self.shape = np.array(lattice.shape) + 2 * HALO_BLOCKS
        self.step = (int(self.shape[1] * self.shape[2]), int(self.shape[2]), 1)

    def code(self, block: np.ndarray) -> np.ndarray:
        """Return the codes of blocks, (n, 3) -> (n,)."""
        return (block + HALO_BLOCKS) @ np.array(self.step)

    def neighbors(self, code: np.ndarray) -> np.ndarray:
        """Return the codes at most RINGS blocks from any of `code`, ascending."""
        for step in self.step:
            code = np.sort(
                (code[:, None] + step * np.arange(-HALO_BLOCKS, HALO_BLOCKS + 1)).ravel()
            )
            code = code[np.diff(code, prepend=-1) > 0]
        return code

    def owner(self, code: np.ndarray, cut: np.ndarray, empty: np.ndarray) -> np.ndarray:
        """Return the rank that may own particles in each block, -1 if none can.

        Args:
            code: Codes of the blocks, shape (n,).
            cut: Present cuts.
            empty: First key and end of a stretch without particles of each rank, shape (ranks, 2).
        """
        block = np.stack(np.unravel_index(code, self.shape), 1) - HALO_BLOCKS
        inside = ((block >= 0) & (block < self.lattice.shape)).all(1)
        key = self.lattice.key(block[inside])
        owner = load_balance.owners(key, cut)
        low, high = empty[owner].T
        out = np.full(len(code), -1, np.int64)
        out[inside] = np.where((key >= low) & (key < high), -1, owner)
        return out


@kernel
def _pairs_with_other_ranks(codes, nearby, owner, rank, plane, row, targets):
    """List the pairs of a block and another rank that may own a block near it; return their number.

    Args:
        codes: Codes of the blocks, shape (blocks,).
        nearby: Codes of all blocks around them, ascending, shape (m,).
        owner: Rank that may own each of these, or -1, shape (m,).
        rank: This rank.
        plane: Step of the code along x.
        row: Step of the code along y.
        targets: Block and rank of each pair (out), shape (2, n).
    """
    n = 0
    for b in range(len(codes)):
        begin, last = n, rank
        for i in range(-HALO_BLOCKS, HALO_BLOCKS + 1):
            for j in range(-HALO_BLOCKS, HALO_BLOCKS + 1):
                p = np.searchsorted(nearby, codes[b] + i * plane + j * row - HALO_BLOCKS)
                for k in range(p, p + 2 * HALO_BLOCKS + 1):  # the list holds the whole column
                    if owner[k] == last or owner[k] == rank or owner[k] < 0:
                        continue
                    last, new = owner[k], True
                    for q in range(begin, n):
                        new = new and targets[1, q] != last
                    if new:
                        targets[0, n], targets[1, n] = b, last
                        n += 1
    return n

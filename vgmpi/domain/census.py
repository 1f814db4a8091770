"""Which blocks hold particles, and who owns them, as far as a rank needs to know: its own blocks
and two rings around them. No rank ever holds more, however many there are.

The owner of a block follows from its key and the cuts alone, so a rank finds those it must tell of
its particles without a table. Of every rank all know three numbers: its work, and the longest
stretch of its piece of the curve where there is nothing. Without these the owner of the air over a
pool would hear from everyone at the surface.
"""

from typing import NamedTuple

import numpy as np

from ..device.jit import kernel
from . import balance
from .blocks import Lattice
from .ranks import Alone

RINGS = 2  # blocks around its own that a rank's tables look at
SAMPLES = 8  # places that each rank tells of its particles' part of the curve before the first cuts


class Census(NamedTuple):
    """Segments of this rank's blocks and of those at most RINGS away, ascending by (key, group)."""

    key: np.ndarray  # (n,) place of the block on the Hilbert curve
    code: np.ndarray  # (n,) the block
    group: np.ndarray  # (n,)
    particles: np.ndarray  # (n,) how many of them
    owner: np.ndarray  # (n,) rank
    load: np.ndarray  # (ranks,) work of each rank, see balance.predicted


def census(
    rows: np.ndarray, lattice: Lattice, ranks: Alone, costs: np.ndarray, cut: np.ndarray | None,
    steps: int,
) -> tuple[Census, np.ndarray]:  # fmt: skip
    """Merge the ranks' rows; cut the curve anew where that is worth it. Collective.

    rows: (n, 4) of key, code, group, count, of particles that this rank holds, wherever they
    belong; costs: (groups,) work per particle; cut: None at the start; steps: since the last sort.
    Returns the Census and the cuts in force.
    """
    first = cut is None
    if cut is None:
        cut = _guess(rows, ranks, costs)
    rows = _brought(rows, cut, ranks)
    known = ranks.each(_told(rows, cut, ranks.rank, costs))
    if first or balance.worth(known[:, 0], steps):
        old, cut = cut, _recut(rows, known[:, 0], ranks, costs, cut, steps, first)
        if cut is not old:
            rows = _brought(rows, cut, ranks)
            known = ranks.each(_told(rows, cut, ranks.rank, costs))
    key, code, group, particles = _with_rings(rows, lattice, ranks, cut, known[:, 1:]).T
    return Census(key, code, group, particles, balance.owners(key, cut), known[:, 0]), cut


def _guess(rows: np.ndarray, ranks: Alone, costs: np.ndarray) -> np.ndarray:
    """Cuts by a sample, so that no rank has to merge much more than its share."""
    key, work, _ = _by_block(rows[np.argsort(rows[:, 0], kind="stable")], costs)
    ends = np.cumsum(work)
    # ranks that hold the same blocks name different places
    share = (np.arange(SAMPLES) + ranks.rank * 0.6180339887 % 1.0) / SAMPLES
    at = np.searchsorted(ends, share * ends[-1]) if len(key) else np.zeros(0, np.int64)
    told = np.stack([key[at], np.full(len(at), work.sum() // SAMPLES)], 1)
    told = ranks.all_rows(told)
    told = told[np.argsort(told[:, 0], kind="stable")]
    key, work, _ = balance.by_block(told[:, 0], told[:, 1], told[:, 1])
    return balance.cuts(key, work, ranks.size, None)


def _brought(rows: np.ndarray, cut: np.ndarray, ranks: Alone) -> np.ndarray:
    """Rows brought to the owners of their blocks: those of this rank's blocks, merged, ascending by
    (key, group)."""
    rows = ranks.deliver(rows, balance.owners(rows[:, 0], cut))
    if (balance.owners(rows[:, 0], cut) != ranks.rank).any():
        raise RuntimeError("ranks disagree on who owns a block")
    rows = rows[np.lexsort((rows[:, 2], rows[:, 0]))]
    new = np.ones(len(rows), bool)
    new[1:] = (rows[1:, [0, 2]] != rows[:-1, [0, 2]]).any(1)
    first = np.flatnonzero(new)
    merged = rows[first]
    if len(first):
        merged[:, 3] = np.add.reduceat(rows[:, 3], first)
    return merged


def _by_block(rows: np.ndarray, costs: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Keys, work and particles of the blocks of rows that ascend by key."""
    return balance.by_block(
        rows[:, 0], balance.predicted(rows[:, 3], costs[rows[:, 2]]), rows[:, 3]
    )


def _told(rows: np.ndarray, cut: np.ndarray, rank: int, costs: np.ndarray) -> np.ndarray:
    """What all ranks know of one: its work; first key and end of the longest stretch of its piece
    of the curve where it owns nothing. (3,)
    """
    low = int(cut[rank - 1]) if rank > 0 else 0
    high = int(cut[rank]) if rank < len(cut) else np.iinfo(np.int64).max
    keys = rows[(rows[:, 0] >= low) & (rows[:, 0] < high), 0]
    begin, end = np.append(low, keys + 1), np.append(keys, high)
    longest = np.argmax(end - begin)
    work = int(balance.predicted(rows[:, 3], costs[rows[:, 2]]).sum())
    return np.array([work, begin[longest], end[longest]], np.int64)


def _recut(rows, load, ranks, costs, cut, steps, first) -> np.ndarray:
    """The cuts in force, or new ones: the same on every rank."""
    before = int(load[: ranks.rank].sum())
    mine = balance.offers(*_by_block(rows, costs), before, int(load.sum()), ranks.size)
    key, work, count = ranks.all_rows(mine).T
    return balance.recut(key, work, count, ranks.size, None if first else cut, steps)


def _with_rings(rows, lattice: Lattice, ranks: Alone, cut, empty) -> np.ndarray:
    """This rank's rows and those of other ranks' blocks near its own, ascending by (key, group).

    empty: (ranks, 2) first key and end of a stretch where each rank owns nothing.
    """
    if ranks.size == 1:
        return rows
    wide = _Wide(lattice)
    first = np.flatnonzero(np.diff(rows[:, 0], prepend=-1))
    at = wide.code(lattice.block(rows[first, 1]))
    near = wide.around(at)
    owner = wide.owner(near, cut, empty)
    to = np.empty((2, (2 * RINGS + 1) ** 3 * len(at)), np.int64)
    n = _reached(at, near, owner, ranks.rank, *wide.step[:2], to)
    block, rank = to[:, :n]
    segments = np.diff(np.append(first, len(rows)))[block]
    row = np.repeat(first[block] - np.cumsum(segments) + segments, segments) + np.arange(
        segments.sum()
    )
    came = ranks.deliver(rows[row], np.repeat(rank, segments))
    # who told us looked at our piece of the curve, not at our blocks
    place = wide.code(lattice.block(came[:, 1]))
    if len(near):
        came = came[near[np.minimum(np.searchsorted(near, place), len(near) - 1)] == place]
    else:
        came = came[:0]
    rows = np.concatenate([rows, came])
    return rows[np.lexsort((rows[:, 2], rows[:, 0]))]


class _Wide:
    """The lattice with a margin of RINGS blocks, so that a step from a block to one near it is a
    step of its code."""

    def __init__(self, lattice: Lattice):
        self.lattice = lattice
        self.shape = np.array(lattice.shape) + 2 * RINGS
        self.step = (int(self.shape[1] * self.shape[2]), int(self.shape[2]), 1)

    def code(self, block: np.ndarray) -> np.ndarray:
        """(n, 3) -> (n,)."""
        return (block + RINGS) @ np.array(self.step)

    def around(self, code: np.ndarray) -> np.ndarray:
        """Codes at most RINGS blocks from some of `code`, ascending."""
        for step in self.step:
            code = np.sort((code[:, None] + step * np.arange(-RINGS, RINGS + 1)).ravel())
            code = code[np.diff(code, prepend=-1) > 0]
        return code

    def owner(self, code: np.ndarray, cut: np.ndarray, empty: np.ndarray) -> np.ndarray:
        """Rank that may own particles there; -1 where none can."""
        block = np.stack(np.unravel_index(code, self.shape), 1) - RINGS
        inside = ((block >= 0) & (block < self.lattice.shape)).all(1)
        key = self.lattice.key(block[inside])
        owner = balance.owners(key, cut)
        low, high = empty[owner].T
        out = np.full(len(code), -1, np.int64)
        out[inside] = np.where((key >= low) & (key < high), -1, owner)
        return out


@kernel
def _reached(at, near, owner, rank, far, row, to):
    """List every block with every other rank that may own one near it; returns how many pairs.

    at: (blocks,) codes; near: codes, ascending, of all blocks around them, of which owner: (near,)
    tells the rank or -1; far, row: steps of the code along x and y; to: (2, ...) block and rank.
    """
    n = 0
    for b in range(len(at)):
        begin, last = n, rank
        for i in range(-RINGS, RINGS + 1):
            for j in range(-RINGS, RINGS + 1):
                p = np.searchsorted(near, at[b] + i * far + j * row - RINGS)
                for k in range(p, p + 2 * RINGS + 1):  # all of the column are there
                    if owner[k] == last or owner[k] == rank or owner[k] < 0:
                        continue
                    last, new = owner[k], True
                    for q in range(begin, n):
                        new = new and to[1, q] != last
                    if new:
                        to[0, n], to[1, n] = b, last
                        n += 1
    return n

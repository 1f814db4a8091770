"""What a sort costs one rank of very many beside sorting its own particles: rows, census and tables
of a rank amid a cube of full blocks. The rank does its own work; what the others would have told it
is laid out before.
"""

import time
import tracemalloc

import numpy as np

from tests.benchmarks.scaling_model import NEEDS, PARTICLES_PER_FULL_BLOCK, cube
from vgmpi.parallel import exchange_topology, load_balance, migration
from vgmpi.parallel.block_ownership import HALO_BLOCKS, build_block_directory
from vgmpi.parallel.communicator import SerialCommunicator

CROSS = 4  # particles that cross each face, edge or corner of a block between two sorts
REPEATS = 25


class Amid(SerialCommunicator):
    """One rank of `size`; the others' share of every verb is known beforehand."""

    def __init__(self, rank: int, size: int, summaries: np.ndarray, runs: np.ndarray):
        """told: (size, 3) as each rank tells of itself; runs: (n, 3) that all offer for cuts."""
        self.rank, self.size = rank, size
        self.summaries, self.runs = summaries, runs
        self.incoming: list[np.ndarray] = []  # what the next deliveries bring from other ranks
        self.sent: list[int] = []  # partners of each delivery

    def each(self, numbers):
        """Return the summaries of all ranks."""
        out = self.summaries.copy()
        out[self.rank] = numbers
        return out

    def all_rows(self, rows):
        """Return the prepared rows of all ranks."""
        return self.runs

    def sparse_exchange(self, rows, to):
        """Return own rows and prepared rows of other ranks."""
        self.sent.append(len(np.unique(to[to != self.rank])))
        return np.concatenate([rows[to == self.rank], self.incoming.pop(0)])


class Sort:
    """The sort of the rank in the middle, again and again."""

    def __init__(self, ranks: int, particles: int):
        self.lattice, key, code = cube(ranks, particles)
        count = np.full(len(key), PARTICLES_PER_FULL_BLOCK)
        work = load_balance.predicted_work(count, np.ones(len(key)))
        self.cut = load_balance.partition(key, work, ranks, None)
        owner = load_balance.owners(key, self.cut)
        self.rank = owner[len(owner) // 2]
        first = np.searchsorted(owner, np.arange(ranks + 1))
        load = np.add.reduceat(work, first[:-1])
        summaries = np.stack([load, key[first[1:] - 1] + 1, np.append(self.cut, key[-1] + 2)], 1)
        pieces = [slice(a, b) for a, b in zip(first[:-1], first[1:], strict=True)]
        before, total = np.cumsum(load) - load, int(load.sum())
        runs = [
            load_balance.candidate_cuts(key[p], work[p], count[p], int(b), total, ranks)
            for p, b in zip(pieces, before, strict=True)
        ]
        self.ranks = Amid(self.rank, ranks, summaries, np.concatenate(runs))
        rows = np.stack([key, code, np.zeros_like(key), count], 1)
        own_rows = pieces[self.rank]
        self.code = code[own_rows]
        neighbors = [self._within(rows, own_rows, reach) for reach in (1, HALO_BLOCKS)]
        self.rings = rows[neighbors[1]]
        block, neighbor_block = (
            self.lattice.block(self.code),
            self.lattice.block(code[neighbors[0]]),
        )
        touched = (np.abs(block[:, None] - neighbor_block) <= 1).all(2).any(1)
        self.crossed = rows[own_rows][touched] * [1, 1, 1, 0] + [0, 0, 0, CROSS]
        inside = np.isin(self._around(), code)
        self.number = np.where(inside, CROSS, 0)
        self.number[:, 13] = PARTICLES_PER_FULL_BLOCK - CROSS * 26

    def _around(self) -> np.ndarray:
        """Codes of the blocks around this rank's own, (blocks, 27)."""
        return self.code[:, None] + migration.neighbor_code_offsets(self.lattice)

    def _within(self, rows, own_rows: slice, reach: int) -> np.ndarray:
        """Rows of other ranks' blocks at most `reach` from this rank's."""
        own = self.lattice.block(rows[own_rows, 1])
        low, high = own.min(0) - reach, own.max(0) + reach
        block = self.lattice.block(rows[:, 1])
        neighbors = np.flatnonzero(((block >= low) & (block <= high)).all(1))
        neighbors = neighbors[(neighbors < own_rows.start) | (neighbors >= own_rows.stop)]
        gap = np.abs(block[neighbors][:, None] - own).max(2).min(1)
        return neighbors[gap <= reach]

    def once(self, looks: bool) -> exchange_topology.ExchangeTopology:
        """One sort; looks: with a look for new cuts, which are not taken."""
        load = self.ranks.summaries[0, 0]
        self.ranks.summaries[0, 0] = load * (1.05 if looks else 1.0)
        self.ranks.incoming = [self.crossed, self.rings]
        targets = migration.migration_targets(self.lattice, self.code, self.number)
        rows = targets.rows(0)
        blocks, cut = build_block_directory(
            rows, self.lattice, self.ranks, np.ones(1), self.cut, 10
        )
        self.ranks.summaries[0, 0] = load
        if cut is not self.cut:
            raise AssertionError("new cuts: what the others tell would be wrong")
        return exchange_topology.build_topology(blocks, self.lattice, self.rank, NEEDS)


def measure(ranks: int, particles: int) -> dict:
    """Milliseconds of processor time, least of REPEATS, and megabytes at most of a sort's rows,
    census and tables."""
    sort = Sort(ranks, particles)
    result = {"ranks": ranks, "blocks": len(sort.code), "rings": len(sort.rings)}
    for name, looks in (("kept", False), ("looked", True)):
        sort.once(looks)
        spent = []
        for _ in range(REPEATS):
            began = time.thread_time()
            sort.once(looks)
            spent.append(time.thread_time() - began)
        tracemalloc.start()
        sort.once(looks)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        result[name] = 1e3 * min(spent), 1e-6 * peak
    return result | {"partners": max(sort.ranks.sent)}


def text(rows: list[dict]) -> str:
    """The result as a table."""
    lines = [
        "rows, census and tables of one rank at a sort, beside sorting its particles:",
        "   ranks   own blocks   others' in two rings   partners   cuts kept   looked for new ones",
    ]
    for row in rows:
        unchanged, looked = (f"{row[k][0]:.2f} ms {row[k][1]:.2f} MB" for k in ("kept", "looked"))
        lines.append(
            f"{row['ranks']:8d} {row['blocks']:12d} {row['rings']:22d} {row['partners']:10d}"
            f"   {unchanged}   {looked}"
        )
    return "\n".join(lines)

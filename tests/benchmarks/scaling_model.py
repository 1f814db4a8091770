"""Scaling on paper: what a step costs on many ranks, from constants measured here and the solver's
own tables of who sends what to whom; held against runs on the ranks this machine can start.

A rank's step = work / rate of one core + node blocks that ranks share + packing both ways
             + what of the exchange the interior does not hide + the reduction + Python
             + a sort's census and tables, by the steps from sort to sort.

Efficiency compares with one rank that has as many particles on a busy machine (weak scaling). Work,
node blocks, bytes and neighbours are those of a cube of full blocks, cut by the solver, of the
worst of some ranks.
"""

import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from vgmpi.parallel import exchange_topology, halo_exchange
from vgmpi.parallel.block_lattice import BLOCK_EDGE, BlockLattice
from vgmpi.parallel.block_ownership import BlockDirectory
from vgmpi.parallel.communicator import PersistentExchange, SerialCommunicator
from vgmpi.parallel.load_balance import BLOCK_COST, owners, partition
from vgmpi.tools.bench.benchmark_case import Case, lay_out
from vgmpi.tools.bench.interleaved_rounds import Contestant, Worker
from vgmpi.tools.bench.vgmpi_contestant import WORK

PARTICLES_PER_FULL_BLOCK = 8 * BLOCK_EDGE**3  # particles of a full block
SAMPLE = 8  # ranks of which tables are laid out
CYCLES = 8  # from sort to sort, of which the quickest counts
RANKS = (1, 8, 64, 512, 4096)
PER_RANK = (10_000, 30_000, 100_000, 300_000, 1_000_000)
STEPS_PER_SORT = 19  # of the scene of the benchmark
OVERLAPPED = 0.5  # share of a step's work during which messages may travel: P2G and grid


def cube(ranks: int, particles: int) -> tuple[BlockLattice, np.ndarray, np.ndarray]:
    """A cube of about `particles` per rank in full blocks: its lattice, keys (n,) ascending and
    codes (n,)."""
    side = max(1, round((ranks * particles / PARTICLES_PER_FULL_BLOCK) ** (1 / 3)))
    lattice = BlockLattice((BLOCK_EDGE * (side + 4),) * 3, 1.0)
    blocks = np.stack(np.meshgrid(*[np.arange(side)] * 3, indexing="ij"), -1).reshape(-1, 3) + 2
    key, code = lattice.key(blocks), lattice.code(blocks)
    order = np.argsort(key)
    return lattice, key[order], code[order]


def tables(ranks: int, blocks: float) -> dict:
    """Return table sizes of the worst of SAMPLE ranks of a cube of ranks x blocks full blocks.

    One phase, single precision: own blocks, border blocks, node blocks that others add to, bytes
    sent, neighbors, and the mean blocks of all ranks.
    """
    lattice, key, code = cube(ranks, PARTICLES_PER_FULL_BLOCK * blocks)
    ones = np.ones(len(key))
    owner = owners(key, partition(key, ones, ranks, None))
    census = BlockDirectory(
        key,
        code,
        np.zeros(len(key), np.int64),
        ones * PARTICLES_PER_FULL_BLOCK,
        owner,
        np.ones(ranks),
    )
    chosen = np.unique(np.linspace(0, ranks - 1, SAMPLE).round().astype(int))
    rank_tables = np.array([_of_rank(census, lattice, rank) for rank in chosen])
    names = ("own", "border", "shared", "bytes", "neighbours")
    return dict(zip(names, rank_tables.max(0), strict=True)) | {"mean": len(key) / ranks}


# one phase, nothing to touch: what the scene of the benchmark asks of the tables
NEEDS = exchange_topology.TopologyRequirements(np.zeros(1, np.int64), False, False)


class SilentCommunicator(SerialCommunicator):
    """Ranks that say nothing: to lay out messages."""

    def link(self, sends, receives):
        """Return a link that transfers nothing."""
        return PersistentExchange()


def _of_rank(census: BlockDirectory, lattice: BlockLattice, rank: int) -> list[float]:
    t = exchange_topology.build_topology(census, lattice, rank, NEEDS)
    messages = halo_exchange.HaloExchange(SilentCommunicator(), t, 1)
    size = messages.bytes_sent
    return [
        len(t.code),
        int(t.border.sum()),
        int(t.receives_remote.sum()),
        size,
        len(messages.sends),
    ]


def fit_cost_constants(rows: dict[int, list], busy: list, empty_us: float) -> dict:
    """Seconds per unit of work, shared node block and byte copied, by rows of one and two ranks.

    busy: rows of two runs of one rank each at the same time. Cores share caches and memory, so a
    rank computes slower when the others do, which is no cost of the decomposition: `unit` is a
    busy machine's, `alone` that of one rank on an idle one.
    """
    single, double, both = (np.array(rows_of_ranks) for rows_of_ranks in (rows[1], rows[2], busy))
    stages = len(WORK)
    halo = WORK.index("halo")
    alone, unit = (
        rows_of_ranks[:, :stages].sum()
        / (rows_of_ranks[:, stages] + BLOCK_COST * rows_of_ranks[:, stages + 1]).sum()
        for rows_of_ranks in (single, both)
    )
    copied = double[:, halo].sum() / (2 * double[:, stages + 3].sum())
    remainder = double[:, :stages].sum() - double[:, halo].sum()
    remainder -= unit * (double[:, stages] + BLOCK_COST * double[:, stages + 1]).sum()
    return {
        "alone": alone,
        "unit": unit,
        "copied": copied,
        "shared": max(0.0, remainder / double[:, stages + 2].sum()),
        "python": 1e-6 * empty_us,
    }


def predicted(c: dict, work: float, shared: float, size: float) -> float:
    """Return the seconds that a rank computes in a step.

    Args:
        c: Constants of fit_cost_constants.
        work: Work of the rank.
        shared: Shared node blocks.
        size: Bytes sent.
    """
    return c["unit"] * work + c["shared"] * shared + c["copied"] * 2 * size


def step(c: dict, ranks: int, particles: int, latency: float, bandwidth: float) -> float:
    """Return the seconds of a step.

    Args:
        c: Constants; c["tables"], if present: seconds of a sort's census and tables per own block,
            divided by the steps between sorts.
        ranks: Number of ranks.
        particles: Particles of each rank.
        latency: Latency of a message [s].
        bandwidth: Bandwidth of one rank's link [B/s].
    """
    blocks = max(1, round(particles / PARTICLES_PER_FULL_BLOCK))
    t = tables(ranks, blocks)
    work = particles * (1.0 + BLOCK_COST / PARTICLES_PER_FULL_BLOCK) * t["own"] / t["mean"]
    computes = predicted(c, work, t["shared"], t["bytes"])
    travels = t["neighbours"] * latency + t["bytes"] / bandwidth
    hidden = OVERLAPPED * c["unit"] * work * (1.0 - t["border"] / t["own"])
    reduction = 2.0 * np.log2(ranks) * latency if ranks > 1 else 0.0
    tables_again = c.get("tables", 0.0) * t["own"] if ranks > 1 else 0.0
    return computes + max(0.0, travels - hidden) + reduction + tables_again + c["python"]


def measure(real_ranks: list[int], particles: int, say) -> tuple[dict[int, list], list, float]:
    """Rows of `inside.Contestant.work` for each number of real ranks with `particles` each; those
    of two runs of one rank at the same time; the time of an empty step on one rank [us]."""
    rows, busy, empty = {}, [], 0.0
    for n in real_ranks:
        say(f"{n} rank(s) of {particles:,} particles")
        case = Case("fluid", n * particles)
        with tempfile.TemporaryDirectory(prefix="vgmpi-bench-") as folder:
            lay_out(case, ["single"], Path(folder))
            workers = [Worker(Contestant("own", ranks=n), case, Path(folder))]
            try:
                rows[n] = workers[0].ask("work", cycles=CYCLES)["rows"]
                if n == 1:
                    empty = workers[0].ask("empty", steps=200)["us"]
                    workers.append(Worker(Contestant("own"), case, Path(folder)))
                    with ThreadPoolExecutor(2) as pool:
                        both = pool.map(lambda w: w.ask("work", cycles=CYCLES)["rows"], workers)
                        busy = [row for rank_rows in both for row in rank_rows]
            finally:
                for worker in workers:
                    worker.close()
    return rows, busy, empty


def text(rows: dict[int, list], c: dict, latency: float, bandwidth: float, cores: int) -> str:
    """Return the constants, the check against real runs, and the times.

    Args:
        rows: Rows of real runs by the number of ranks.
        c: Constants.
        latency: Latency of a message [s].
        bandwidth: Bandwidth of one rank's link [B/s].
        cores: Cores of this machine.
    """
    stages = len(WORK)
    lines = [
        f"measured: {1e9 * c['alone']:.1f} ns per particle (a block counts as {BLOCK_COST:.0f}"
        f" more), {1e9 * c['unit']:.1f} ns while the other core computes too,"
        f" {1e6 * c['shared']:.2f} us per node block shared, {1e9 * c['copied']:.3f} ns per byte"
        f" packed or unpacked, {1e6 * c['python']:.0f} us of Python",
        f"a sort's census and tables: {1e9 * c.get('tables', 0.0):.0f} ns per own block and step",
        "real runs: processor time that a rank computes in a step (waiting not counted)",
        "   ranks  particles each   measured [us]: mean   largest   predicted: mean   largest"
        "   kB sent   neighbours",
    ]
    for n, rank_rows in rows.items():
        row = np.array(rank_rows)
        spent = 1e6 * row[:, :stages].sum(1)
        work = row[:, stages] + BLOCK_COST * row[:, stages + 1]
        constants_used = c if n > 1 else c | {"unit": c["alone"]}
        times = 1e6 * predicted(constants_used, work, row[:, stages + 2], row[:, stages + 3])
        lines.append(
            f"{n:8d} {row[:, stages].mean():15,.0f} {spent.mean():21.0f} {spent.max():9.0f}"
            f" {times.mean():17.0f} {times.max():9.0f} {row[:, stages + 3].max() / 1e3:9.0f}"
            f" {row[:, stages + 4].max():12.0f}" + (" (more ranks than cores)" * (n > cores))
        )
    lines += [
        f"predicted efficiency with {1e6 * latency:g} us and {1e-9 * bandwidth:g} GB/s per rank:",
        "   particles per rank" + "".join(f"{n:9d} rk" for n in RANKS),
    ]
    for particles in PER_RANK:
        alone = step(c, 1, particles, latency, bandwidth)
        every = [alone / step(c, n, particles, latency, bandwidth) for n in RANKS]
        lines.append(f"{particles:21,d}" + "".join(f"{e:12.3f}" for e in every))
    return "\n".join(lines)

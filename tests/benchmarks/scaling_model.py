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

from vgmpi.apps.bench.benchmark_case import Case, lay_out
from vgmpi.apps.bench.instrumented_contestant import WORK
from vgmpi.apps.bench.interleaved_rounds import Contestant, Worker
from vgmpi.parallel import exchange_topology, halo_exchange
from vgmpi.parallel.block_lattice import BLOCK_EDGE, BlockLattice
from vgmpi.parallel.block_ownership import BlockDirectory
from vgmpi.parallel.communicator import PersistentExchange, SerialCommunicator
from vgmpi.parallel.load_balance import BLOCK_COST, owners, partition

FILL = 8 * BLOCK_EDGE**3  # particles of a full block
SAMPLE = 8  # ranks of which tables are laid out
CYCLES = 8  # from sort to sort, of which the quickest counts
RANKS = (1, 8, 64, 512, 4096)
PER_RANK = (10_000, 30_000, 100_000, 300_000, 1_000_000)
STEPS_PER_SORT = 19  # of the scene of the benchmark
OVERLAPPED = 0.5  # share of a step's work during which messages may travel: P2G and grid


def tables(ranks: int, blocks: int) -> dict:
    """Of the worst of SAMPLE ranks of a cube of about ranks x blocks full blocks, one phase, single
    precision: own blocks, those at the border, node blocks that others add to, bytes sent,
    neighbours; and blocks in the mean of all ranks."""
    side = max(1, round((ranks * blocks) ** (1 / 3)))
    at = np.stack(np.meshgrid(*[np.arange(side)] * 3, indexing="ij"), -1).reshape(-1, 3) + 2
    lattice = BlockLattice((BLOCK_EDGE * (side + 4),) * 3, 1.0)
    key, code = lattice.key(at), lattice.code(at)
    order = np.argsort(key)
    key, code = key[order], code[order]
    ones = np.ones(len(key))
    owner = owners(key, partition(key, ones, ranks, None))
    census = BlockDirectory(
        key, code, np.zeros(len(key), np.int64), ones * FILL, owner, np.ones(ranks)
    )
    chosen = np.unique(np.linspace(0, ranks - 1, SAMPLE).round().astype(int))
    found = np.array([_of_rank(census, lattice, rank) for rank in chosen])
    names = ("own", "border", "shared", "bytes", "neighbours")
    return dict(zip(names, found.max(0), strict=True)) | {"mean": len(key) / ranks}


# one phase, nothing to touch: what the scene of the benchmark asks of the tables
NEEDS = exchange_topology.TopologyRequirements(
    np.zeros(1, np.int64), False, False, np.zeros(1, np.int64)
)


class Silent(SerialCommunicator):
    """Ranks that say nothing: to lay out messages."""

    def link(self, sends, receives):
        return PersistentExchange()


def _of_rank(census: BlockDirectory, lattice: BlockLattice, rank: int) -> list[float]:
    t = exchange_topology.build_topology(census, lattice, rank, NEEDS)
    messages = halo_exchange.HaloExchange(Silent(), t, 1)
    size = messages.bytes_sent
    return [
        len(t.code),
        int(t.border.sum()),
        int(t.receives_remote.sum()),
        size,
        len(messages.sends),
    ]


def constants(rows: dict[int, list], busy: list, empty_us: float) -> dict:
    """Seconds per unit of work, shared node block and byte copied, by rows of one and two ranks.

    busy: rows of two runs of one rank each at the same time. Cores share caches and memory, so a
    rank computes slower when the others do, which is no cost of the decomposition: `unit` is a
    busy machine's, `alone` that of one rank on an idle one.
    """
    one, two, both = (np.array(found) for found in (rows[1], rows[2], busy))
    stages = len(WORK)
    halo = WORK.index("halo")
    alone, unit = (
        found[:, :stages].sum() / (found[:, stages] + BLOCK_COST * found[:, stages + 1]).sum()
        for found in (one, both)
    )
    copied = two[:, halo].sum() / (2 * two[:, stages + 3].sum())
    rest = two[:, :stages].sum() - two[:, halo].sum()
    rest -= unit * (two[:, stages] + BLOCK_COST * two[:, stages + 1]).sum()
    return {
        "alone": alone,
        "unit": unit,
        "copied": copied,
        "shared": max(0.0, rest / two[:, stages + 2].sum()),
        "python": 1e-6 * empty_us,
    }


def predicted(c: dict, work: float, shared: float, size: float) -> float:
    """Seconds a rank computes in a step."""
    return c["unit"] * work + c["shared"] * shared + c["copied"] * 2 * size


def step(c: dict, ranks: int, particles: int, latency: float, bandwidth: float) -> float:
    """Seconds of a step with `particles` on each of `ranks`; latency [s], bandwidth [B/s] of one
    rank's link. c["tables"], if it is there: seconds of a sort's census and tables per own block,
    by the steps from sort to sort."""
    blocks = max(1, round(particles / FILL))
    t = tables(ranks, blocks)
    work = particles * (1.0 + BLOCK_COST / FILL) * t["own"] / t["mean"]
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
            workers = [Worker(Contestant("inside", ranks=n), case, Path(folder))]
            try:
                rows[n] = workers[0].ask("work", cycles=CYCLES)["rows"]
                if n == 1:
                    empty = workers[0].ask("empty", steps=200)["us"]
                    workers.append(Worker(Contestant("inside"), case, Path(folder)))
                    with ThreadPoolExecutor(2) as pool:
                        both = pool.map(lambda w: w.ask("work", cycles=CYCLES)["rows"], workers)
                        busy = [row for found in both for row in found]
            finally:
                for worker in workers:
                    worker.close()
    return rows, busy, empty


def text(rows: dict[int, list], c: dict, latency: float, bandwidth: float, cores: int) -> str:
    """Constants, the check against real runs, the prediction."""
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
    for n, found in rows.items():
        row = np.array(found)
        spent = 1e6 * row[:, :stages].sum(1)
        work = row[:, stages] + BLOCK_COST * row[:, stages + 1]
        here = c if n > 1 else c | {"unit": c["alone"]}
        told = 1e6 * predicted(here, work, row[:, stages + 2], row[:, stages + 3])
        lines.append(
            f"{n:8d} {row[:, stages].mean():15,.0f} {spent.mean():21.0f} {spent.max():9.0f}"
            f" {told.mean():17.0f} {told.max():9.0f} {row[:, stages + 3].max() / 1e3:9.0f}"
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

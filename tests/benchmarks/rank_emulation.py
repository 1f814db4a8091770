"""One rank of many alone in a process: what it computes in a step by the tables it would have, full
blocks of a fluid, and messages in which nobody adds anything. No rank waits, nothing travels.
"""

import dataclasses
import tempfile
import time
from pathlib import Path

import numpy as np

from tests.benchmarks.scaling_model import NEEDS, PARTICLES_PER_FULL_BLOCK, SilentCommunicator
from tests.benchmarks.sort_scaling import cube
from vgmpi.parallel import exchange_topology
from vgmpi.parallel.block_lattice import BITS, BLOCK_EDGE, INTEGER, BlockLattice
from vgmpi.parallel.block_ownership import BlockDirectory
from vgmpi.parallel.halo_exchange import HaloExchange
from vgmpi.parallel.load_balance import owners, partition
from vgmpi.solver.engines.cpu import Cpu
from vgmpi.tools.bench import vgmpi_contestant
from vgmpi.tools.bench.benchmark_case import Case, lay_out

STAGES = ("p2g border", "pack", "p2g inner", "grid inner", "add", "grid border", "g2p")
RESET_INTERVAL = 12  # [steps] the particles are reset to the start this often


class Rank:
    """One of `ranks` with about `particles` each, in the middle of a cube."""

    def __init__(self, plan, ranks: int, particles: int):
        lattice, key, code = cube(ranks, particles)
        self.plan = dataclasses.replace(plan, cells=lattice.cells)
        lattice = BlockLattice(lattice.cells, plan.dx)
        ones = np.ones(len(key))
        owner = owners(key, partition(key, ones, ranks, None))
        rank = int(owner[len(owner) // 2])
        census = BlockDirectory(
            key, code, np.zeros(len(key), np.int64), ones * PARTICLES_PER_FULL_BLOCK, owner, ones
        )
        self.tables = exchange_topology.build_topology(census, lattice, rank, NEEDS)
        self.engine = Cpu(self.plan, lattice, None, 1)
        self._fill(code[owner == rank])
        self.engine.set_topology(self.tables)
        self.halo = HaloExchange(SilentCommunicator(), self.tables, self.engine.words)

    def _fill(self, code: np.ndarray) -> None:
        """Eight particles per cell, jittered, in motion."""
        (group,), random = self.engine.groups, np.random.default_rng(3)
        n, bits = PARTICLES_PER_FULL_BLOCK * len(code), BITS[self.plan.real]
        cell = np.stack(np.meshgrid(*[np.arange(BLOCK_EDGE)] * 3, indexing="ij"), -1).reshape(
            -1, 1, 3
        )
        part = np.stack(np.meshgrid(*[(0.25, 0.75)] * 3, indexing="ij"), -1).reshape(1, 8, 3)
        x = (cell + part - 2.0).reshape(1, PARTICLES_PER_FULL_BLOCK, 3) + random.uniform(
            -0.2, 0.2, (len(code), PARTICLES_PER_FULL_BLOCK, 3)
        )
        group.reserve(n)
        xi = np.rint(np.ldexp(x.reshape(-1, 3), bits)).astype(INTEGER[self.plan.real])
        group.xi[:, :n] = xi.T
        every = np.arange(n)
        group.f[:, :n] = np.array(group.plan.channels.rest)[:, None]
        group.put("v", every, np.array([5e-2, 4e-2, 3e-2]) * (1 + 0.1 * random.random((n, 3))))
        group.put("vol0", every, np.full((n, 1), self.plan.dx**3 / 8))
        group.ids[:n] = every
        group.segments(
            code,
            PARTICLES_PER_FULL_BLOCK * np.arange(len(code)),
            np.full(len(code), PARTICLES_PER_FULL_BLOCK),
        )
        group.used = n
        self.begin = group.xi[:, :n].copy(), group.f[:, :n].copy()

    def step(self, step: int, dt: float) -> np.ndarray:
        """Seconds of processor time by stage."""
        engine, (group,) = self.engine, self.engine.groups
        if step % RESET_INTERVAL == 0:
            group.xi[:, : group.used], group.f[:, : group.used] = self.begin
        engine.begin(dt, np.zeros(3), self.plan.dx / dt)
        for message in self.halo.receives:
            message.head[:] = step, message.seal
            for part in message.parts:
                part.numbers[:], part.tails[:] = 2**51, 2**15  # sums at rest
        marks = [time.thread_time()]

        def mark(_=None):
            """Record the time."""
            marks.append(time.thread_time())

        for work in (
            lambda: engine.fill(border=True),
            lambda: self.halo.start(step, engine.pack),
            lambda: engine.fill(border=False),
            lambda: engine.update(border=False),
            lambda: self.halo.finish(step, engine.add),
            lambda: engine.update(border=True),
            lambda: engine.gather(step),
        ):
            work()
            mark()
        return np.diff(marks)


def measure(ranks: list[int], particles: int, steps: int) -> list[dict]:
    """A row per number of ranks, in turns step by step: least nanoseconds per particle by stage,
    the mean of the quickest quarter of steps, bytes sent per step."""
    with tempfile.TemporaryDirectory(prefix="vgmpi-bench-") as folder:
        lay_out(Case("fluid", 64), ["single"], Path(folder))
        contestant = vgmpi_contestant.Contestant(
            {"ranks": 1, "threads": 1, "folder": f"{folder}/single"}
        )
    plan, dt = contestant.simulation.plan, contestant.dt
    every = [Rank(plan, n, particles) for n in ranks]
    spent = np.array([[rank.step(k, dt) for rank in every] for k in range(steps)])[1:]
    rows = []
    for k, (n, rank) in enumerate(zip(ranks, every, strict=True)):
        particle_count, totals = len(rank.engine.groups[0]), np.sort(spent[:, k].sum(1))
        rows.append(
            {
                "ranks": n,
                "particles": particle_count,
                "border": int(rank.tables.border.sum()),
                "blocks": len(rank.tables.code),
                "bytes": rank.halo.bytes_sent,
                "neighbours": len(rank.halo.sends),
                "stages": dict(zip(STAGES, 1e9 * spent[:, k].min(0) / particle_count, strict=True)),
                "ns": 1e9 * float(totals[: len(totals) // 4 + 1].mean()) / particle_count,
            }
        )
    return rows


def text(rows: list[dict]) -> str:
    """The result as a table."""
    lines = ["one rank of many by its own tables, ns of processor time per particle and step:"]
    for row in rows:
        stages = ", ".join(f"{name} {ns:.2f}" for name, ns in row["stages"].items())
        lines.append(
            f"{row['ranks']:6d} ranks: {row['ns']:.2f} ns ({row['ns'] - rows[0]['ns']:+.2f}), least"
            f" {sum(row['stages'].values()):.2f}; {row['particles']:,} particles,"
            f" {row['border']} of {row['blocks']} blocks at the border, {row['neighbours']} others,"
            f" {row['bytes'] / 1e3:.0f} kB sent\n              {stages}"
        )
    return "\n".join(lines)

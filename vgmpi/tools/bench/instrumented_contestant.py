"""This solver as a contestant that tells what its ranks do, for the studies of tests/benchmarks."""

import time
import tracemalloc
from typing import cast

import numpy as np

from vgmpi.solver.engines.cpu import Cpu

from . import vgmpi_contestant

WORK = ("p2g", "halo", "grid", "g2p", "sort")  # stages that compute; the others wait


class Contestant(vgmpi_contestant.Contestant):
    """One rank's share; every answer is the same on all ranks."""

    def empty(self, steps: int) -> dict:
        """Return the time of a step without work for its kernels, and what it allocates.

        The time [us] is the minimum of ten rounds; the bytes in Python are those that stay and the
        peak.
        """
        self.restart()
        engine = cast(Cpu, self.simulation.engine)  # or its child for a graphics card
        instance = vars(engine)
        instance["call_if_rows"] = lambda group, kernel, rows, *arguments: engine.run(
            group, kernel, rows[:0], *arguments
        )
        try:
            rounds = [self._timed(steps) for _ in range(10)]
            tracemalloc.start()
            self._timed(steps)
            before = tracemalloc.get_traced_memory()[0]
            tracemalloc.reset_peak()
            self._timed(steps)
            after, peak = tracemalloc.get_traced_memory()
            tracemalloc.stop()
        finally:
            del instance["call_if_rows"]
        worst = self.ranks.max(np.array([min(rounds[1:]), after - before, peak - before]))
        return {"us": 1e6 * worst[0], "stays": worst[1] / steps, "most": worst[2]}

    def _timed(self, steps: int) -> float:
        self.ranks.barrier()
        began = time.perf_counter()
        for _ in range(steps):
            self.step()
        return (time.perf_counter() - began) / steps

    def work(self, cycles: int) -> dict:
        """Return a row per rank with the work of a step, the quickest of `cycles` sort cycles.

        A row has seconds of processor time in WORK, particles, blocks, node blocks that others add
        to, bytes sent, and neighbors.
        """
        self.restart()
        self.cycle()
        simulation, seconds = self.simulation, []
        for _ in range(cycles):
            clock = simulation.clock = vgmpi_contestant.Stages(time.thread_time)
            before, steps = simulation.exchange.bytes_sent, self.cycle()
            seconds.append([clock.spent.get(stage, 0.0) / steps for stage in WORK])
            sent = (simulation.exchange.bytes_sent - before) / steps
        simulation.clock = None
        assert simulation.exchange.halo is not None
        groups, tables = simulation.groups, simulation.exchange.tables
        waits = int(np.repeat(tables.receives_remote, np.diff(tables.first)).sum())
        quickest = min(seconds, key=sum)
        row = [*quickest, sum(map(len, groups)), sum(len(g.start) for g in groups), waits, sent]
        row.append(len(simulation.exchange.halo.sends))
        return {"rows": self.ranks.all_rows(np.array([row], np.float64)).tolist()}

"""This solver as a contestant that tells what its ranks do: for `overhead` and `scaling`."""

import time
import tracemalloc

import numpy as np

from . import own

WORK = ("p2g", "halo", "grid", "g2p", "sort")  # stages that compute; the others wait


class Contestant(own.Contestant):
    """One rank's share; every answer is the same on all ranks."""

    def empty(self, steps: int) -> dict:
        """Time of a step whose kernels are called but get nothing to do [us], least of ten rounds;
        and what such a step allocates: bytes that stay and bytes at most, in Python."""
        self.restart()
        engine = self.simulation.engine
        engine.call = lambda of, kernel, rows, *arguments: engine.run(
            of, kernel, rows[:0], *arguments
        )
        try:
            rounds = [self._timed(steps) for _ in range(10)]
            tracemalloc.start()
            self._timed(steps)
            before = tracemalloc.get_traced_memory()[0]
            tracemalloc.reset_peak()
            self._timed(steps)
            after, most = tracemalloc.get_traced_memory()
            tracemalloc.stop()
        finally:
            del engine.call
        worst = self.ranks.max(np.array([min(rounds[1:]), after - before, most - before]))
        return {"us": 1e6 * worst[0], "stays": worst[1] / steps, "most": worst[2]}

    def _timed(self, steps: int) -> float:
        self.ranks.barrier()
        began = time.perf_counter()
        for _ in range(steps):
            self.step()
        return (time.perf_counter() - began) / steps

    def work(self, cycles: int) -> dict:
        """What each rank computes in a step, least of `cycles` from sort to sort: a row per rank of
        seconds of processor time in WORK, particles, blocks, node blocks that others add to,
        bytes sent, neighbours."""
        self.restart()
        self.cycle()
        simulation, found = self.simulation, []
        for _ in range(cycles):
            clock = simulation.clock = own.Stages(time.thread_time)
            sent, steps = simulation.sent, self.cycle()
            found.append([clock.spent.get(stage, 0.0) / steps for stage in WORK])
            sent = (simulation.sent - sent) / steps
        simulation.clock = None
        held, tables = simulation.groups, simulation.tables
        waits = int(np.repeat(tables.waits, np.diff(tables.first)).sum())
        least = min(found, key=sum)
        row = [*least, sum(map(len, held)), sum(len(g.start) for g in held), waits, sent]
        row.append(len(simulation.halo.sends))
        return {"rows": self.ranks.all_rows(np.array([row], np.float64)).tolist()}

"""Processor time on the longest path of a step, on ranks and threads; run by core_use.py.

    mpirun -n 2 python -m tests.benchmarks.critical_path SCENE STEPS THREADS [KEY=VALUE ...]

Of a stage the slowest rank counts, and of a call on threads the slowest thread. Waiting does not
count, so that other programs on the machine change little. A call on threads adds the least time
that an empty one takes. Rank 0 prints the seconds per step as JSON.
"""

import json
import sys
import time
from pathlib import Path

import numpy as np

from vgmpi.parallel.communicator import init_communicator
from vgmpi.scene.loader import load
from vgmpi.solver.engines.kernel_caller import KernelCaller
from vgmpi.solver.run import prepared_run
from vgmpi.solver.run_options import Options

WARM_UP = 10  # steps that are not counted
IDLE = ("wait", "write")  # stages that wait for others, or that are not made here
EMPTY_CALLS = 2000


class PathClock:
    """Processor time of this rank by stage: of the main thread, and of the slowest thread."""

    def __init__(self) -> None:
        """Start the clock."""
        self.spent: dict[str, float] = {}
        self.calls, self.slowest, self.steps = 0, 0.0, -WARM_UP
        self.last = time.thread_time()

    def __call__(self, stage: str) -> None:
        """Add the time since the last call to a stage."""
        now = time.thread_time()
        self.spent[stage] = self.spent.get(stage, 0.0) + now - self.last + self.slowest
        self.slowest, self.last = 0.0, now

    def listen(self, simulation) -> None:
        """Count a step; begin anew after those that warm up."""
        self.steps += 1
        if self.steps == 0:
            self.spent, self.calls = {}, 0


def count_calls_on_threads(clock: PathClock) -> None:
    """Let all calls on threads add the time of their slowest thread to a clock."""
    original = KernelCaller.each

    def each(self, work, *arguments):
        """Call work on every thread, and note the slowest."""
        if self.pool is None:
            original(self, work, *arguments)
            return
        spent = [0.0] * self.threads

        def timed(thread, *values):
            """Call work on a thread, and note its processor time."""
            begin = time.thread_time()
            work(thread, *values)
            spent[thread] = time.thread_time() - begin

        original(self, timed, *arguments)
        clock.slowest += max(spent)
        clock.calls += 1

    KernelCaller.each = each  # type: ignore[method-assign]


def empty_call_seconds(threads: int) -> float:
    """Return the least time [s] of a call on threads that do nothing, over their own time."""
    if threads == 1:
        return 0.0
    caller, least = KernelCaller(threads), np.inf
    for _ in range(EMPTY_CALLS):
        begin, processor = time.perf_counter(), time.thread_time()
        caller.each(lambda thread: None)
        idle = time.perf_counter() - begin - (time.thread_time() - processor)
        least = min(least, idle)
    return float(least)


def main() -> None:
    """Play the steps and print the seconds per step."""
    path, steps, threads = Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
    ranks, scene = init_communicator(), load(path, sys.argv[4:])
    latency, clock = empty_call_seconds(threads), PathClock()
    options = Options(None, threads, stop_steps=WARM_UP + steps, listeners=[clock.listen])
    count_calls_on_threads(clock)
    with prepared_run(scene, ranks, options) as run:
        run.simulation.clock = clock
        run.run()
    stages = sorted(set(clock.spent) - set(IDLE))
    by_rank = ranks.gather_rows(np.array([[clock.spent[stage] for stage in stages]]))
    if by_rank is not None:
        seconds = by_rank.max(0).sum() + clock.calls * latency
        particles = run.plan.particles
        print(json.dumps({"seconds": seconds / clock.steps, "particles": particles,
                          "calls": clock.calls / clock.steps, "latency": latency}))  # fmt: skip


if __name__ == "__main__":
    main()

"""This solver as a contestant of the benchmark.

It is set up from the scene's file and stepped exactly like a run, and timed by the clock of its
stages.
"""

import os
import time
import tracemalloc
from dataclasses import replace
from pathlib import Path
from typing import cast

import numpy as np

from vgmpi.io import file_layout, initial_state
from vgmpi.parallel.communicator import SerialCommunicator, init_communicator
from vgmpi.parallel.halo_exchange import FieldMessage
from vgmpi.runtime.versions import versions
from vgmpi.scene.loader import load
from vgmpi.solver.diagnostics.conservation import conservation_rows
from vgmpi.solver.engines.cpu import Cpu
from vgmpi.solver.initial_particles import plan_for, preparation_hash, prepare
from vgmpi.solver.run import Options, begin, check

from .benchmark_case import STEPS, BenchError, to_dense

WORK = ("p2g", "halo", "grid", "g2p", "sort")  # stages that compute; the others wait
LONGEST = 200  # steps of a cycle if nothing moves far enough to be sorted


class Stages:
    """Seconds by stage; `now` is the clock that is read."""

    def __init__(self, now):
        self.now = now
        self.spent: dict[str, float] = {}
        self.last = now()

    def __call__(self, stage: str) -> None:
        """Add the time since the last call to a stage."""
        now = self.now()
        self.spent[stage] = self.spent.get(stage, 0.0) + now - self.last
        self.last = now


class Contestant:
    """One rank's share; the studies of tests/benchmarks use `empty` and `work`.

    Args:
        config: folder (scene.toml and gaussians.h5), ranks, threads.
    """

    def __init__(self, config: dict):
        self.ranks = init_communicator() if config["ranks"] > 1 else SerialCommunicator()
        self.versions = versions()
        folder = Path(config["folder"])
        scene = load(folder / "scene.toml")
        if initial_state.preparation_hash(folder / file_layout.GAUSSIANS) != preparation_hash(
            scene
        ):
            # it would be prepared anew, at rest: another scene than the others'
            raise BenchError("the program's sources changed meanwhile: measure again")
        summary = prepare(scene, self.ranks, folder)
        plan = plan_for(scene, summary)
        self.card = os.environ.get("VGMPI_BENCH_DEVICE") == "cuda"
        options = Options(folder, config["threads"], "cuda" if self.card else "cpu")
        check(options, self.ranks)
        self.start = (scene, plan, summary, self.ranks, options)
        self.dt = plan.time_step.fixed
        # one thread: its own time, so that what else the machine does counts little
        is_serial = config["threads"] == 1 and self.ranks.size == 1
        self.now = time.thread_time if is_serial else time.perf_counter
        self.launches = [0]
        if self.card:
            from vgmpi.solver.engines.cuda.graphics_card import finished_at
            from vgmpi.solver.engines.cuda.kernel_launch import LAUNCH_COUNT

            self.now, self.launches = finished_at, LAUNCH_COUNT
        self.restart()
        if self.card:  # compiles, beside the other contestants of the card
            self.step()
            del self.simulation
            self.restart()

    def restart(self, softens_spray: bool = True) -> None:
        """Begin the run again.

        Args:
            softens_spray: Whether the volume of sparse liquid responds less, as in every run.
        """
        scene, plan, summary, ranks, options = self.start
        if not softens_spray:
            groups = tuple(
                group._replace(volume=group.volume._replace(softens_spray=False))
                for group in plan.groups
            )
            plan = replace(plan, groups=groups)
        self.simulation, _ = begin(scene, plan, summary, ranks, options)

    def step(self) -> None:
        """Compute one step."""
        self.simulation.advance(self.dt, (0.0, 0.0))

    def cycle(self) -> int:
        """Steps up to and with the next sort; returns their number, the same on all ranks."""
        sorts = self.simulation.sorts
        steps = 0
        while self.simulation.sorts == sorts and steps < LONGEST:
            self.step()
            steps += 1
        return steps

    def round(self, units: int) -> dict:
        """Time `units` cycles from sort to sort.

        Each step then bears its share of a sort.
        """
        if self.simulation.step > STEPS // 2:
            del self.simulation  # its memory first
            self.restart()
        if self.simulation.step == 0:
            self.cycle()  # memory and code are warm, and the first sort is over
        self.ranks.barrier()
        clock = self.simulation.clock = None if self.card else Stages(self.now)
        began, wall, launched = self.now(), time.perf_counter(), self.launches[0]
        steps = sum(self.cycle() for _ in range(units))
        seconds, wall = self.now() - began, time.perf_counter() - wall
        launches = (self.launches[0] - launched) / steps
        if clock is None:  # the clock of stages would make the processor wait for each of them
            clock = self.simulation.clock = Stages(self.now)
            self.cycle()
        self.simulation.clock = None
        result = {"steps": steps, "seconds": seconds, "wall": wall, "stages": clock.spent}
        return result | {"launches": launches}

    def check(self, steps: int, path: str) -> dict:
        """Write ids, positions (as the rivals see them) and velocities after `steps` steps.

        The rivals do not soften spray, so this solver does not either, along the edges of the cube.
        """
        self.restart(softens_spray=False)
        for _ in range(steps):
            self.step()
        groups = self.simulation.groups
        np.savez(
            f"{path}.{self.ranks.rank}",
            id=np.concatenate([g.ids[g.index()] for g in groups]),
            x=to_dense(np.concatenate([g.positions() for g in groups])),
            v=np.concatenate([g.f[0:3, g.index()].T for g in groups]),
        )
        return {"mass": sum(entry["mass"] for entry in conservation_rows(self.simulation))}

    def halo(self, blocks: int) -> dict:
        """Seconds to make a message of whole node blocks and to add one, the least of some."""
        engine = cast(Cpu, self.simulation.engine)  # or its child for a graphics card
        engine.begin(self.dt, self.simulation.gravity, 1.0)
        chosen = np.arange(min(blocks, len(engine.tables.phase)))
        masks = np.full(len(chosen), ~np.uint64(0))
        count = 64 * len(chosen) * engine.words
        part = FieldMessage(
            "momentum", chosen, masks, np.zeros(3 * count, np.uint64), np.zeros(count, np.uint16)
        )
        seconds = {"pack": np.inf, "add": np.inf}
        for _ in range(10):
            for name in seconds:
                began = self.now()
                getattr(engine, name)(part)
                seconds[name] = min(seconds[name], self.now() - began)
        return {**seconds, "blocks": len(chosen), "bytes": part.numbers.nbytes + part.tails.nbytes}

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
            rounds = [self._step_seconds(steps) for _ in range(10)]
            tracemalloc.start()
            self._step_seconds(steps)
            before = tracemalloc.get_traced_memory()[0]
            tracemalloc.reset_peak()
            self._step_seconds(steps)
            after, peak = tracemalloc.get_traced_memory()
            tracemalloc.stop()
        finally:
            del instance["call_if_rows"]
        worst = self.ranks.max(np.array([min(rounds[1:]), after - before, peak - before]))
        return {"us": 1e6 * worst[0], "stays": worst[1] / steps, "most": worst[2]}

    def _step_seconds(self, steps: int) -> float:
        """Return the wall time of a step [s]."""
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
            clock = simulation.clock = Stages(time.thread_time)
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

"""What rank 0 tells while a run goes on, and the table at its end."""

import logging
import math
import os
import sys
import time

import numpy as np
from tqdm import tqdm

from ..output import store
from ..planning.price import duration
from .left import Left, work_of
from .run import Runner
from .step import Simulation
from .watch import drift

log = logging.getLogger("vgmpi")

SHOWN = 32  # ranks the printed profile lists
LOG_EVERY = 10.0  # [s] between log lines where there is no terminal
STAGES = ("p2g", "halo", "grid", "g2p", "wait", "sort", "write")


class Clock:
    """Wall time by stage: call with the name of the stage that has just ended."""

    def __init__(self):
        self.spent = dict.fromkeys(STAGES, 0.0)
        self.began = self.last = time.perf_counter()
        self.startup = 0.0  # [s] from the start of the program to the end of the first step

    def __call__(self, stage: str) -> None:
        now = time.perf_counter()
        self.spent[stage] += now - self.last
        self.last = now
        if stage == "g2p" and not self.startup:
            self.startup = _age()


def _age() -> float:
    """Seconds since this process was started; 0 where the system does not tell."""
    try:
        with open("/proc/self/stat") as f:
            ticks = int(f.read().rpartition(")")[2].split()[19])
    except OSError:
        return 0.0
    return time.clock_gettime(time.CLOCK_BOOTTIME) - ticks / os.sysconf("SC_CLK_TCK")


class Progress:
    """A bar with the time left on a terminal, otherwise a log line every ten seconds."""

    def __init__(self, run: Runner, quiet: bool, left: Left | None = None):
        self.run, self.end = run, float(run.times[-1])
        self.said, first = time.monotonic(), run.simulation.time
        self.left = left or Left(work_of(run.plan))
        shown = run.ranks.rank == 0 and not quiet
        self.bar = None
        if shown and sys.stderr.isatty():
            form = "{l_bar}{bar}| {n:.3f}/{total:.3f} s [{elapsed}{postfix}]"
            self.bar = tqdm(total=self.end, initial=first, bar_format=form, leave=False)
        self.logs = shown and self.bar is None

    def __call__(self, simulation: Simulation) -> None:
        if self.bar is None and not self.logs:
            return
        now = time.monotonic()
        self.left.step(now, simulation.time)
        if self.bar is not None:
            where = f"step {simulation.step}, frame {self.run.frame}"
            self.bar.set_postfix_str(f"{self._left()}{where}", refresh=False)
            self.bar.update(simulation.time - self.bar.n)
        elif now - self.said >= LOG_EVERY:
            self.said = now
            log.info(
                "%.4g of %.4g s, %sstep %d, frame %d of %d",
                simulation.time, self.end, self._left(), simulation.step, self.run.frame,
                len(self.run.times),
            )  # fmt: skip

    def _left(self) -> str:
        """The time left, once two steps are made."""
        seconds = self.left.seconds(self.end)
        return "" if math.isnan(seconds) else f"{duration(seconds)} left, "

    def close(self) -> None:
        if self.bar is not None:
            self.bar.close()


def table(run: Runner, clock: Clock) -> str:
    """Wall time by stage, particles per second, imbalance, conservation; on rank 0, else "".
    Collective.
    """
    simulation, ranks = run.simulation, run.ranks
    mine = np.array([[clock.spent[s] for s in STAGES]])
    every = ranks.all_rows(mine)
    if ranks.rank != 0:
        return ""
    wall = clock.last - clock.began
    steps = simulation.step - run.first_step
    particles = run.plan.particles
    if run.plan.flows:  # those that are there now
        particles = max(1, sum(entry["count"] for entry in run.latest))
    lines = [f"{steps:,} steps of {particles:,} particles in {wall:.1f} s on {ranks.size} rank(s)"]
    if steps and wall > 0:
        rate = steps * particles / wall
        lines[0] += f": {rate / 1e6:.2f} million particle-steps per second"
        per = 1e9 / (steps * particles) * ranks.size
        lines.append("  stage   mean over ranks   largest   ns per particle and step")
        for k, stage in enumerate(STAGES):
            mean, most = every[:, k].mean(), every[:, k].max()
            lines.append(f"  {stage:6s} {mean:12.2f} s {most:9.2f} s {mean * per:10.1f}")
        most = simulation.load.max() / (simulation.load.mean() or 1.0)  # nothing may be left
        lines.append(f"  imbalance  {most:.3f} (largest rank's predicted work over the mean)")
        sent = simulation.sent / steps / 1e3
        lines.append(f"  sorts      {simulation.sorts}, halo {sent:.0f} kB per step from rank 0")
    if run.opening and run.latest:
        lines.append(f"  conserved  {drift(run.opening, run.latest)}")
    return "\n".join(lines)


PROFILE = ("rank", "particles", "work", *STAGES, "neighbours", "sent", "moved", "startup")


def profile(run: Runner, clock: Clock) -> str:
    """What each rank did, as profile.csv in the output folder; on rank 0 also as a table, else "".
    Collective.
    """
    simulation, ranks = run.simulation, run.ranks
    steps = max(1, simulation.step - run.first_step)
    neighbours = len(simulation.halo.sends) if simulation.halo is not None else 0
    mine = [
        ranks.rank, sum(len(group) for group in simulation.groups),
        simulation.load[ranks.rank] / (simulation.load.mean() or 1.0), *clock.spent.values(),
        neighbours, simulation.sent / steps, simulation.moved, clock.startup,
    ]  # fmt: skip
    rows = ranks.root_rows(np.array([mine], np.float64))
    if rows is None or run.options.folder is None:
        return ""
    path = run.options.folder / "profile.csv"
    words = [PROFILE, *([f"{value:.6g}" for value in row] for row in rows)]
    store.replace_text(path, "".join(",".join(line) + "\n" for line in words))
    said = ["rank particles work/mean", *(f"{stage} [s]" for stage in STAGES)]
    lines = ["  ".join([*said, "neighbours  kB/step  moved"])]
    for row in rows[:SHOWN]:
        numbers = [f"{row[0]:4.0f} {row[1]:9.0f} {row[2]:9.3f}"]
        numbers += [
            f"{value:{len(name) + 4}.2f}" for name, value in zip(STAGES, row[3:], strict=False)
        ]
        numbers.append(f"{row[-4]:10.0f} {row[-3] / 1e3:8.1f} {row[-2]:6.0f}")
        lines.append("  ".join(numbers))
    if len(rows) > SHOWN:
        lines.append(f"... and {len(rows) - SHOWN} ranks more")
    lines.append(
        f"work: largest over mean {rows[:, 2].max():.3f} by static weights; start-up"
        f" {rows[:, -1].max():.2f} s to the end of the first step; all rows: {path}"
    )
    return "\n".join(lines)

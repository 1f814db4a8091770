"""Progress bar during a run, and the timing table and rank profile at its end."""

import contextlib
import logging
import math
import os
import sys
import time
from collections.abc import Iterator

import numpy as np
from tqdm import tqdm

from vgmpi.io import hdf5_writer
from vgmpi.runtime.message_text import format_duration
from vgmpi.solver.run import Runner
from vgmpi.solver.simulation import Simulation

from .conservation import format_drift
from .eta import RemainingTimeEstimator, work_of
from .liquid_fill import changed_volume_lines

log = logging.getLogger("vgmpi")

MAX_PRINTED_RANKS = 32  # largest number of ranks in the printed profile
MAX_WAIT_SHARE = 0.5  # [-] of the time, above which a line tells how long ranks waited
LOG_EVERY = 10.0  # [s] between log lines where there is no terminal
STAGES = ("p2g", "halo", "grid", "g2p", "wait", "sort", "write")
WORK_STAGES = ("p2g", "grid", "g2p")  # stages of which a rank does no more than its part


class Clock:
    """Time by stage: call it with the name of the stage that has just ended."""

    def __init__(self):
        """Start the clock."""
        self.spent = dict.fromkeys(STAGES, 0.0)
        self.began = self.last = time.perf_counter()
        self.work, self.last_cpu = 0.0, time.process_time()  # [s] processor time of WORK_STAGES
        # [s] wall and processor time from the program's start to the end of the first step
        self.startup = self.startup_cpu = 0.0

    def __call__(self, stage: str) -> None:
        """Add the time since the last call to a stage."""
        now = time.perf_counter()
        self.spent[stage] += now - self.last
        self.last = now
        cpu = time.process_time()
        if stage in WORK_STAGES:
            self.work += cpu - self.last_cpu
        self.last_cpu = cpu
        if stage == "g2p" and not self.startup:
            self.startup, self.startup_cpu = _process_age(), cpu


def _process_age() -> float:
    """Return the seconds since this process started; 0 if the system does not say."""
    try:
        with open("/proc/self/stat") as f:
            ticks = int(f.read().rpartition(")")[2].split()[19])
    except OSError:
        return 0.0
    return time.clock_gettime(time.CLOCK_BOOTTIME) - ticks / os.sysconf("SC_CLK_TCK")


class Progress:
    """Progress bar with the remaining time on a terminal, else a log line every ten seconds."""

    def __init__(
        self, run: Runner, quiet: bool, left: RemainingTimeEstimator | None = None,
        bar: bool = False,
    ):  # fmt: skip
        """Open the bar.

        Args:
            run: The run.
            quiet: Whether nothing is shown.
            left: Estimator of the remaining time; by default one that takes the work from the plan.
            bar: Whether there is a bar even without a terminal.
        """
        self.run, self.end = run, float(run.times[-1])
        self.last_log, first = time.monotonic(), run.simulation.time
        self.estimator = left or RemainingTimeEstimator(work_of(run.plan))
        visible = run.ranks.rank == 0 and not quiet
        self.bar = None
        if visible and (bar or sys.stderr.isatty()):
            bar_format = "{l_bar}{bar}| {n:.3f}/{total:.3f} s [{elapsed}{postfix}]"
            self.bar = tqdm(total=self.end, initial=first, bar_format=bar_format, leave=False)
        self.logs = visible and self.bar is None

    def __call__(self, simulation: Simulation) -> None:
        """Show the progress after a step."""
        if self.bar is None and not self.logs:
            return
        now = time.monotonic()
        self.estimator.step(now, simulation.time)
        if self.bar is not None:
            where = f"step {simulation.step}, frame {self.run.frame}"
            self.bar.set_postfix_str(f"{self._remaining()}{where}", refresh=False)
            with contextlib.suppress(OSError):  # a terminal that was closed; SIGHUP stops the run
                self.bar.update(simulation.time - self.bar.n)
        elif now - self.last_log >= LOG_EVERY:
            self.last_log = now
            log.info(
                "%.4g of %.4g s, %sstep %d, frame %d of %d",
                simulation.time, self.end, self._remaining(), simulation.step, self.run.frame,
                len(self.run.times),
            )  # fmt: skip

    def _remaining(self) -> str:
        """Return the remaining time as text; empty before the second step."""
        seconds = self.estimator.eta(self.end)
        return "" if math.isnan(seconds) else f"{format_duration(seconds)} left, "

    def close(self) -> None:
        """Close the bar."""
        if self.bar is not None:
            self.bar.close()


def is_interactive() -> bool:
    """Return whether somebody watches: a terminal, or a notebook."""
    return sys.stderr.isatty() or "ipykernel" in sys.modules


@contextlib.contextmanager
def shown_progress(run: Runner, visible: bool) -> Iterator[None]:
    """Show a bar while a run steps, if it is to be visible."""
    if not visible:
        yield
        return
    progress = Progress(run, quiet=False, bar=True)
    run.options.listeners.append(progress)
    try:
        yield
    finally:
        progress.close()


def timing_table(run: Runner, clock: Clock) -> str:
    """Return the timing table of the run, on rank 0, else "". Collective.

    It shows wall time by stage, particle-steps per second, load imbalance and conservation.
    """
    simulation, ranks = run.simulation, run.ranks
    local = np.array([[clock.spent[s] for s in STAGES]])
    by_rank = ranks.all_rows(local)
    if ranks.rank != 0:
        return ""
    wall = clock.last - clock.began
    steps = simulation.step - run.first_step
    particles, unit, units = run.plan.particles, "particle", "particles"
    if not particles:
        counted = [feature.counted for feature in run.plan.features if feature.counted[0]]
        particles, unit, units = counted[0] if counted else (particles, unit, units)
    if run.plan.changes_mass:  # the particles present now
        particles = max(1, sum(entry["particles"] for entry in run.latest_conservation))
    lines = [f"{steps:,} steps of {particles:,} {units} in {wall:.1f} s on {ranks.size} rank(s)"]
    if steps and wall > 0:
        rate = steps * particles / wall
        lines[0] += f": {rate / 1e6:.2f} million {unit}-steps per second"
        per = 1e9 / (steps * particles) * ranks.size
        lines.append(f"  stage   mean over ranks   largest   ns per {unit} and step")
        for k, stage in enumerate(STAGES):
            mean, maximum = by_rank[:, k].mean(), by_rank[:, k].max()
            lines.append(f"  {stage:6s} {mean:12.2f} s {maximum:9.2f} s {mean * per:10.1f}")
        maximum = simulation.load.max() / (
            simulation.load.mean() or 1.0
        )  # perhaps no particle is left
        waited = by_rank[:, STAGES.index("wait")].sum() / max(by_rank.sum(), 1e-300)
        if ranks.size > 1 and waited > MAX_WAIT_SHARE:
            lines.append(
                f"  waiting    ranks waited {100 * waited:.0f} % of the time for each other: other"
                " programs use the cores, or there are more ranks than cores or work"
            )
        lines.append(f"  imbalance  {maximum:.3f} (largest rank's predicted work over the mean)")
        sent = simulation.exchange.bytes_sent / steps / 1e3
        lines.append(f"  sorts      {simulation.sorts}, halo {sent:.0f} kB per step from rank 0")
    if run.initial_conservation and run.latest_conservation:
        lines.append(
            f"  conserved  {format_drift(run.initial_conservation, run.latest_conservation)}"
        )
        lines += changed_volume_lines(run.latest_conservation)
    return "\n".join(lines)


PROFILE = (
    "rank",
    "particles",
    "work",
    *STAGES,
    "neighbours",
    "sent",
    "moved",
    "startup",
    "startup_cpu",
)


def rank_profile(run: Runner, clock: Clock) -> str:
    """Write profile.csv, which says what each rank did, to the output folder. Collective.

    Returns:
        The same numbers as a table, on rank 0, else "".
    """
    simulation, ranks = run.simulation, run.ranks
    steps = max(1, simulation.step - run.first_step)
    neighbours = len(simulation.exchange.halo.sends) if simulation.exchange.halo is not None else 0
    local = [
        ranks.rank, sum(len(group) for group in simulation.groups),
        simulation.load[ranks.rank] / (simulation.load.mean() or 1.0), *clock.spent.values(),
        neighbours, simulation.exchange.bytes_sent / steps, simulation.moved, clock.startup,
        clock.startup_cpu,
    ]  # fmt: skip
    rows = ranks.gather_rows(np.array([local], np.float64))
    if rows is None or run.options.folder is None:
        return ""
    path = run.options.folder / "profile.csv"
    words = [PROFILE, *([f"{value:.6g}" for value in row] for row in rows)]
    hdf5_writer.replace_text(path, "".join(",".join(line) + "\n" for line in words))
    titles = ["rank particles work/mean", *(f"{stage} [s]" for stage in STAGES)]
    lines = ["  ".join([*titles, "neighbours  kB/step  moved"])]
    for row in rows[:MAX_PRINTED_RANKS]:
        numbers = [f"{row[0]:4.0f} {row[1]:9.0f} {row[2]:9.3f}"]
        numbers += [
            f"{value:{len(name) + 4}.2f}" for name, value in zip(STAGES, row[3:], strict=False)
        ]
        numbers.append(f"{row[-5]:10.0f} {row[-4] / 1e3:8.1f} {row[-3]:6.0f}")
        lines.append("  ".join(numbers))
    if len(rows) > MAX_PRINTED_RANKS:
        lines.append(f"... and {len(rows) - MAX_PRINTED_RANKS} ranks more")
    lines.append(
        f"work: largest over mean {rows[:, 2].max():.3f} by static weights; start-up"
        f" {rows[:, -1].max():.2f} s to the end of the first step; all rows: {path}"
    )
    return "\n".join(lines)

"""Scenes at the extremes, a row each: what must happen, what happened.

No row may lose a particle or mass, nor, where nothing pushes on it, momentum; none may hang.
"""

import logging
import time
from dataclasses import dataclass

import numpy as np

from tests.benchmarks.limit_scenes import Row, rows
from vgmpi.api import Run, load, simulate
from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.runtime.config.schema import SceneError

MOMENTUM = 1e-12  # allowed change, of the largest sum m |v| of the run
SECONDS = 60.0  # of one row; more is taken for a hang
OUTCOMES = {0: "ran", 2: "refused", 3: "exit 3"}


class TimeLimitExceeded(RuntimeError):
    """A run that goes on for too long."""


@dataclass
class CaseResult:
    """Result of one row."""

    row: Row
    summary: str  # in a line
    steps: int
    seconds: float
    drift: float  # of momentum, NaN where it is not asked
    good: bool


class _Heard(logging.Handler):
    """Keeps what the solver logs."""

    def __init__(self):
        super().__init__()
        self.lines: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        """Record one message."""
        self.lines.append(record.getMessage())


class _Watch:
    """Follows a run: its first arrays, its momentum, its length."""

    def __init__(self, row: Row):
        self.row, self.began = row, time.perf_counter()
        self.first: dict = {}
        self.start = np.zeros(3)
        self.scale, self.drift, self.steps = 0.0, 0.0, 0

    def frame(self, this: Run) -> None:
        """Record the first arrays and compare the momentum."""
        if not self.first:
            self.first = this.arrays("positions", "velocity", "vol0", "object", "id")
            self.first["bound"] = this.simulation.bound()
            self.start = self._momentum(this)
            self.began = time.perf_counter()  # kernels have been compiled
        self._compare(this)

    def step(self, this: Run) -> None:
        """Compare the momentum and stop a run that hangs."""
        self.steps = this.step
        if this.step % 20 == 0:
            self._compare(this)
        if this.step > self.row.steps or time.perf_counter() - self.began > SECONDS:
            raise TimeLimitExceeded

    def _momentum(self, this: Run) -> np.ndarray:
        arrays = this.arrays("velocity", "vol0", "object")
        plan = this.simulation.plan
        density = np.array([plan.groups[g].density if g >= 0 else 0.0 for g in plan.group_of])
        p = (density[arrays["object"]] * arrays["vol0"])[:, None] * arrays["velocity"]
        self.scale = max(self.scale, float(np.sqrt((p**2).sum(1)).sum()))
        return p.sum(0)

    def _compare(self, this: Run) -> None:
        if self.row.momentum:
            change = np.abs(self._momentum(this) - self.start).max()
            self.drift = max(self.drift, change / (self.scale or 1.0))

    def is_conserved(self, this: Run) -> bool:
        """Return whether every particle is present with the bits of its volume."""
        now = this.arrays("vol0", "object", "id")
        return all(np.array_equal(now[name], self.first[name]) for name in now)


def run_case(row: Row) -> CaseResult:
    """Run a row's scene in this process, without files."""
    log_lines, log = _Heard(), logging.getLogger("vgmpi")
    level, through = log.level, log.propagate
    log.addHandler(log_lines)
    log.setLevel(logging.INFO)
    log.propagate = False  # what a row is expected to say is no news
    watch = _Watch(row)
    try:
        summary, good = _outcome(row, watch, log_lines)
    finally:
        log.removeHandler(log_lines)
        log.setLevel(level)
        log.propagate = through
    drift = watch.drift if row.momentum else np.nan
    if row.momentum and not drift <= MOMENTUM:
        summary, good = f"momentum changed by {drift:.1e}; {summary}", False
    return CaseResult(row, summary, watch.steps, time.perf_counter() - watch.began, drift, good)


def _outcome(row: Row, watch: _Watch, log_lines: _Heard) -> tuple[str, bool]:
    code, details, good = 0, [], True
    try:
        scene = load("scene.toml", text=row.text)
        with simulate(scene, ranks=SerialCommunicator()) as this:
            watch.frame(this)
            for _ in this:
                watch.step(this)
                if this.is_at_frame:
                    watch.frame(this)
        code = this.code or 0
    except SceneError as error:
        code, log_lines.lines = 2, error.lines
    except TimeLimitExceeded:
        return f"hangs: {watch.steps} steps", False
    if code != 2 and not watch.is_conserved(this):
        return "lost particles or mass", False
    if code == 0 and row.check is not None:
        good, detail = row.check(this, watch.first)
        details.append(detail)
    if code != row.code:
        details += log_lines.lines[-1:]
    missing = [word for word in row.says if word not in "\n".join(log_lines.lines)]
    if missing:
        details.append(f"does not say {', '.join(missing)}")
    elif row.says:
        details.append(next(line for line in log_lines.lines if row.says[-1] in line))
    good = good and code == row.code and not missing
    return "; ".join([OUTCOMES.get(code, f"exit {code}"), *details]), good


def chosen(words: list[str], fast: bool) -> list[Row]:
    """Rows with one of the words in their name; all without words. fast: the quick ones only."""
    selected = [row for row in rows() if row.fast or not fast]
    return [row for row in selected if not words or any(word in row.name for word in words)]


HEAD = f"{'scene':33s} {'expected':25s} {'steps':>6s} {'seconds':>8s} {'momentum':>9s}        found"


def line(result: CaseResult) -> str:
    """A row of the table."""
    drift = "" if np.isnan(result.drift) else f"{result.drift:.0e}"
    good = "pass" if result.good else "FAIL"
    return (
        f"{result.row.name:33s} {result.row.expected:25s} {result.steps:6d} {result.seconds:8.2f}"
        f" {drift:>9s}  {good}  {result.summary}"
    )

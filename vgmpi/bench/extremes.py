"""Scenes at the extremes, a row each: what must happen, what happened.

No row may lose a particle or mass, nor, where nothing pushes on it, momentum; none may hang.
"""

import logging
import time
from dataclasses import dataclass

import numpy as np

from ..api import Run, load, run
from ..domain.ranks import Alone
from ..tables import SceneError
from .extreme_scenes import Row, rows

MOMENTUM = 1e-12  # allowed change, of the largest sum m |v| of the run
SECONDS = 60.0  # of one row; more is taken for a hang
OUTCOMES = {0: "ran", 2: "refused", 3: "exit 3"}


class Hang(RuntimeError):
    """A run that goes on for too long."""


@dataclass
class Found:
    """What a row did."""

    row: Row
    said: str  # in a line
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
        self.lines.append(record.getMessage())


class _Watch:
    """Follows a run: its first arrays, its momentum, its length."""

    def __init__(self, row: Row):
        self.row, self.began = row, time.perf_counter()
        self.first: dict = {}
        self.start = np.zeros(3)
        self.scale, self.drift, self.steps = 0.0, 0.0, 0

    def frame(self, this: Run) -> None:
        if not self.first:
            self.first = this.arrays("x", "v", "vol0", "object", "id")
            self.first["bound"] = this.simulation.bound()
            self.start = self._momentum(this)
            self.began = time.perf_counter()  # kernels have been compiled
        self._compare(this)

    def step(self, this: Run) -> None:
        self.steps = this.step
        if this.step % 20 == 0:
            self._compare(this)
        if this.step > self.row.steps or time.perf_counter() - self.began > SECONDS:
            raise Hang

    def _momentum(self, this: Run) -> np.ndarray:
        found = this.arrays("v", "vol0", "object")
        plan = this.simulation.plan
        density = np.array([plan.groups[g].density if g >= 0 else 0.0 for g in plan.group_of])
        p = (density[found["object"]] * found["vol0"])[:, None] * found["v"]
        self.scale = max(self.scale, float(np.sqrt((p**2).sum(1)).sum()))
        return p.sum(0)

    def _compare(self, this: Run) -> None:
        if self.row.momentum:
            change = np.abs(self._momentum(this) - self.start).max()
            self.drift = max(self.drift, change / (self.scale or 1.0))

    def kept(self, this: Run) -> bool:
        """Whether every particle is there with the bits of its volume."""
        now = this.arrays("vol0", "object", "id")
        return all(np.array_equal(now[name], self.first[name]) for name in now)


def execute(row: Row) -> Found:
    """Run a row's scene in this process, without files."""
    heard, log = _Heard(), logging.getLogger("vgmpi")
    level, through = log.level, log.propagate
    log.addHandler(heard)
    log.setLevel(logging.INFO)
    log.propagate = False  # what a row is expected to say is no news
    watch = _Watch(row)
    try:
        said, good = _outcome(row, watch, heard)
    finally:
        log.removeHandler(heard)
        log.setLevel(level)
        log.propagate = through
    drift = watch.drift if row.momentum else np.nan
    if row.momentum and not drift <= MOMENTUM:
        said, good = f"momentum changed by {drift:.1e}; {said}", False
    return Found(row, said, watch.steps, time.perf_counter() - watch.began, drift, good)


def _outcome(row: Row, watch: _Watch, heard: _Heard) -> tuple[str, bool]:
    code, details, good = 0, [], True
    try:
        scene = load("scene.toml", text=row.text)
        this = run(scene, None, watch.step, watch.frame, Alone())
        code = this.code or 0
    except SceneError as error:
        code, heard.lines = 2, error.lines
    except Hang:
        return f"hangs: {watch.steps} steps", False
    if code != 2 and not watch.kept(this):
        return "lost particles or mass", False
    if code == 0 and row.check is not None:
        good, said = row.check(this, watch.first)
        details.append(said)
    if code != row.code:
        details += heard.lines[-1:]
    missing = [word for word in row.says if word not in "\n".join(heard.lines)]
    if missing:
        details.append(f"does not say {', '.join(missing)}")
    elif row.says:
        details.append(next(line for line in heard.lines if row.says[-1] in line))
    good = good and code == row.code and not missing
    return "; ".join([OUTCOMES.get(code, f"exit {code}"), *details]), good


def chosen(words: list[str], fast: bool) -> list[Row]:
    """Rows with one of the words in their name; all without words. fast: the quick ones only."""
    found = [row for row in rows() if row.fast or not fast]
    return [row for row in found if not words or any(word in row.name for word in words)]


HEAD = f"{'scene':33s} {'expected':25s} {'steps':>6s} {'seconds':>8s} {'momentum':>9s}        found"


def line(found: Found) -> str:
    """A row of the table."""
    drift = "" if np.isnan(found.drift) else f"{found.drift:.0e}"
    good = "pass" if found.good else "FAIL"
    return (
        f"{found.row.name:33s} {found.row.expected:25s} {found.steps:6d} {found.seconds:8.2f}"
        f" {drift:>9s}  {good}  {found.said}"
    )

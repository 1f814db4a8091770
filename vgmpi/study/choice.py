"""What a study found, put into numbers between its runs: which setting does what for how much."""

from dataclasses import dataclass

import numpy as np

from ..scene.scene import Scene
from .knobs import PLAIN, Setting, grid

SLACK = 1.05  # an error this near to the wanted one is taken for it


@dataclass(frozen=True)
class Measured:
    """A run, or what is expected of one: processor time [s]; error (share); number of cells along
    the longest edge."""

    setting: Setting
    cpu: float
    error: float
    cells: int


def best(found: list[Measured]) -> list[Measured]:
    """Those which no other beats in both, from cheap to dear."""
    kept: list[Measured] = []
    for one in sorted(found, key=lambda m: (m.cpu, m.error)):
        if not kept or one.error < kept[-1].error:
            kept.append(one)
    return kept


def _along(known: dict[int, float], at: int) -> float:
    """Between runs of other cells, from few to many, on logarithmic scales; beyond them as the last
    two go. 0 where there are none."""
    if not known:
        return 0.0
    x, y = np.log(list(known)), np.log(np.maximum(list(known.values()), 1e-12))
    if len(x) == 1:
        return float(np.exp(y[0]))
    k = int(np.clip(np.searchsorted(x, np.log(at)) - 1, 0, len(x) - 2))
    slope = (y[k + 1] - y[k]) / (x[k + 1] - x[k])
    return float(np.exp(y[k] + slope * (np.log(at) - x[k])))


@dataclass(frozen=True)
class Turned:
    """A knob turned. factor: of the time, and more: what it adds to the square of the error, at the
    scene's own cells; off: by what times both are off that at cells that were run with it."""

    setting: Setting
    factor: float
    more: float
    off: dict[int, tuple[float, float]]

    def at(self, cells: int) -> tuple[float, float]:
        """How far off both are there: between those that were run on logarithmic scales, and beyond
        as at the nearest."""
        x = np.log(sorted(self.off))
        y = np.log([self.off[n] for n in sorted(self.off)])
        cpu, error = (np.exp(np.interp(np.log(cells), x, y[:, k])) for k in (0, 1))
        return float(cpu), float(error)


class Model:
    """Time and error of settings that were not run: of cells between those that were, with other
    knobs turned as they were turned at the scene's own cells, where they are told by a factor of
    the time and by an error of their own, which adds to the square. What was run is known."""

    def __init__(self, scene: Scene, found: list[Measured], counts: list[int]):
        self.scene, self.found = scene, {m.setting: m for m in found}
        own = max(scene.domain.cells)
        plain = {m.cells: m for m in found if m.setting.of_grid}
        self.cpu = {n: plain[n].cpu for n in sorted(plain)}
        # the finest is what the others are held to: its error is not known
        self.held = {m.cells for m in found if m.error == 0} if len(plain) > 1 else set()
        self.error = {n: plain[n].error for n in sorted(plain) if n not in self.held}
        self.counts = sorted({*counts, *plain})
        base = plain[own]
        self.turned = [Turned(PLAIN, 1.0, 0.0, {own: (1.0, 1.0)})]
        for m in found:
            if not m.setting.of_grid and m.cells == own:
                more = max(m.error**2 - base.error**2, 0.0) ** 0.5
                self.turned.append(Turned(m.setting, m.cpu / base.cpu, more, {own: (1.0, 1.0)}))
        for turned in self.turned[1:]:
            self._learn(turned)

    def _learn(self, turned: Turned) -> None:
        """How far off it is at cells other than the scene's own that were run with it."""
        for n in self.counts:
            m = self.found.get(grid(self.scene, n).and_then(turned.setting))
            if m and n not in turned.off and n not in self.held:
                cpu, error = self.of(n, turned)
                turned.off[n] = m.cpu / cpu, max(m.error, 1e-12) / max(error, 1e-12)

    def of(self, count: int, turned: Turned) -> tuple[float, float]:
        """Time [s] and error with that many cells."""
        cpu, error = turned.at(count)
        plain = (_along(self.error, count) ** 2 + turned.more**2) ** 0.5
        return turned.factor * cpu * _along(self.cpu, count), error * plain

    def choices(self) -> list[Measured]:
        """Every number of cells with every knob."""
        found = []
        for count in self.counts:
            for turned in self.turned:
                setting = grid(self.scene, count).and_then(turned.setting)
                known = None if count in self.held else self.found.get(setting)
                found.append(known or Measured(setting, *self.of(count, turned), count))
        return found

    def within(self, error: float | None, cpu: float | None, run: bool = False) -> Measured | None:
        """The cheapest that is off by no more than `error`, or the best where none is given, of
        those that take no longer than `cpu` [s]. run: of those that were run."""
        there = [m for m in self.choices() if not run or m.setting in self.found]
        there = [m for m in there if cpu is None or m.cpu <= SLACK * cpu]
        if error is None:
            return min(there, key=lambda m: (m.error, m.cpu), default=None)
        good = [m for m in there if m.error <= SLACK * error]
        return min(good, key=lambda m: m.cpu, default=None)

"""What a study found, put into numbers between its runs: which setting does what for how much."""

from dataclasses import dataclass

import numpy as np

from ..scene.scene import Scene
from .knobs import PLAIN, Setting, of_cells

SLACK = 1.05  # an error this near to the wanted one is taken for it


@dataclass(frozen=True)
class Measured:
    """A run: processor time [s]; error (share); number of cells along the longest edge."""

    setting: Setting
    cpu: float
    error: float
    cells: int


@dataclass(frozen=True)
class Choice:
    """A setting, and what it is expected to take [s] and to be off."""

    setting: Setting
    cpu: float
    error: float


def best(found: list[Measured]) -> list[Measured]:
    """Those which no other beats in both, from cheap to dear."""
    kept: list[Measured] = []
    for one in sorted(found, key=lambda m: (m.cpu, m.error)):
        if not kept or one.error < kept[-1].error:
            kept.append(one)
    return kept


def _along(cells: list[int], values: list[float], at: int) -> float:
    """Between runs of other cells, on logarithmic scales; beyond them as the last two go. 0 where
    there are none."""
    if not cells:
        return 0.0
    x, y = np.log(cells), np.log(np.maximum(values, 1e-12))
    if len(x) == 1:
        return float(np.exp(y[0]))
    k = int(np.clip(np.searchsorted(x, np.log(at)) - 1, 0, len(x) - 2))
    slope = (y[k + 1] - y[k]) / (x[k + 1] - x[k])
    return float(np.exp(y[k] + slope * (np.log(at) - x[k])))


class Model:
    """Time and error of settings that were not run: of cells between those that were, with other
    knobs turned as they were turned at the scene's own cells, where they are told by a factor of
    the time and by an error of their own, which adds to the square."""

    def __init__(self, scene: Scene, found: list[Measured], counts: list[int]):
        self.scene, self.counts = scene, counts
        own = max(scene.domain.cells)
        plain = {m.cells: m for m in found if set(dict(m.setting.knobs)) <= {"cells"}}
        # the finest is what the others are held to: its error is not known
        self.grids = sorted(n for n in plain if plain[n].error > 0)
        self.cpu = [plain[n].cpu for n in sorted(plain)]
        self.all = sorted(plain)
        self.error = [plain[n].error for n in self.grids]
        base = plain[own]
        self.turned = [(PLAIN, 1.0, 0.0)]
        for m in found:
            if m.setting.knobs and "cells" not in dict(m.setting.knobs):
                more = max(m.error**2 - base.error**2, 0.0) ** 0.5
                self.turned.append((m.setting, m.cpu / base.cpu, more))

    def of(self, count: int, factor: float, more: float) -> tuple[float, float]:
        """Time [s] and error with that many cells."""
        cpu = factor * _along(self.all, self.cpu, count)
        return cpu, (_along(self.grids, self.error, count) ** 2 + more**2) ** 0.5

    def choices(self) -> list[Choice]:
        """Every number of cells with every knob."""
        own, out = max(self.scene.domain.cells), []
        for count in self.counts:
            grid = PLAIN if count == own else of_cells(self.scene, count)
            for setting, factor, more in self.turned:
                out.append(Choice(grid.and_then(setting), *self.of(count, factor, more)))
        return out

    def within_error(self, error: float) -> Choice | None:
        """The cheapest that is not off by more."""
        there = [c for c in self.choices() if c.error <= SLACK * error]
        return min(there, key=lambda c: c.cpu) if there else None

    def within_budget(self, cpu: float) -> Choice | None:
        """The best that takes no longer [s]."""
        there = [c for c in self.choices() if c.cpu <= cpu]
        return min(there, key=lambda c: (c.error, c.cpu)) if there else None

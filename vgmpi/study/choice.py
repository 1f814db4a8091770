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


class Model:
    """Time and error of settings that were not run: of cells between those that were, with other
    knobs turned as they were turned at the scene's own cells, where they are told by a factor of
    the time and by an error of their own, which adds to the square."""

    def __init__(self, scene: Scene, found: list[Measured], counts: list[int]):
        self.scene, self.counts = scene, counts
        own = max(scene.domain.cells)
        plain = {m.cells: m for m in found if m.setting.of_grid}
        self.cpu = {n: plain[n].cpu for n in sorted(plain)}
        # the finest is what the others are held to: its error is not known
        held = {m.cells for m in found if m.error == 0} if len(plain) > 1 else set()
        self.error = {n: plain[n].error for n in sorted(plain) if n not in held}
        base = plain[own]
        self.turned = [(PLAIN, 1.0, 0.0)]
        for m in found:
            if not m.setting.of_grid and m.cells == own:
                more = max(m.error**2 - base.error**2, 0.0) ** 0.5
                self.turned.append((m.setting, m.cpu / base.cpu, more))

    def of(self, count: int, factor: float, more: float) -> tuple[float, float]:
        """Time [s] and error with that many cells."""
        return factor * _along(self.cpu, count), (_along(self.error, count) ** 2 + more**2) ** 0.5

    def choices(self) -> list[Measured]:
        """Every number of cells with every knob."""
        return [
            Measured(
                grid(self.scene, count).and_then(setting), *self.of(count, factor, more), count
            )
            for count in self.counts
            for setting, factor, more in self.turned
        ]

    def within_error(self, error: float) -> Measured | None:
        """The cheapest that is not off by more."""
        there = [c for c in self.choices() if c.error <= SLACK * error]
        return min(there, key=lambda c: c.cpu) if there else None

    def within_budget(self, cpu: float) -> Measured | None:
        """The best that takes no longer [s]."""
        there = [c for c in self.choices() if c.cpu <= cpu]
        return min(there, key=lambda c: (c.error, c.cpu)) if there else None

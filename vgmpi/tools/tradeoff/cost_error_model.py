"""Cost and error of settings between the runs of a study, and the choice among them."""

from dataclasses import dataclass

import numpy as np

from vgmpi.scene.scene import Scene

from .parameter_sweep import BASELINE, Setting, grid

SLACK = 1.05  # [-] errors and costs up to this factor above the limit count as within it


@dataclass(frozen=True)
class CostError:
    """Cost and error of a run, or their prediction."""

    setting: Setting
    cpu: float  # [s] processor time
    error: float  # [-] relative error
    cells: int  # along the longest edge


def pareto_front(results: list[CostError]) -> list[CostError]:
    """Return the Pareto front, from cheap to expensive."""
    front: list[CostError] = []
    for result in sorted(results, key=lambda m: (m.cpu, m.error)):
        if not front or result.error < front[-1].error:
            front.append(result)
    return front


def _interpolate(samples: dict[int, float], cells: int) -> float:
    """Interpolate between runs of other cell counts on logarithmic scales.

    Beyond them the last two are extrapolated. samples: values by cell count, ascending; 0 if there
    are none.
    """
    if not samples:
        return 0.0
    x, y = np.log(list(samples)), np.log(np.maximum(list(samples.values()), 1e-12))
    if len(x) == 1:
        return float(np.exp(y[0]))
    k = int(np.clip(np.searchsorted(x, np.log(cells)) - 1, 0, len(x) - 2))
    slope = (y[k + 1] - y[k]) / (x[k + 1] - x[k])
    return float(np.exp(y[k] + slope * (np.log(cells) - x[k])))


@dataclass(frozen=True)
class SettingEffect:
    """Effect of one changed parameter on cost and error.

    Both are known at the scene's own cells; `corrections` holds measured over predicted cost and
    error at other cells that were run with it.
    """

    setting: Setting
    factor: float  # [-] of the cost
    added_error: float  # [-] error that adds to the error of the cells in quadrature
    corrections: dict[int, tuple[float, float]]  # cells -> corrections of cost and error

    def corrections_at(self, cells: int) -> tuple[float, float]:
        """Return the corrections of cost and error at a cell count.

        They are interpolated on logarithmic scales, and constant beyond the runs.
        """
        x = np.log(sorted(self.corrections))
        y = np.log([self.corrections[n] for n in sorted(self.corrections)])
        cpu, error = (np.exp(np.interp(np.log(cells), x, y[:, k])) for k in (0, 1))
        return float(cpu), float(error)


class CostErrorModel:
    """Model of cost and error of settings that were not run.

    Cell counts are interpolated between runs. Other parameters act as at the scene's own cells: by
    a factor on the cost and by an error of their own that adds in quadrature. Runs keep their
    measured values.
    """

    def __init__(self, scene: Scene, results: list[CostError], counts: list[int]):
        self.scene, self.results = scene, {m.setting: m for m in results}
        own_cells = max(scene.domain.cells)
        plain = {m.cells: m for m in results if m.setting.of_grid}
        self.cpu = {n: plain[n].cpu for n in sorted(plain)}
        # the finest run is the reference of the others: its error is unknown
        self.references = {m.cells for m in results if m.error == 0} if len(plain) > 1 else set()
        self.error = {n: plain[n].error for n in sorted(plain) if n not in self.references}
        self.counts = sorted({*counts, *plain})
        base = plain[own_cells]
        self.turned = [SettingEffect(BASELINE, 1.0, 0.0, {own_cells: (1.0, 1.0)})]
        for m in results:
            if not m.setting.of_grid and m.cells == own_cells:
                added_error = max(m.error**2 - base.error**2, 0.0) ** 0.5
                self.turned.append(
                    SettingEffect(m.setting, m.cpu / base.cpu, added_error, {own_cells: (1.0, 1.0)})
                )
        for turned in self.turned[1:]:
            self._learn(turned)

    def _learn(self, effect: SettingEffect) -> None:
        """Set the corrections of an effect at other cells that were run with it."""
        for n in self.counts:
            m = self.results.get(grid(self.scene, n).and_then(effect.setting))
            if m and n not in effect.corrections and n not in self.references:
                cpu, error = self.predict(n, effect)
                effect.corrections[n] = m.cpu / cpu, max(m.error, 1e-12) / max(error, 1e-12)

    def predict(self, count: int, effect: SettingEffect) -> tuple[float, float]:
        """Return cost [s] and error of an effect at a cell count."""
        cpu, error = effect.corrections_at(count)
        plain = (_interpolate(self.error, count) ** 2 + effect.added_error**2) ** 0.5
        return effect.factor * cpu * _interpolate(self.cpu, count), error * plain

    def choices(self) -> list[CostError]:
        """Return all combinations of cell counts and parameters."""
        results = []
        for count in self.counts:
            for effect in self.turned:
                setting = grid(self.scene, count).and_then(effect.setting)
                result = None if count in self.references else self.results.get(setting)
                results.append(result or CostError(setting, *self.predict(count, effect), count))
        return results

    def within(self, error: float | None, cpu: float | None, run: bool = False) -> CostError | None:
        """Return the cheapest setting within an error, or the most accurate within a cost.

        Args:
            error: Upper limit of the error, or None to look for the smallest error.
            cpu: Upper limit of the cost [s], or None.
            run: Whether only settings that were run are considered.

        Returns:
            The setting, or None if there is none.
        """
        candidates = [m for m in self.choices() if not run or m.setting in self.results]
        candidates = [m for m in candidates if cpu is None or m.cpu <= SLACK * cpu]
        if error is None:
            return min(candidates, key=lambda m: (m.error, m.cpu), default=None)
        accurate = [m for m in candidates if m.error <= SLACK * error]
        return min(accurate, key=lambda m: m.cpu, default=None)

"""The runs that a search has asked for so far, in its order, and how far each is off."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..study.knobs import Setting
from ..study.runs import StudyError
from .axes import Axis, setting
from .runs import Done, Runs
from .target import Target


class Spent(RuntimeError):
    """There are no runs left."""


@dataclass(frozen=True)
class Trial:
    """A run: its number from 1, what for, where it lies (parameters,), and how far it is off what
    is fitted and what is held out, nan where it blew up, was not looked at or nothing is held
    out."""

    number: int
    what: str
    u: tuple[float, ...]
    values: tuple[float, ...]
    setting: Setting
    done: Done
    loss: float
    held: float


class Trials:
    """most: runs that may be asked for, of which `kept` are for what comes after the search."""

    def __init__(
        self, runs: Runs, axes: list[Axis], target: Target, most: int,
        heard: Callable[[Trial], None] = lambda trial: None,
    ):  # fmt: skip
        self.runs, self.axes, self.target, self.most = runs, axes, target, most
        self.heard, self.kept, self.what = heard, 0, ""
        self.all: dict[Setting, Trial] = {}
        self._off: dict[tuple[Setting, int], tuple[np.ndarray, np.ndarray]] = {}

    def ask(
        self, points: list[np.ndarray], beside: Setting | None = None, look: bool = True
    ) -> list[Trial]:
        """The runs at points (parameters,) of 0 .. 1; beside: what each sets as well; look: whether
        to tell how far they are off. Raises Spent before any of them, and StudyError."""
        wanted = [setting(self.axes, u) for u in points]
        wanted = [one.and_then(beside) if beside else one for one in wanted]
        new = [one for one in dict.fromkeys(wanted) if one not in self.all]
        if len(self.all) + len(new) > self.most - self.kept:
            raise Spent
        at = dict(zip(wanted, points))
        for one, done in zip(new, self.runs.all(new), strict=True):  # told as they come
            self._note(one, at[one], done, look)
        return [self._seen(one) if look else self.all[one] for one in wanted]

    def _seen(self, one: Setting) -> Trial:
        """The run of a setting, looked at now if it was not before."""
        trial = self.all[one]
        if trial.done.whole and np.isnan(trial.loss):
            loss, held = self._losses(one, trial.done)
            self.all[one] = replace(trial, loss=loss, held=held)
        return self.all[one]

    def _losses(self, one: Setting, done: Done) -> tuple[float, float]:
        fitted, out = self._read(one, done, self.target.stages - 1)
        return _rms(fitted), _rms(out)

    def _note(self, one: Setting, u: np.ndarray, done: Done, look: bool) -> None:
        loss = held = float("nan")
        if done.whole and look:
            loss, held = self._losses(one, done)
        place = tuple(float(x) for x in u)
        values = tuple(axis.value(x) for axis, x in zip(self.axes, place, strict=True))
        trial = Trial(len(self.all) + 1, self.what, place, values, one, done, loss, held)
        self.all[one] = trial
        self.heard(trial)

    def _read(self, one: Setting, done: Done, stage: int) -> tuple[np.ndarray, np.ndarray]:
        if (one, stage) not in self._off:
            self._off[one, stage] = self.target.off(done.folder, stage)
        return self._off[one, stage]

    def off(self, trial: Trial, stage: int) -> np.ndarray:
        """How far a run is off (n,), inf where it blew up."""
        if not trial.done.whole:
            return np.full((~self.target.held[stage]).sum(), np.inf)
        return self._read(trial.setting, trial.done, stage)[0]

    def loss(self, trial: Trial, stage: int) -> float:
        """Root of the mean square of that; inf where it blew up."""
        return _rms(self.off(trial, stage))

    def best(self) -> Trial:
        """The run that is least off, of those that set the parameters alone and were looked at."""
        plain = [t for t in self.all.values() if len(t.setting.knobs) == len(self.axes)]
        whole = [t for t in plain if t.done.whole and not np.isnan(t.loss)]
        if not whole:
            raise StudyError("every run blew up")
        return min(whole, key=lambda t: (t.loss, t.number))

    def slopes(self, u: np.ndarray, stage: int, share: float, both: bool = False) -> np.ndarray:
        """Differences (n, parameters) of what runs are off over steps along each parameter: of that
        share, inwards; or to both sides, of twice that. Raises StudyError, Spent."""
        steps = np.array([axis.step(share) * (2 if both else 1) for axis in self.axes])
        sign = np.where(u + steps > 1, -1.0, 1.0)
        ahead = [moved(u, k, sign[k] * steps[k]) for k in range(len(u))]
        behind = [moved(u, k, -sign[k] * steps[k]) if both else u for k in range(len(u))]
        trials = self.ask([*ahead, *behind])
        columns = []
        for k, one in enumerate(zip(trials[: len(u)], trials[len(u) :])):
            if not one[0].done.whole:  # blew up: to the other side
                (other,) = self.ask([moved(u, k, -sign[k] * steps[k])])
                one = (other, self.ask([u])[0])
            if not (one[0].done.whole and one[1].done.whole):
                raise StudyError(f"runs blow up beside {', '.join(one[1].setting.overrides)}")
            width = one[0].u[k] - one[1].u[k]
            columns.append((self.off(one[0], stage) - self.off(one[1], stage)) / width)
        return np.stack(columns, axis=1)


def moved(u: np.ndarray, k: int, by: float) -> np.ndarray:
    """A point moved along one parameter, within the range."""
    out = np.array(u, float)
    out[k] = min(max(out[k] + by, 0.0), 1.0)
    return out


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")

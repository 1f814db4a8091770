"""Evaluations of the objective that a search has requested, in their order."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from vgmpi.tools.tradeoff.parameter_sweep import Setting
from vgmpi.tools.tradeoff.study_runs import StudyError

from .parameter_space import ParameterAxis, setting
from .run_pool import CompletedRun, RunPool
from .target_base import Target


class BudgetExhausted(RuntimeError):
    """Signal that no runs are left."""


@dataclass(frozen=True)
class Evaluation:
    """Evaluation of a run.

    number counts from 1; purpose names the phase of the fit; u: position, (parameters,); values
    [SI]. loss, holdout_loss: losses of fitted and of held-out values, nan if the run blew up, was
    not compared with the target, or nothing is held out.
    """

    number: int
    purpose: str
    u: tuple[float, ...]
    values: tuple[float, ...]
    setting: Setting
    done: CompletedRun
    loss: float
    holdout_loss: float


class Evaluations:
    """Evaluations of runs, at most `max_runs`, and their residuals."""

    def __init__(
        self, runs: RunPool, axes: list[ParameterAxis], target: Target, max_runs: int,
        on_evaluation: Callable[[Evaluation], None] = lambda trial: None,
    ):  # fmt: skip
        """Start without evaluations.

        `reserved_runs` of the runs are kept back for the steps after the search.

        Args:
            runs: Pool that makes the runs.
            axes: Parameters.
            target: Target to which runs are compared.
            max_runs: Largest number of runs.
            on_evaluation: Called with each new evaluation.
        """
        self.runs, self.axes, self.target, self.max_runs = runs, axes, target, max_runs
        self.on_evaluation, self.reserved_runs, self.purpose = on_evaluation, 0, ""
        self.all: dict[Setting, Evaluation] = {}
        self._residuals: dict[tuple[Setting, int], tuple[np.ndarray, np.ndarray]] = {}

    def evaluate(
        self, points: list[np.ndarray], extra_setting: Setting | None = None, with_loss: bool = True
    ) -> list[Evaluation]:
        """Evaluate runs at points (parameters,) in [0, 1].

        Args:
            points: Points of the runs.
            extra_setting: Further setting of each run.
            with_loss: Whether to compare the runs with the target.

        Raises:
            BudgetExhausted: Before any of the runs is made, if not enough are left.
            StudyError: If a run cannot be made.
        """
        wanted = [setting(self.axes, u) for u in points]
        wanted = [
            setting_.and_then(extra_setting) if extra_setting else setting_ for setting_ in wanted
        ]
        new = [setting_ for setting_ in dict.fromkeys(wanted) if setting_ not in self.all]
        if len(self.all) + len(new) > self.max_runs - self.reserved_runs:
            raise BudgetExhausted
        point_of = dict(zip(wanted, points))
        for setting_, done in zip(
            new, self.runs.all(new), strict=True
        ):  # each is recorded as soon as it has ended
            self._record(setting_, point_of[setting_], done, with_loss)
        return [
            self._with_loss(setting_) if with_loss else self.all[setting_] for setting_ in wanted
        ]

    def _with_loss(self, setting_: Setting) -> Evaluation:
        """Return the evaluation of a setting, compared with the target now if not before."""
        trial = self.all[setting_]
        if trial.done.completed and np.isnan(trial.loss):
            loss, holdout_loss = self._losses(setting_, trial.done)
            self.all[setting_] = replace(trial, loss=loss, holdout_loss=holdout_loss)
        return self.all[setting_]

    def _losses(self, setting_: Setting, done: CompletedRun) -> tuple[float, float]:
        """Return the losses of fitted and of held-out values in the finest stage."""
        fitted, held_out = self._load_residuals(setting_, done, self.target.stages - 1)
        return _rms(fitted), _rms(held_out)

    def _record(
        self, setting_: Setting, u: np.ndarray, done: CompletedRun, with_loss: bool
    ) -> None:
        """Append an evaluation and report it."""
        loss = holdout_loss = float("nan")
        if done.completed and with_loss:
            loss, holdout_loss = self._losses(setting_, done)
        position = tuple(float(x) for x in u)
        values = tuple(axis.from_unit(x) for axis, x in zip(self.axes, position, strict=True))
        trial = Evaluation(
            len(self.all) + 1, self.purpose, position, values, setting_, done, loss, holdout_loss
        )
        self.all[setting_] = trial
        self.on_evaluation(trial)

    def _load_residuals(
        self, setting_: Setting, done: CompletedRun, stage: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the residuals of a run, from the cache if possible."""
        if (setting_, stage) not in self._residuals:
            self._residuals[setting_, stage] = self.target.residual(done.folder, stage)
        return self._residuals[setting_, stage]

    def residual(self, trial: Evaluation, stage: int) -> np.ndarray:
        """Return the residual of a run, shape (n,), inf if it blew up."""
        if not trial.done.completed:
            return np.full((~self.target.holdout_mask[stage]).sum(), np.inf)
        return self._load_residuals(trial.setting, trial.done, stage)[0]

    def loss(self, trial: Evaluation, stage: int) -> float:
        """Return the root mean square of the residual, inf if the run blew up."""
        return _rms(self.residual(trial, stage))

    def best(self) -> Evaluation:
        """Return the evaluation of least loss.

        Runs with further settings or without a loss are excluded. Raises StudyError if every run
        blew up.
        """
        candidates = [t for t in self.all.values() if len(t.setting.knobs) == len(self.axes)]
        completed = [t for t in candidates if t.done.completed and not np.isnan(t.loss)]
        if not completed:
            raise StudyError("every run blew up")
        return min(completed, key=lambda t: (t.loss, t.number))

    def jacobian(
        self, u: np.ndarray, stage: int, share: float, central: bool = False
    ) -> np.ndarray:
        """Return the finite-difference Jacobian of the residual, shape (n, parameters).

        Args:
            u: Point, shape (parameters,).
            stage: Stage of the target.
            share: Step, as in `ParameterAxis.step`.
            central: Whether to take central differences, of twice the step, instead of one-sided
                ones towards the middle of the range.

        Raises StudyError, BudgetExhausted.
        """
        steps = np.array([axis.step(share) * (2 if central else 1) for axis in self.axes])
        sign = np.where(u + steps > 1, -1.0, 1.0)
        forward = [step_along(u, k, sign[k] * steps[k]) for k in range(len(u))]
        backward = [step_along(u, k, -sign[k] * steps[k]) if central else u for k in range(len(u))]
        trials = self.evaluate([*forward, *backward])
        columns = []
        for k, pair in enumerate(zip(trials[: len(u)], trials[len(u) :])):
            if not pair[0].done.completed:  # this run blew up; step to the other side
                (reflected,) = self.evaluate([step_along(u, k, -sign[k] * steps[k])])
                pair = (reflected, self.evaluate([u])[0])
            if not (pair[0].done.completed and pair[1].done.completed):
                raise StudyError(f"runs blow up beside {', '.join(pair[1].setting.overrides)}")
            width = pair[0].u[k] - pair[1].u[k]
            columns.append((self.residual(pair[0], stage) - self.residual(pair[1], stage)) / width)
        return np.stack(columns, axis=1)


def step_along(u: np.ndarray, k: int, step: float) -> np.ndarray:
    """Return a copy of point u, moved along parameter k but kept within its range."""
    moved = np.array(u, float)
    moved[k] = min(max(moved[k] + step, 0.0), 1.0)
    return moved


def _rms(values: np.ndarray) -> float:
    """Return the root mean square, nan of nothing."""
    return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")

"""Gradient descent on score distillation, or minimization of the denoising loss.

The gradient of a video model reaches the parameters through finite differences of runs.
"""

from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import minimize_scalar

from vgmpi.tools.fit.video_prior.denoising_target import DenoisingTarget
from vgmpi.tools.fit.video_prior.score_distillation import directional_derivative
from vgmpi.tools.tradeoff.study_runs import StudyError

from . import optimizers
from .evaluations import BudgetExhausted, Evaluations, step_along
from .fit_config import FitFile

FIRST_STEP = 0.1  # [ranges] length of the first step
# [ranges] longest step; [-] largest ratio of a step to the one before
MAX_STEP, MAX_STEP_GROWTH = 0.25, 2.0
STEP_TOLERANCE = 2e-3  # [ranges] the descent ends when a step is shorter
SEARCH_TOLERANCE = 1e-3  # [ranges] tolerance of the scalar search


class BlewUp(StudyError):
    """Error raised when a run that a gradient needs did not complete."""


@dataclass
class SdsResult:
    """Result of a search with a video model.

    u: final point (parameters,). budget_exhausted: whether the search ended because no runs were
    left. notes: lines for the report.
    """

    u: np.ndarray
    budget_exhausted: bool
    notes: list[str] = field(default_factory=list)


def search(file: FitFile, trials: Evaluations) -> SdsResult:
    """Scan the parameter ranges, then descend along the gradient or the loss.

    Raises:
        FitFileError: If too few runs are allowed or a parameter has no visible effect.
        StudyError: If a run cannot be made.
    """
    method, count = file.settings.method, len(file.axes)
    min_runs = 2 * count + 3
    if trials.max_runs < min_runs:
        message = f"must be {min_runs} or more for {count} parameters of [sds]"
        raise file.wrong(("method", "max_runs"), f"{message}; got {method.max_runs}")
    u = optimizers.start(file)
    try:
        if method.scan_points:
            u = optimizers.coarse_scan(trials, u, method.scan_points)
            _reject_unseen(file, trials)
        else:
            trials.evaluate([u])
    except BudgetExhausted:
        message = (
            f"a scan of {method.scan_points} for each parameter leaves none of {method.max_runs}"
        )
        raise file.wrong(("method", "max_runs"), f"{message}: give more runs") from None
    if method.algorithm == "cma":
        return _minimize_loss(trials, u, method.seed)
    return _descend(file, trials, u, method.fd_step)


def _reject_unseen(file: FitFile, trials: Evaluations) -> None:
    """Reject parameters that change nothing of what the model sees.

    Raises:
        FitFileError: For the first such parameter.
    """
    assert isinstance(trials.target, DenoisingTarget)
    runs = [t for t in trials.all.values() if t.done.completed]
    codes = [trials.target.code(t.done.folder) for t in runs]
    for k, axis in enumerate(file.axes):
        pairs = [
            (i, j) for i, evaluation in enumerate(runs) for j, other in enumerate(runs[:i])
            if {m for m, (a, b) in enumerate(zip(evaluation.u, other.u)) if a != b} == {k}
        ]  # fmt: skip
        if pairs and all(np.array_equal(codes[i], codes[j]) for i, j in pairs):
            message = "nothing that the model sees changes over the whole range: leave it out"
            raise file.wrong(("parameter", k, "key"), f"{axis.key}: {message}")


def gradient(trials: Evaluations, u: np.ndarray, share: float) -> np.ndarray:
    """Return the score distillation gradient at a point, shape (parameters,), per latent entry.

    The gradient takes 2 P + 1 runs; the model is queried for the central one only.

    Args:
        trials: Evaluations, with a DenoisingTarget.
        u: Point, shape (parameters,).
        share: Step of the differences, as in `ParameterAxis.step`.

    Raises:
        BudgetExhausted: If no runs are left.
        BlewUp: If a run of the difference stencil did not complete.
        StudyError: If a run cannot be made.
    """
    target = trials.target
    assert isinstance(target, DenoisingTarget)
    steps = [axis.step(share) for axis in trials.axes]
    forward = [step_along(u, k, step) for k, step in enumerate(steps)]
    backward = [step_along(u, k, -step) for k, step in enumerate(steps)]
    evaluations = trials.evaluate([u, *forward, *backward], with_loss=False)
    if not all(t.done.completed for t in evaluations):
        failed = next(t for t in evaluations if not t.done.completed)
        raise BlewUp(f"a run blows up at {', '.join(failed.setting.overrides)}")
    (center,) = trials.evaluate([u])
    sds_gradient, components = target.sds_gradient(center.done.folder), []
    for k, (upper, lower) in enumerate(zip(evaluations[1 : len(u) + 1], evaluations[len(u) + 1 :])):
        ends = [target.code(t.done.folder).ravel() for t in (upper, lower)]
        components.append(
            directional_derivative(sds_gradient, ends[0], ends[1], upper.u[k] - lower.u[k])
        )
    return np.array(components)


def _descend(file: FitFile, trials: Evaluations, u: np.ndarray, share: float) -> SdsResult:
    """Move each parameter to the zero of its gradient by the secant method.

    The last two gradients determine a step (Fahlman 1988, Quickprop). The scale of the gradient is
    unknown; the first step is therefore FIRST_STEP, and no step is much longer than the one before.
    """
    trials.purpose = "descent"
    points, slopes, spent = [u], [], False
    try:
        slopes.append(gradient(trials, u, share))
        step = -FIRST_STEP * np.sign(slopes[0])
        while True:
            candidate = np.clip(points[-1] + step, 0.0, 1.0)
            if np.abs(candidate - points[-1]).max() < STEP_TOLERANCE:
                break
            try:
                slopes.append(gradient(trials, candidate, share))
            except BlewUp:
                step = step / 2  # the next try starts from the last point whose runs completed
                continue
            points.append(candidate)
            step = quickprop_step(points, slopes)
    except BudgetExhausted:
        spent = True
    if not slopes:
        message = f"{len(trials.all)} of {trials.max_runs} runs are used before the first gradient"
        raise file.wrong(("method", "max_runs"), f"{message}: give more runs")
    sizes = [float(np.abs(g).max()) for g in slopes]
    best = int(np.argmin(sizes)) if spent else len(points) - 1
    return SdsResult(points[best], spent, _report_lines(file, slopes, best))


def quickprop_step(points: list[np.ndarray], slopes: list[np.ndarray]) -> np.ndarray:
    """Return the Quickprop step from the last of points (parameters,) with these gradients."""
    last_step, slope_change = points[-1] - points[-2], slopes[-1] - slopes[-2]
    max_step = np.minimum(MAX_STEP_GROWTH * np.maximum(np.abs(last_step), STEP_TOLERANCE), MAX_STEP)
    is_convex = last_step * slope_change > 0
    secant_step = -slopes[-1] * last_step / np.where(is_convex, slope_change, 1.0)
    return np.where(
        is_convex, np.clip(secant_step, -max_step, max_step), -max_step * np.sign(slopes[-1])
    )


def _report_lines(file: FitFile, slopes: list[np.ndarray], best: int) -> list[str]:
    """Return the lines of the report about the gradients, at the start and at point `best`."""
    out = [
        "How sure this is, is not known: a model's taste is no measurement, and has no residuals"
        " that would tell.",
        "", "## The model's gradient", "", "| parameter | at first | here |", "|---|---|---|",
    ]  # fmt: skip
    for k, axis in enumerate(file.axes):
        out.append(f"| {axis.key} | {slopes[0][k]:.3g} | {slopes[best][k]:.3g} |")
    rounds = f"{len(slopes)} gradients by score distillation, each of {2 * len(file.axes) + 1} runs"
    return [*out, "", f"{rounds}. They are per number of a code, over a parameter's whole range."]


def _minimize_loss(trials: Evaluations, u: np.ndarray, seed: int) -> SdsResult:
    """Minimize the loss itself.

    One parameter is found by Brent's search between the neighbors of the best scanned point,
    several by CMA-ES. Raises StudyError.
    """
    notes = ["How sure this is, is not known: a model's taste has no residuals that would tell."]
    if len(u) > 1:
        best = optimizers.cma_es_fit(trials, u, seed)
        return SdsResult(best, len(trials.all) >= trials.max_runs, notes)
    trials.purpose, spent = "search", False
    scanned = sorted(t.u[0] for t in trials.all.values())
    low = max([x for x in scanned if x < u[0]], default=0.0)
    high = min([x for x in scanned if x > u[0]], default=1.0)

    def loss(x: float) -> float:
        """Return the loss at x, a large number if the run blew up."""
        (evaluation,) = trials.evaluate([np.array([x])])
        return evaluation.loss if evaluation.done.completed else 1e6

    try:
        minimize_scalar(
            loss, bounds=(low, high), method="bounded", options={"xatol": SEARCH_TOLERANCE}
        )
    except BudgetExhausted:
        spent = True
    return SdsResult(np.array(trials.best().u), spent, notes)

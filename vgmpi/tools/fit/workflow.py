"""Workflow of a fit, from the fit file to its result with confidence intervals."""

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy import stats

from vgmpi.scene.scene import Scene
from vgmpi.tools.tradeoff import parameter_sweep
from vgmpi.tools.tradeoff.study_runs import StudyError

from . import optimizers, sds_descent
from .evaluations import BudgetExhausted, Evaluation, Evaluations
from .fit_config import FitFile, FitFileError

CONFIDENCE = 0.95  # [-] level of the intervals
# [-] smallest over largest singular value of the column-normalized Jacobian below which two runs
# test whether parameters can be identified
SINGULAR_RATIO_MIN = 0.3
PROBE_STEP = 0.25  # [ranges] step of these test runs
VISIBILITY_RATIO = 0.05  # [-] effect of a joint step over that of a single one that counts as none
GCI_SAFETY_FACTOR = 3.0  # [-] factor on a two-grid error for a 95 % interval (Roache 1994, GCI)
PARTICIPATION_MIN = 0.3  # [-] component of a unit direction above which a parameter takes part
# Runs reserved for the end besides the differences: two test identifiability, one takes the last
# step, one has other cells.
RESERVED_RUNS = 4


@dataclass(frozen=True)
class FitUncertainty:
    """Uncertainty of the fitted parameters at the 95 % level.

    Half-widths are in u, in which 0 and 1 are the ends of a parameter's range.
    """

    noise_halfwidth: np.ndarray  # (parameters,) statistical part
    discretization_halfwidth: np.ndarray  # (parameters,) part of the cell size
    correlation: np.ndarray  # (parameters, parameters)
    singular_values: np.ndarray  # of the column-normalized Jacobian, descending
    reference_cell_count: int | None  # cells along the longest edge in the second run, if any


def find_unidentifiable(trials: Evaluations, u: np.ndarray, J: np.ndarray) -> list[int]:
    """Return parameters that can be moved together without visible effect; none if identifiable.

    If the Jacobian is ill-conditioned, two runs test it: a long step along the singular direction
    of the smallest singular value, and the same step of one of its parameters alone.

    Args:
        trials: Evaluations made so far.
        u: Point, shape (parameters,).
        J: Jacobian of the residual at u, shape (n, parameters).
    """
    if len(u) < 2:
        return []
    if not is_ill_conditioned(J):
        return []
    length = np.maximum(np.linalg.norm(J, axis=0), 1e-300)
    directions = np.linalg.svd(J / length, full_matrices=False)[2]
    direction = directions[-1] / length
    members = [int(k) for k in np.flatnonzero(np.abs(directions[-1]) > PARTICIPATION_MIN)]
    direction = np.where(np.isin(np.arange(len(u)), members), direction, 0.0)
    step = _longest_step(u, direction / np.abs(direction).max())
    lead = members[int(np.argmax(np.abs(step[members])))]
    single_step = np.where(np.arange(len(u)) == lead, step, 0.0)
    trials.purpose = "told apart"
    stage = trials.target.stages - 1
    base, together, single = trials.evaluate([u, u + step, u + single_step])
    if not (together.done.completed and single.done.completed):
        return []
    base_residual = trials.residual(base, stage)
    changes = [
        np.linalg.norm(trials.residual(t, stage) - base_residual) for t in (together, single)
    ]
    return members if changes[0] < VISIBILITY_RATIO * changes[1] else []


def is_ill_conditioned(J: np.ndarray) -> bool:
    """Return whether the column-normalized Jacobian (n, parameters) is ill-conditioned."""
    length = np.maximum(np.linalg.norm(J, axis=0), 1e-300)
    singular_values = np.linalg.svd(J / length, compute_uv=False)
    return bool(singular_values[-1] < SINGULAR_RATIO_MIN * singular_values[0])


def _longest_step(u: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Return the longest step along a direction or against it, at most PROBE_STEP."""
    longest = np.zeros_like(u)
    for step in (direction * PROBE_STEP, -direction * PROBE_STEP):
        scale = np.where(step > 0, 1 - u, u) / np.maximum(np.abs(step), 1e-300)
        candidate = step * min(1.0, float(scale.min()))
        if np.abs(candidate).max() > np.abs(longest).max():
            longest = candidate
    return longest


def estimate_uncertainty(
    trials: Evaluations, best: Evaluation, J: np.ndarray, other_cells: str
) -> FitUncertainty:
    """Estimate 95 % intervals of the fitted parameters.

    The noise part is that of least squares with independent errors, or with errors correlated over
    the blur width in images. The discretization part is from one run with other cells.

    Args:
        trials: Evaluations made so far.
        best: Evaluation at the fitted values.
        J: Jacobian of the residual there, shape (n, parameters).
        other_cells: Choice of the other cells: coarser, finer or none.
    """
    stage = trials.target.stages - 1
    residual, correlated_count = (
        trials.residual(best, stage),
        trials.target.correlated_counts[stage],
    )
    is_affected = (np.abs(J).max(1) > 0) | (residual != 0)
    degrees_of_freedom = max(int(is_affected.sum() / correlated_count) - J.shape[1], 1)
    inverse = np.linalg.pinv(J.T @ J)
    standard_error = np.sqrt(np.diag(inverse) * float(residual @ residual) / degrees_of_freedom)
    noise_halfwidth = float(stats.t.ppf(0.5 + CONFIDENCE / 2, degrees_of_freedom)) * standard_error
    scale = np.maximum(np.sqrt(np.diag(inverse)), 1e-300)
    length = np.maximum(np.linalg.norm(J, axis=0), 1e-300)
    singular_values = np.linalg.svd(J / length, compute_uv=False)
    shift, reference_cell_count = discretization_shift(trials, best, J, other_cells)
    return FitUncertainty(
        noise_halfwidth,
        shift,
        inverse / np.outer(scale, scale),
        singular_values,
        reference_cell_count,
    )


def discretization_shift(
    trials: Evaluations, best: Evaluation, J: np.ndarray, other_cells: str
) -> tuple[np.ndarray, int | None]:
    """Estimate the discretization error of the parameters by one run with other cells.

    The change of the residual is projected on the parameters, taken as proportional to the cell
    size, and multiplied by GCI_SAFETY_FACTOR.

    Args:
        trials: Evaluations made so far.
        best: Evaluation at the fitted values.
        J: Jacobian of the residual there, shape (n, parameters).
        other_cells: Choice of the other cells: coarser, finer or none.

    Returns:
        The error, shape (parameters,) in u, and the cells along the longest edge in the other run:
        half as many or the next that can be run, or twice as many; zeros and None without such a
        run.
    """
    scene, stage = trials.runs.scene, trials.target.stages - 1
    cell_count = max(scene.domain.cells)
    trials.purpose = f"{other_cells} cells"
    for count in _cell_counts(scene, other_cells):
        try:
            (run,) = trials.evaluate([np.array(best.u)], parameter_sweep.with_cells(scene, count))
        except BudgetExhausted:
            break
        except StudyError:
            continue  # bodies may be too close to open walls in these cells
        if run.done.completed:
            change = trials.residual(run, stage) - trials.residual(best, stage)
            parameter_shift = np.linalg.lstsq(J, change, rcond=1e-6)[0]
            # share of a difference proportional to the cell size that remains in the scene's cells
            error_share = 1 / abs(1 - cell_count / count)
            return GCI_SAFETY_FACTOR * np.abs(parameter_shift) * error_share, count
    return np.zeros(len(best.u)), None


def _cell_counts(scene: Scene, other_cells: str) -> Iterable[int]:
    """Return candidate cell counts along the longest edge for the other run, best first."""
    cell_count, unit = max(scene.domain.cells), parameter_sweep.cell_unit(scene)
    if other_cells == "none":
        return ()
    if other_cells == "finer":
        return (2 * cell_count,)
    min_count = -(-parameter_sweep.MIN_CELLS * cell_count // min(scene.domain.cells))
    return range(unit * -(-max(cell_count // 2, min_count) // unit), cell_count, unit)


@dataclass(frozen=True)
class FitResult:
    """Result of a fit.

    best: evaluation of the fitted values. uncertainty: None if it could not be estimated.
    budget_exhausted: whether the search ended because no runs were left. notes: lines that say why
    the uncertainty is unknown.
    """

    best: Evaluation
    uncertainty: FitUncertainty | None
    budget_exhausted: bool
    notes: tuple[str, ...] = ("No runs were left to tell how sure this is.",)


def run_fit(file: FitFile, trials: Evaluations) -> FitResult:
    """Scan the ranges, reject parameters that cannot be fitted, search, estimate uncertainty.

    Raises:
        FitFileError: If parameters have no effect or cannot be identified, or too few runs are
            allowed.
        StudyError: If a run cannot be made.
        ImportError: If a package is missing.
    """
    method = file.settings.method
    if file.settings.sds is not None:
        return _fit_to_video_prior(file, trials)
    trials.reserved_runs = 2 * len(file.axes) + RESERVED_RUNS
    if trials.max_runs <= trials.reserved_runs + 2:
        message = f"must be {trials.reserved_runs + 3} or more for {len(file.axes)} parameters"
        raise file.wrong(("method", "max_runs"), f"{message}; got {method.max_runs}")
    u, stage = optimizers.start(file), trials.target.stages - 1
    try:
        u = optimizers.coarse_scan(trials, u, method.scan_points)
        _reject_insensitive(file, trials)
        trials.purpose = "told apart"
        if len(u) > 1 and is_ill_conditioned(trials.jacobian(u, stage, method.fd_step)):
            # One-sided differences have curvature errors, other ones in each parameter.
            _reject_unidentifiable(
                file, trials, u, trials.jacobian(u, stage, method.fd_step, central=True)
            )
    except BudgetExhausted:
        usage = f"{len(trials.all)} of {method.max_runs} runs are used before the search begins"
        message = f"{usage}, with a scan of {method.scan_points} for each parameter: give more runs"
        raise file.wrong(("method", "max_runs"), message) from None
    if method.algorithm == "cma":
        u = optimizers.cma_es_fit(trials, u, method.seed)
    else:
        u = optimizers.least_squares_fit(trials, u, method.fd_step)
    budget_exhausted = len(trials.all) >= trials.max_runs - trials.reserved_runs
    trials.reserved_runs = 0
    return _finish_with_uncertainty(file, trials, u, budget_exhausted)


def _fit_to_video_prior(file: FitFile, trials: Evaluations) -> FitResult:
    """Fit to a video model. Raises FitFileError, StudyError, ImportError."""
    result = sds_descent.search(file, trials)
    (best,) = trials.evaluate([result.u])
    return FitResult(best, None, result.budget_exhausted, tuple(result.notes))


def _finish_with_uncertainty(
    file: FitFile, trials: Evaluations, u: np.ndarray, budget_exhausted: bool
) -> FitResult:
    """Take the last step and estimate the uncertainty, if runs are left for it.

    Args:
        file: The fit file.
        trials: Evaluations made so far.
        u: Result of the search, shape (parameters,).
        budget_exhausted: Whether the search used up its runs.
    """
    method, stage = file.settings.method, trials.target.stages - 1
    trials.purpose = "around it"
    try:
        J = trials.jacobian(u, stage, method.fd_step, central=True)
        _reject_unidentifiable(file, trials, u, J)
        trials.purpose = "around it"
        (best,) = trials.evaluate([optimizers.gauss_newton_step(trials, u, J)])
        return FitResult(
            best,
            estimate_uncertainty(trials, best, J, method.discretization_check),
            budget_exhausted,
        )
    except (BudgetExhausted, StudyError):
        return FitResult(trials.best(), None, budget_exhausted)


def _reject_insensitive(file: FitFile, trials: Evaluations) -> None:
    """Reject parameters without effect on the target. Raises FitFileError."""
    insensitive = (
        optimizers.insensitive_parameters(trials) if file.settings.method.scan_points > 1 else []
    )
    if insensitive:
        message = "nothing that the target shows changes over the whole range: leave it out"
        raise FitFileError(
            file.source.lines(
                [(("parameter", k, "key"), _named(file, k, message)) for k in insensitive]
            )
        )


def _named(file: FitFile, k: int, message: str) -> str:
    """Return a message with the key of parameter k in front."""
    return f"{file.axes[k].key}: {message}"


def _reject_unidentifiable(
    file: FitFile, trials: Evaluations, u: np.ndarray, J: np.ndarray
) -> None:
    """Reject parameters that cannot be told apart near u. Raises FitFileError."""
    members = find_unidentifiable(trials, u, J)
    if not members:
        return
    names = [f"{file.axes[k].key} ({file.line(k)})" for k in members]
    message = f"{' and '.join(names)} cannot be told apart by this target: moved together, with"
    message += " nothing to see of it; give all but one of them a value in the scene"
    raise file.wrong(("parameter", members[-1]), message)


def interval(result: FitResult, file: FitFile, k: int) -> tuple[float, float] | None:
    """Return the 95 % interval of parameter k [SI], discretization included.

    Returns None if it is not known.
    """
    if result.uncertainty is None:
        return None
    halfwidth = float(
        result.uncertainty.noise_halfwidth[k] + result.uncertainty.discretization_halfwidth[k]
    )
    return file.axes[k].interval(result.best.u[k], halfwidth) if math.isfinite(halfwidth) else None

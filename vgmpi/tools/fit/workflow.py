"""Workflow of a fit, from the fit file to its result."""

import math
from dataclasses import dataclass

import numpy as np

from vgmpi.tools.tradeoff.study_runs import StudyError

from . import optimizers, sds_descent
from .evaluations import BudgetExhausted, Evaluation, Evaluations
from .fit_config import FitFile, FitFileError
from .uncertainty import (
    FitUncertainty,
    estimate_uncertainty,
    find_unidentifiable,
    is_ill_conditioned,
)

# Runs reserved for the end besides the differences: two test identifiability, one takes the last
# step, one has other cells.
RESERVED_RUNS = 4


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

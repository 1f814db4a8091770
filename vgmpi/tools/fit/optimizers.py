"""Optimizers: coarse scan, least squares, CMA-ES and a final Gauss-Newton step."""

import numpy as np
from scipy.optimize import least_squares

from vgmpi.tools.tradeoff.study_runs import StudyError

from .evaluations import BudgetExhausted, Evaluations
from .fit_config import FitFile

INITIAL_SPREAD = 0.2  # [ranges] standard deviation of CMA-ES at its start
MIN_SPREAD = 1e-3  # [ranges] CMA-ES ends below this standard deviation
# [-] relative changes of the squared loss that end a stage: all stages but the last, the last one
COARSE_TOLERANCE, FINE_TOLERANCE = 1e-3, 1e-4
PARAMETER_TOLERANCE = 1e-3  # [ranges] change of the parameters that ends a stage


def start(file: FitFile) -> np.ndarray:
    """Return the start point of the search, shape (parameters,)."""
    return np.array([axis.to_unit(axis.initial) for axis in file.axes])


def coarse_scan(trials: Evaluations, u: np.ndarray, count: int) -> np.ndarray:
    """Scan each parameter range in turn and return the best point, the start included.

    Points are compared by the loss of the coarsest stage.

    Raises:
        StudyError: If every run of the scan blew up.
    """
    trials.purpose = "scan"
    best = min(trials.evaluate([u]), key=lambda t: trials.loss(t, 0))
    for k in range(len(u)):
        positions = (np.arange(count) + 0.5) / count
        points = [np.where(np.arange(len(u)) == k, position, best.u) for position in positions]
        best = min([best, *trials.evaluate(points)], key=lambda t: trials.loss(t, 0))
    if not best.done.completed:
        raise StudyError("every run of the scan blew up: other ranges, or other initial values")
    return np.array(best.u)


def insensitive_parameters(trials: Evaluations) -> list[int]:
    """Return the parameters without effect on the target in any run of the scan.

    Call it before other runs are made.
    """
    insensitive = []
    runs = [t for t in trials.all.values() if t.done.completed]
    for k in range(len(trials.axes)):
        changes = []  # rms over pairs of runs that differ in k alone; empty if the others blew up
        for evaluation in runs:
            others = [t for t in runs if _differing_parameters(t, evaluation) == {k}]
            residuals = [trials.residual(t, trials.target.stages - 1) for t in others]
            residual = trials.residual(evaluation, trials.target.stages - 1)
            changes += [float(np.sqrt(np.mean((r - residual) ** 2))) for r in residuals]
        if changes and max(changes) < COARSE_TOLERANCE:
            insensitive.append(k)
    return insensitive


def _differing_parameters(evaluation, other_evaluation) -> set[int]:
    """Return the indices of the parameters in which two evaluations differ."""
    return {k for k, (a, b) in enumerate(zip(evaluation.u, other_evaluation.u)) if a != b}


def least_squares_fit(trials: Evaluations, u: np.ndarray, share: float) -> np.ndarray:
    """Minimize the residuals by least squares, from the coarse to the fine stage.

    The method is the trust region reflective algorithm of scipy.optimize.least_squares with finite
    differences. The search ends early if no runs are left.

    Args:
        trials: Evaluations made so far.
        u: Start, shape (parameters,).
        share: Step of the differences, as in `ParameterAxis.step`.

    Returns:
        The best point, shape (parameters,).
    """
    trials.purpose = "search"
    for stage in range(trials.target.stages):
        is_last = stage == trials.target.stages - 1

        def residual(x: np.ndarray, stage: int = stage) -> np.ndarray:
            """Return the residual at x."""
            return trials.residual(trials.evaluate([x])[0], stage)

        def jacobian(x: np.ndarray, stage: int = stage) -> np.ndarray:
            """Return the Jacobian at x."""
            return trials.jacobian(x, stage, share)

        try:
            tolerance = FINE_TOLERANCE if is_last else COARSE_TOLERANCE
            inside = np.clip(u, PARAMETER_TOLERANCE, 1 - PARAMETER_TOLERANCE)
            solution = least_squares(
                residual,
                inside,
                jacobian,
                bounds=(0.0, 1.0),
                xtol=PARAMETER_TOLERANCE,
                ftol=tolerance,
                gtol=1e-14,
            )
        except BudgetExhausted:
            return np.array(trials.best().u)
        u = solution.x
    return u


def cma_es_fit(trials: Evaluations, u: np.ndarray, seed: int) -> np.ndarray:
    """Minimize the loss by CMA-ES (Hansen 2016), with the package cmaes.

    Raises:
        StudyError: If the package is missing.
    """
    try:
        from cmaes import CMA
    except ImportError:
        raise StudyError("method.algorithm = 'cma' needs: pip install 'vgmpi[fit]'") from None

    trials.purpose = "search"
    bounds = np.tile([0.0, 1.0], (len(u), 1))
    search = CMA(mean=u, sigma=INITIAL_SPREAD, bounds=bounds, seed=seed)
    try:
        spread = INITIAL_SPREAD
        while not search.should_stop() and spread > MIN_SPREAD:
            points = [search.ask() for _ in range(search.population_size)]
            spread = float(np.std(points, axis=0).max())
            evaluations = trials.evaluate(points)
            losses = [t.loss if t.done.completed else 1e6 for t in evaluations]
            search.tell(list(zip(points, losses)))
    except BudgetExhausted:
        pass
    return np.array(trials.best().u)


def gauss_newton_step(trials: Evaluations, u: np.ndarray, J: np.ndarray) -> np.ndarray:
    """Take one Gauss-Newton step with the central-difference J if it lowers the loss."""
    stage = trials.target.stages - 1
    (current,) = trials.evaluate([u])
    step = -np.linalg.lstsq(J, trials.residual(current, stage), rcond=1e-6)[0]
    try:
        (candidate,) = trials.evaluate([np.clip(u + step, 0.0, 1.0)])
    except BudgetExhausted:
        return u
    return (
        np.array(candidate.u) if candidate.done.completed and candidate.loss < current.loss else u
    )

"""From a start to the least loss: first over each parameter's range, then down the slope."""

import numpy as np
from scipy.optimize import least_squares

from ..study.runs import StudyError
from .settings import FitFile
from .trials import Spent, Trials

SPREAD = 0.2  # of CMA-ES at its start, of the range
NARROW = 1e-3  # at which it is done
LOOSE, CLOSE = 1e-3, 1e-4  # changes of the square of the loss at which a stage is done
NEAR = 1e-3  # of the range, the same of the parameters


def start(file: FitFile) -> np.ndarray:
    """Where the search begins (parameters,)."""
    return np.array([axis.at(axis.start) for axis in file.axes])


def scan(trials: Trials, u: np.ndarray, count: int) -> np.ndarray:
    """The best of so many runs spread over the range of each parameter, one after the other, and
    of the start; seen coarsely."""
    trials.what = "scan"
    best = min(trials.ask([u]), key=lambda t: trials.loss(t, 0))
    for k in range(len(u)):
        places = (np.arange(count) + 0.5) / count
        points = [np.where(np.arange(len(u)) == k, place, best.u) for place in places]
        best = min([best, *trials.ask(points)], key=lambda t: trials.loss(t, 0))
    if not best.done.whole:
        raise StudyError("every run of the scan blew up: other ranges, or another start")
    return np.array(best.u)


def blind(trials: Trials) -> list[int]:
    """Parameters that no run of the scan shows anything of; before anything else is run."""
    found = []
    runs = [t for t in trials.all.values() if t.done.whole]
    for k in range(len(trials.axes)):
        seen = []  # of pairs of runs that differ in it alone; none where the others blew up
        for one in runs:
            others = [t for t in runs if _apart_in(t, one) == {k}]
            off = [trials.off(t, trials.target.stages - 1) for t in others]
            here = trials.off(one, trials.target.stages - 1)
            seen += [float(np.sqrt(np.mean((o - here) ** 2))) for o in off]
        if seen and max(seen) < LOOSE:
            found.append(k)
    return found


def _apart_in(one, other) -> set[int]:
    return {k for k, (a, b) in enumerate(zip(one.u, other.u)) if a != b}


def least(trials: Trials, u: np.ndarray, share: float) -> np.ndarray:
    """Least squares by differences, from coarse to fine (scipy.optimize.least_squares, trf: a
    trust region inside of the range). Ends early where runs are spent."""
    trials.what = "search"
    for stage in range(trials.target.stages):
        last = stage == trials.target.stages - 1

        def off(x: np.ndarray, stage: int = stage) -> np.ndarray:
            return trials.off(trials.ask([x])[0], stage)

        def slopes(x: np.ndarray, stage: int = stage) -> np.ndarray:
            return trials.slopes(x, stage, share)

        try:
            close = CLOSE if last else LOOSE
            inside = np.clip(u, NEAR, 1 - NEAR)
            found = least_squares(
                off, inside, slopes, bounds=(0.0, 1.0), xtol=NEAR, ftol=close, gtol=1e-14
            )
        except Spent:
            return np.array(trials.best().u)
        u = found.x
    return u


def cma(trials: Trials, u: np.ndarray, seed: int) -> np.ndarray:
    """CMA-ES (Hansen 2016) by the package cmaes. Raises StudyError without it."""
    try:
        from cmaes import CMA
    except ImportError:
        raise StudyError("method.kind = 'cma' needs: pip install 'vgmpi[fit]'") from None

    trials.what = "search"
    inside = np.tile([0.0, 1.0], (len(u), 1))
    search = CMA(mean=u, sigma=SPREAD, bounds=inside, seed=seed)
    try:
        spread = SPREAD
        while not search.should_stop() and spread > NARROW:
            points = [search.ask() for _ in range(search.population_size)]
            spread = float(np.std(points, axis=0).max())
            made = trials.ask(points)
            losses = [t.loss if t.done.whole else 1e6 for t in made]
            search.tell(list(zip(points, losses)))
    except Spent:
        pass
    return np.array(trials.best().u)


def polished(trials: Trials, u: np.ndarray, J: np.ndarray) -> np.ndarray:
    """One step of Gauss and Newton further, with differences to both sides; only where it is
    better."""
    stage = trials.target.stages - 1
    (here,) = trials.ask([u])
    step = -np.linalg.lstsq(J, trials.off(here, stage), rcond=1e-6)[0]
    try:
        (there,) = trials.ask([np.clip(u + step, 0.0, 1.0)])
    except Spent:
        return u
    return np.array(there.u) if there.done.whole and there.loss < here.loss else u

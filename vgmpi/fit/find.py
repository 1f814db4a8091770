"""From a fit file to what was found: the order of the work."""

import math
from dataclasses import dataclass

import numpy as np

from ..study.runs import StudyError
from . import apart, descent, search
from .settings import FitFile, FitFileError
from .trials import Spent, Trial, Trials

BESIDE = 4  # runs behind the search besides its differences: two to tell apart, a step, cells


@dataclass(frozen=True)
class Found:
    """What came of a fit. best: the run of the values found; known: what is sure of them, None
    where it cannot be told; spent: whether the search ended because runs were; unsure: why it
    cannot be told, in lines."""

    best: Trial
    known: apart.Known | None
    spent: bool
    unsure: tuple[str, ...] = ("No runs were left to tell how sure this is.",)


def find(file: FitFile, trials: Trials) -> Found:
    """Look over the ranges, refuse what nothing can be told of, search, and tell how sure it is.
    Raises FitFileError for parameters that cannot be told apart, StudyError, ImportError."""
    method = file.settings.method
    if file.settings.sds is not None:
        return _liked(file, trials)
    trials.kept = 2 * len(file.axes) + BESIDE
    if trials.most <= trials.kept + 2:
        said = f"must be {trials.kept + 3} or more for {len(file.axes)} parameters"
        raise file.wrong(("method", "runs"), f"{said}; got {method.runs}")
    u, stage = search.start(file), trials.target.stages - 1
    try:
        u = search.scan(trials, u, method.scan)
        _refuse_blind(file, trials)
        trials.what = "told apart"
        if len(u) > 1 and apart.alike(trials.slopes(u, stage, method.step)):
            # differences to both sides: those to one bend, each parameter's another way
            _refuse_same(file, trials, u, trials.slopes(u, stage, method.step, both=True))
    except Spent:
        tries = f"{len(trials.all)} of {method.runs} runs are used before the search begins"
        said = f"{tries}, with a scan of {method.scan} for each parameter: give more runs"
        raise file.wrong(("method", "runs"), said) from None
    if method.kind == "cma":
        u = search.cma(trials, u, method.seed)
    else:
        u = search.least(trials, u, method.step)
    spent = len(trials.all) >= trials.most - trials.kept
    trials.kept = 0
    return _sure(file, trials, u, spent)


def _liked(file: FitFile, trials: Trials) -> Found:
    """By a model's taste. Raises FitFileError, StudyError, ImportError."""
    liked = descent.search(file, trials)
    (best,) = trials.ask([liked.u])
    return Found(best, None, liked.spent, tuple(liked.told))


def _sure(file: FitFile, trials: Trials, u: np.ndarray, spent: bool) -> Found:
    method, stage = file.settings.method, trials.target.stages - 1
    trials.what = "around it"
    try:
        J = trials.slopes(u, stage, method.step, both=True)
        _refuse_same(file, trials, u, J)
        trials.what = "around it"
        (best,) = trials.ask([search.polished(trials, u, J)])
        return Found(best, apart.known(trials, best, J, method.grid), spent)
    except (Spent, StudyError):
        return Found(trials.best(), None, spent)


def _refuse_blind(file: FitFile, trials: Trials) -> None:
    """Raises FitFileError."""
    found = search.blind(trials) if file.settings.method.scan > 1 else []
    if found:
        said = "nothing that the target shows changes over the whole range: leave it out"
        raise FitFileError(
            file.source.lines([(("parameter", k, "key"), _named(file, k, said)) for k in found])
        )


def _named(file: FitFile, k: int, said: str) -> str:
    return f"{file.axes[k].key}: {said}"


def _refuse_same(file: FitFile, trials: Trials, u: np.ndarray, J: np.ndarray) -> None:
    """Raises FitFileError."""
    members = apart.same(trials, u, J)
    if not members:
        return
    names = [f"{file.axes[k].key} ({file.line(k)})" for k in members]
    said = f"{' and '.join(names)} cannot be told apart by this target: moved together, with"
    said += " nothing to see of it; give all but one of them a value in the scene"
    raise file.wrong(("parameter", members[-1]), said)


def interval(found: Found, file: FitFile, k: int) -> tuple[float, float] | None:
    """Of 95 %, with what the cells do [SI]; None where it is not known."""
    if found.known is None:
        return None
    off = float(found.known.noise[k] + found.known.cells[k])
    return file.axes[k].around(found.best.u[k], off) if math.isfinite(off) else None

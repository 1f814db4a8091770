"""Down the gradient that a video model gives, by differences of runs; or along its loss."""

from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import minimize_scalar

from ..study.runs import StudyError
from . import search as fitted
from .settings import FitFile
from .taste.distilled import slope
from .taste.liking import Taste
from .trials import Spent, Trials, moved

FIRST = 0.1  # of a range: the first step
MOST, GROWS = 0.25, 2.0  # of a range: the longest one; and how much longer than the one before
REST = 2e-3  # of a range: steps at which it is at rest
CLOSE = 1e-3  # of a range: how near a scalar search comes


class BlewUp(StudyError):
    """A run that a gradient needs did not come to its end."""


@dataclass
class Liked:
    """Where it ended (parameters,), whether because runs were spent, and what is to be told."""

    u: np.ndarray
    spent: bool
    told: list[str] = field(default_factory=list)


def search(file: FitFile, trials: Trials) -> Liked:
    """Look over the ranges, then down. Raises FitFileError, StudyError."""
    method, count = file.settings.method, len(file.axes)
    fewest = 2 * count + 3
    if trials.most < fewest:
        said = f"must be {fewest} or more for {count} parameters of [sds]"
        raise file.wrong(("method", "runs"), f"{said}; got {method.runs}")
    u = fitted.start(file)
    try:
        if method.scan:
            u = fitted.scan(trials, u, method.scan)
            _refuse_unseen(file, trials)
        else:
            trials.ask([u])
    except Spent:
        said = f"a scan of {method.scan} for each parameter leaves none of {method.runs}"
        raise file.wrong(("method", "runs"), f"{said}: give more runs") from None
    if method.kind == "cma":
        return _by_loss(trials, u, method.seed)
    return _down(file, trials, u, method.step)


def _refuse_unseen(file: FitFile, trials: Trials) -> None:
    """Raises FitFileError for a parameter that changes nothing of what the model sees."""
    assert isinstance(trials.target, Taste)
    runs = [t for t in trials.all.values() if t.done.whole]
    codes = [trials.target.code(t.done.folder) for t in runs]
    for k, axis in enumerate(file.axes):
        pairs = [
            (i, j) for i, one in enumerate(runs) for j, other in enumerate(runs[:i])
            if {m for m, (a, b) in enumerate(zip(one.u, other.u)) if a != b} == {k}
        ]  # fmt: skip
        if pairs and all(np.array_equal(codes[i], codes[j]) for i, j in pairs):
            said = "nothing that the model sees changes over the whole range: leave it out"
            raise file.wrong(("parameter", k, "key"), f"{axis.key}: {said}")


def gradient(trials: Trials, u: np.ndarray, share: float) -> np.ndarray:
    """Of score distillation at u (parameters,), per number of a code: 2 P + 1 runs, of which the
    model is asked about the one in the middle alone. Raises Spent, BlewUp, StudyError."""
    target = trials.target
    assert isinstance(target, Taste)
    steps = [axis.step(share) for axis in trials.axes]
    ahead = [moved(u, k, step) for k, step in enumerate(steps)]
    behind = [moved(u, k, -step) for k, step in enumerate(steps)]
    made = trials.ask([u, *ahead, *behind], look=False)
    if not all(t.done.whole for t in made):
        gone = next(t for t in made if not t.done.whole)
        raise BlewUp(f"a run blows up at {', '.join(gone.setting.overrides)}")
    (here,) = trials.ask([u])
    pulled, found = target.pull(here.done.folder), []
    for k, (one, other) in enumerate(zip(made[1 : len(u) + 1], made[len(u) + 1 :])):
        ends = [target.code(t.done.folder).ravel() for t in (one, other)]
        found.append(slope(pulled, ends[0], ends[1], one.u[k] - other.u[k]))
    return np.array(found)


def _down(file: FitFile, trials: Trials, u: np.ndarray, share: float) -> Liked:
    """Each parameter to where its gradient would vanish by its last two values (Fahlman 1988,
    Quickprop); of the gradient's own size nothing is known, so that the first step is FIRST, and
    none is much longer than the one before it."""
    trials.what = "descent"
    places, slopes, spent = [u], [], False
    try:
        slopes.append(gradient(trials, u, share))
        step = -FIRST * np.sign(slopes[0])
        while True:
            there = np.clip(places[-1] + step, 0.0, 1.0)
            if np.abs(there - places[-1]).max() < REST:
                break
            try:
                slopes.append(gradient(trials, there, share))
            except BlewUp:
                step = step / 2  # from the last place that is sound
                continue
            places.append(there)
            step = next_step(places, slopes)
    except Spent:
        spent = True
    if not slopes:
        said = f"{len(trials.all)} of {trials.most} runs are used before the first gradient"
        raise file.wrong(("method", "runs"), f"{said}: give more runs")
    sizes = [float(np.abs(g).max()) for g in slopes]
    best = int(np.argmin(sizes)) if spent else len(places) - 1
    return Liked(places[best], spent, _told(file, slopes, best))


def next_step(places: list[np.ndarray], slopes: list[np.ndarray]) -> np.ndarray:
    """From the last of places (parameters,) with these gradients."""
    way, change = places[-1] - places[-2], slopes[-1] - slopes[-2]
    most = np.minimum(GROWS * np.maximum(np.abs(way), REST), MOST)
    rises = way * change > 0
    straight = -slopes[-1] * way / np.where(rises, change, 1.0)
    return np.where(rises, np.clip(straight, -most, most), -most * np.sign(slopes[-1]))


def _told(file: FitFile, slopes: list[np.ndarray], best: int) -> list[str]:
    out = [
        "How sure this is, is not known: a model's taste is no measurement, and has no residuals"
        " that would tell.",
        "", "## The model's gradient", "", "| parameter | at first | here |", "|---|---|---|",
    ]  # fmt: skip
    for k, axis in enumerate(file.axes):
        out.append(f"| {axis.key} | {slopes[0][k]:.3g} | {slopes[best][k]:.3g} |")
    rounds = f"{len(slopes)} gradients by score distillation, each of {2 * len(file.axes) + 1} runs"
    return [*out, "", f"{rounds}. They are per number of a code, over a parameter's whole range."]


def _by_loss(trials: Trials, u: np.ndarray, seed: int) -> Liked:
    """Where the loss itself is least: of one parameter by Brent's search between the neighbours of
    the scan's best, of more by CMA-ES. Raises StudyError."""
    told = ["How sure this is, is not known: a model's taste has no residuals that would tell."]
    if len(u) > 1:
        found = fitted.cma(trials, u, seed)
        return Liked(found, len(trials.all) >= trials.most, told)
    trials.what, spent = "search", False
    seen = sorted(t.u[0] for t in trials.all.values())
    low = max([x for x in seen if x < u[0]], default=0.0)
    high = min([x for x in seen if x > u[0]], default=1.0)

    def loss(x: float) -> float:
        (one,) = trials.ask([np.array([x])])
        return one.loss if one.done.whole else 1e6

    try:
        minimize_scalar(loss, bounds=(low, high), method="bounded", options={"xatol": CLOSE})
    except Spent:
        spent = True
    return Liked(np.array(trials.best().u), spent, told)

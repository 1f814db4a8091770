"""What a fit can tell: intervals, and parameters that cannot be told apart."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from ..scene.scene import Scene
from ..study import knobs
from ..study.runs import StudyError
from .trials import Spent, Trial, Trials

SURE = 0.95
ALIKE = 0.3  # smallest over largest singular value, of columns of length 1, below which it is tried
FAR = 0.25  # of the range: how far two are moved together, to see whether anything shows
SHOWS = 0.05  # of what one of them alone does: less is nothing
TWO_GRIDS = 3.0  # of an error told by two grids, for an interval of 95 % (Roache 1994, GCI)
PART = 0.3  # of a direction of length 1, from which a parameter has part in it


@dataclass(frozen=True)
class Known:
    """Of what was found: off by noise and by cells (parameters,), half of each interval in u;
    correlations (parameters, parameters); singular values of the differences, of columns of length
    1, from large to small; and how many cells the run beside it had, None where there was none."""

    noise: np.ndarray
    cells: np.ndarray
    correlation: np.ndarray
    singular: np.ndarray
    beside: int | None


def same(trials: Trials, u: np.ndarray, J: np.ndarray) -> list[int]:
    """Parameters that can be moved together with nothing to see of it; none where all can be told
    apart. Two runs where the differences J (n, parameters) suggest it: far along that direction,
    and as far along one of them alone."""
    if len(u) < 2:
        return []
    if not alike(J):
        return []
    length = np.maximum(np.linalg.norm(J, axis=0), 1e-300)
    directions = np.linalg.svd(J / length, full_matrices=False)[2]
    way = directions[-1] / length
    members = [int(k) for k in np.flatnonzero(np.abs(directions[-1]) > PART)]
    way = np.where(np.isin(np.arange(len(u)), members), way, 0.0)
    step = _inside(u, way / np.abs(way).max())
    first = members[int(np.argmax(np.abs(step[members])))]
    alone = np.where(np.arange(len(u)) == first, step, 0.0)
    trials.what = "told apart"
    stage = trials.target.stages - 1
    here, together, one = trials.ask([u, u + step, u + alone])
    if not (together.done.whole and one.done.whole):
        return []
    at = trials.off(here, stage)
    moved = [np.linalg.norm(trials.off(t, stage) - at) for t in (together, one)]
    return members if moved[0] < SHOWS * moved[1] else []


def alike(J: np.ndarray) -> bool:
    """Whether the differences (n, parameters) suggest that some parameters do the same."""
    length = np.maximum(np.linalg.norm(J, axis=0), 1e-300)
    singular = np.linalg.svd(J / length, compute_uv=False)
    return bool(singular[-1] < ALIKE * singular[0])


def _inside(u: np.ndarray, way: np.ndarray) -> np.ndarray:
    """The longest step along a direction, forwards or backwards, of at most FAR of a range."""
    best = np.zeros_like(u)
    for step in (way * FAR, -way * FAR):
        room = np.where(step > 0, 1 - u, u) / np.maximum(np.abs(step), 1e-300)
        found = step * min(1.0, float(room.min()))
        if np.abs(found).max() > np.abs(best).max():
            best = found
    return best


def known(trials: Trials, best: Trial, J: np.ndarray, grid: str) -> Known:
    """Intervals of 95 %. noise: of least squares, for errors that know nothing of each other, or
    in pictures of those beside them, over which these are blurred. cells: what differs from a run
    in other cells, as far as the parameters can make up for it, taken to fall with the cells'
    size, and thrice that."""
    stage = trials.target.stages - 1
    off, alike = trials.off(best, stage), trials.target.alike[stage]
    shown = (np.abs(J).max(1) > 0) | (off != 0)
    free = max(int(shown.sum() / alike) - J.shape[1], 1)
    inverse = np.linalg.pinv(J.T @ J)
    spread = np.sqrt(np.diag(inverse) * float(off @ off) / free)
    noise = float(student.ppf(0.5 + SURE / 2, free)) * spread
    scale = np.maximum(np.sqrt(np.diag(inverse)), 1e-300)
    length = np.maximum(np.linalg.norm(J, axis=0), 1e-300)
    singular = np.linalg.svd(J / length, compute_uv=False)
    shift, beside = of_cells(trials, best, J, grid)
    return Known(noise, shift, inverse / np.outer(scale, scale), singular, beside)


def of_cells(
    trials: Trials, best: Trial, J: np.ndarray, grid: str
) -> tuple[np.ndarray, int | None]:
    """How far what is found is off for the cells of the scene (parameters,), by one run in others;
    and how many it had along the longest edge: half, or as many more as it takes, or twice."""
    scene, stage = trials.runs.scene, trials.target.stages - 1
    own = max(scene.domain.cells)
    trials.what = f"{grid} cells"
    for count in _counts(scene, grid):
        try:
            (run,) = trials.ask([np.array(best.u)], knobs.of_cells(scene, count))
        except Spent:
            break
        except StudyError:
            continue  # bodies that are too near to open walls
        if run.done.whole:
            change = trials.off(run, stage) - trials.off(best, stage)
            moved = np.linalg.lstsq(J, change, rcond=1e-6)[0]
            # of what falls with the cells' size: the share that is left in those of the scene
            left = 1 / abs(1 - own / count)
            return TWO_GRIDS * np.abs(moved) * left, count
    return np.zeros(len(best.u)), None


def _counts(scene: Scene, grid: str) -> Iterable[int]:
    """Cells along the longest edge that tell what those of the scene do, best ones first."""
    own, unit = max(scene.domain.cells), knobs.unit_of(scene)
    if grid == "none":
        return ()
    if grid == "finer":
        return (2 * own,)
    fewest = -(-knobs.FEWEST * own // min(scene.domain.cells))
    return range(unit * -(-max(own // 2, fewest) // unit), own, unit)

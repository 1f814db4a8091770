"""Whether what a scene moves can go where it is sent, in the time it is given."""

import itertools
import logging

import numpy as np

from vgmpi.domain.movers import FAR
from vgmpi.planning.driven import course_of
from vgmpi.prepare.collider import Collider
from vgmpi.scene.motion import LOOKS, Courses
from vgmpi.scene.objects import Object
from vgmpi.scene.scene import Scene

log = logging.getLogger("vgmpi")

THIN = 2.0  # cells, below which a collider is not seen as it is; three where two of its walls meet
UNSURE = 0.25  # cells, of a thickness that is found on a lattice
MOST = 2_000_000  # points looked at to find that


def astray(scene: Scene, collider: Collider | None) -> list[tuple[tuple, str]]:
    """(key of its object, text) for each part of a collider's motion that leaves the domain, or is
    too fast for a fixed time step. Warns of one that is thin."""
    if collider is None:
        return []
    thick = _thickness(collider, scene.domain.cell)
    if thick < (THIN - UNSURE) * scene.domain.cell:
        log.warning(
            "collider '%s' is %.2g cells thick where it is thickest: below %g what it keeps apart"
            " may pass", collider.name, thick / scene.domain.cell, THIN,
        )  # fmt: skip
    if collider.course is None:
        return []
    found, courses = [], Courses([collider.course])
    for t0, t1, key in collider.course.legs(scene.time.end):
        far = collider.course.far(*collider.ends())
        said = _too_fast(scene, float(courses.fastest(t0, t1, np.array([far]))[0]))
        said = said or _outside(scene, collider, courses, t1)
        found += [(("motion", *key), said)] if said else []
    return found


def leaves(scene: Scene, thing: Object, x: np.ndarray) -> list[tuple[tuple, str]]:
    """(key of its object, text) for each part of the motion of a body, with particles at x (n, 3)
    [m], that takes some of it out of the domain, or is too fast for a fixed time step."""
    if not thing.driven or thing.motion is None or not len(x):
        return []
    low, high = extent(x)
    course = course_of(thing, low, high)
    found, courses, hull = [], Courses([course]), _hull(x)
    for t0, t1, key in course.legs(scene.time.end):
        far = np.array([course.far(low, high)])
        said = _too_fast(scene, float(courses.fastest(t0, t1, far)[0]))
        for time in np.linspace(t0, t1, LOOKS + 1)[1:]:
            said = said or _beyond(scene, hull, courses, float(time))
        found += [(("motion", *key), said)] if said else []
    return found


def extent(x: np.ndarray) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Lower and upper corner [m] of particles at x (n, 3) [m]; of none, the origin."""
    if not len(x):
        return (0.0,) * 3, (0.0,) * 3
    return tuple(map(float, x.min(axis=0))), tuple(map(float, x.max(axis=0)))


def _hull(x: np.ndarray) -> np.ndarray:
    """Those of the points x (n, 3) that are farthest out in any direction."""
    from scipy.spatial import ConvexHull, QhullError  # only where a body is driven

    try:
        return x[ConvexHull(x).vertices]
    except QhullError:  # flat
        return x


def _beyond(scene: Scene, x: np.ndarray, courses: Courses, time: float) -> str:
    """Of a body with points at x (n, 3) [m] at the start, of which one is outside the domain at a
    time [s]."""
    pose = courses.matrices(time)[0]
    at = x @ pose[:3, :3].T + pose[:3, 3]
    for a, name in enumerate("xyz"):
        low, high, size = at[:, a].min(), at[:, a].max(), scene.domain.size[a]
        if low < 0 or high > size:
            return (
                f"takes the body out of the domain: at {time:.4g} s it is at {name} ="
                f" {low:.4g} .. {high:.4g} m; the domain is 0 .. {size:g} m"
            )
    return ""


def _too_fast(scene: Scene, speed: float) -> str:
    most, dt = FAR * scene.domain.cell, scene.time.dt
    if speed * dt <= most:
        return ""
    gone = speed * dt / scene.domain.cell
    return (
        f"moves at up to {speed:.4g} m/s, {gone:.3g} cells in a step of time.dt = {dt:g} s: at most"
        f" {FAR:g} are possible, by time.dt = {most / speed:.2g} s or without time.dt"
    )


def _outside(scene: Scene, collider: Collider, courses: Courses, time: float) -> str:
    """Of one that is nowhere in the domain at a time [s]."""
    corners = np.array(list(itertools.product(*zip(*collider.ends(), strict=True))))
    pose = courses.matrices(time)[0]
    corners = corners @ pose[:3, :3].T + pose[:3, 3]
    low, high = corners.min(axis=0), corners.max(axis=0)
    for a, name in enumerate("xyz"):
        size = scene.domain.size[a]
        if high[a] < 0 or low[a] > size:
            return (
                f"leads out of the domain: at {time:g} s all of it is at {name} = {low[a]:.4g} .."
                f" {high[a]:.4g} m; the domain is 0 .. {size:g} m"
            )
    return ""


def _thickness(collider: Collider, dx: float) -> float:
    """Twice the greatest depth [m] of a point in it, to half a cell; infinite where there would be
    too many points to look at."""
    low, high = collider.ends()
    counts = 2 * np.ceil((high - low) / dx).astype(int) + 1  # the middle is one of them
    if np.prod(counts.astype(float)) > MOST:
        return np.inf
    axes = [np.linspace(a, b, n) for a, b, n in zip(low, high, counts, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    return -2.0 * float(collider.distance(points).min())

"""Checks of prescribed motions: they stay in the domain and respect a fixed time step."""

import itertools
import logging

import numpy as np

from vgmpi.kernels.colliders.moving_colliders import MAX_COLLIDER_TRAVEL_CELLS
from vgmpi.planning.plan import MAX_STEPS
from vgmpi.scene.objects import Object
from vgmpi.scene.rigid_motion import SPEED_SAMPLES, Trajectories, Trajectory, course_of
from vgmpi.scene.scene import Scene
from vgmpi.scene.scene_feature import hint

from .collider_sdf import Collider

log = logging.getLogger("vgmpi")

MIN_THICKNESS_CELLS = 2.0  # [cells] of a body or collider, below which the grid does not resolve it
THICKNESS_TOLERANCE_CELLS = 0.25  # [cells] of a thickness that was measured on a lattice
MAX_SAMPLES = 2_000_000  # [points] of that lattice
# intervals of a run for which the travel of motions is computed, and samples of each
TRAVEL_INTERVALS, TRAVEL_SAMPLES = 128, 8


def validate_collider_motion(scene: Scene, collider: Collider | None) -> list[tuple[tuple, str]]:
    """Return (key of its object, message) for each invalid segment of a collider's motion.

    A segment is invalid if the collider leaves the domain, or is too fast for a fixed time step. A
    thin collider gives a warning.
    """
    if collider is None:
        return []
    if (
        collider.body is None and collider.detail is None
    ):  # free bodies have a line of their own in the plan
        _warn_if_thin(collider, scene.domain.cell)
    if collider.course is None:
        return []
    errors, courses = [], Trajectories([collider.course])
    for t0, t1, key in collider.course.segments(scene.time.end):
        radius = collider.course.max_radius(*collider.ends())
        speed = float(courses.fastest(t0, t1, np.array([radius]))[0])
        message = _too_fast(scene, speed, t1 - t0) or _outside(scene, collider, courses, t1)
        errors += [(("motion", *key), message)] if message else []
    return errors


def validate_body_motion(scene: Scene, obj: Object, x: np.ndarray) -> list[tuple[tuple, str]]:
    """Return (key of its object, message) for each invalid segment of a prescribed body's motion.

    A segment is invalid if it takes some particle out of the domain, or is too fast for a fixed
    time step. x: particles, shape (n, 3) [m].
    """
    if obj.role != "body" or obj.motion is None or not len(x):
        return []
    low, high = extent(x)
    course = course_of(obj.motion, low, high)
    errors, courses, hull = [], Trajectories([course]), _hull(x)
    for t0, t1, key in course.segments(scene.time.end):
        radius = np.array([course.max_radius(low, high)])
        message = _too_fast(scene, float(courses.fastest(t0, t1, radius)[0]), t1 - t0)
        for time in np.linspace(t0, t1, SPEED_SAMPLES + 1)[1:]:
            message = message or _outside_domain(scene, hull, courses, float(time))
        errors += [(("motion", *key), message)] if message else []
    return errors


def extent(x: np.ndarray) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return lower and upper corner [m] of particles at x (n, 3) [m]; the origin without any."""
    if not len(x):
        return (0.0,) * 3, (0.0,) * 3
    return tuple(map(float, x.min(axis=0))), tuple(map(float, x.max(axis=0)))


def _hull(x: np.ndarray) -> np.ndarray:
    """Return the points of x (n, 3) [m] on the convex hull."""
    from scipy.spatial import (
        ConvexHull,
        QhullError,
    )  # imported here, since only prescribed bodies need it

    try:
        return x[ConvexHull(x).vertices]
    except QhullError:  # flat
        return x


def _outside_domain(scene: Scene, x: np.ndarray, courses: Trajectories, time: float) -> str:
    """Return an error if a body leaves the domain at a time [s], or "".

    x: its points at the start, shape (n, 3) [m].
    """
    pose = courses.matrices(time)[0]
    position = x @ pose[:3, :3].T + pose[:3, 3]
    for a, name in enumerate("xyz"):
        low, high, size = position[:, a].min(), position[:, a].max(), scene.domain.size[a]
        if low < 0 or high > size:
            return (
                f"takes the body out of the domain: at {time:.4g} s it is at {name} ="
                f" {low:.4g} .. {high:.4g} m; the domain is 0 .. {size:g} m"
            )
    return ""


def motion_steps(
    scene: Scene, colliders: list[Collider], of_bodies: list[tuple[Trajectory, float]]
) -> np.ndarray:
    """Return the steps that prescribed motions take in equal intervals of the run, shape (n,).

    The fastest point of the fastest collider or body counts; there is no entry if nothing moves.

    Args:
        scene: The scene.
        colliders: Its colliders.
        of_bodies: Motion of each body that moves, and its largest radius about the axis [m].
    """
    courses = [
        (c.course, c.course.max_radius(*c.ends())) for c in colliders if c.course is not None
    ]
    courses += of_bodies
    if not courses:
        return np.zeros(0)
    every = Trajectories([course for course, _ in courses])
    radius = np.array([far for _, far in courses])
    times = np.linspace(0.0, scene.time.end, TRAVEL_INTERVALS * TRAVEL_SAMPLES + 1)
    travel = np.array([every.travels(a, b, radius).max() for a, b in itertools.pairwise(times)])
    step = MAX_COLLIDER_TRAVEL_CELLS * scene.domain.cell
    return travel.reshape(-1, TRAVEL_SAMPLES).sum(axis=1) / step


def _too_fast(scene: Scene, speed: float, duration: float) -> str:
    """Return an error if a speed [m/s] needs too many steps or too short a fixed one, or ""."""
    limit, dt = MAX_COLLIDER_TRAVEL_CELLS * scene.domain.cell, scene.time.dt
    if speed * duration > MAX_STEPS * limit:
        return (
            f"moves at up to {speed:.4g} m/s, which are {speed * duration / limit:.2g} steps of"
            f" {MAX_COLLIDER_TRAVEL_CELLS:g} cells: at most {MAX_STEPS:.2g} are possible"
        )
    if speed * dt <= limit:
        return ""
    cell_count = speed * dt / scene.domain.cell
    return (
        f"moves at up to {speed:.4g} m/s, {cell_count:.3g} cells in a step of time.dt = {dt:g} s:"
        f" at most {MAX_COLLIDER_TRAVEL_CELLS:g} are possible,"
        f" by time.dt = {limit / speed:.2g} s or without time.dt"
    )


def _outside(scene: Scene, collider: Collider, courses: Trajectories, time: float) -> str:
    """Return an error if a collider is wholly outside the domain at a time [s], or ""."""
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


def is_thin(thickness: float, dx: float) -> bool:
    """Return whether the grid does not resolve a body or collider.

    Args:
        thickness: Its thickness [m], measured on a lattice.
        dx: Cell size [m].
    """
    return thickness < (MIN_THICKNESS_CELLS - THICKNESS_TOLERANCE_CELLS) * dx


def _warn_if_thin(collider: Collider, dx: float) -> None:
    """Warn of a collider that the grid does not resolve."""
    thickness = _thickness(collider, dx)
    if is_thin(thickness, dx):
        log.warning(
            "collider '%s' is %.2g cells thick where it is thickest: below %g what it keeps apart"
            " may pass%s", collider.name, thickness / dx, MIN_THICKNESS_CELLS,
            hint("thin collider"),
        )  # fmt: skip


def _thickness(collider: Collider, dx: float) -> float:
    """Return twice the largest depth [m] in a collider, to half a cell.

    It is infinite if there would be too many points to test.
    """
    low, high = collider.ends()
    counts = 2 * np.ceil((high - low) / dx).astype(int) + 1  # the center is one of the points
    if np.prod(counts.astype(float)) > MAX_SAMPLES:
        return np.inf
    axes = [np.linspace(a, b, n) for a, b, n in zip(low, high, counts, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    return -2.0 * float(collider.distance(points).min())

"""Signed distance of shapes: `[object.shape]` of a scene, or the same from the files of a run.

A shape is any object with the attribute `form`, the name of another one with the numbers of the
form. Distances are in the shape's own coordinates [m], negative inside.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np


def distance(shape: Any, points: np.ndarray) -> np.ndarray:
    """Return the signed distance (n,) of `points` (n, 3) to the shape's surface.

    Exact for box, sphere, cylinder, capsule, cone and torus; first order near an ellipsoid; a bound
    on the true distance for unions from inside, blended ones and differences (Quilez 2008).
    """
    form = getattr(shape, shape.form)
    match shape.form:
        case "box":
            low, high = np.asarray(form)
            return _from_box(np.abs(points - (low + high) / 2) - (high - low) / 2)
        case "sphere":
            return _length(points - np.asarray(form.center)) - form.radius
        case "ellipsoid":
            return _from_ellipsoid(points - np.asarray(form.center), np.asarray(form.radii))
        case "cylinder":
            return _from_cylinder(form, points)
        case "capsule":
            along, across, length = _rod_coordinates(form, points)
            beyond = along - np.clip(along, 0.0, length)
            return np.hypot(beyond, across) - form.radius
        case "cone":
            return _from_cone(form, points)
        case "torus":
            along, across = _about_axis(form, points)
            return np.hypot(across - form.major_radius, along) - form.minor_radius
        case "union":
            return _union((distance(part, points) for part in form), shape.blend_radius)
    sign = 1.0 if shape.form == "intersection" else -1.0
    out = distance(form[0], points)
    for part in form[1:]:  # one after the other, since there may be hundreds
        out = np.maximum(out, sign * distance(part, points))
    return out


def normals(shape: Any, points: np.ndarray, step: float) -> np.ndarray:
    """Return outward unit normals (n, 3) by central differences over 2 `step` [m]."""
    out = np.empty_like(points)
    for axis in range(3):
        shift = np.zeros(3)
        shift[axis] = step
        out[:, axis] = distance(shape, points + shift) - distance(shape, points - shift)
    size = _length(out)[:, None]
    return np.where(size > 0, out / np.maximum(size, 1e-300), (0.0, 0.0, 1.0))


def _length(v: np.ndarray) -> np.ndarray:
    """Return the lengths of vectors (n, 3)."""
    return np.sqrt(v[:, 0] ** 2 + v[:, 1] ** 2 + v[:, 2] ** 2)


def _from_box(q: np.ndarray) -> np.ndarray:
    """Return the distance from |x - center| - half edges, both (n, k)."""
    square, side = np.maximum(q[:, 0], 0.0) ** 2, q[:, 0]
    for axis in range(1, q.shape[1]):  # by columns: NumPy reduces short rows one by one
        square += np.maximum(q[:, axis], 0.0) ** 2
        side = np.maximum(side, q[:, axis])
    return np.sqrt(square) + np.minimum(side, 0.0)


def _from_ellipsoid(x: np.ndarray, radii: np.ndarray) -> np.ndarray:
    """Return the approximate distance to an ellipsoid."""
    k0, k1 = _length(x / radii), _length(x / radii**2)
    estimate = k0 * (k0 - 1.0) / np.maximum(k1, 1e-300)
    return np.where(k1 > 0, estimate, -radii.min())


def _union(parts: Iterator[np.ndarray], blend: float | None) -> np.ndarray:
    """Return the distance (n,) to the union of parts with given distances.

    Blended (Quilez 2013): each pair within `blend` of each other loses up to a quarter of it, so
    that edges between them become parabolas; slopes stay at most 1.
    """
    out = next(parts)
    for part in parts:
        lower = np.minimum(out, part)
        if blend is not None:
            lower = lower - np.maximum(blend - np.abs(out - part), 0.0) ** 2 / (4 * blend)
        out = lower
    return out


def _about_axis(ring: Any, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the distances along the axis from the center, and from the axis."""
    x, axis = points - np.asarray(ring.center), np.asarray(ring.axis)
    along = x[:, 0] * axis[0] + x[:, 1] * axis[1] + x[:, 2] * axis[2]
    return along, _length(x - along[:, None] * axis)


def _from_cone(cone: Any, points: np.ndarray) -> np.ndarray:
    """Return the distance from the two flat ends and the slope between their rims.

    It is computed in the half-plane of the axis.
    """
    along, across, length = _rod_coordinates(cone, points)
    first, second = cone.radii
    # The ends are discs at 0 and at `length`.
    is_first_half = along <= length / 2
    beyond = np.maximum(across - np.where(is_first_half, first, second), 0.0)
    to_end = np.where(is_first_half, along, along - length) ** 2 + beyond**2
    # The slope goes from (0, first) to (length, second).
    slope = (length, second - first)
    fraction = along * slope[0] + (across - first) * slope[1]
    fraction = np.clip(fraction / max(slope[0] ** 2 + slope[1] ** 2, 1e-300), 0.0, 1.0)
    to_slope = (along - fraction * slope[0]) ** 2 + (across - first - fraction * slope[1]) ** 2
    inside = (along > 0) & (along < length)
    inside &= across * length < first * length + along * slope[1]
    return np.where(inside, -1.0, 1.0) * np.sqrt(np.minimum(to_end, to_slope))


def _rod_coordinates(rod: Any, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Return the distances along the axis from its first end and from it, and its length."""
    a, b = np.asarray(rod.endpoints)
    length = float(np.linalg.norm(b - a))
    axis = (b - a) / max(length, 1e-300)
    x = points - a
    along = x[:, 0] * axis[0] + x[:, 1] * axis[1] + x[:, 2] * axis[2]
    return along, _length(x - along[:, None] * axis), length


def _from_cylinder(rod: Any, points: np.ndarray) -> np.ndarray:
    """Return the distance to a cylinder."""
    along, across, length = _rod_coordinates(rod, points)
    q = np.stack([np.abs(along - length / 2) - length / 2, across - rod.radius], axis=1)
    return _from_box(q)

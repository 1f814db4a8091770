"""Shapes of solids in a scene."""

import math
from typing import Annotated, Any

from pydantic import BeforeValidator

from vgmpi.runtime.config.schema import (
    Color,
    Point,
    Positive,
    Quantity,
    StrictModel,
    parse_vector3,
)

SHAPE_KINDS = (
    "box",
    "sphere",
    "ellipsoid",
    "cylinder",
    "capsule",
    "cone",
    "torus",
    "union",
    "difference",
    "intersection",
)

UNIT_VECTORS = {
    "x": (1.0, 0.0, 0.0),
    "-x": (-1.0, 0.0, 0.0),
    "y": (0.0, 1.0, 0.0),
    "-y": (0.0, -1.0, 0.0),
    "z": (0.0, 0.0, 1.0),
    "-z": (0.0, 0.0, -1.0),
}


def _axis(value: Any) -> tuple[float, float, float]:
    """Return a unit vector from "x", "-x", "y", "-y", "z", "-z" or three numbers."""
    numbers = UNIT_VECTORS.get(value) if isinstance(value, str) else parse_vector3(value)
    if numbers is None or not any(numbers):
        names = ", ".join(map(repr, UNIT_VECTORS))
        raise ValueError(f"must be {names} or three numbers that are not all 0")
    x, y, z = numbers
    size = math.hypot(x, y, z)
    return x / size, y / size, z / size


def _corners(value: Any) -> Any:
    """Refuse a box whose first corner is not the lower one; other errors are reported later."""
    try:
        low, high = ([Quantity("m").parse(c) for c in corner] for corner in value)
    except (ValueError, TypeError):
        return value
    if len(low) == len(high) == 3 and any(a >= b for a, b in zip(low, high, strict=True)):
        raise ValueError("must be [[x0, y0, z0], [x1, y1, z1]] with x0 < x1, y0 < y1, z0 < z1")
    return value


Axis = Annotated[tuple[float, float, float], BeforeValidator(_axis)]
Corners = Annotated[tuple[Point, Point], BeforeValidator(_corners)]
NonNegativeLength = Annotated[float, Quantity("m", ge=0)]


class Sphere(StrictModel):
    """Ball."""

    center: Point
    """its center"""
    radius: Positive
    """its radius"""


class Ellipsoid(StrictModel):
    """Ellipsoid with axes along x, y and z."""

    center: Point
    """its center"""
    radii: tuple[Positive, Positive, Positive]
    """half axes along x, y and z"""


class CylinderShape(StrictModel):
    """Cylinder (flat ends) or capsule (round ends that extend beyond the axis by the radius)."""

    endpoints: tuple[Point, Point]
    """the two ends of its axis"""
    radius: Positive
    """its radius"""


class Cone(StrictModel):
    """Cone, or a frustum between two flat ends."""

    endpoints: tuple[Point, Point]
    """the two ends of its axis"""
    radii: tuple[NonNegativeLength, NonNegativeLength]
    """its radius at each of them; 0 is a tip"""


class Torus(StrictModel):
    """Ring."""

    center: Point
    """its center"""
    axis: Axis = (0.0, 0.0, 1.0)
    """axis of symmetry: "x", "-x", "y", "-y", "z", "-z" or three numbers"""
    major_radius: Positive
    """radius of the center line of its tube"""
    minor_radius: Positive
    """radius of the tube"""


class Shape(StrictModel):
    """Solid: exactly one of the keys box, sphere, ellipsoid, cylinder, capsule, cone, torus, union,
    difference, intersection.
    """

    box: Corners | None = None
    """lower and upper corner"""
    sphere: Sphere | None = None
    """{ center, radius }"""
    ellipsoid: Ellipsoid | None = None
    """{ center, radii }"""
    cylinder: CylinderShape | None = None
    """{ endpoints, radius }"""
    capsule: CylinderShape | None = None
    """{ endpoints, radius }"""
    cone: Cone | None = None
    """{ endpoints, radii }"""
    torus: Torus | None = None
    """{ center, axis, major_radius, minor_radius }"""
    union: tuple["Shape", ...] | None = None
    """list of shapes; where they overlap the first one gives the color"""
    difference: tuple["Shape", ...] | None = None
    """list of shapes: the first minus all others. A shape that cuts a hole into a collider must
    extend three cells beyond it on both sides, because water stops at its ends, too"""
    intersection: tuple["Shape", ...] | None = None
    """list of shapes: what lies in all of them; the first one gives the color"""
    blend_radius: Positive | None = None
    """unions only: radius of rounded edges between parts; coincident surfaces of parts move outward
    by a quarter of it"""
    color: Color | None = None
    """color of this part; default: that of the object"""

    @property
    def form(self) -> str:
        """Return which kind of shape it is."""
        return next(form for form in SHAPE_KINDS if getattr(self, form) is not None)


def validate_shape(raw: Any, path: tuple) -> list[tuple[tuple, str]]:
    """Return (path, message) for every shape inside `raw` that has no kind or several."""
    if not isinstance(raw, dict):
        return []
    errors = []
    present = [form for form in SHAPE_KINDS if form in raw]
    if len(present) > 1:
        errors.append((path, f"has {' and '.join(present)}: give exactly one"))
    if not present:
        errors.append((path, f"has no form: give one of {', '.join(SHAPE_KINDS)}"))
    if "blend_radius" in raw and "union" not in raw:
        errors.append(((*path, "blend_radius"), "is only for a union"))
    for form in ("union", "difference", "intersection"):
        parts = raw.get(form)
        if isinstance(parts, list) and len(parts) < 2:
            errors.append(((*path, form), f"needs at least 2 shapes; got {len(parts)}"))
        for k, part in enumerate(parts if isinstance(parts, list) else []):
            errors += validate_shape(part, (*path, form, k))
    return errors

"""The forms that solids are made of, as they stand in a scene."""

import math
from typing import Annotated, Any

from pydantic import BeforeValidator

from vgmpi.tables import Colour, Point, Positive, Quantity, Table, three

FORMS = (
    "box",
    "sphere",
    "ellipsoid",
    "cylinder",
    "capsule",
    "cone",
    "torus",
    "union",
    "difference",
)


def _axis(value: Any) -> tuple[float, float, float]:
    named = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
    numbers = named.get(value) if isinstance(value, str) else three(value)
    if numbers is None or not any(numbers):
        raise ValueError("must be 'x', 'y', 'z' or three numbers that are not all 0")
    x, y, z = numbers
    size = math.hypot(x, y, z)
    return x / size, y / size, z / size


def _corners(value: Any) -> Any:
    """Refuse a box whose first corner is not the lower one; anything else wrong is said later."""
    try:
        low, high = ([Quantity("m").parse(c) for c in corner] for corner in value)
    except (ValueError, TypeError):
        return value
    if len(low) == len(high) == 3 and any(a >= b for a, b in zip(low, high, strict=True)):
        raise ValueError("must be [[x0, y0, z0], [x1, y1, z1]] with x0 < x1, y0 < y1, z0 < z1")
    return value


Axis = Annotated[tuple[float, float, float], BeforeValidator(_axis)]
Corners = Annotated[tuple[Point, Point], BeforeValidator(_corners)]
Wide = Annotated[float, Quantity("m", ge=0)]


class Sphere(Table):
    """A ball."""

    center: Point
    """its middle"""
    radius: Positive
    """its radius"""


class Ellipsoid(Table):
    """An ellipsoid with axes along x, y and z."""

    center: Point
    """its middle"""
    radii: tuple[Positive, Positive, Positive]
    """half its extent along x, y and z"""


class Rod(Table):
    """A cylinder (flat ends) or capsule (round ends that stick out by the radius)."""

    ends: tuple[Point, Point]
    """the two ends of its axis"""
    radius: Positive
    """its radius"""


class Cone(Table):
    """A cone, or a piece of one between two flat ends."""

    ends: tuple[Point, Point]
    """the two ends of its axis"""
    radii: tuple[Wide, Wide]
    """its radius at each of them; 0 is a tip"""


class Torus(Table):
    """A ring."""

    center: Point
    """its middle"""
    axis: Axis = (0.0, 0.0, 1.0)
    """what it lies around: "x", "y", "z" or three numbers"""
    radius: Positive
    """of the circle in the middle of its tube"""
    tube: Positive
    """radius of the tube"""


class Shape(Table):
    """A solid: exactly one of box, sphere, ellipsoid, cylinder, capsule, cone, torus, union,
    difference."""

    box: Corners | None = None
    """lower and upper corner"""
    sphere: Sphere | None = None
    """{ center, radius }"""
    ellipsoid: Ellipsoid | None = None
    """{ center, radii }"""
    cylinder: Rod | None = None
    """{ ends, radius }"""
    capsule: Rod | None = None
    """{ ends, radius }"""
    cone: Cone | None = None
    """{ ends, radii }"""
    torus: Torus | None = None
    """{ center, axis, radius, tube }"""
    union: tuple["Shape", ...] | None = None
    """list of shapes; where they overlap the first one gives the colour"""
    difference: tuple["Shape", ...] | None = None
    """list of shapes: the first without all others. What cuts a hole into a collider must reach
    three cells out of it on both sides: water stops at its ends, too"""
    blend: Positive | None = None
    """unions only: edges where parts meet are rounded over about this length; where surfaces of
    parts coincide they move out by a quarter of it"""
    colour: Colour | None = None
    """colour of this part; without it the object's"""

    @property
    def form(self) -> str:
        """Which of the forms it is."""
        return next(form for form in FORMS if getattr(self, form) is not None)


def shape_complaints(raw: Any, path: tuple) -> list[tuple[tuple, str]]:
    """(path, text) for every shape inside `raw` that has none or several forms."""
    if not isinstance(raw, dict):
        return []
    found = []
    forms = [form for form in FORMS if form in raw]
    if len(forms) > 1:
        found.append((path, f"has {' and '.join(forms)}: give exactly one"))
    if not forms:
        found.append((path, f"has no form: give one of {', '.join(FORMS)}"))
    if "blend" in raw and "union" not in raw:
        found.append(((*path, "blend"), "is only for a union"))
    for form in ("union", "difference"):
        parts = raw.get(form)
        if isinstance(parts, list) and len(parts) < 2:
            found.append(((*path, form), f"needs at least 2 shapes; got {len(parts)}"))
        for k, part in enumerate(parts if isinstance(parts, list) else []):
            found += shape_complaints(part, (*path, form, k))
    return found

"""What can stand in a scene: objects from Gaussians, meshes and shapes, and how they are placed."""

import math
import re
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, model_validator

from vgmpi.tables import Length, Point, Positive, Quantity, Share, Table, nearest

SOURCES = ("gaussians", "mesh", "shape")
SIZES = ("height", "width", "depth", "scale")
FORMS = ("box", "sphere", "ellipsoid", "cylinder", "capsule", "union", "difference")
PER_CELL = (1, 8, 27, 64)
OF_BODIES = (
    "material",
    "velocity",
    "spin",
    "mode",
    "fraction",
    "fraction_profile",
    "compressed",
    "phase",
)

Velocity = tuple[
    Annotated[float, Quantity("m/s")],
    Annotated[float, Quantity("m/s")],
    Annotated[float, Quantity("m/s")],
]
Wavenumber = Annotated[float, Quantity("rad/m")]
Spin = tuple[
    Annotated[float, Quantity("rad/s")],
    Annotated[float, Quantity("rad/s")],
    Annotated[float, Quantity("rad/s")],
]


def _three(value: Any) -> tuple[float, float, float] | None:
    """Three finite numbers, or None."""
    if not isinstance(value, list | tuple) or len(value) != 3:
        return None
    if not all(isinstance(c, int | float) and math.isfinite(c) for c in value):
        return None
    return float(value[0]), float(value[1]), float(value[2])


def _color(value: Any) -> tuple[float, float, float]:
    if isinstance(value, str) and re.fullmatch(r"#[0-9a-fA-F]{6}", value):
        red, green, blue = (int(value[k : k + 2], 16) / 255 for k in (1, 3, 5))
        return red, green, blue
    numbers = _three(value)
    if numbers is None or min(numbers) < 0 or max(numbers) > 1:
        raise ValueError("must be a colour such as '#6fb7d6' or three numbers from 0 to 1")
    return numbers


def _axis(value: Any) -> tuple[float, float, float]:
    named = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
    numbers = named.get(value) if isinstance(value, str) else _three(value)
    if numbers is None or not any(numbers):
        raise ValueError("must be 'x', 'y', 'z' or three numbers that are not all 0")
    x, y, z = numbers
    size = math.hypot(x, y, z)
    return x / size, y / size, z / size


def checked_name(value: Any) -> str:
    """A name that can stand in messages and file names."""
    if not isinstance(value, str) or not re.fullmatch(r"[^\W\d][\w -]*", value):
        raise ValueError("must begin with a letter and hold letters, digits, spaces, _ and - only")
    return value


def _per_cell(value: Any) -> int:
    if isinstance(value, bool) or value not in PER_CELL:
        raise ValueError("must be 1, 8, 27 or 64: a whole number of particles per cell and axis")
    return int(value)


def _corners(value: Any) -> Any:
    """Refuse a box whose first corner is not the lower one; anything else wrong is said later."""
    try:
        low, high = ([Quantity("m").parse(c) for c in corner] for corner in value)
    except (ValueError, TypeError):
        return value
    if len(low) == len(high) == 3 and any(a >= b for a, b in zip(low, high, strict=True)):
        raise ValueError("must be [[x0, y0, z0], [x1, y1, z1]] with x0 < x1, y0 < y1, z0 < z1")
    return value


Color = Annotated[tuple[float, float, float], BeforeValidator(_color)]
Axis = Annotated[tuple[float, float, float], BeforeValidator(_axis)]
Corners = Annotated[tuple[Point, Point], BeforeValidator(_corners)]


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


class Shape(Table):
    """A solid: exactly one of box, sphere, ellipsoid, cylinder, capsule, union, difference."""

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
    union: tuple["Shape", ...] | None = None
    """list of shapes; where they overlap the first one gives the colour"""
    difference: tuple["Shape", ...] | None = None
    """list of shapes: the first without all others"""
    color: Color | None = None
    """colour of this part; without it the object's"""

    @property
    def form(self) -> str:
        """Which of the forms it is."""
        return next(form for form in FORMS if getattr(self, form) is not None)


class Select(Table):
    """Which Gaussians of a capture to keep; lengths are in the file's own units and axes."""

    box: Corners | None = None
    """keep those inside: lower and upper corner"""
    sphere: Sphere | None = None
    """keep those inside: { center, radius }"""
    min_opacity: Share = 0.0
    """drop those fainter than this"""
    outliers: Annotated[float, Quantity("", ge=0)] = 0.0
    """drop those whose mean distance to 8 neighbours is this many standard deviations above the
    cloud's mean (2 .. 4 removes floaters); 0: keep all"""


class Rotation(Table):
    """A turn about an axis through the object."""

    axis: Axis
    """"x", "y", "z" or three numbers"""
    angle: Annotated[float, Quantity("rad")]
    """right-handed angle"""


class Mode(Table):
    """A wave of velocities at the start: amplitude sin(wave . x + phase)."""

    amplitude: Velocity
    """largest velocity"""
    wave: tuple[Wavenumber, Wavenumber, Wavenumber]
    """wave vector k, 2 pi / wavelength along its direction; x is the position in the domain"""
    phase: Annotated[float, Quantity("rad")] = 0.0
    """"90 deg" makes the sine a cosine"""


class Profile(Table):
    """A share that changes along one axis: straight lines between points, constant beyond them."""

    axis: Literal["x", "y", "z"]
    """along which it changes"""
    at: tuple[Length, ...]
    """ascending positions in the domain, two or more"""
    share: tuple[Share, ...]
    """the share at each of them; no particles where it is 0"""

    @model_validator(mode="after")
    def _matches(self) -> "Profile":
        if len(self.at) < 2 or len(self.at) != len(self.share):
            raise ValueError("at and share must be of one length, 2 or more")
        if any(a >= b for a, b in zip(self.at, self.at[1:])):
            raise ValueError("at must ascend")
        return self


def _listed(value: Any) -> Any:
    return [value] if isinstance(value, dict) else value


class Object(Table):
    """One thing in the scene: exactly one of gaussians, mesh, shape."""

    name: Annotated[str, BeforeValidator(checked_name)]
    """unique name: letters, digits, spaces, _ and -, beginning with a letter"""
    role: Literal["body", "scenery"] = "body"
    """body: has mass and moves. scenery: is only drawn, and may be a collider"""
    material: str | None = None
    """name of a [material.*] table; required for a body, absent for scenery"""
    gaussians: str | None = None
    """a Gaussian file (.ply .splat .spz), relative to the scene's folder"""
    mesh: str | None = None
    """a surface mesh (.obj .stl .ply .vtk .vtu), relative to the scene's folder"""
    shape: Shape | None = None
    """a solid made of simple forms"""
    select: Select | None = None
    """which part of a capture (gaussians) to take"""
    up: Literal["x", "-x", "y", "-y", "z", "-z"] = "z"
    """axis of the file that points up; most captures have "-y", most meshes "y\""""
    height: Positive | None = None
    """scale the object to this extent along z (before `rotation`)"""
    width: Positive | None = None
    """scale the object to this extent along x (before `rotation`)"""
    depth: Positive | None = None
    """scale the object to this extent along y (before `rotation`)"""
    scale: Annotated[float, Quantity("", gt=0)] | None = None
    """linear scale from the file's units to metres; default 1"""
    rotation: Annotated[tuple[Rotation, ...], BeforeValidator(_listed)] = ()
    """{ axis, angle } or a list of them, applied in order"""
    position: Point | None = None
    """where the middle of its base comes to lie: middle of the extent in x and y, lowest z"""
    origin: Point | None = None
    """instead of `position`: where the origin of its own coordinates comes to lie. Parts of one
    capture stay together with the same scale, rotation and origin. Default for shapes: 0, 0, 0"""
    velocity: Velocity = (0.0, 0.0, 0.0)
    """at the start"""
    spin: Spin = (0.0, 0.0, 0.0)
    """angular velocity at the start, about the centre of mass"""
    mode: Annotated[tuple[Mode, ...], BeforeValidator(_listed)] = ()
    """waves of velocity at the start, besides velocity and spin: { amplitude, wave, phase } or a
    list of them"""
    fraction: Annotated[float, Quantity("", gt=0, le=1)] = 1.0
    """share of the space it lies in that is its own: where two objects lie over each other, their
    shares should add up to 1. Its particles' volumes and masses are scaled by it"""
    fraction_profile: Profile | None = None
    """instead of `fraction`: { axis, at, share }, a share that changes along an axis"""
    compressed: Literal["no", "hydrostatic"] = "no"
    """fluids only. hydrostatic: at rest under gravity from the start, the pressure is the weight of
    the fluid between each particle and the object's top; without it a deep pool first bounces"""
    phase: str | None = None
    """objects of one kind of material with the same phase share one velocity field: they stick
    together instead of colliding. Default: all fluids share one, each solid has its own"""
    particles_per_cell: Annotated[int, BeforeValidator(_per_cell)] = 8
    """particles per full cell inside shapes, meshes and fillings: 1, 8, 27 or 64"""
    fill: Literal[True, False, "closed"] = True
    """fill a capture's hollow inside. true: also through holes in its surface; "closed": only
    where the surface is closed; false: leave it hollow"""
    prune: Literal["off"] = "off"
    """thin out a capture: off"""
    color: Color = (0.7, 0.7, 0.7)
    """colour of shapes, and of meshes without colours: "#rrggbb" or three numbers 0..1"""
    opacity: Share = 0.95
    """opacity of the Gaussians made for shapes, meshes and fillings"""
    opacity_scale: Share = 1.0
    """fluids only: factor on opacities when drawn; water looks like water at 0.005 .. 0.05"""
    alpha_min: Annotated[float, Quantity("", ge=1e-5, le=0.5)] | None = None
    """contributions fainter than this are not drawn; default 1/255, and 1e-4 where
    opacity_scale is below 0.1"""
    collider: bool = False
    """scenery only: bodies collide with it"""

    @property
    def source(self) -> str:
        """Which of gaussians, mesh, shape it is made from."""
        return next(key for key in SOURCES if getattr(self, key) is not None)

    @property
    def speed(self) -> float:
        """[m/s] A bound on its speed at the start, its spin aside."""
        return math.hypot(*self.velocity) + sum(math.hypot(*m.amplitude) for m in self.mode)

    @property
    def drawn_from(self) -> float:
        """The faintest contribution that is drawn."""
        if self.alpha_min is not None:
            return self.alpha_min
        return 1 / 255 if self.opacity_scale >= 0.1 else 1e-4


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
    for form in ("union", "difference"):
        parts = raw.get(form)
        if isinstance(parts, list) and len(parts) < 2:
            found.append(((*path, form), f"needs at least 2 shapes; got {len(parts)}"))
        for k, part in enumerate(parts if isinstance(parts, list) else []):
            found += shape_complaints(part, (*path, form, k))
    return found


def body_complaint(name: Any, role: dict[str, str] | None) -> str:
    """Why `name` is not the name of a body, or nothing. role: of each object by its name, None
    where the names are not known for errors in them.
    """
    if role is None or not isinstance(name, str):
        return ""
    if name not in role:
        return f"there is no object '{name}'{nearest(name, role)}; known: {', '.join(role)}"
    return "" if role[name] == "body" else f"'{name}' is scenery: it has no mass and does not move"


def object_complaints(raw: dict) -> list[tuple[tuple, str]]:
    """(path, text) for every pair of keys of one object that do not go together.

    Looks at which keys are there, not at their values, so that it works on a table that has other
    errors.
    """
    found: list[tuple[tuple, str]] = []
    sources = [key for key in SOURCES if key in raw]
    if not sources:
        found.append(((), f"has no source: give one of {', '.join(SOURCES)}"))
    if len(sources) > 1:
        found.append(((sources[1],), f"{' and '.join(sources)} given at once: give exactly one"))
    sizes = [key for key in SIZES if key in raw]
    if len(sizes) > 1:
        found.append(((sizes[1],), f"{' and '.join(sizes)} given at once: give one"))
    if "position" in raw and "origin" in raw:
        found.append((("origin",), "position and origin given at once: give one"))
    if sources and "shape" not in raw and "position" not in raw and "origin" not in raw:
        found.append(((), "needs a position (of the middle of its base) or an origin"))
    if sources == ["shape"]:
        found += shape_complaints(raw["shape"], ("shape",))
    for key in ("select", "fill", "prune"):
        if key in raw and sources and "gaussians" not in raw:
            found.append(((key,), f"is only for objects made of gaussians, not of a {sources[0]}"))
    scenery = raw.get("role") == "scenery"
    if scenery:
        for key in OF_BODIES:
            if key in raw:
                found.append(((key,), "is not for scenery: it has no mass and does not move"))
    elif "material" not in raw:
        found.append((("material",), "required key is missing: what the body is made of"))
    if "fraction" in raw and "fraction_profile" in raw:
        said = "fraction and fraction_profile given at once: give one"
        found.append((("fraction_profile",), said))
    if raw.get("collider") is True and not scenery:
        found.append((("collider",), 'is only for role = "scenery": bodies collide anyway'))
    return found

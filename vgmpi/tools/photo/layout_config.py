"""Schema of layout.toml: the user's description of a photograph and the guesses written into it."""

import math
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import BeforeValidator, Field, ValidationError, field_validator, model_validator

from vgmpi.runtime.config.schema import (
    Quantity,
    StrictModel,
    TomlError,
    format_input,
    format_validation_errors,
    parse_vector3,
)
from vgmpi.runtime.config.toml_source import TomlSource
from vgmpi.runtime.message_text import did_you_mean
from vgmpi.scene.objects import checked_name

from .mask_to_mesh import Reconstruction

FLOOR = "floor"
MAX_OBJECTS = 64  # upper limit of the objects of a layout
MAX_NAME_LENGTH = 60  # [letters] names become names of files
MIN_LENGTH, MAX_LENGTH = 1e-5, 1e5  # [m] range of lengths in a photograph


class LayoutError(TomlError):
    """Errors of a layout.toml: `lines` has one complete sentence per error."""


def _degrees(value: Any) -> float:
    """Parse an angle; the result is in degrees."""
    if isinstance(value, str):
        return round(math.degrees(Quantity("rad").parse(value)), 12)
    return Quantity("").parse(value)


def _box(value: Any) -> tuple[int, int, int, int]:
    """Parse [left, top, right, bottom] in pixels."""
    good = isinstance(value, list | tuple) and len(value) == 4
    if not good or not all(type(v) in (int, float) and abs(v) < 1e6 for v in value):
        raise ValueError("must be [left, top, right, bottom] in pixels")
    left, top, right, bottom = (round(v) for v in value)
    if right <= left or bottom <= top:
        raise ValueError("must have right > left and bottom > top: [left, top, right, bottom]")
    return left, top, right, bottom


def _point_prompts(value: Any) -> tuple[tuple[float, float, bool], ...]:
    """Parse [x, y] and [x, y, 'in' or 'out'] into x, y and whether the object is there."""
    if not isinstance(value, list | tuple):
        raise ValueError("must be a list of [x, y] or [x, y, 'out']")
    points = []
    for point in value:
        good = isinstance(point, list | tuple) and len(point) in (2, 3)
        if not good or not all(type(v) in (int, float) and abs(v) < 1e6 for v in point[:2]):
            raise ValueError("must be a list of [x, y] or [x, y, 'out'], in pixels")
        if len(point) == 3 and point[2] not in ("in", "out", True, False):
            raise ValueError("the third of a point is 'out' where the object is not, or 'in'")
        points.append(
            (float(point[0]), float(point[1]), len(point) == 2 or point[2] in ("in", True))
        )
    return tuple(points)


def _support(value: Any) -> str | float:
    """Parse a height above the floor [m], 'floor' or the name of an object."""
    if isinstance(value, str) and value[:1].isalpha():
        return value
    try:
        return Quantity("m", ge=0, le=MAX_LENGTH).parse(value)
    except ValueError as error:
        raise ValueError(f"{error}; or 'floor', or the name of another object") from None


Length = Annotated[float, Quantity("m", ge=MIN_LENGTH, le=MAX_LENGTH)]
Degrees = Annotated[float, BeforeValidator(_degrees)]
Support = Annotated[str | float, BeforeValidator(_support)]
Box = Annotated[tuple[int, int, int, int], BeforeValidator(_box)]
PointPrompts = Annotated[tuple[tuple[float, float, bool], ...], BeforeValidator(_point_prompts)]
Axis = Literal["x", "-x", "y", "-y", "z", "-z"]


class CameraTable(StrictModel):
    """The camera that took the photograph."""

    fov: Annotated[Degrees, Field(ge=5, le=140)] | None = None
    """vertical field of view"""
    pitch: Annotated[Degrees, Field(ge=-30, le=80)] | None = None
    """by how much it looks down"""
    height: Length | None = None
    """of the eye above the floor, the plane that things stand on"""


class MasksTable(StrictModel):
    """Segmenter of the objects."""

    method: Literal["grabcut", "sam", "sam2", "sam3"] = "grabcut"
    weights: str = ""
    """folder with the weights, or their name at Hugging Face; default: the usual ones"""


class DepthTable(StrictModel):
    """Source of the objects' depths."""

    method: Literal["floor", "depth-anything"] = "floor"
    weights: str = ""
    """of Depth Anything: as of masks"""


class MaterialsTable(StrictModel):
    """Source of the objects' materials."""

    method: Literal["names", "clip"] = "names"
    weights: str = ""
    """of CLIP: as of masks"""


class BodiesTable(StrictModel):
    """Source of the objects' bodies, unless an object names its own."""

    method: Literal["mask", "triposplat", "trellis", "sam3d", "program"] = "mask"
    python: str = ""
    """the interpreter in which the generator is installed"""
    script: str = ""
    """method = "program": called as PYTHON SCRIPT --image CROP.png --output BODY.ply --seed N"""
    seed: Annotated[int, Field(strict=True, ge=0, le=2**31)] = 1
    folder: str = ""
    """with Gaussian files or meshes of the objects' names, which go before"""

    @model_validator(mode="after")
    def _check_program(self):
        """Require an interpreter for generators, and a script for method = 'program' only."""
        if self.method != "mask" and not self.python:
            raise ValueError(f"{self.method} needs python = '/its/environment/bin/python'")
        if (self.method == "program") != bool(self.script):
            raise ValueError("script is for method = 'program', which needs one")
        return self


class SceneTable(StrictModel):
    """Options of the scene."""

    end: Annotated[float, Quantity("s", gt=0, le=3600)] = 1.0
    frames: Annotated[int, Field(strict=True, ge=2, le=10000)] = 26
    cells: Annotated[int, Field(strict=True, ge=16, le=512)] = 64
    """along the longest edge of the domain"""
    shadows: Literal["keep", "remove"] = "keep"
    """in the background: shadows that the objects throw in the photograph"""


def _travel(value: Any) -> tuple[float, float, float]:
    """Parse the direction in which light travels; it must point down."""
    numbers = parse_vector3(value)
    if numbers is None or max(map(abs, numbers)) > MAX_LENGTH:
        raise ValueError("must be three numbers [right, away from the camera, up]")
    if not numbers[2] <= -0.02 * math.hypot(*numbers) < 0:
        raise ValueError("must point down: the third number, up, is below 0")
    return numbers


class LightTable(StrictModel):
    """Light of the photograph, for shadows that come later."""

    direction: Annotated[tuple[float, float, float], BeforeValidator(_travel)] | None = None
    """in which it travels: to the right, away from the camera, up"""
    width: Annotated[float, Quantity("1", ge=0.005, le=0.5)] | None = None
    """tangent of its half width, which softens shadows"""
    darkness: Annotated[float, Quantity("1", ge=0.05, le=0.95)] | None = None
    """part of the light on the floor that shadows lack"""


class ObjectTable(StrictModel):
    """Object in the photograph."""

    name: Annotated[str, BeforeValidator(checked_name)]
    box: Box | None = None
    point_prompts: PointPrompts = ()
    mask: str | None = None
    text: Annotated[str, Field(max_length=200)] | None = None
    material: str | None = None
    reconstruction: Reconstruction | None = None
    thickness: Annotated[float, Quantity("1", ge=0.02, le=4)] | None = None
    height: Length | None = None
    support: Support | None = None
    distance: Length | None = None
    yaw: Annotated[Degrees, Field(ge=-360, le=360)] | None = None
    body: str | None = None
    up: Axis | None = None
    multi_view: str | None = None
    wall: Annotated[float, Quantity("1", ge=0.03, le=0.5)] | None = None
    inside: str | None = None

    @field_validator("name")
    @classmethod
    def _check_name(cls, value: str) -> str:
        """Refuse the name of the floor and names too long for a file."""
        if len(value) > MAX_NAME_LENGTH or value == FLOOR:
            message = "no object can be called so" if value == FLOOR else "is too long for a file"
            raise ValueError(f"{message}: at most {MAX_NAME_LENGTH} letters, not 'floor'")
        return value

    @model_validator(mode="after")
    def _check_single_body(self):
        """Refuse more than one source of the object's body."""
        keys = ("reconstruction", "body", "multi_view")
        sources = [key for key in keys if getattr(self, key) is not None]
        if len(sources) > 1:
            raise ValueError(f"has {' and '.join(sources)}: only one of them makes its body")
        if self.wall is not None and self.reconstruction != "cup":
            raise ValueError('wall: allowed with reconstruction = "cup" only')
        useless = [key for key in (*keys, "support", "distance") if getattr(self, key) is not None]
        if self.inside is not None and useless:
            raise ValueError(f"has inside and {useless[0]}: its cup decides its body and its place")
        return self


class Empty(StrictModel):
    """Schema of a layout.toml before its objects are proposed."""

    camera: CameraTable = CameraTable()
    masks: MasksTable = MasksTable()
    depth: DepthTable = DepthTable()
    materials: MaterialsTable = MaterialsTable()
    bodies: BodiesTable = BodiesTable()
    scene: SceneTable = SceneTable()
    light: LightTable = LightTable()


class Layout(Empty):
    """Schema of a complete layout.toml."""

    object: Annotated[tuple[ObjectTable, ...], Field(max_length=MAX_OBJECTS)]


class LoadedLayout(NamedTuple):
    """Layout with its source file."""

    layout: Layout
    source: TomlSource

    def wrong(self, *errors: tuple[tuple, str]) -> LayoutError:
        """Return the error about keys, given by path and message."""
        return LayoutError(self.source.lines(list(errors)))

    def path(self, name: str) -> Path:
        """Return the path of a file that the layout names, relative to the layout's folder."""
        return self.source.folder / name


def read(path: Path) -> LoadedLayout:
    """Read a layout.

    Raises:
        LayoutError: The layout is invalid; it reports all errors at once.
    """
    source = TomlSource(path, error=LayoutError)
    if not source.data.get("object"):
        message = "object: no object is told: [[object]] tables with a name and a box each"
        raise LayoutError([f"{source.path}:1: {message}; --find proposes some"])
    try:
        loaded = LoadedLayout(Layout.model_validate(source.data), source)
    except ValidationError as error:
        raise LayoutError(source.lines(format_validation_errors(error, Layout))) from None
    layout = loaded.layout
    errors = _check_names(layout) + _check_supports(layout) + _check_cups(layout)
    if errors:
        raise loaded.wrong(*errors)
    return loaded


def read_empty(path: Path) -> tuple[Empty, TomlSource]:
    """Read a layout without objects, for which objects shall be proposed.

    Raises:
        LayoutError: The layout is invalid or has objects already.
    """
    source = TomlSource(path, error=LayoutError)
    if source.data.get("object"):
        message = "object: there are objects already: --find proposes them where there are none"
        raise LayoutError([f"{source.place(('object', 0))[1]}: {message}"])
    try:
        return Empty.model_validate({k: v for k, v in source.data.items() if k != "object"}), source
    except ValidationError as error:
        raise LayoutError(source.lines(format_validation_errors(error, Empty))) from None


def read_unfinished(path: Path) -> tuple[Empty, str, tuple[ObjectTable, ...]]:
    """Read a layout that may be absent and may have no objects yet.

    Returns:
        The layout without its objects, its text, and the objects.

    Raises:
        LayoutError: The layout is invalid.
    """
    if not path.exists():
        return Empty(), "", ()
    source = TomlSource(path, error=LayoutError)
    if source.data.get("object"):
        loaded = read(path)
        return loaded.layout, source.text, loaded.layout.object
    empty, source = read_empty(path)
    return empty, source.text, ()


def _check_names(layout: Layout) -> list[tuple[tuple, str]]:
    """Return errors of equal names, ignoring case as some file systems do."""
    errors, first_index = [], {}
    for k, obj in enumerate(layout.object):
        key = obj.name.lower()
        if key in first_index:
            message = f"two objects have the name '{obj.name}'; each needs its own files"
            errors.append((("object", k, "name"), message))
        first_index[key] = k
    return errors


def _check_supports(layout: Layout) -> list[tuple[tuple, str]]:
    """Return errors of unknown supports and of objects that support themselves."""
    names = [obj.name for obj in layout.object]
    holds = {obj.name: obj.support for obj in layout.object}
    errors = []
    for k, obj in enumerate(layout.object):
        path, support = ("object", k, "support"), obj.support
        if isinstance(support, str) and support not in (*names, FLOOR):
            valid = ", ".join([FLOOR, *(n for n in names if n != obj.name)])
            hint = did_you_mean(support, [FLOOR, *names])
            message = f"there is no object '{support}'{hint}; known: {valid}, or a height"
            errors.append((path, message))
            continue
        chain = [obj.name]
        while isinstance(support, str) and support in holds and support not in chain:
            chain.append(support)
            support = holds[support]
        if support == obj.name:
            message = "it holds up itself" if len(chain) == 1 else "they hold up each other"
            errors.append((path, f"nothing holds it up: {message}; {format_input(obj.support)}"))
    return errors


def _check_cups(layout: Layout) -> list[tuple[tuple, str]]:
    """Return errors of liquids whose cup is absent or is no cup."""
    cups = [obj.name for obj in layout.object if obj.reconstruction == "cup"]
    errors = []
    for k, obj in enumerate(layout.object):
        if obj.inside is not None and obj.inside not in cups:
            names = f"such objects: {', '.join(cups) or 'none'}"
            message = f"'{obj.inside}' is no object with reconstruction = \"cup\"; {names}"
            errors.append((("object", k, "inside"), message))
    return errors

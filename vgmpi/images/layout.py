"""layout.toml: what is told of a photograph, and what was guessed, written back into it."""

import math
import os
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import BeforeValidator, Field, ValidationError, field_validator, model_validator

from vgmpi.images.bodies import Form
from vgmpi.misspelt import nearest
from vgmpi.scene.objects import checked_name
from vgmpi.source import Source
from vgmpi.tables import Quantity, Table, TomlError, explain, got

FLOOR = "floor"
MOST = 64  # objects
LONGEST_NAME = 60
SMALLEST, LARGEST = 1e-5, 1e5  # m, of what is in a photograph


class LayoutError(TomlError):
    """What is wrong with a layout.toml: `lines`, one finished sentence per error."""


def _degrees(value: Any) -> float:
    if isinstance(value, str):
        return round(math.degrees(Quantity("rad").parse(value)), 12)
    return Quantity("").parse(value)


def _box(value: Any) -> tuple[int, int, int, int]:
    good = isinstance(value, list | tuple) and len(value) == 4
    if not good or not all(type(v) in (int, float) and abs(v) < 1e6 for v in value):
        raise ValueError("must be [left, top, right, bottom] in pixels")
    left, top, right, bottom = (round(v) for v in value)
    if right <= left or bottom <= top:
        raise ValueError("must have right > left and bottom > top: [left, top, right, bottom]")
    return left, top, right, bottom


def _clicks(value: Any) -> tuple[tuple[float, float, bool], ...]:
    if not isinstance(value, list | tuple):
        raise ValueError("must be a list of [x, y] or [x, y, 'out']")
    found = []
    for one in value:
        good = isinstance(one, list | tuple) and len(one) in (2, 3)
        if not good or not all(type(v) in (int, float) and abs(v) < 1e6 for v in one[:2]):
            raise ValueError("must be a list of [x, y] or [x, y, 'out'], in pixels")
        if len(one) == 3 and one[2] not in ("in", "out", True, False):
            raise ValueError("the third of a click is 'out' where the object is not, or 'in'")
        found.append((float(one[0]), float(one[1]), len(one) == 2 or one[2] in ("in", True)))
    return tuple(found)


def _support(value: Any) -> str | float:
    if isinstance(value, str) and value[:1].isalpha():
        return value
    try:
        return Quantity("m", ge=0, le=LARGEST).parse(value)
    except ValueError as error:
        raise ValueError(f"{error}; or 'floor', or the name of another object") from None


Length = Annotated[float, Quantity("m", ge=SMALLEST, le=LARGEST)]
Degrees = Annotated[float, BeforeValidator(_degrees)]
Support = Annotated[str | float, BeforeValidator(_support)]
Box = Annotated[tuple[int, int, int, int], BeforeValidator(_box)]
Clicks = Annotated[tuple[tuple[float, float, bool], ...], BeforeValidator(_clicks)]
Axis = Literal["x", "-x", "y", "-y", "z", "-z"]


class CameraTable(Table):
    """The camera that took the photograph."""

    fov: Annotated[Degrees, Field(ge=5, le=140)] | None = None
    """vertical field of view"""
    pitch: Annotated[Degrees, Field(ge=-30, le=80)] | None = None
    """by how much it looks down"""
    height: Length | None = None
    """of the eye above the floor, the plane that things stand on"""


class MasksTable(Table):
    """Who finds which pixels are an object's."""

    by: Literal["grabcut", "sam", "sam2", "sam3"] = "grabcut"
    weights: str = ""
    """folder with the weights, or their name at Hugging Face; default: the usual ones"""


class DepthTable(Table):
    """Who tells how far objects are."""

    by: Literal["floor", "depth-anything"] = "floor"
    weights: str = ""
    """of Depth Anything: as of masks"""


class MaterialsTable(Table):
    """Who guesses what objects are made of."""

    by: Literal["names", "clip"] = "names"
    weights: str = ""
    """of CLIP: as of masks"""


class BodiesTable(Table):
    """Who makes bodies of pictures, where an object does not say."""

    by: Literal["form", "triposplat", "trellis", "sam3d", "program"] = "form"
    python: str = ""
    """the interpreter in which the generator is installed"""
    script: str = ""
    """by = "program": called as PYTHON SCRIPT --image CROP.png --output BODY.ply --seed N"""
    seed: Annotated[int, Field(strict=True, ge=0, le=2**31)] = 1
    folder: str = ""
    """with Gaussian files or meshes of the objects' names, which go before"""

    @model_validator(mode="after")
    def _told(self):
        if self.by != "form" and not self.python:
            raise ValueError(f"{self.by} needs python = '/its/environment/bin/python'")
        if (self.by == "program") != bool(self.script):
            raise ValueError("script is for by = 'program', which needs one")
        return self


class SceneTable(Table):
    """What the scene shall be."""

    end: Annotated[float, Quantity("s", gt=0)] = 1.0
    frames: Annotated[int, Field(strict=True, ge=2, le=10000)] = 26
    cells: Annotated[int, Field(strict=True, ge=16, le=512)] = 64
    """along the longest edge of the domain"""


class ObjectTable(Table):
    """One thing in the photograph."""

    name: Annotated[str, BeforeValidator(checked_name)]
    box: Box | None = None
    clicks: Clicks = ()
    mask: str | None = None
    text: Annotated[str, Field(max_length=200)] | None = None
    material: str | None = None
    form: Form | None = None
    thickness: Annotated[float, Quantity("1", ge=0.02, le=4)] | None = None
    height: Length | None = None
    support: Support | None = None
    distance: Length | None = None
    yaw: Annotated[Degrees, Field(ge=-360, le=360)] | None = None
    body: str | None = None
    up: Axis | None = None
    views: str | None = None

    @field_validator("name")
    @classmethod
    def _short(cls, value: str) -> str:
        if len(value) > LONGEST_NAME or value == FLOOR:
            said = "no object can be called so" if value == FLOOR else "is too long for a file"
            raise ValueError(f"{said}: at most {LONGEST_NAME} letters, not 'floor'")
        return value

    @model_validator(mode="after")
    def _one_body(self):
        told = [key for key in ("form", "body", "views") if getattr(self, key) is not None]
        if len(told) > 1:
            raise ValueError(f"has {' and '.join(told)}: only one of them makes its body")
        return self


class Empty(Table):
    """A layout.toml before its objects are proposed."""

    camera: CameraTable = CameraTable()
    masks: MasksTable = MasksTable()
    depth: DepthTable = DepthTable()
    materials: MaterialsTable = MaterialsTable()
    bodies: BodiesTable = BodiesTable()
    scene: SceneTable = SceneTable()


class Layout(Empty):
    """A layout.toml."""

    object: Annotated[tuple[ObjectTable, ...], Field(max_length=MOST)]


class Told(NamedTuple):
    """A layout and where it stands."""

    layout: Layout
    source: Source

    def wrong(self, *errors: tuple[tuple, str]) -> LayoutError:
        """The error about keys, by their paths."""
        return LayoutError(self.source.lines(list(errors)))

    def path(self, name: str) -> Path:
        """A file that the layout names, relative to its folder."""
        return self.source.folder / name


def read(path: Path) -> Told:
    """The layout in a file. Raises LayoutError, all that is wrong at once."""
    source = Source(path, error=LayoutError)
    if not source.data.get("object"):
        said = "object: no object is told: [[object]] tables with a name and a box each"
        raise LayoutError([f"{source.path}:1: {said}; --find proposes some"])
    try:
        told = Told(Layout.model_validate(source.data), source)
    except ValidationError as error:
        raise LayoutError(source.lines(explain(error, Layout))) from None
    wrong = _names(told.layout) + _supports(told.layout)
    if wrong:
        raise told.wrong(*wrong)
    return told


def read_empty(path: Path) -> tuple[Empty, Source]:
    """A layout without objects, for which these are to be proposed. Raises LayoutError."""
    source = Source(path, error=LayoutError)
    if source.data.get("object"):
        said = "object: there are objects already: --find proposes them where there are none"
        raise LayoutError([f"{source.place(('object', 0))[1]}: {said}"])
    try:
        return Empty.model_validate({k: v for k, v in source.data.items() if k != "object"}), source
    except ValidationError as error:
        raise LayoutError(source.lines(explain(error, Empty))) from None


def _names(layout: Layout) -> list[tuple[tuple, str]]:
    """Two objects of one name, also where a file system takes no notice of capitals."""
    wrong, seen = [], {}
    for k, thing in enumerate(layout.object):
        key = thing.name.lower()
        if key in seen:
            said = f"two objects have the name '{thing.name}'; each needs its own files"
            wrong.append((("object", k, "name"), said))
        seen[key] = k
    return wrong


def _supports(layout: Layout) -> list[tuple[tuple, str]]:
    """Supports that are not there, and objects that hold up themselves."""
    names = [thing.name for thing in layout.object]
    holds = {thing.name: thing.support for thing in layout.object}
    wrong = []
    for k, thing in enumerate(layout.object):
        at, held = ("object", k, "support"), thing.support
        if isinstance(held, str) and held not in (*names, FLOOR):
            known = ", ".join([FLOOR, *(n for n in names if n != thing.name)])
            near = nearest(held, [FLOOR, *names])
            said = f"there is no object '{held}'{near}; known: {known}, or a height"
            wrong.append((at, said))
            continue
        chain = [thing.name]
        while isinstance(held, str) and held in holds and held not in chain:
            chain.append(held)
            held = holds[held]
        if held == thing.name:
            said = "it holds up itself" if len(chain) == 1 else "they hold up each other"
            wrong.append((at, f"nothing holds it up: {said}; {got(thing.support)}"))
    return wrong


def rewritten(text: str, guesses: list[tuple[tuple, Any, str]]) -> str:
    """The text of a layout with values that it did not have, each with the reason behind it; all
    else stays as it was written. guesses: path of the key, value, reason. Raises LayoutError."""
    try:
        import tomlkit
    except ImportError:
        said = "writing guesses into a layout needs tomlkit: pip install 'vgmpi[images]'"
        raise LayoutError([said]) from None
    held = tomlkit.parse(text)
    for path, value, reason in guesses:
        here: Any = held
        for part in path[:-1]:
            if isinstance(part, str) and part not in here:
                here[part] = tomlkit.table()
            here = here[part]
        item = tomlkit.item(value)
        if reason and not isinstance(here, tomlkit.items.InlineTable):
            item.comment(" ".join(reason.split()))
        here[path[-1]] = item
    return tomlkit.dumps(held)


def relative(path: Path, folder: Path) -> str:
    """How a layout in `folder` names a file."""
    return Path(os.path.relpath(path.resolve(), folder.resolve())).as_posix()

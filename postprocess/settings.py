"""render.toml: camera, picture, video and splatting, checked before anything is drawn."""

import difflib
import math
import re
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    model_validator,
)

from vgmpi.splatting.floor import Floor
from vgmpi.splatting.splat import ALPHA_MIN_RANGE


def _vector(value: Any) -> tuple[float, float, float]:
    if (
        not isinstance(value, list | tuple)
        or len(value) != 3
        or not all(type(v) in (int, float) and math.isfinite(v) for v in value)
    ):
        raise ValueError("allowed: three numbers [x, y, z]")
    return tuple(float(v) for v in value)


def _direction(value: Any) -> tuple[float, float, float]:
    value = _vector(value)
    if not any(value):
        raise ValueError("allowed: a direction that is not zero")
    return value


def _background(value: Any) -> tuple[float, float, float] | str:
    allowed = "allowed: '#rrggbb', [r, g, b] of numbers 0 to 1, 'none', or the name of a picture"
    if isinstance(value, str):
        if not value or value.startswith("#") and not re.fullmatch("#[0-9a-fA-F]{6}", value):
            raise ValueError(allowed)
        return value
    try:
        color = _vector(value)
    except ValueError:
        raise ValueError(allowed) from None
    if min(color) < 0 or max(color) > 1:
        raise ValueError(allowed)
    return color


Vector = Annotated[tuple[float, float, float], BeforeValidator(_vector)]
Direction = Annotated[tuple[float, float, float], BeforeValidator(_direction)]
Background = Annotated[tuple[float, float, float] | str, BeforeValidator(_background)]


def _color(value: Any) -> tuple[float, float, float]:
    if isinstance(value, str) and not re.fullmatch("#[0-9a-fA-F]{6}", value):
        raise ValueError("allowed: '#rrggbb' or [r, g, b] of numbers 0 to 1")
    value = _background(value)
    if isinstance(value, str):
        return tuple(int(value[i : i + 2], 16) / 255 for i in (1, 3, 5))
    return value


Color = Annotated[tuple[float, float, float], BeforeValidator(_color)]


class SettingsError(ValueError):
    """All errors of a render.toml; `lines` holds one clear line for each."""

    def __init__(self, lines: list[str]):
        super().__init__("\n".join(lines))
        self.lines = lines


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


@dataclass(frozen=True)
class Key:
    """A point of a camera's path. part: of the video, 0..1; or time: of the simulation [s]."""

    part: float | None
    time: float | None
    eye: tuple[float, float, float]
    target: tuple[float, float, float] | None
    fov: float | None  # degrees


def _keys(value: Any) -> tuple[Key, ...]:
    """Keys of a path from what the file says, each mistake with the number of its key."""
    if not isinstance(value, list) or len(value) < 2:
        raise ValueError("allowed: a list of two or more { part, eye, target, fov }")
    keys = []
    for number, entry in enumerate(value, start=1):
        try:
            keys.append(_key(entry))
        except ValueError as error:
            raise ValueError(f"key {number}: {error}") from None
    for name in ("part", "time"):
        at = [getattr(key, name) for key in keys]
        if any(v is not None for v in at):
            if None in at:
                raise ValueError("all keys need part, or all need time")
            if any(b <= a for a, b in zip(at, at[1:])):
                raise ValueError(f"{name} must grow from key to key")
    return tuple(keys)


def _key(entry: Any) -> Key:
    names = ("part", "time", "eye", "target", "fov")
    if not isinstance(entry, dict) or not set(entry) <= set(names):
        raise ValueError(f"allowed: a table of {', '.join(names)}")
    if ("part" in entry) == ("time" in entry):
        raise ValueError("needs one of part, time")
    if "eye" not in entry:
        raise ValueError("needs eye = [x, y, z]")
    for name, low, high in (("part", 0, 1), ("time", 0, math.inf), ("fov", 1e-3, 170)):
        v = entry.get(name, 1)
        if type(v) not in (int, float) or not math.isfinite(v) or not low <= v <= high:
            raise ValueError(f"{name} = {v!r}: allowed: a number from {low:g} to {high:g}")
    points = {n: _vector(entry[n]) for n in ("eye", "target") if n in entry}
    if points.get("target") == points["eye"]:
        raise ValueError("eye and target are the same point")
    return Key(
        entry.get("part"), entry.get("time"), points["eye"], points.get("target"), entry.get("fov")
    )


# what a camera of each kind may be told, besides kind and name
CAMERA_KEYS = {
    "orbit": ("target", "up", "fov", "near", "distance", "height", "turns", "angle"),
    "fixed": ("target", "up", "fov", "near", "eye"),
    "keyframes": ("target", "up", "fov", "near", "keys"),
    "transforms": ("near", "file", "image", "scale"),
    "colmap": ("near", "folder", "image", "scale"),
}
CAMERA_NEEDS = {"fixed": "eye = [x, y, z]", "keyframes": "keys = [...]"}
CAMERA_NEEDS |= {"transforms": "file = 'transforms.json'", "colmap": "folder = 'sparse/0'"}


class CameraSettings(_Table):
    """Lengths in m, angles in degrees. What is left out is chosen so that the domain is in view."""

    kind: Literal["orbit", "fixed", "keyframes", "transforms", "colmap"] = "orbit"
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]{1,40}$")] | None = None
    target: Vector | None = None
    up: Direction = (0.0, 0.0, 1.0)
    fov: Annotated[float, Field(gt=0, lt=170)] = 40.0  # vertical
    near: Annotated[float, Field(gt=0)] | None = None
    eye: Vector | None = None
    distance: Annotated[float, Field(gt=0)] | None = None  # from target to eye
    height: float | None = None  # of the eye above the target
    turns: float = 0.0  # full circles over the video
    angle: float = 25.0  # at the first frame; 0 looks from -y, 90 from +x
    keys: Annotated[tuple[Key, ...], BeforeValidator(_keys)] | None = None
    file: str | None = None  # relative to the folder of render.toml, as the next
    folder: str | None = None
    image: str | None = None  # the one camera of a file to look through
    scale: Annotated[float, Field(gt=0, le=4)] = 1.0  # of a file's picture sizes

    @model_validator(mode="after")
    def _fits_kind(self):
        allowed = {"kind", "name", *CAMERA_KEYS[self.kind]}
        wrong = [
            name for name in type(self).model_fields if name in self.model_fields_set - allowed
        ]
        if wrong:
            raise ValueError(f"a camera of kind '{self.kind}' has no {', '.join(wrong)}")
        needs = CAMERA_NEEDS.get(self.kind)
        if needs and getattr(self, needs.split()[0]) is None:
            raise ValueError(f"a camera of kind '{self.kind}' needs {needs}")
        if self.eye is not None and self.eye == self.target:
            raise ValueError("eye and target are the same point")
        if None not in (self.height, self.distance) and abs(self.height) >= self.distance:
            raise ValueError("height must be less than distance")
        return self


class FloorSettings(_Table):
    """A plane z = height under the Gaussians, and their shadow on it."""

    height: float = 0.0  # m
    color: Color = (0.85, 0.85, 0.85)
    squares: Annotated[float, Field(gt=0)] | None = None  # side [m]; every other one in `other`
    other: Color = (0.7, 0.7, 0.7)
    light: Direction = (0.3, 0.2, -1.0)  # in which it travels
    shadow: Annotated[float, Field(ge=0, le=1)] = 0.6
    softness: Annotated[float, Field(ge=0, le=1)] = 0.1

    @model_validator(mode="after")
    def _from_above(self):
        if not self.light[2] < 0:
            raise ValueError("allowed: a light that points down, light = [x, y, -z]")
        return self

    def floor(self) -> Floor:
        squares = None if self.squares is None else (self.other, self.squares)
        return Floor(self.height, self.color, squares, self.light, self.shadow, self.softness)


class PictureSettings(_Table):
    width: Annotated[int, Field(ge=16, le=8192)] = 800  # pixels
    height: Annotated[int, Field(ge=16, le=8192)] = 800
    background: Background = "#ffffff"
    supersample: Annotated[int, Field(ge=1, le=4)] = 1
    floor: FloorSettings | None = None

    @model_validator(mode="after")
    def _one_ground(self):
        if self.floor is not None and self.background == "none":
            raise ValueError('a transparent background ("none") leaves no room for a floor')
        return self


class VideoSettings(_Table):
    fps: Annotated[float, Field(ge=1, le=240)] = 25.0
    quality: Annotated[float, Field(ge=0, le=10)] = 8.0


class FrameSettings(_Table):
    first: Annotated[int, Field(ge=0)] = 0
    last: Annotated[int, Field(ge=0)] | None = None
    every: Annotated[int, Field(ge=1)] = 1


class SplattingSettings(_Table):
    """`classic` is what captures are trained for; the others keep tiny Gaussians thin."""

    mode: Literal["classic", "antialias", "mip"] = "classic"
    lowpass: Annotated[float, Field(gt=0, le=2)] | None = None  # pixels^2
    alpha_min: Annotated[float, Field(ge=ALPHA_MIN_RANGE[0], le=ALPHA_MIN_RANGE[1])] | None = None

    def options(self) -> dict[str, Any]:
        """Arguments of splat.render but alpha_min."""
        usual = 0.1 if self.mode == "mip" else 0.3
        return {"lowpass": self.lowpass or usual, "antialias": self.mode != "classic"}


class LookSettings(_Table):
    """How Gaussians follow their particles. None: what the scene says (vgmpi/scene/settings.py)."""

    colour_transfer: Literal["off", "frame", "relax"] | None = None  # step is the run's own
    colour_time: Annotated[float, Field(gt=0)] | None = None  # s
    colour_degree: Annotated[int, Field(strict=True, ge=0, le=3)] | None = None
    colour_bodies: tuple[str, ...] | None = None
    covariance: Literal["evolve", "fixed"] = "evolve"  # fixed: the shapes at rest
    harmonics: Literal["rotate", "fixed"] = "rotate"  # fixed: colours do not turn with solids
    opacity: Literal["scaled", "fixed"] = "scaled"  # fixed: as captured, no opacity_scale
    # shapes of fluids, sand and snow; None: deformation where F is known, else volume
    normalise: Literal["volume", "radius", "deformation"] | None = None
    opacity_scale: dict[str, Annotated[float, Field(ge=0, le=1)]] = {}  # by the object's name

    def colours(self) -> dict[str, Any]:
        """What is said of colours that travel, by the names of the scene's [appearance]."""
        return {k: v for k, v in self if k.startswith("colour_") and v is not None}


CAMERAS = "[[camera]]"  # no key of a TOML file can be called so without quotes


class Settings(_Table):
    camera: CameraSettings = CameraSettings()
    cameras: Annotated[tuple[CameraSettings, ...], Field(alias=CAMERAS)] = ()
    picture: PictureSettings = PictureSettings()
    video: VideoSettings = VideoSettings()
    frames: FrameSettings = FrameSettings()
    splatting: SplattingSettings = SplattingSettings()
    look: LookSettings = LookSettings()

    @model_validator(mode="after")
    def _names_differ(self):
        names = [one.name for one in self.cameras]
        if len(names) > 1 and (None in names or len(set(names)) < len(names)):
            raise ValueError("several cameras need a name each, no two the same")
        return self

    def views(self) -> tuple[CameraSettings, ...]:
        """The cameras that draw, one or more."""
        return self.cameras or (self.camera,)


def load(path: str | Path | None) -> Settings:
    """The settings of a render.toml, or the usual ones without a file. Raises SettingsError."""
    if path is None:
        return Settings()
    try:
        text = Path(path).read_text(encoding="utf-8")
        data = tomllib.loads(text)
    except OSError as error:
        raise SettingsError([f"{path}: {error.strerror or error}"]) from None
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        line = re.search(r"line (\d+)", str(error))
        at = f":{line.group(1)}" if line else ""
        raise SettingsError([f"{path}{at}: not readable as TOML: {error}"]) from None
    if isinstance(data.get("camera"), list) and data["camera"]:
        data[CAMERAS] = data.pop("camera")
    try:
        return Settings.model_validate(data)
    except ValidationError as error:
        lines = [_explain(path, text, item) for item in error.errors()]
        raise SettingsError(list(dict.fromkeys(lines))) from None


def _explain(path: str | Path, text: str, item: Any) -> str:
    """`file:line: key: value: what is allowed`."""
    loc, which = item["loc"], None
    if loc[:1] == (CAMERAS,):  # one of several: its number, counted from 1
        which = loc[1] + 1 if len(loc) > 1 else None
        loc = ("camera", *loc[2:])
    keys = [part for part in loc if isinstance(part, str) and part.isidentifier()]
    in_floor = keys[:2] == ["picture", "floor"]
    keys = keys[: 3 if in_floor else 2]  # deeper parts name alternatives of a type, not keys
    if keys == ["look", "opacity_scale"]:
        keys = [str(part) for part in item["loc"][:3]]  # but here names of objects
    allowed = re.sub(r"^(Value error, |Input should be )", "", item["msg"])
    if item["type"] == "extra_forbidden":
        table = Settings if len(keys) == 1 else Settings.model_fields[keys[0]].annotation
        table = FloorSettings if in_floor else table
        names = [name for name in table.model_fields if name != "cameras"]
        near = difflib.get_close_matches(keys[-1], names, 1)
        hint = f" (did you mean '{near[0]}'?)" if near else ""
        said = f"unknown key: allowed are {', '.join(names)}{hint}"
    elif item["type"] == "model_type":
        said = f"{item['input']!r}: allowed: a table [{keys[-1]}]"
    elif isinstance(item["input"], dict):
        said = allowed
    else:
        said = f"{item['input']!r}: allowed: {allowed.removeprefix('allowed: ')}"
    keys = keys or ["camera"]  # the one rule that spans tables
    return f"{path}:{_line(text, keys, which)}: {'.'.join(keys)}: {said}"


def _line(text: str, keys: list[str], which: int | None = None) -> int:
    """Line of a key of a TOML text (of its table if the key is not found).

    which: of several tables [[name]], counted from 1.
    """
    table, found, seen = "", 1, 0
    for number, line in enumerate(text.splitlines(), start=1):
        head = re.match(r"\s*\[?\[\s*([\w.-]+)\s*\]", line)
        if head:
            table = head.group(1)
            seen += keys[:1] == [table]
            if keys[:1] == [table] and which in (None, seen):
                found = number
            continue
        if which not in (None, seen):
            continue
        name = re.match(r"\s*([\w.-]+)\s*=", line)
        if name:
            full = f"{table}.{name.group(1)}" if table else name.group(1)
            if full == ".".join(keys):
                return number
            if full in (keys[0], ".".join(keys[:2])):
                found = number
    return found

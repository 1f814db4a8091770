"""render.toml: camera, picture, video and splatting, checked before anything is drawn."""

import math
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    field_validator,
    model_validator,
)

from vgmpi.source import Source
from vgmpi.splatting.floor import Floor
from vgmpi.splatting.light import Light
from vgmpi.splatting.splat import ALPHA_MIN_RANGE
from vgmpi.studio import lighting
from vgmpi.tables import (
    LEAST,
    MOST,
    Colour,
    Quantity,
    Table,
    TomlError,
    colour,
    explain,
    three,
)


def _vector(value: Any) -> tuple[float, float, float]:
    numbers = three(value)
    if numbers is None:
        raise ValueError("must be three numbers [x, y, z]")
    if max(map(abs, numbers)) > MOST:
        raise ValueError(f"must be of numbers up to {MOST:g} in size")
    return numbers


def _direction(value: Any) -> tuple[float, float, float]:
    value = _vector(value)
    if not any(value):
        raise ValueError("must be a direction that is not zero")
    if max(map(abs, value)) < LEAST:
        raise ValueError(f"must be a direction of a length from {LEAST:g}")
    return value


def _degrees(value: Any) -> Any:
    """Of a text with a unit; numbers are degrees already."""
    if not isinstance(value, str):
        return value
    try:
        return round(math.degrees(Quantity("rad").parse(value)), 12)
    except ValueError:
        raise ValueError("must be a number of degrees, or a text as '30 deg', '0.5 rad'") from None


def _background(value: Any) -> tuple[float, float, float] | str:
    if isinstance(value, str) and value and not value.startswith("#"):
        return value
    try:
        return colour(value)
    except ValueError as error:
        raise ValueError(f"{error}, 'none', or the name of a picture") from None


Vector = Annotated[tuple[float, float, float], BeforeValidator(_vector)]
Degrees = Annotated[float, BeforeValidator(_degrees)]
Direction = Annotated[tuple[float, float, float], BeforeValidator(_direction)]
Background = Annotated[tuple[float, float, float] | str, BeforeValidator(_background)]


OLD_NAMES = {"picture": {"color": "colour"}}  # what keys inside were called before


class SettingsError(TomlError):
    """What is wrong with a render.toml, or with what it asks for."""


class _Table(Table):
    model_config = ConfigDict(allow_inf_nan=False)

    @field_validator("*")
    @classmethod
    def _of_a_size(cls, value: Any) -> Any:
        """Squares and cubes of all numbers are numbers."""
        if isinstance(value, float) and value and not LEAST <= abs(value) <= MOST:
            raise ValueError(f"must be 0 or from {LEAST:g} to {MOST:g} in size")
        return value


class Key(_Table):
    """A point of a camera's path."""

    part: Annotated[float, Field(ge=0, le=1)] | None = None
    """of the video, 0..1; or"""
    time: Annotated[float, Field(ge=0)] | None = None
    """of the simulation [s]"""
    eye: Vector
    """where the camera stands: [x, y, z]"""
    target: Vector | None = None
    """what it looks at"""
    fov: Annotated[Degrees, Field(ge=1e-3, le=170)] | None = None
    """degrees"""

    @model_validator(mode="after")
    def _one_of_each(self):
        if (self.part is None) == (self.time is None):
            raise ValueError("needs one of part, time")
        if self.eye == self.target:
            raise ValueError("eye and target are the same point")
        return self


def _path(keys: tuple[Key, ...]) -> tuple[Key, ...]:
    if len(keys) < 2:
        raise ValueError("needs two or more keys { part, eye, target, fov }")
    for name in ("part", "time"):
        at = [getattr(key, name) for key in keys]
        if any(v is not None for v in at):
            if None in at:
                raise ValueError("all keys need part, or all need time")
            if any(b <= a for a, b in zip(at, at[1:])):
                raise ValueError(f"{name} must grow from key to key")
    return keys


LENS = ("aperture", "focus")
# what a camera of each kind may be told, besides kind and name
CAMERA_KEYS = {
    "orbit": (*LENS, "target", "up", "fov", "near", "distance", "height", "turns", "angle"),
    "fixed": (*LENS, "target", "up", "fov", "near", "eye"),
    "keyframes": (*LENS, "target", "up", "fov", "near", "keys"),
    "transforms": (*LENS, "near", "file", "image", "scale"),
    "colmap": (*LENS, "near", "folder", "image", "scale"),
}
CAMERA_NEEDS = {"fixed": "eye = [x, y, z]", "keyframes": "keys = [...]"}
CAMERA_NEEDS |= {"transforms": "file = 'transforms.json'", "colmap": "folder = 'sparse/0'"}


class CameraSettings(_Table):
    """Lengths in m, angles in degrees. What is left out is chosen so that the domain is in view."""

    kind: Literal["orbit", "fixed", "keyframes", "transforms", "colmap"] = "orbit"
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]{1,40}$")] | None = None
    target: Vector | None = None
    up: Direction = (0.0, 0.0, 1.0)
    fov: Annotated[Degrees, Field(gt=0, lt=170)] = 40.0  # vertical
    near: Annotated[float, Field(gt=0)] | None = None
    eye: Vector | None = None
    distance: Annotated[float, Field(gt=0)] | None = None  # from target to eye
    height: float | None = None  # of the eye above the target
    turns: float = 0.0  # full circles over the video
    angle: Degrees = 25.0  # at the first frame; 0 looks from -y, 90 from +x
    keys: Annotated[tuple[Key, ...], AfterValidator(_path)] | None = None
    file: str | None = None  # relative to the folder of render.toml, as the next
    folder: str | None = None
    image: str | None = None  # the one camera of a file to look through
    scale: Annotated[float, Field(gt=0, le=4)] = 1.0  # of a file's picture sizes
    aperture: Annotated[float, Field(ge=0)] = 0.0  # radius of the lens: what is not in focus blurs
    focus: Annotated[float, Field(gt=0)] | None = None  # how far what is sharp is, along the axis

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
        if self.aperture > 0 and self.focus is None:
            raise ValueError("a camera with an aperture needs focus")
        if None not in (self.height, self.distance) and abs(self.height) >= self.distance:
            raise ValueError("height must be less than distance")
        return self


class FloorSettings(_Table):
    """A plane z = height under the Gaussians, and their shadow on it."""

    # studio: tiles with faint joints that fade into the backdrop; none: there is no floor; plain: of
    # one color or in squares. Default: studio, or plain where colors are given
    kind: Literal["studio", "plain", "none"] | None = None
    height: float = 0.0  # m
    tiles: Annotated[float, Field(ge=0)] | None = None  # edge of the studio's tiles [m]; 0: none
    colour: Colour | None = None  # default: light grey; over a picture none, only its shadow
    squares: Annotated[float, Field(gt=0)] | None = None  # side [m]; every other one in `other`
    other: Colour = (0.7, 0.7, 0.7)
    light: Direction = (0.3, 0.2, -1.0)  # in which it travels
    shadow: Annotated[float, Field(ge=0, le=1)] = 0.6
    softness: Annotated[float, Field(ge=0, le=1)] = 0.1

    @model_validator(mode="after")
    def _from_above(self):
        if not self.light[2] < 0:
            raise ValueError("needs a light that points down, light = [x, y, -z]")
        return self

    def floor(self, photograph: bool, light: Light | None = None) -> Floor:
        """photograph: whether the background is a picture. light: of all things, whose direction,
        shadow and softness count where the floor is not told its own."""
        squares = None if self.squares is None else (self.other, self.squares)
        bare = photograph and squares is None
        colour = self.colour or (None if bare else Floor.color)
        own = {name: getattr(self, name) for name in ("light", "shadow", "softness")}
        if light is not None:
            said = self.model_fields_set
            usual = {"light": light.direction, "shadow": light.shadow, "softness": light.softness}
            own = {name: own[name] if name in said else usual[name] for name in own}
        contact = light.contact if light is not None else 0.0
        return Floor(self.height, colour, squares, **own, contact=contact)


class PictureSettings(_Table):
    width: Annotated[int, Field(ge=16, le=8192)] = 800  # pixels
    height: Annotated[int, Field(ge=16, le=8192)] = 800
    background: Background | None = (
        None  # default: the studio's backdrop; white with preset "paper"
    )
    tone: Literal["neutral", "none"] | None = None  # curve from light to display values
    edges: Annotated[int, Field(ge=1, le=8)] = 3  # rays across a pixel where neighbors differ
    supersample: Annotated[int, Field(ge=1, le=4)] = 1
    samples: Annotated[int, Field(ge=2, le=256)] = 16  # of an aperture and of a shutter
    floor: FloorSettings | None = None

    @model_validator(mode="after")
    def _one_ground(self):
        if self.floor is not None and self.background == "none":
            raise ValueError('a transparent background ("none") leaves no room for a floor')
        return self


class VideoSettings(_Table):
    fps: Annotated[float, Field(ge=1, le=240)] = 25.0
    quality: Annotated[float, Field(ge=0, le=10)] = 8.0
    shutter: Annotated[float, Field(ge=0, le=1)] = 0.0  # share of a frame's time that it is open


class FrameSettings(_Table):
    first: Annotated[int, Field(ge=0)] = 0
    last: Annotated[int, Field(ge=0)] | None = None
    every: Annotated[int, Field(ge=1)] = 1

    def numbers(self, count: int) -> list[int]:
        """The frames to draw of a run that has so many."""
        return list(range(self.first, self.end(count) + 1, self.every))

    def end(self, count: int) -> int:
        """The frame behind which none is drawn."""
        return count - 1 if self.last is None else min(self.last, count - 1)


class SplattingSettings(_Table):
    """`classic` is what captures are trained for; the others keep tiny Gaussians thin."""

    mode: Literal["classic", "antialias", "mip"] = "classic"
    lowpass: Annotated[float, Field(gt=0, le=2)] | None = None  # pixels^2
    alpha_min: Annotated[float, Field(ge=ALPHA_MIN_RANGE[0], le=ALPHA_MIN_RANGE[1])] | None = None

    def options(self) -> dict[str, Any]:
        """Arguments of splat.render but alpha_min."""
        usual = 0.1 if self.mode == "mip" else 0.3
        return {"lowpass": self.lowpass or usual, "antialias": self.mode != "classic"}


class SurroundingsSettings(_Table):
    """What liquids mirror: a gradient, or a picture of all directions."""

    zenith: Colour = (0.45, 0.65, 0.9)
    horizon: Colour = (0.93, 0.95, 0.97)
    ground: Colour = (0.5, 0.48, 0.45)
    picture: str | None = None  # twice as wide as high, up above; relative to render.toml's folder


class LightSettings(_Table):
    """A light from far away: shadows on all that is drawn, and shades of what is turned away."""

    direction: Direction | None = None  # in which it travels
    key: Annotated[float, Field(ge=0, le=10)] = lighting.KEY  # strength on a surface that faces it
    sky: Annotated[float, Field(ge=0, le=10)] = lighting.SKY  # strength of the light from all sides
    width: Annotated[float, Field(ge=0.005, le=0.5)] = lighting.WIDTH  # half width: soft shadows
    cells: Annotated[int, Field(ge=16, le=400)] = 150  # of what hides light, along the domain
    captures: Annotated[float, Field(ge=0, le=1)] = 0.5  # how much of it captures take
    shadow: Annotated[float, Field(ge=0, le=1)] = Light.shadow
    softness: Annotated[float, Field(ge=0, le=1)] = Light.softness
    shade: Annotated[float, Field(ge=0, le=1)] = Light.shade
    contact: Annotated[float, Field(ge=0, le=1)] = Light.contact

    def light(self) -> Light:
        """The light of preset "paper"."""
        names = ("shadow", "softness", "shade", "contact")
        own = {name: getattr(self, name) for name in names}
        return Light(self.direction or Light.direction, **own)


class LiquidSettings(_Table):
    """Liquids that are drawn with a surface (look.liquid = "surface")."""

    method: Literal["field", "filter"] | None = None  # a field in space, or a filter of depths
    fine: Annotated[float, Field(ge=1, le=4)] = 2.5  # cells of the field in a spacing
    scatter: Annotated[float, Field(ge=0)] | None = None  # own light [1/m]; by the opacities
    walls: bool = True  # whether the domain's walls cut it flat
    index: Annotated[float, Field(ge=1.0, le=3.0)] = 1.333  # of refraction
    # way after which white light has the liquid's colour [m]; default: a third of what is in view
    clear: Annotated[float, Field(gt=0)] | None = None
    highlight: Annotated[float, Field(ge=0, le=100)] = 2.0
    roughness: Annotated[Degrees, Field(ge=0.1, le=60)] = 3.0  # half width of the highlight
    surroundings: SurroundingsSettings = SurroundingsSettings()


def _ascending(value: tuple[float, float]) -> tuple[float, float]:
    if not 1.0 <= value[0] <= value[1] <= 20.0:
        raise ValueError("must be two numbers [low, high] with 1 <= low <= high <= 20")
    return value


class LookSettings(_Table):
    """How Gaussians follow their particles. None: what the scene says (vgmpi/scene/settings.py)."""

    preset: Literal["studio", "paper"] = "studio"  # paper: Gaussians as they are, without a studio
    liquid: Literal["gaussians", "surface"] | None = None  # how fluids are drawn
    children: Annotated[int, Field(strict=True, ge=1, le=64)] = 16  # of a particle of sand or snow
    tear: Annotated[tuple[float, float], AfterValidator(_ascending)] = (1.8, 4.5)  # spacings
    dust: Annotated[float, Field(ge=0, le=1)] = 0.03  # opacity
    foam: Annotated[float, Field(ge=0, le=1)] = 0.8  # most that is white
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
    # by the object's name: up to how much brighter or darker each particle is than its colour
    grain: dict[str, Annotated[float, Field(ge=0, le=1)]] = {}

    def colours(self) -> dict[str, Any]:
        """What is said of colours that travel, by the names of the scene's [appearance]."""
        return {k: v for k, v in self if k.startswith("colour_") and v is not None}


def _listed(value: Any) -> Any:
    if not isinstance(value, dict | list):
        raise ValueError("must be a table [camera], or several tables [[camera]]")
    return [value] if isinstance(value, dict) else value


class Settings(_Table):
    camera: Annotated[tuple[CameraSettings, ...], BeforeValidator(_listed), Field(min_length=1)] = (
        CameraSettings(),
    )
    picture: PictureSettings = PictureSettings()
    video: VideoSettings = VideoSettings()
    frames: FrameSettings = FrameSettings()
    splatting: SplattingSettings = SplattingSettings()
    look: LookSettings = LookSettings()
    liquid: LiquidSettings = LiquidSettings()
    light: LightSettings | None = None

    def views(self) -> tuple[CameraSettings, ...]:
        """The cameras that draw, one or more."""
        return self.camera

    @property
    def studio(self) -> bool:
        """Whether pictures are drawn by the studio: not where another way is asked for."""
        if self.look.liquid == "gaussians" or self.liquid.method == "filter":
            return False
        return self.look.preset == "studio"

    @property
    def background(self) -> tuple[float, float, float] | str:
        """Of the picture, white where nothing is said."""
        asked = self.picture.background
        return "#ffffff" if asked is None else asked


def load(path: str | Path | None) -> Settings:
    """The settings of a render.toml, or the usual ones without a file. Raises SettingsError."""
    if path is None:
        return Settings()
    source = Source(path, error=SettingsError, old_names=OLD_NAMES)
    try:
        chosen = Settings.model_validate(source.data)
    except ValidationError as error:
        raise SettingsError(source.lines(explain(error, Settings))) from None
    names = [one.name for one in chosen.camera]
    for k, name in enumerate(names):
        if len(names) > 1 and (name is None or name in names[:k]):
            said = "several cameras need a name each, no two the same"
            raise SettingsError(source.lines([(("camera", k), said)]))
    return chosen

"""render.toml: camera, picture, video and splatting, checked before anything is drawn. What it says
of how things look is in appearance.py."""

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    ValidationError,
    model_validator,
)

from postprocess.appearance import (
    Degrees,
    Direction,
    LightSettings,
    LiquidSettings,
    LookSettings,
    RenderTable,
    Vector,
)
from vgmpi.source import Source
from vgmpi.splatting.floor import Floor
from vgmpi.splatting.light import Light
from vgmpi.splatting.splat import ALPHA_MIN_RANGE
from vgmpi.tables import Colour, TomlError, colour, explain


def _background(value: Any) -> tuple[float, float, float] | str:
    if isinstance(value, str) and value and not value.startswith("#"):
        return value
    try:
        return colour(value)
    except ValueError as error:
        raise ValueError(f"{error}, 'none', or the name of a picture") from None


Background = Annotated[tuple[float, float, float] | str, BeforeValidator(_background)]


CAPTURES = 0.5  # of the studio's light that captures take
OLD_NAMES = {"picture": {"color": "colour"}}  # what keys inside were called before


class SettingsError(TomlError):
    """What is wrong with a render.toml, or with what it asks for."""


class Key(RenderTable):
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


class CameraSettings(RenderTable):
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


class FloorSettings(RenderTable):
    """A plane z = height under the Gaussians, and their shadow on it."""

    # studio: tiles with faint joints that fade into the backdrop; none: there is no floor; plain:
    # of one color or in squares; photograph: only shadows that have come since the first frame,
    # since the background holds the others. Default: studio, or plain where colors are given
    kind: Literal["studio", "plain", "photograph", "none"] | None = None
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


class PictureSettings(RenderTable):
    width: Annotated[int, Field(ge=16, le=8192)] = 800  # pixels
    height: Annotated[int, Field(ge=16, le=8192)] = 800
    # default: the studio's backdrop; white with preset "paper"
    background: Background | None = None
    tone: Literal["neutral", "none"] | None = None  # curve from light to display values
    edges: Annotated[int, Field(ge=1, le=8)] = 3  # rays across a pixel where neighbors differ
    supersample: Annotated[int, Field(ge=1, le=4)] = 1
    samples: Annotated[int, Field(ge=2, le=256)] = 16  # of an aperture and of a shutter
    floor: FloorSettings | None = None

    @property
    def on_photograph(self) -> bool:
        """Whether the background is a picture from a file."""
        asked = self.background
        return isinstance(asked, str) and not asked.startswith("#") and asked != "none"

    @model_validator(mode="after")
    def _one_ground(self):
        if self.floor is not None and self.background == "none":
            raise ValueError('a transparent background ("none") leaves no room for a floor')
        if self.floor is not None and self.floor.kind == "photograph" and not self.on_photograph:
            raise ValueError('a floor of kind "photograph" needs a picture as background')
        return self


class VideoSettings(RenderTable):
    fps: Annotated[float, Field(ge=1, le=240)] = 25.0
    quality: Annotated[float, Field(ge=0, le=10)] = 8.0
    shutter: Annotated[float, Field(ge=0, le=1)] = 0.0  # share of a frame's time that it is open


class FrameSettings(RenderTable):
    first: Annotated[int, Field(ge=0)] = 0
    last: Annotated[int, Field(ge=0)] | None = None
    every: Annotated[int, Field(ge=1)] = 1

    def numbers(self, count: int) -> list[int]:
        """The frames to draw of a run that has so many."""
        return list(range(self.first, self.end(count) + 1, self.every))

    def end(self, count: int) -> int:
        """The frame behind which none is drawn."""
        return count - 1 if self.last is None else min(self.last, count - 1)


class SplattingSettings(RenderTable):
    """`classic` is what captures are trained for; the others keep tiny Gaussians thin."""

    mode: Literal["classic", "antialias", "mip"] = "classic"
    lowpass: Annotated[float, Field(gt=0, le=2)] | None = None  # pixels^2
    alpha_min: Annotated[float, Field(ge=ALPHA_MIN_RANGE[0], le=ALPHA_MIN_RANGE[1])] | None = None

    def options(self) -> dict[str, Any]:
        """Arguments of splat.render but alpha_min."""
        usual = 0.1 if self.mode == "mip" else 0.3
        return {"lowpass": self.lowpass or usual, "antialias": self.mode != "classic"}


def _listed(value: Any) -> Any:
    if not isinstance(value, dict | list):
        raise ValueError("must be a table [camera], or several tables [[camera]]")
    return [value] if isinstance(value, dict) else value


class Settings(RenderTable):
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

    def on_paper(self) -> "Settings":
        """The same in the paper's way, where nothing is said of a preset."""
        if "preset" in self.look.model_fields_set:
            return self
        look = self.look.model_copy(update={"preset": "paper"})
        return self.model_copy(update={"look": look})

    @property
    def captures(self) -> float:
        """How much of the studio's light captures take, 0..1: none before a photograph that holds
        their first shadows."""
        if self.light is not None and self.light.captures is not None:
            return self.light.captures
        floor = self.picture.floor
        return 0.0 if floor is not None and floor.kind == "photograph" else CAPTURES

    @property
    def toned(self) -> bool:
        """Whether light is shown through the tone curve: not before a background that was asked
        for, whose colors it could not all show."""
        if self.picture.tone is None:
            return self.picture.background in (None, "none")
        return self.picture.tone == "neutral"

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

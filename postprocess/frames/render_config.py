"""Schema of render.toml: camera, picture, video and splatting, checked before rendering.

The tables about the appearance of bodies are in look_config.py.
"""

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    ValidationError,
    model_validator,
)

from vgmpi.runtime.config.schema import Color, TomlError, format_validation_errors, parse_color
from vgmpi.runtime.config.toml_source import TomlSource

from ..raster.ground_plane import GroundPlane
from ..raster.rasterize import ALPHA_MIN_RANGE, LOWPASS
from ..raster.shadow_lighting import Light
from .look_config import (
    Degrees,
    Direction,
    LightSettings,
    LiquidSettings,
    LookSettings,
    RenderTable,
    Vector,
)


def _background(value: Any) -> tuple[float, float, float] | str:
    """Parse a color, 'none', or the name of a picture."""
    if isinstance(value, str) and value and not value.startswith("#"):
        return value
    try:
        return parse_color(value)
    except ValueError as error:
        raise ValueError(f"{error}, 'none', or the name of a picture") from None


Background = Annotated[tuple[float, float, float] | str, BeforeValidator(_background)]


SETTINGS_NAME = "render.toml"  # looked for in and beside the folder of a run
CAPTURE_LIGHT = 0.5  # [-] share of the studio's light that acts on captures


class SettingsError(TomlError):
    """Error in a render.toml, or in a file that it names."""


class Keyframe(RenderTable):
    """A keyframe of a camera path."""

    progress: Annotated[float, Field(ge=0, le=1)] | None = None
    """share of the video's duration, 0..1; or"""
    time: Annotated[float, Field(ge=0)] | None = None
    """time of the simulation [s]"""
    eye: Vector
    """where the camera stands: [x, y, z]"""
    target: Vector | None = None
    """point at the center of the image [m]"""
    fov: Annotated[Degrees, Field(ge=1e-3, le=170)] | None = None
    """vertical field of view [degrees]"""

    @model_validator(mode="after")
    def _one_of_each(self):
        """Require progress or time, and eye different from target."""
        if (self.progress is None) == (self.time is None):
            raise ValueError("needs one of progress, time")
        if self.eye == self.target:
            raise ValueError("eye and target are the same point")
        return self


def _check_path(keyframes: tuple[Keyframe, ...]) -> tuple[Keyframe, ...]:
    """Require two or more keyframes in ascending order."""
    if len(keyframes) < 2:
        raise ValueError("needs two or more keyframes { progress, eye, target, fov }")
    for name in ("progress", "time"):
        values = [getattr(keyframe, name) for keyframe in keyframes]
        if any(v is not None for v in values):
            if None in values:
                raise ValueError("all keyframes need progress, or all need time")
            if any(b <= a for a, b in zip(values, values[1:])):
                raise ValueError(f"{name} must grow from keyframe to keyframe")
    return keyframes


LENS = ("aperture", "focus")
# keys of each kind of camera, besides kind and name
CAMERA_KEYS = {
    "orbit": (
        *LENS,
        "target",
        "up",
        "fov",
        "near",
        "distance",
        "height",
        "revolutions",
        "azimuth",
    ),  # fmt: skip
    "fixed": (*LENS, "target", "up", "fov", "near", "eye"),
    "keyframes": (*LENS, "target", "up", "fov", "near", "keyframes"),
    "transforms": (*LENS, "near", "file", "image", "scale"),
    "colmap": (*LENS, "near", "folder", "image", "scale"),
}
CAMERA_NEEDS = {"fixed": "eye = [x, y, z]", "keyframes": "keyframes = [...]"}
CAMERA_NEEDS |= {"transforms": "file = 'transforms.json'", "colmap": "folder = 'sparse/0'"}


class CameraSettings(RenderTable):
    """A camera. Omitted lengths and angles are chosen so that the domain is in view."""

    kind: Literal["orbit", "fixed", "keyframes", "transforms", "colmap"] = "orbit"
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]{1,40}$")] | None = None
    target: Vector | None = None
    up: Direction = (0.0, 0.0, 1.0)
    fov: Annotated[Degrees, Field(gt=0, lt=170)] = 40.0  # [degrees] vertical field of view
    near: Annotated[float, Field(gt=0)] | None = None
    eye: Vector | None = None
    distance: Annotated[float, Field(gt=0)] | None = None  # [m] from target to eye
    height: float | None = None  # [m] of the eye above the target
    revolutions: float = 0.0  # full circles over the video
    azimuth: Degrees = 25.0  # [degrees] at the first frame; 0 is a view from -y, 90 from +x
    keyframes: Annotated[tuple[Keyframe, ...], AfterValidator(_check_path)] | None = None
    file: str | None = None  # relative to the folder of render.toml; folder too
    folder: str | None = None
    image: str | None = None  # name of the camera that is used from a file
    scale: Annotated[float, Field(gt=0, le=4)] = 1.0  # factor on the image sizes of a file
    aperture: Annotated[float, Field(ge=0)] = 0.0  # [m] radius of the lens; 0: pinhole
    focus: Annotated[float, Field(gt=0)] | None = None  # [m] focus distance along the axis

    @model_validator(mode="after")
    def _fits_kind(self):
        """Require the keys of the camera's kind, and no others."""
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
    """A plane z = height under the Gaussians that receives their shadow."""

    # studio: tiles with faint joints that fade into the backdrop; none: no floor; plain: one color
    # or a checkerboard; photograph: only shadows that were added since the first frame, because the
    # background holds the others. Default: studio, or plain if colors are given
    kind: Literal["studio", "plain", "photograph", "none"] | None = None
    height: float = 0.0  # [m]
    tile_size: Annotated[float, Field(ge=0)] | None = (
        None  # [m] edge of the studio's tiles; 0: none
    )
    color: Color | None = None  # default: light gray; only a shadow on a picture
    # [m] side of the squares of a checkerboard; every other one has checker_color
    checker_size: Annotated[float, Field(gt=0)] | None = None
    checker_color: Color = (0.7, 0.7, 0.7)
    light: Direction = (0.3, 0.2, -1.0)  # direction of travel
    shadow: Annotated[float, Field(ge=0, le=1)] = 0.6
    softness: Annotated[float, Field(ge=0, le=1)] = 0.1

    @model_validator(mode="after")
    def _check_direction(self):
        """Require a light that points down."""
        if not self.light[2] < 0:
            raise ValueError("needs a light that points down, light = [x, y, -z]")
        return self

    def floor(self, photograph: bool, light: Light | None = None) -> GroundPlane:
        """Return the floor of preset "paper".

        photograph: whether the background is a picture. light: light of the scene, whose direction,
        shadow and softness are used unless the floor has its own.
        """
        size = self.checker_size
        squares = None if size is None else (self.checker_color, size)
        is_bare = photograph and squares is None
        color = self.color or (None if is_bare else GroundPlane.color)
        values = {name: getattr(self, name) for name in ("light", "shadow", "softness")}
        if light is not None:
            explicit = self.model_fields_set
            shared = {"light": light.direction, "shadow": light.shadow, "softness": light.softness}
            values = {name: values[name] if name in explicit else shared[name] for name in values}
        contact = light.contact if light is not None else 0.0
        return GroundPlane(self.height, color, squares, **values, contact=contact)


class PictureSettings(RenderTable):
    """Size, background and quality of images."""

    width: Annotated[int, Field(ge=16, le=8192)] = 800  # [pixels]
    height: Annotated[int, Field(ge=16, le=8192)] = 800
    # default: the studio's backdrop; white with preset "paper"
    background: Background | None = None
    # from light to display values: Khronos PBR Neutral
    tone_mapping: Literal["neutral", "none"] | None = None
    edge_samples: Annotated[int, Field(ge=1, le=8)] = 3  # rays across a pixel at edges
    supersample: Annotated[int, Field(ge=1, le=4)] = 1
    blur_samples: Annotated[int, Field(ge=2, le=256)] = 16  # of the aperture and of the shutter
    floor: FloorSettings | None = None

    @property
    def on_photograph(self) -> bool:
        """True if the background is a picture from a file."""
        background = self.background
        return (
            isinstance(background, str) and not background.startswith("#") and background != "none"
        )

    @model_validator(mode="after")
    def _one_ground(self):
        """Require that floor and background go together."""
        if self.floor is not None and self.background == "none":
            raise ValueError('a transparent background ("none") leaves no room for a floor')
        if self.floor is not None and self.floor.kind == "photograph" and not self.on_photograph:
            raise ValueError('a floor of kind "photograph" needs a picture as background')
        return self


class VideoSettings(RenderTable):
    """Frame rate, quality and shutter of the video."""

    fps: Annotated[float, Field(ge=1, le=240)] = 25.0
    quality: Annotated[float, Field(ge=0, le=10)] = 8.0
    shutter: Annotated[float, Field(ge=0, le=1)] = 0.0  # open share of the frame interval


class FrameSettings(RenderTable):
    """Selection of frames."""

    first: Annotated[int, Field(ge=0)] = 0
    last: Annotated[int, Field(ge=0)] | None = None
    every: Annotated[int, Field(ge=1)] = 1

    def numbers(self, count: int) -> list[int]:
        """Return the frames to draw of a run with `count` frames."""
        return list(range(self.first, self.end(count) + 1, self.every))

    def end(self, count: int) -> int:
        """Return the last frame to draw."""
        return count - 1 if self.last is None else min(self.last, count - 1)


class SplattingSettings(RenderTable):
    """Filter of the rasterizer.

    Mode `capture` draws each object by the render model of its capture; the others draw all objects
    alike.
    """

    mode: Literal["capture", "classic", "antialias", "mip"] = "capture"
    lowpass: Annotated[float, Field(gt=0, le=2)] | None = None  # [pixels^2]
    alpha_min: Annotated[float, Field(ge=ALPHA_MIN_RANGE[0], le=ALPHA_MIN_RANGE[1])] | None = None

    def options(self) -> dict[str, Any]:
        """Return the arguments of rasterize.render except alpha_min."""
        if self.mode == "capture":
            return {"lowpass": self.lowpass, "antialias": None}
        default = 0.1 if self.mode == "mip" else LOWPASS
        return {"lowpass": self.lowpass or default, "antialias": self.mode != "classic"}


def _to_list(value: Any) -> Any:
    """Accept one table or a list of tables."""
    if not isinstance(value, dict | list):
        raise ValueError("must be a table [camera], or several tables [[camera]]")
    return [value] if isinstance(value, dict) else value


class Settings(RenderTable):
    """Contents of a render.toml."""

    camera: Annotated[
        tuple[CameraSettings, ...], BeforeValidator(_to_list), Field(min_length=1)
    ] = (CameraSettings(),)
    picture: PictureSettings = PictureSettings()
    video: VideoSettings = VideoSettings()
    frames: FrameSettings = FrameSettings()
    splatting: SplattingSettings = SplattingSettings()
    look: LookSettings = LookSettings()
    liquid: LiquidSettings = LiquidSettings()
    light: LightSettings | None = None

    def views(self) -> tuple[CameraSettings, ...]:
        """Return the cameras, one or more."""
        return self.camera

    @property
    def studio(self) -> bool:
        """True if the studio draws the images."""
        return self.look.preset == "studio"

    def on_paper(self) -> "Settings":
        """Return settings with preset "paper" unless a preset is given."""
        if "preset" in self.look.model_fields_set:
            return self
        look = self.look.model_copy(update={"preset": "paper"})
        return self.model_copy(update={"look": look})

    @property
    def captures(self) -> float:
        """Share of the studio's light that acts on captures, 0..1.

        It is 0 on a photograph that holds their first shadows.
        """
        if self.light is not None and self.light.captures is not None:
            return self.light.captures
        floor = self.picture.floor
        return 0.0 if floor is not None and floor.kind == "photograph" else CAPTURE_LIGHT

    @property
    def toned(self) -> bool:
        """True if the tone curve is applied.

        By default it is not applied to a given background, whose colors it could not all show.
        """
        if self.picture.tone_mapping is None:
            return self.picture.background in (None, "none")
        return self.picture.tone_mapping == "neutral"

    @property
    def background(self) -> tuple[float, float, float] | str:
        """Background of the image, white by default."""
        background = self.picture.background
        return "#ffffff" if background is None else background


def find_settings(folder: Path) -> Path | None:
    """Return the render.toml in the folder of a run, or beside it, or None."""
    places = [folder / SETTINGS_NAME, folder.resolve().parent / SETTINGS_NAME]
    return next((path for path in places if path.exists()), None)


def base_folder(path: str | Path | None) -> Path:
    """Return the folder of a render.toml, for the files it names; the current one without it."""
    return Path(".") if path is None else Path(path).parent


def load(path: str | Path | None) -> Settings:
    """Load a render.toml, or return the defaults without a file. Raises SettingsError."""
    if path is None:
        return Settings()
    source = TomlSource(path, error=SettingsError)
    try:
        chosen = Settings.model_validate(source.data)
    except ValidationError as error:
        raise SettingsError(source.lines(format_validation_errors(error, Settings))) from None
    names = [entry.name for entry in chosen.camera]
    for k, name in enumerate(names):
        if len(names) > 1 and (name is None or name in names[:k]):
            message = "several cameras need a name each, no two the same"
            raise SettingsError(source.lines([(("camera", k), message)]))
    return chosen


def error_lines(error: Exception, path: str | Path | None) -> list[str]:
    """Return the lines of an error, with file and line where they begin with a key of render.toml.

    Args:
        error: SettingsError, or an error of one line.
        path: The file render.toml, or None if there is none.
    """
    lines = error.lines if isinstance(error, SettingsError) else [str(error)]
    try:
        source = None if path is None else TomlSource(path)
    except TomlError:
        source = None
    return [line if source is None else source.with_place(line) for line in lines]

"""fit.toml: what is looked for, what it is held to, and how; checked before anything is run."""

import math
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, ValidationError, model_validator

from ..scene.reader import load as load_scene
from ..scene.scene import Scene
from ..source import Source
from ..tables import Quantity, SceneError, Table, TomlError, explain, got
from .axes import Axis, missing, value_at
from .taste.settings import Sds

FEWEST_RUNS, MOST_PARAMETERS = 3, 20


class FitFileError(TomlError):
    """What is wrong with a fit.toml, or with what it names."""


def _number(value: Any) -> int | float | str:
    """A number in SI, or a text with a unit, which the scene's own key reads."""
    if isinstance(value, str) and value.strip():
        return value
    if isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value):
        return value
    raise ValueError("must be a number, or a text with a unit such as '1 kPa'")


def _finer(value: tuple[int, ...]) -> tuple[int, ...]:
    if not value or sorted(set(value)) != list(value):
        raise ValueError("must be one number or more, each larger than the one before")
    return value


def _sharper(value: tuple[float, ...]) -> tuple[float, ...]:
    if not value or sorted(set(value), reverse=True) != list(value):
        raise ValueError("must be one number or more, each smaller than the one before")
    return value


def _some(value: tuple[Any, ...]) -> tuple[Any, ...]:
    if not 1 <= len(value) <= MOST_PARAMETERS:
        raise ValueError(f"must be from 1 to {MOST_PARAMETERS} tables; got {len(value)}")
    return value


Number = Annotated[Any, BeforeValidator(_number)]
Blur = Annotated[float, Field(ge=0, le=1000)]
_ABSENT: Any = None  # a target is asked for where there is one: [sds] stands in its place
Share = Annotated[float, Field(gt=0, le=0.5, strict=True)]


class Parameter(Table):
    """A number of the scene that is looked for."""

    key: Annotated[str, Field(min_length=1)]
    """of the scene, as --set takes it, such as material.rubber.youngs_modulus"""
    range: tuple[Number, Number]
    """the least and the largest value"""
    logarithmic: bool = True
    """whether steps are factors: for what may be off by a factor; not for a range with 0 in it"""
    start: Number | None = None
    """where the search begins; default: the scene's own value"""


class Target(Table):
    """What runs are held to: exactly one of video, frames, table."""

    video: str | None = None
    """a video, or a folder of .png, of what the scene shows; relative to fit.toml"""
    render: str | None = None
    """of a video: the render.toml by which runs are drawn to lie beside it, with one camera that is
    told where it stands; of frames: of the video of both beside each other"""
    blur: Annotated[tuple[Blur, ...], AfterValidator(_sharper)] | None = None
    """of a video: over how many pixels pictures are blurred, from coarse to fine; default: a
    16th, a 48th and a 140th of their width"""
    pixels: Annotated[int, Field(ge=16, le=1024, strict=True)] = 128
    """of a video: of the longer side of the pictures that are compared, at most"""
    camera_shift: Annotated[float, Field(ge=0, le=100)] = 0.0
    """of a video: pixels that its camera may be off; of a run the shift that suits best counts"""
    frame_time: Annotated[float, Quantity("s", gt=0)] | None = None
    """of a video: time between its pictures; those of a moment of which the scene has a frame are
    compared; default: its pictures are the frames that render.toml draws, one by one"""

    frames: str | None = None
    """folder of a run, of the same domain and the same bodies by name; relative to fit.toml"""
    table: str | None = None
    """CSV with a header: a probe's table of another run, or what was measured or published"""
    hold_out: Annotated[int, Field(ge=0, strict=True)] = 5
    """every so many frames, or rows, one that the search does not see, to hold what is found to;
    0: none"""
    bodies: tuple[str, ...] | None = None
    """of frames: the bodies that are looked at; default: all"""
    boxes: Annotated[
        tuple[Annotated[int, Field(ge=2, le=64, strict=True)], ...], AfterValidator(_finer)
    ] = (6, 16)
    """of frames: boxes along the domain's longest edge in which a body's mass is counted, from
    coarse to fine"""
    probe: str | None = None
    """of a table: the probe of the scene that measures the same"""
    columns: dict[str, str] | tuple[str, ...] | None = None
    """of a table: columns that are compared; as { probe's = "table's" } where names differ;
    default: all that both have"""
    time: str = "time"
    """of a table: its column of times"""
    time_unit: Annotated[float, Field(gt=0, strict=True)] = 1.0
    """of a table: what 1 in that column is in s"""
    time_zero: Annotated[float, Field(strict=True)] = 0.0
    """of a table, or of a video with frame_time: when its time 0 is in the scene [s]"""
    value_unit: Annotated[float, Field(gt=0, strict=True)] = 1.0
    """of a table: what 1 in the columns compared is in SI"""
    where: dict[str, str] = {}
    """of a table: only rows with these words in these columns"""

    @model_validator(mode="after")
    def _fits_kind(self):
        given = [kind for kind in KEYS if getattr(self, kind) is not None]
        if len(given) != 1:
            said = f"{' and '.join(given)} given at once" if given else "nothing to hold runs to"
            raise ValueError(f"{said}: give exactly one of {', '.join(KEYS)}")
        allowed = {given[0], "hold_out", *KEYS[given[0]]}
        wrong = [name for name in type(self).model_fields if name in self.model_fields_set]
        wrong = [name for name in wrong if name not in allowed]
        if wrong:
            raise ValueError(f"a target of {given[0]} has no {', '.join(wrong)}")
        if self.video is not None and self.render is None:
            raise ValueError(
                "a video needs render: the render.toml that draws runs as it shows them"
            )
        if self.table is not None and self.probe is None:
            raise ValueError("a table needs probe: which one of the scene measures the same")
        if self.hold_out == 1:
            raise ValueError("hold_out = 1 leaves nothing to fit to: 0, or 2 and more")
        return self


KEYS = {
    "video": ("render", "blur", "pixels", "camera_shift", "frame_time", "time_zero"),
    "frames": ("bodies", "boxes", "render"),
    "table": ("probe", "columns", "time", "time_unit", "time_zero", "value_unit", "where"),
}


class Method(Table):
    """How it is looked for."""

    kind: Literal["least-squares", "cma", "descent"] = "least-squares"
    """least squares by differences, or CMA-ES (pip install 'vgmpi[fit]'), for losses with many
    valleys; of [sds] descent along the model's gradient, the default there, or cma"""
    runs: Annotated[int, Field(ge=FEWEST_RUNS, strict=True)] = 40
    """at most so many, those that are kept from before counted too"""
    scan: Annotated[int, Field(ge=0, le=100, strict=True)] = 5
    """runs spread over each parameter's range before anything else"""
    step: Share = 0.02
    """of differences: share of the value, of a range that is not logarithmic share of the range"""
    grid: Literal["coarser", "finer", "none"] = "coarser"
    """one more run at the end, in cells up to twice as large, or half as large (it takes as long as
    ten), tells what the cells do to what is found"""
    seed: Annotated[int, Field(ge=0, strict=True)] = 1
    """of CMA-ES"""


class Settings(Table):
    parameter: Annotated[tuple[Parameter, ...], AfterValidator(_some)]
    """[[parameter]]: what is looked for"""
    target: Target = _ABSENT
    """[target]: what runs are held to; or"""
    sds: Sds | None = None
    """[sds]: a video model that says what it thinks of them"""
    method: Method = Method()
    """[method]: how"""

    @model_validator(mode="before")
    @classmethod
    def _descends(cls, data: Any) -> Any:
        """The default of method.kind is another with [sds]."""
        method = data.get("method", {}) if isinstance(data, dict) and "sds" in data else None
        return data | {"method": {"kind": "descent"} | method} if type(method) is dict else data


class FitFile:
    """A fit.toml and its scene, checked. `settings`; `axes`: a parameter each; `folder`: where the
    file lies."""

    def __init__(self, path: str | Path, scene: Scene):
        """Raises FitFileError with a line for each thing that is wrong."""
        self.source = Source(path, error=FitFileError)
        self.folder, self.scene = self.source.folder, scene
        try:
            self.settings = Settings.model_validate(self.source.data)
        except ValidationError as error:
            raise FitFileError(self.source.lines(explain(error, Settings))) from None
        found = self._held_to()
        self.axes: list[Axis] = []
        for k, parameter in enumerate(self.settings.parameter):
            if parameter.key in [one.key for one in self.settings.parameter[:k]]:
                found.append((("parameter", k, "key"), f"is named twice; {got(parameter.key)}"))
                continue
            axis = self._axis(k, parameter, found)
            if axis is not None:
                self.axes.append(axis)
        if found:
            raise FitFileError(self.source.lines(found))

    def _held_to(self) -> list[tuple[tuple, str]]:
        """What is wrong with what runs are held to, and with how."""
        asked, kind = self.settings, self.settings.method.kind
        if asked.target is None and asked.sds is None:
            return [(("target",), "required key is missing: [target], or [sds]")]
        if asked.target is not None and asked.sds is not None:
            return [(("sds",), "[target] and [sds] given at once: give exactly one of both")]
        if asked.sds is None and kind == "descent":
            return [(("method", "kind"), f"goes with [sds] alone; {got(kind)}")]
        if asked.sds is not None and kind == "least-squares":
            said = "a model's taste has no residuals: must be one of descent, cma"
            return [(("method", "kind"), f"{said}; {got(kind)}")]
        return []

    def wrong(self, path: tuple, said: str) -> FitFileError:
        """The error for a key, found after loading."""
        return FitFileError(self.source.lines([(path, said)]))

    def line(self, k: int) -> str:
        """ "fit.toml:12" of the k-th parameter."""
        return self.source.place(("parameter", k))[1]

    def _axis(self, k: int, parameter: Parameter, found: list) -> Axis | None:
        """The parameter in numbers; what is wrong with it goes to `found`."""
        here: tuple = ("parameter", k)
        gone = missing(self.scene, parameter.key)
        if gone:
            found.append(((*here, "key"), f"{gone}; {got(parameter.key)}"))
            return None
        ends: list[float] = []
        for end in (0, 1):
            value = self._si(parameter.key, parameter.range[end], (*here, "range", end), found)
            if value is None:
                return None
            ends.append(value)
        low, high = ends
        if not low < high:
            found.append(((*here, "range"), f"must be [low, high]; got [{low:g}, {high:g}]"))
            return None
        if parameter.logarithmic and low <= 0:
            said = f"begins at {low:g}, which has no logarithm: give logarithmic = false, or more"
            found.append(((*here, "range"), said))
            return None
        if parameter.start is not None:
            start = self._si(parameter.key, parameter.start, (*here, "start"), found)
            if start is None:
                return None
        else:
            start = float(value_at(self.scene, parameter.key) or low)
        if not low <= start <= high:
            whose = "start" if parameter.start is not None else "range"
            own = "" if parameter.start is not None else "the scene's own value, "
            found.append(
                ((*here, whose), f"{own}{start:g}, is not from {low:g} to {high:g}: give a start")
            )
            return None
        return Axis(parameter.key, low, high, start, parameter.logarithmic)

    def _si(self, key: str, value: float | str, path: tuple, found: list) -> float | None:
        """What the scene makes of a value of a key [SI]; where it refuses it, None."""
        text = value if isinstance(value, str) else repr(value)
        try:
            scene = load_scene(
                self.scene.path, (*self.scene.overrides, f"{key}={text}"), self.scene.text
            )
        except SceneError as error:
            said = error.lines[0].partition(": ")[2] or error.lines[0]
            unknown = "unknown key" in said or "has no item" in said or "expected key" in said
            unknown = unknown or "is not a table" in said
            at = (*path[:2], "key") if unknown else path
            found.append((at, f"the scene says: {said}; {got(key if unknown else value)}"))
            return None
        number = value_at(scene, key)
        if isinstance(number, bool) or not isinstance(number, float):
            said = "is a whole number" if type(number) is int else "is no number of the scene"
            found.append(((*path[:2], "key"), f"{said}, which cannot be looked for; {got(key)}"))
            return None
        return number

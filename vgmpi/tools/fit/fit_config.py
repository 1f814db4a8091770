"""Schema of fit.toml: parameters, target and method, checked before any run."""

import math
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, ValidationError, model_validator

from vgmpi.runtime.config.schema import (
    Quantity,
    SceneError,
    StrictModel,
    TomlError,
    format_input,
    format_validation_errors,
)
from vgmpi.runtime.config.toml_source import TomlSource
from vgmpi.scene import loader
from vgmpi.scene.scene import Scene
from vgmpi.tools.fit.video_prior.sds_config import Sds

from .parameter_space import ParameterAxis, missing_table_message, value_at

MIN_RUNS, MAX_PARAMETERS = 3, 20


class FitFileError(TomlError):
    """Error in a fit.toml or in a file that it names."""


def _number(value: Any) -> int | float | str:
    """Accept a number in SI, or a text with a unit that the key of the scene parses."""
    if isinstance(value, str) and value.strip():
        return value
    if isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value):
        return value
    raise ValueError("must be a number, or a text with a unit such as '1 kPa'")


def _increasing(value: tuple[int, ...]) -> tuple[int, ...]:
    """Require strictly increasing values."""
    if not value or sorted(set(value)) != list(value):
        raise ValueError("must be one number or more, each larger than the one before")
    return value


def _decreasing(value: tuple[float, ...]) -> tuple[float, ...]:
    """Require strictly decreasing values."""
    if not value or sorted(set(value), reverse=True) != list(value):
        raise ValueError("must be one number or more, each smaller than the one before")
    return value


def _limited_count(value: tuple[Any, ...]) -> tuple[Any, ...]:
    """Require 1 to MAX_PARAMETERS tables."""
    if not 1 <= len(value) <= MAX_PARAMETERS:
        raise ValueError(f"must be from 1 to {MAX_PARAMETERS} tables; got {len(value)}")
    return value


Number = Annotated[Any, BeforeValidator(_number)]
Blur = Annotated[float, Field(ge=0, le=1000)]
_ABSENT: Any = None  # [target] may be absent only if [sds] is present
Share = Annotated[float, Field(gt=0, le=0.5, strict=True)]


class Parameter(StrictModel):
    """A number of the scene that is fitted."""

    key: Annotated[str, Field(min_length=1)]
    """of the scene, as --set takes it, such as material.rubber.youngs_modulus"""
    range: tuple[Number, Number]
    """the least and the largest value"""
    scale: Literal["log", "linear"] = "log"
    """whether equal steps are equal factors (log; the range must be positive) or differences"""
    initial: Number | None = None
    """value at the start of the search; default: the value of the scene"""


class Target(StrictModel):
    """Data to which runs are compared: exactly one of video, run, table."""

    video: str | None = None
    """path of a video or of a folder of .png, relative to fit.toml"""
    render: str | None = None
    """path of a render.toml with one camera at a fixed place: of a video, runs are drawn with it
    for comparison; of a run, it is used for the side-by-side video"""
    blur: Annotated[tuple[Blur, ...], AfterValidator(_decreasing)] | None = None
    """blur widths [pixels] of the stages of a video, from coarse to fine; default: 1/16, 1/48 and
    1/140 of the image width"""
    pixels: Annotated[int, Field(ge=16, le=1024, strict=True)] = 128
    """largest longer side [pixels] of the compared pictures of a video"""
    max_camera_shift: Annotated[float, Field(ge=0, le=100)] = 0.0
    """largest misalignment [pixels] of the camera of a video; the best-fitting shift is used"""
    frame_time: Annotated[float, Quantity("s", gt=0)] | None = None
    """time between the pictures of a video [s]; pictures at times of the scene's frames are
    compared; default: the pictures are the frames that render.toml draws, one by one"""

    run: str | None = None
    """folder of a run with the same domain and body names, relative to fit.toml"""
    table: str | None = None
    """CSV file with a header: a probe's table of another run, or measured or published data"""
    holdout_every: Annotated[int, Field(ge=0, strict=True)] = 5
    """one of so many frames or rows is excluded from the search to validate the result; 0: none"""
    bodies: tuple[str, ...] | None = None
    """bodies that are compared with a run; default: all"""
    density_bins: Annotated[
        tuple[Annotated[int, Field(ge=2, le=64, strict=True)], ...], AfterValidator(_increasing)
    ] = (6, 16)
    """of a run: number of bins along the domain's longest edge in which the mass of a body is
    summed, from coarse to fine"""
    probe: str | None = None
    """probe of the scene that corresponds to a table"""
    columns: dict[str, str] | tuple[str, ...] | None = None
    """columns of a table that are compared; { probe's = "table's" } if names differ; default: all
    common columns"""
    time: str = "time"
    """time column of a table"""
    time_scale: Annotated[float, Field(gt=0, strict=True)] = 1.0
    """unit of the time column [s]"""
    time_offset: Annotated[float, Field(strict=True)] = 0.0
    """time of the scene at time 0 of a table, or of a video with frame_time [s]"""
    value_scale: Annotated[float, Field(gt=0, strict=True)] = 1.0
    """unit of the compared columns of a table [SI]"""
    filter: dict[str, str] = {}
    """of a table: only rows with these words in these columns are used"""

    @model_validator(mode="after")
    def _fits_kind(self):
        kinds = [kind for kind in KEYS if getattr(self, kind) is not None]
        if len(kinds) != 1:
            message = f"{' and '.join(kinds)} given at once" if kinds else "nothing to hold runs to"
            raise ValueError(f"{message}: give exactly one of {', '.join(KEYS)}")
        allowed = {kinds[0], "holdout_every", *KEYS[kinds[0]]}
        wrong = [name for name in type(self).model_fields if name in self.model_fields_set]
        wrong = [name for name in wrong if name not in allowed]
        if wrong:
            raise ValueError(f"a target of {kinds[0]} has no {', '.join(wrong)}")
        if self.video is not None and self.render is None:
            raise ValueError(
                "a video needs render: the render.toml that draws runs as it shows them"
            )
        if self.table is not None and self.probe is None:
            raise ValueError("a table needs probe: which one of the scene measures the same")
        if self.holdout_every == 1:
            raise ValueError("holdout_every = 1 leaves nothing to fit to: 0, or 2 and more")
        return self


KEYS = {
    "video": ("render", "blur", "pixels", "max_camera_shift", "frame_time", "time_offset"),
    "run": ("bodies", "density_bins", "render"),
    "table": ("probe", "columns", "time", "time_scale", "time_offset", "value_scale", "filter"),
}


class Method(StrictModel):
    """Search method."""

    algorithm: Literal["least-squares", "cma", "descent"] = "least-squares"
    """least squares with finite differences, or CMA-ES (pip install 'vgmpi[fit]') for losses with
    several minima; with [sds] gradient descent, the default there, or cma"""
    max_runs: Annotated[int, Field(ge=MIN_RUNS, strict=True)] = 40
    """largest number of runs, those of an interrupted fit included"""
    scan_points: Annotated[int, Field(ge=0, le=100, strict=True)] = 5
    """runs spread over the range of each parameter before the search"""
    fd_step: Share = 0.02
    """step of finite differences: share of the value, or of a range of linear scale"""
    discretization_check: Literal["coarser", "finer", "none"] = "coarser"
    """cells of one more run that estimates the discretization error: up to twice as large, or half
    as large (which takes as long as ten runs)"""
    seed: Annotated[int, Field(ge=0, strict=True)] = 1
    """random seed of CMA-ES"""


class Settings(StrictModel):
    """Contents of a fit.toml."""

    parameter: Annotated[tuple[Parameter, ...], AfterValidator(_limited_count)]
    """[[parameter]]: what is looked for"""
    target: Target = _ABSENT
    """[target]: data to which runs are compared; or"""
    sds: Sds | None = None
    """[sds]: a video model that rates the runs"""
    method: Method = Method()
    """[method]: search method"""

    @model_validator(mode="before")
    @classmethod
    def _descends(cls, data: Any) -> Any:
        """Make descent the default of method.algorithm with [sds]."""
        method = data.get("method", {}) if isinstance(data, dict) and "sds" in data else None
        return (
            data | {"method": {"algorithm": "descent"} | method} if type(method) is dict else data
        )


class FitFile:
    """A checked fit.toml and its scene.

    `settings`: contents; `axes`: one per parameter; `folder`: the folder of the file.
    """

    def __init__(self, path: str | Path, scene: Scene):
        """Load and check. Raises FitFileError with a line for each error."""
        self.source = TomlSource(path, error=FitFileError)
        self.folder, self.scene = self.source.folder, scene
        try:
            self.settings = Settings.model_validate(self.source.data)
        except ValidationError as error:
            raise FitFileError(
                self.source.lines(format_validation_errors(error, Settings))
            ) from None
        errors = self._target_errors()
        self.axes: list[ParameterAxis] = []
        keys: list[str] = []
        for k, parameter in enumerate(self.settings.parameter):
            key = parameter.key
            if key in keys:
                errors.append((("parameter", k, "key"), f"is named twice; {format_input(key)}"))
                continue
            keys.append(key)
            axis = self._axis(k, parameter, errors)
            if axis is not None:
                self.axes.append(axis)
        if errors:
            raise FitFileError(self.source.lines(errors))

    def _target_errors(self) -> list[tuple[tuple, str]]:
        """Return the errors in the choice of target and method."""
        settings, algorithm = self.settings, self.settings.method.algorithm
        if settings.target is None and settings.sds is None:
            return [(("target",), "required key is missing: [target], or [sds]")]
        if settings.target is not None and settings.sds is not None:
            return [(("sds",), "[target] and [sds] given at once: give exactly one of both")]
        where = ("method", "algorithm")
        if settings.sds is None and algorithm == "descent":
            return [(where, f"goes with [sds] alone; {format_input(algorithm)}")]
        if settings.sds is not None and algorithm == "least-squares":
            message = "a model's taste has no residuals: must be one of descent, cma"
            return [(where, f"{message}; {format_input(algorithm)}")]
        return []

    def wrong(self, path: tuple, message: str) -> FitFileError:
        """Return the error for a key that is found wrong after loading."""
        return FitFileError(self.source.lines([(path, message)]))

    def line(self, k: int) -> str:
        """Return the place of the k-th parameter, such as "fit.toml:12"."""
        return self.source.place(("parameter", k))[1]

    def _axis(self, k: int, parameter: Parameter, errors: list) -> ParameterAxis | None:
        """Convert a parameter to numbers; append its errors to `errors`."""
        location: tuple = ("parameter", k)
        missing = missing_table_message(self.scene, parameter.key)
        if missing:
            errors.append(((*location, "key"), f"{missing}; {format_input(parameter.key)}"))
            return None
        ends: list[float] = []
        for end in (0, 1):
            value = self._si(parameter.key, parameter.range[end], (*location, "range", end), errors)
            if value is None:
                return None
            ends.append(value)
        low, high = ends
        if not low < high:
            errors.append(((*location, "range"), f"must be [low, high]; got [{low:g}, {high:g}]"))
            return None
        if parameter.scale == "log" and low <= 0:
            message = f"begins at {low:g}, which has no logarithm: give scale = 'linear', or more"
            errors.append(((*location, "range"), message))
            return None
        if parameter.initial is not None:
            initial = self._si(parameter.key, parameter.initial, (*location, "initial"), errors)
            if initial is None:
                return None
        else:
            initial = float(value_at(self.scene, parameter.key) or low)
        if not low <= initial <= high:
            field = "initial" if parameter.initial is not None else "range"
            prefix = "" if parameter.initial is not None else "the scene's own value, "
            message = f"{prefix}{initial:g}, is not from {low:g} to {high:g}: give an initial value"
            errors.append(((*location, field), message))
            return None
        return ParameterAxis(parameter.key, low, high, initial, parameter.scale)

    def _si(self, key: str, value: float | str, path: tuple, errors: list) -> float | None:
        """Return the value [SI] that the scene makes of a key's value, or None if it refuses it.

        Args:
            key: Key of the scene.
            value: Number [SI] or text with a unit.
            path: Path of the value in fit.toml.
            errors: Errors (in/out).
        """
        text = value if isinstance(value, str) else repr(value)
        try:
            scene = loader.load(
                self.scene.path, (*self.scene.overrides, f"{key}={text}"), self.scene.text
            )
        except SceneError as error:
            message = error.lines[0].partition(": ")[2] or error.lines[0]
            is_unknown = (
                "unknown key" in message or "has no item" in message or "expected key" in message
            )
            is_unknown = is_unknown or "is not a table" in message
            location = (*path[:2], "key") if is_unknown else path
            errors.append(
                (
                    location,
                    f"the scene says: {message}; {format_input(key if is_unknown else value)}",
                )
            )
            return None
        number = value_at(scene, key)
        if isinstance(number, bool) or not isinstance(number, float):
            message = "is a whole number" if type(number) is int else "is no number of the scene"
            errors.append(
                ((*path[:2], "key"), f"{message}, which cannot be looked for; {format_input(key)}")
            )
            return None
        return number

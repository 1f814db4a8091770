"""Typed tables: quantities with units, a base model that refuses unknown keys, and their errors.

A field is declared as `density: Annotated[float, Quantity("kg/m3", gt=0)] = 1000.0`; in the scene
file it is a number in SI units or a text such as "1 g/cm3". The program uses SI units alone.
"""

import importlib
import math
import pkgutil
import re
from collections.abc import Iterable
from dataclasses import dataclass
from fractions import Fraction
from typing import Annotated, Any, TypeVar, get_args

from pydantic import BaseModel, BeforeValidator, ConfigDict, Strict, ValidationError
from pydantic_core import core_schema

from vgmpi.runtime.message_text import did_you_mean

Kind = TypeVar("Kind", bound=type[BaseModel])

_BASE = ("m", "kg", "s", "K", "rad")
_UNITS: dict[str, tuple[str | float, tuple[int, ...]]] = {
    "1": ("1", (0, 0, 0, 0, 0)),
    "%": ("0.01", (0, 0, 0, 0, 0)),
    "m": ("1", (1, 0, 0, 0, 0)),
    "km": ("1000", (1, 0, 0, 0, 0)),
    "cm": ("0.01", (1, 0, 0, 0, 0)),
    "mm": ("0.001", (1, 0, 0, 0, 0)),
    "um": ("1e-06", (1, 0, 0, 0, 0)),
    "l": ("0.001", (3, 0, 0, 0, 0)),
    "kg": ("1", (0, 1, 0, 0, 0)),
    "g": ("0.001", (0, 1, 0, 0, 0)),
    "t": ("1000", (0, 1, 0, 0, 0)),
    "s": ("1", (0, 0, 1, 0, 0)),
    "ms": ("0.001", (0, 0, 1, 0, 0)),
    "us": ("1e-06", (0, 0, 1, 0, 0)),
    "min": ("60", (0, 0, 1, 0, 0)),
    "h": ("3600", (0, 0, 1, 0, 0)),
    "Hz": ("1", (0, 0, -1, 0, 0)),
    "kHz": ("1000", (0, 0, -1, 0, 0)),
    "rpm": (2 * math.pi / 60, (0, 0, -1, 0, 1)),
    "N": ("1", (1, 1, -2, 0, 0)),
    "kN": ("1000", (1, 1, -2, 0, 0)),
    "Pa": ("1", (-1, 1, -2, 0, 0)),
    "kPa": ("1000", (-1, 1, -2, 0, 0)),
    "MPa": ("1e+06", (-1, 1, -2, 0, 0)),
    "GPa": ("1e+09", (-1, 1, -2, 0, 0)),
    "mPa": ("0.001", (-1, 1, -2, 0, 0)),
    "bar": ("100000", (-1, 1, -2, 0, 0)),
    "J": ("1", (2, 1, -2, 0, 0)),
    "W": ("1", (2, 1, -3, 0, 0)),
    "K": ("1", (0, 0, 0, 1, 0)),
    "rad": ("1", (0, 0, 0, 0, 1)),
    "deg": (math.pi / 180, (0, 0, 0, 0, 1)),
}
_DIMENSION_NAMES = {  # dimension of a unit, as an error names it
    "": "a plain number", "1": "a share", "m": "a length", "s": "a time", "Hz": "a rate",
    "1/s": "a rate",
    "N": "a force", "Pa": "a pressure or a stiffness", "Pa s": "a viscosity",
    "kg/m3": "a density", "m/s": "a speed", "m/s2": "an acceleration", "m2/s": "a diffusion",
    "kg/s": "a mass per time", "m3/s": "a volume per time",
    "N m": "a torque", "N/m": "a force per length", "N s/m": "a force per speed",
    "rad": "an angle", "rad/s": "a turning speed", "rad/m": "an angle per length",
}  # fmt: skip
# [SI] range of a quantity that is not 0: its square and its cube are finite numbers
MIN_MAGNITUDE, MAX_MAGNITUDE = 1e-100, 1e100
_FACTOR = re.compile(r"(%|1|[A-Za-z]+)(?:\^?(-?\d))?")
_TEXT = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(.*?)\s*")


def unit(text: str) -> tuple[Fraction, tuple[int, ...]]:
    """Return the SI factor and the exponents of (m, kg, s, K, rad) of a unit such as "kg/m3".

    "" has no unit. The factor is a fraction, so that "35 cm" becomes the float nearest to 0.35 and
    not its neighbor.

    Raises:
        ValueError: If a part of the text is no unit.
    """
    factor, powers = Fraction(1), [0] * len(_BASE)
    for k, side in enumerate((text or "1").split("/")):
        for part in re.split(r"[\s*]+", side.strip().strip("()")):
            match = _FACTOR.fullmatch(part)
            if not match or match[1] not in _UNITS:
                raise ValueError(f"'{part or text}' is not a unit known here")
            power = int(match[2] or 1) * (1 if k == 0 else -1)
            scale, base = _UNITS[match[1]]
            factor *= Fraction(scale) ** power
            powers = [p + power * b for p, b in zip(powers, base, strict=True)]
    return factor, tuple(powers)


def compatible_units(si: str) -> list[str]:
    """Return names of units with the dimension of `si`, for messages and documentation."""
    named = [name for name, (_, powers) in _UNITS.items() if powers == unit(si)[1]]
    named = [name for name in named if name not in ("1", "mPa")]  # mPa would look like MPa
    extra = {
        "m/s": ["cm/s", "km/h"],
        "kg/m3": ["g/cm3", "t/m3"],
        "m/s2": ["cm/s2"],
        "Pa s": ["mPa s"],
    }
    extra |= {"rad/s": ["deg/s"], "m2/s": ["cm2/s"]}
    extra |= {"kg/s": ["g/s", "t/h"], "m3/s": ["l/s", "l/min"]}
    names = named + extra.get(si, [])
    return names if si in (*names, "", "1") else [si, *names]


@dataclass(frozen=True, slots=True)
class Quantity:
    """Marker of a float field with a physical `unit` (SI); bounds are given in that unit.

    It accepts a number (SI) or a text with any unit of the same dimension, and yields a finite
    float in SI. The unit "" is a plain number.
    """

    unit: str
    gt: float | None = None
    ge: float | None = None
    lt: float | None = None
    le: float | None = None

    def parse(self, value: Any) -> float:
        """Return the SI value of a scene's entry.

        Raises:
            ValueError: If it is not allowed; the message says what is.
        """
        number = self._number(value)
        is_invalid = (
            not math.isfinite(number)
            or (self.gt is not None and not number > self.gt)
            or (self.ge is not None and not number >= self.ge)
            or (self.lt is not None and not number < self.lt)
            or (self.le is not None and not number <= self.le)
        )
        if is_invalid:
            allowed_range = self.bounds("" if self.unit in ("", "1") else f" {self.unit}")
            raise ValueError(f"must be {allowed_range or 'finite'}")
        signed = self.gt is not None or self.ge is not None  # other quantities may come close to 0
        if abs(number) > MAX_MAGNITUDE or (signed and 0 < abs(number) < MIN_MAGNITUDE):
            zero = "" if self.gt is not None else "0 or "
            raise ValueError(f"must be {zero}from {MIN_MAGNITUDE:g} to {MAX_MAGNITUDE:g} in size")
        return number

    def bounds(self, name: str = "") -> str:
        """Return the bounds, such as "> 0 kg/m3" for the name " kg/m3"; "" without bounds."""
        signs = ((">", self.gt), (">=", self.ge), ("<", self.lt), ("<=", self.le))
        return " and ".join(f"{sign} {b:g}{name}" for sign, b in signs if b is not None)

    def _number(self, value: Any) -> float:
        """Return the SI value before its bounds are checked."""
        if isinstance(value, int | float) and not isinstance(value, bool):
            return float(value)
        units = compatible_units(self.unit)
        alternative = (
            f" or a text such as '2 {units[0]}' (units: {', '.join(units)})" if units else ""
        )
        hint = (
            f"expected a number{'' if self.unit in ('', '1') else f' [{self.unit}]'}{alternative}"
        )
        match = _TEXT.fullmatch(value) if isinstance(value, str) else None
        if not match:
            raise ValueError(hint)
        try:
            factor, powers = unit(match[2] or "1")
        except ValueError as error:
            raise ValueError(f"{error}; {hint}") from None
        if powers != unit(self.unit)[1]:
            dimension = _DIMENSION_NAMES.get(self.unit, "this")
            problem = (
                f"'{match[2]}' does not measure {dimension}" if match[2] else "the text has no unit"
            )
            raise ValueError(f"{problem}; {hint}")
        if not 1e-300 < abs(float(match[1])) < 1e300:  # avoids huge integers from "1e999999999 m"
            return float(match[1])
        return float(Fraction(match[1]) * factor)

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> core_schema.CoreSchema:
        return core_schema.no_info_plain_validator_function(self.parse)


@dataclass(frozen=True, slots=True)
class ChangeableOnResume:
    """Marker of a key that may change when a run goes on from a checkpoint."""

    effect: str  # effect of the change


Length = Annotated[float, Quantity("m")]
Positive = Annotated[float, Quantity("m", gt=0)]
Share = Annotated[float, Quantity("1", ge=0, le=1)]
Point = tuple[Length, Length, Length]
Switch = Annotated[bool, Strict()]  # a number would pass for true in some checks and not in others


def parse_vector3(value: Any) -> tuple[float, float, float] | None:
    """Return three finite numbers, or None if the value is something else."""
    if not isinstance(value, list | tuple) or len(value) != 3:
        return None
    if not all(type(c) in (int, float) and math.isfinite(c) for c in value):
        return None
    return float(value[0]), float(value[1]), float(value[2])


def parse_color(value: Any) -> tuple[float, float, float]:
    """Return red, green and blue (0 to 1) of "#rrggbb" or three numbers; else raise ValueError."""
    if isinstance(value, str) and re.fullmatch(r"#[0-9a-fA-F]{6}", value):
        red, green, blue = (int(value[k : k + 2], 16) / 255 for k in (1, 3, 5))
        return red, green, blue
    numbers = parse_vector3(value)
    if numbers is None or min(numbers) < 0 or max(numbers) > 1:
        raise ValueError("must be a color such as '#6fb7d6' or three numbers from 0 to 1")
    return numbers


Color = Annotated[tuple[float, float, float], BeforeValidator(parse_color)]


class StrictModel(BaseModel):
    """Base of everything that is read from a TOML file: unknown keys are errors, values are frozen.

    The text under a field describes it; docs/reference/scene.md is made of these texts.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=True)


class TomlError(ValueError):
    """Error in a TOML file: `lines` holds one complete sentence per mistake."""

    def __init__(self, lines: list[str]):
        super().__init__("\n".join(lines))
        self.lines = lines

    def with_line(self, line: str):
        """Return this error with another line at its end."""
        return type(self)([*self.lines, line])


class SceneError(TomlError):
    """Error in a scene."""


def register_kinds(package: str, folders: Iterable[str], registry: dict[str, Kind]) -> None:
    """Import every module of a package, which registers its kinds, and sort the registry by kind.

    Folders and modules whose names begin with _ are left out.

    Args:
        package: Name of the package.
        folders: Its `__path__`.
        registry: Classes by their kinds (in/out).
    """
    for module in sorted(pkgutil.iter_modules(folders)):
        if not module.ispkg and not module.name.startswith("_"):
            importlib.import_module(f"{package}.{module.name}")
    for kind in sorted(registry):
        registry[kind] = registry.pop(kind)


PLAIN_WORDS = {  # for pydantic's
    "a valid tuple": "a list",
    "a valid string": "a text",
    "a valid boolean": "true or false",
}


def format_validation_errors(
    error: ValidationError, table: type[BaseModel]
) -> list[tuple[tuple, str]]:
    """Return (path of the key, what is wrong with it) for every error that pydantic found."""
    return [_explain(dict(item), table) for item in error.errors(include_url=False)]


def as_list(value: Any) -> Any:
    """Return a single table as a list of it, and everything else as it is."""
    return [value] if isinstance(value, dict) else value


def as_names(value: Any) -> Any:
    """Return a text as a list of it, and everything else as it is."""
    return [value] if isinstance(value, str) else value


def format_input(value: object) -> str:
    """Return the value as the user wrote it, shortened."""
    text = str(value).lower() if isinstance(value, bool) else repr(value)
    return f"got {text if len(text) <= 60 else text[:57] + '...'}"


def _explain(item: dict, table: type[BaseModel]) -> tuple[tuple, str]:
    """Return the path and the message of one of pydantic's errors."""
    path, kind, value = tuple(item["loc"]), item["type"], item.get("input")
    if kind == "extra_forbidden":
        holder = table_at(table, path[:-1])
        allowed = list(holder.model_fields) if holder else []
        suggestion = did_you_mean(
            path[-1], allowed
        )  # a list of thirty keys would hide the suggestion
        return path, f"unknown key{suggestion or '; known here: ' + ', '.join(allowed)}"
    if kind == "missing" and isinstance(path[-1], int):
        return path[:-1], f"has too few values; {format_input(value)}"
    if kind == "missing":
        holder = table_at(table, path[:-1])
        field = holder.model_fields.get(path[-1]) if holder else None
        meaning = " ".join((field.description or "").split()) if field else ""
        return path, "required key is missing" + (f": {meaning}" if meaning else "")
    if kind == "literal_error":
        allowed = _literals(item["ctx"]["expected"])
        return (
            path,
            f"must be one of {', '.join(allowed)}{did_you_mean(value, allowed)};"
            f" {format_input(value)}",
        )
    if kind in ("model_type", "dict_type", "model_attributes_type"):
        return path, f"must be a table of keys; {format_input(value)}"
    message = re.sub(
        r"^(Input|String|Tuple) should", "must", item["msg"].removeprefix("Value error, ")
    )
    if kind == "too_long":
        return path, f"must have at most {item['ctx']['max_length']} values; {format_input(value)}"
    for words, plain in PLAIN_WORDS.items():
        message = message.replace(words, plain)
    message = f"{message[:1].lower()}{message[1:]}"
    return path, message if isinstance(value, dict) else f"{message}; {format_input(value)}"


def _literals(expected: str) -> list[str]:
    """Return the allowed values in a message of pydantic, as TOML."""
    words = re.findall(r"'[^']*'|[^\s,']+", expected.replace(" or ", ", "))
    spelt = {"True": "true", "False": "false"}
    return [spelt.get(word, word.strip("'")) for word in words]


def table_at(table: type[BaseModel], path: tuple) -> type[BaseModel] | None:
    """Return the table class at `path` below `table`; None if the path leaves the tables."""
    current: Any = table
    for part in path:
        if isinstance(part, int):
            continue
        field = current.model_fields.get(part) if current else None
        current = tables_in(field.annotation) if field else None
    return current


def tables_in(annotation: Any) -> type[BaseModel] | None:
    """Return the table class within an annotation such as `tuple[Shape, ...] | None`."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next(filter(None, map(tables_in, get_args(annotation))), None)

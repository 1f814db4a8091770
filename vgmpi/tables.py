"""Typed tables: quantities with units, a base model that refuses unknown keys, and their errors.

A field is declared `density: Annotated[float, Quantity("kg/m3", gt=0)] = 1000.0`; in the scene
file it is a number in SI or a text such as "1 g/cm3". Inside the program there is only SI.
"""

import importlib
import math
import pkgutil
import re
from collections.abc import Iterable
from dataclasses import dataclass
from fractions import Fraction
from typing import Annotated, Any, get_args

from pydantic import BaseModel, BeforeValidator, ConfigDict, ValidationError
from pydantic_core import core_schema

from vgmpi.misspelt import nearest

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
_MEASURED = {  # what a unit is for, as an error says it
    "": "a plain number", "1": "a share", "m": "a length", "s": "a time", "Hz": "a rate",
    "N": "a force", "Pa": "a pressure or a stiffness", "Pa s": "a viscosity",
    "kg/m3": "a density", "m/s": "a speed", "m/s2": "an acceleration", "m2/s": "a diffusion",
    "kg/s": "a mass per time", "m3/s": "a volume per time",
    "rad": "an angle", "rad/s": "a turning speed", "rad/m": "an angle per length",
}  # fmt: skip
LEAST, MOST = 1e-100, 1e100  # of a quantity that is not 0: its square and its cube are numbers
_FACTOR = re.compile(r"(%|1|[A-Za-z]+)(?:\^?(-?\d))?")
_TEXT = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(.*?)\s*")


def unit(text: str) -> tuple[Fraction, tuple[int, ...]]:
    """SI factor and exponents of (m, kg, s, K, rad) of a unit such as "kg/m3" or "Pa s".

    "" has no unit. The factor is a fraction, so that "35 cm" becomes the float nearest to 0.35 and
    not its neighbour. Raises ValueError where a part is not a unit.
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


def same_units(si: str) -> list[str]:
    """Names of units that measure the same thing as `si`, for messages and documentation."""
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
    found = named + extra.get(si, [])
    return found if si in (*found, "", "1") else [si, *found]


@dataclass(frozen=True, slots=True)
class Quantity:
    """Marks a float field as a quantity measured in `unit` (SI), with bounds given in that unit.

    Accepts a number (SI) or a text with any unit of the same dimension; yields a finite float in
    SI. The unit "" is a plain number.
    """

    unit: str
    gt: float | None = None
    ge: float | None = None
    lt: float | None = None
    le: float | None = None

    def parse(self, value: Any) -> float:
        """SI value of what stands in the scene; raises ValueError that says what is allowed."""
        number = self._number(value)
        bad = (
            not math.isfinite(number)
            or (self.gt is not None and not number > self.gt)
            or (self.ge is not None and not number >= self.ge)
            or (self.lt is not None and not number < self.lt)
            or (self.le is not None and not number <= self.le)
        )
        if bad:
            said = self.bounds("" if self.unit in ("", "1") else f" {self.unit}")
            raise ValueError(f"must be {said or 'finite'}")
        signed = self.gt is not None or self.ge is not None  # others may come close to 0
        if abs(number) > MOST or (signed and 0 < abs(number) < LEAST):
            zero = "" if self.gt is not None else "0 or "
            raise ValueError(f"must be {zero}from {LEAST:g} to {MOST:g} in size")
        return number

    def bounds(self, name: str = "") -> str:
        """The bounds, such as "> 0 kg/m3" for the name " kg/m3"; empty without bounds."""
        signs = ((">", self.gt), (">=", self.ge), ("<", self.lt), ("<=", self.le))
        return " and ".join(f"{sign} {b:g}{name}" for sign, b in signs if b is not None)

    def _number(self, value: Any) -> float:
        if isinstance(value, int | float) and not isinstance(value, bool):
            return float(value)
        units = same_units(self.unit)
        like = f" or a text such as '2 {units[0]}' (units: {', '.join(units)})" if units else ""
        hint = f"expected a number{'' if self.unit in ('', '1') else f' [{self.unit}]'}{like}"
        match = _TEXT.fullmatch(value) if isinstance(value, str) else None
        if not match:
            raise ValueError(hint)
        try:
            factor, powers = unit(match[2] or "1")
        except ValueError as error:
            raise ValueError(f"{error}; {hint}") from None
        if powers != unit(self.unit)[1]:
            what = _MEASURED.get(self.unit, "this")
            said = f"'{match[2]}' does not measure {what}" if match[2] else "the text has no unit"
            raise ValueError(f"{said}; {hint}")
        if not 1e-300 < abs(float(match[1])) < 1e300:  # no huge integers out of "1e999999999 m"
            return float(match[1])
        return float(Fraction(match[1]) * factor)

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> core_schema.CoreSchema:
        return core_schema.no_info_plain_validator_function(self.parse)


@dataclass(frozen=True, slots=True)
class MayChange:
    """Marks a key that may be another one when a run goes on from a checkpoint; said: what happens
    then."""

    said: str


Length = Annotated[float, Quantity("m")]
Positive = Annotated[float, Quantity("m", gt=0)]
Share = Annotated[float, Quantity("1", ge=0, le=1)]
Point = tuple[Length, Length, Length]


def three(value: Any) -> tuple[float, float, float] | None:
    """Three finite numbers, or None."""
    if not isinstance(value, list | tuple) or len(value) != 3:
        return None
    if not all(type(c) in (int, float) and math.isfinite(c) for c in value):
        return None
    return float(value[0]), float(value[1]), float(value[2])


def colour(value: Any) -> tuple[float, float, float]:
    """Red, green and blue of "#rrggbb" or three numbers 0..1; raises ValueError."""
    if isinstance(value, str) and re.fullmatch(r"#[0-9a-fA-F]{6}", value):
        red, green, blue = (int(value[k : k + 2], 16) / 255 for k in (1, 3, 5))
        return red, green, blue
    numbers = three(value)
    if numbers is None or min(numbers) < 0 or max(numbers) > 1:
        raise ValueError("must be a colour such as '#6fb7d6' or three numbers from 0 to 1")
    return numbers


Colour = Annotated[tuple[float, float, float], BeforeValidator(colour)]


class Table(BaseModel):
    """Base of everything read from a TOML file: unknown keys are errors, values never change.

    The text under a field says what it means; docs/scene.md is made of these texts.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=True)


class TomlError(ValueError):
    """What is wrong with a TOML file: `lines`, one finished sentence per error."""

    def __init__(self, lines: list[str]):
        super().__init__("\n".join(lines))
        self.lines = lines

    def also(self, line: str):
        """The same error with a line behind the others."""
        return type(self)([*self.lines, line])


class SceneError(TomlError):
    """What is wrong with a scene."""


def register_kinds(package: str, folders: Iterable[str], registry: dict[str, type]) -> None:
    """Import every module of a package, which registers its kinds, and order the registry by them.

    Folders and modules whose names begin with _ are left out.

    Args:
        package: Name of the package.
        folders: Its `__path__`.
        registry: Classes by their kinds, in/out.
    """
    for module in sorted(pkgutil.iter_modules(folders)):
        if not module.ispkg and not module.name.startswith("_"):
            importlib.import_module(f"{package}.{module.name}")
    for kind in sorted(registry):
        registry[kind] = registry.pop(kind)


def explain(error: ValidationError, table: type[BaseModel]) -> list[tuple[tuple, str]]:
    """(path of the key, what is wrong with it) for every error pydantic found in a `table`."""
    return [_explain(dict(item), table) for item in error.errors(include_url=False)]


def got(value: object) -> str:
    """The value as the user wrote it, short."""
    shown = str(value).lower() if isinstance(value, bool) else repr(value)
    return f"got {shown if len(shown) <= 60 else shown[:57] + '...'}"


def _explain(item: dict, table: type[BaseModel]) -> tuple[tuple, str]:
    path, kind, value = tuple(item["loc"]), item["type"], item.get("input")
    if kind == "extra_forbidden":
        holder = table_at(table, path[:-1])
        known = list(holder.model_fields) if holder else []
        near = nearest(path[-1], known)  # a list of thirty keys would hide it
        return path, f"unknown key{near or '; known here: ' + ', '.join(known)}"
    if kind == "missing" and isinstance(path[-1], int):
        return path[:-1], f"has too few values; {got(value)}"
    if kind == "missing":
        holder = table_at(table, path[:-1])
        field = holder.model_fields.get(path[-1]) if holder else None
        return path, "required key is missing" + (
            f": {field.description}" if field and field.description else ""
        )
    if kind == "literal_error":
        known = _literals(item["ctx"]["expected"])
        return path, f"must be one of {', '.join(known)}{nearest(value, known)}; {got(value)}"
    if kind in ("model_type", "dict_type", "model_attributes_type"):
        return path, f"must be a table of keys; {got(value)}"
    said = re.sub(
        r"^(Input|String|Tuple) should", "must", item["msg"].removeprefix("Value error, ")
    )
    said = said.replace("a valid tuple", "a list")
    said = f"{said[:1].lower()}{said[1:]}"
    return path, said if isinstance(value, dict) else f"{said}; {got(value)}"


def _literals(expected: str) -> list[str]:
    words = re.findall(r"'[^']*'|[^\s,']+", expected.replace(" or ", ", "))
    spelt = {"True": "true", "False": "false"}
    return [spelt.get(word, word.strip("'")) for word in words]


def table_at(table: type[BaseModel], path: tuple) -> type[BaseModel] | None:
    """The table class found by following `path` from `table`; None where that leaves the tables."""
    here: Any = table
    for part in path:
        if isinstance(part, int):
            continue
        field = here.model_fields.get(part) if here else None
        here = tables_in(field.annotation) if field else None
    return here


def tables_in(annotation: Any) -> type[BaseModel] | None:
    """The table class inside an annotation such as `tuple[Shape, ...] | None`."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next(filter(None, map(tables_in, get_args(annotation))), None)

"""The space that is searched: each parameter from 0 to 1 over its range."""

import math
from dataclasses import dataclass
from typing import Any

from ..misspelt import nearest
from ..scene.scene import Scene
from ..study.knobs import Setting


@dataclass(frozen=True)
class Axis:
    """A parameter: its key, range and start in SI, and whether equal steps are equal factors."""

    key: str
    low: float
    high: float
    start: float
    logarithmic: bool

    @property
    def width(self) -> float:
        """Of the range: its logarithm where that counts."""
        return math.log(self.high / self.low) if self.logarithmic else self.high - self.low

    def value(self, u: float) -> float:
        """[SI] at u of 0 .. 1."""
        if self.logarithmic:
            return min(max(self.low * math.exp(u * self.width), self.low), self.high)
        return self.low + u * (self.high - self.low)

    def at(self, value: float) -> float:
        """Where a value lies, 0 .. 1."""
        if self.logarithmic:
            return math.log(value / self.low) / self.width
        return (value - self.low) / self.width

    def step(self, share: float) -> float:
        """In u: that share of the value, or of the range where it is not logarithmic."""
        return math.log1p(share) / self.width if self.logarithmic else share

    def around(self, u: float, off: float) -> tuple[float, float]:
        """The values [SI] that lie `off` (in u) to both sides of u, also beyond the range."""
        if self.logarithmic:
            middle, factor = self.low * math.exp(u * self.width), math.exp(off * self.width)
            return middle / factor, middle * factor
        return self.low + (u - off) * self.width, self.low + (u + off) * self.width


def setting(axes: list[Axis], u: Any) -> Setting:
    """What a run at a point (parameters,) sets."""
    values = {axis.key: repr(axis.value(float(x))) for axis, x in zip(axes, u, strict=True)}
    return Setting(tuple(values.items()), tuple(f"{key}={v}" for key, v in values.items()))


def value_at(scene: Scene, key: str) -> Any:
    """What a checked scene has at a key as --set takes it [SI]; None where there is nothing."""
    here: Any = scene.resolved()
    for part in _parts(key):
        here = _inside(here, part)
    return here


def missing(scene: Scene, key: str) -> str:
    """What is not there of the tables that hold a key, as a sentence; else nothing."""
    here, parts = scene.resolved(), _parts(key)
    for k, part in enumerate(parts[:-1]):
        held = here if isinstance(here, dict) else _named(here)
        here = _inside(here, part)
        if here is None:
            return f"the scene has no {'.'.join(parts[: k + 1])}{nearest(part, held)}"
    return ""


def _parts(key: str) -> list[str]:
    return [part.strip().strip("\"'") for part in key.split(".")]


def _named(here: Any) -> list[str]:
    """Names of the tables in a list."""
    tables = here if isinstance(here, list) else []
    return [str(x["name"]) for x in tables if isinstance(x, dict) and "name" in x]


def _inside(here: Any, part: str) -> Any:
    if isinstance(here, dict):
        return here.get(part)
    if not isinstance(here, list):
        return None
    named = [x for x in here if isinstance(x, dict) and x.get("name") == part]
    index = int(part) if part.isdecimal() and int(part) < len(here) else None
    return named[0] if named else here[index] if index is not None else None

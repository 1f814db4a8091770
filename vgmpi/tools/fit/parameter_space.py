"""Space of the searched parameters, each mapped from its range to [0, 1]."""

import math
from dataclasses import dataclass
from typing import Any

from vgmpi.runtime.message_text import did_you_mean
from vgmpi.scene.scene import Scene
from vgmpi.tools.tradeoff.parameter_sweep import Setting


@dataclass(frozen=True)
class ParameterAxis:
    """A parameter: its key, range and initial value [SI], and its scale, "log" or "linear"."""

    key: str
    low: float
    high: float
    initial: float
    scale: str

    @property
    def logarithmic(self) -> bool:
        """Return whether equal steps are equal factors."""
        return self.scale == "log"

    @property
    def width(self) -> float:
        """Width of the range, of its logarithm for a logarithmic axis."""
        return math.log(self.high / self.low) if self.logarithmic else self.high - self.low

    def from_unit(self, u: float) -> float:
        """Return the value [SI] at u in [0, 1]."""
        if self.logarithmic:
            return min(max(self.low * math.exp(u * self.width), self.low), self.high)
        return self.low + u * (self.high - self.low)

    def to_unit(self, value: float) -> float:
        """Return the position u in [0, 1] of a value [SI]."""
        if self.logarithmic:
            return math.log(value / self.low) / self.width
        return (value - self.low) / self.width

    def step(self, share: float) -> float:
        """Return a step in u: a share of the value, or of the range on a linear scale."""
        return math.log1p(share) / self.width if self.logarithmic else share

    def interval(self, u: float, halfwidth: float) -> tuple[float, float]:
        """Return the values [SI] at u -/+ halfwidth, beyond the range if need be."""
        if self.logarithmic:
            middle, factor = self.low * math.exp(u * self.width), math.exp(halfwidth * self.width)
            return middle / factor, middle * factor
        return self.low + (u - halfwidth) * self.width, self.low + (u + halfwidth) * self.width


def setting(axes: list[ParameterAxis], u: Any) -> Setting:
    """Return the setting of a run at a point u (parameters,)."""
    values = {axis.key: repr(axis.from_unit(float(x))) for axis, x in zip(axes, u, strict=True)}
    return Setting(tuple(values.items()), tuple(f"{key}={v}" for key, v in values.items()))


def value_at(scene: Scene, key: str) -> Any:
    """Return the value [SI] of a checked scene at a key of --set, or None if absent."""
    value: Any = scene.to_json()
    for part in _parts(key):
        value = _inside(value, part)
    return value


def missing_table_message(scene: Scene, key: str) -> str:
    """Return a sentence about the first missing table that would hold a key, or ''."""
    value, parts = scene.to_json(), _parts(key)
    for k, part in enumerate(parts[:-1]):
        names = value if isinstance(value, dict) else _named(value)
        value = _inside(value, part)
        if value is None:
            return f"the scene has no {'.'.join(parts[: k + 1])}{did_you_mean(part, names)}"
    return ""


def _parts(key: str) -> list[str]:
    """Split a key of --set at its dots."""
    return [part.strip().strip("\"'") for part in key.split(".")]


def _named(value: Any) -> list[str]:
    """Return the names of the tables in a list."""
    tables = value if isinstance(value, list) else []
    return [str(x["name"]) for x in tables if isinstance(x, dict) and "name" in x]


def _inside(value: Any, part: str) -> Any:
    """Return an entry of a table, or of a list by name or index; None if absent."""
    if isinstance(value, dict):
        return value.get(part)
    if not isinstance(value, list):
        return None
    named = [x for x in value if isinstance(x, dict) and x.get("name") == part]
    index = int(part) if part.isdecimal() and int(part) < len(value) else None
    return named[0] if named else value[index] if index is not None else None

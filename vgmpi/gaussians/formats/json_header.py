"""JSON headers of Gaussian files, bounded before they are parsed and checked value by value."""

import json
import math
import re
from dataclasses import dataclass
from typing import Any

import numpy as np

from .validation import GaussianFileError

MAX_BYTES = 4 << 20  # [bytes] of a header: parsed, it takes up to twenty times as much
_MAX_DEPTH = 64  # [-] nested lists and objects
_MAX_INTEGER = 1 << 53
_STRING = re.compile(rb'"[^"\\]*+(?:\\.[^"\\]*+)*+(?:"|\\?\Z)', re.DOTALL)
_NO_DEFAULT: Any = object()


@dataclass(frozen=True)
class JsonObject:
    """Object of a header.

    Attributes:
        values: Values by key.
        name: What it is, for messages, such as "accessor 3".
    """

    values: dict[str, Any]
    name: str

    def __contains__(self, key: str) -> bool:
        return key in self.values

    def integer(
        self, key: str, default: Any = _NO_DEFAULT, low: int = 0, high: int = _MAX_INTEGER
    ) -> int:
        """Return a whole number.

        Args:
            key: Key of the value.
            default: Number where there is none; without it, there must be one.
            low, high: Allowed range.
        """
        value = self._value(key, default)
        if isinstance(value, float) and value.is_integer():
            value = int(value)
        if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
            bound = f"from {low} to {high}" if high < _MAX_INTEGER else f"of at least {low}"
            raise self._error(key, f"a whole number {bound}")
        return value

    def text(self, key: str, default: Any = _NO_DEFAULT) -> str:
        """Return a text."""
        value = self._value(key, default)
        if not isinstance(value, str):
            raise self._error(key, "a text")
        return value

    def numbers(self, key: str, min_count: int, max_count: int | None = None) -> np.ndarray:
        """Return a list of finite numbers.

        Args:
            key: Key of the list.
            min_count, max_count: Allowed lengths; without `max_count`, exactly `min_count`.
        """
        max_count = min_count if max_count is None else max_count
        value = self._value(key)
        fits = isinstance(value, list) and min_count <= len(value) <= max_count
        if not fits or not all(_is_finite(number) for number in value):
            single = min_count == max_count
            count = f"{min_count}" if single else f"{min_count} to {max_count}"
            raise self._error(key, f"a list of {count} numbers")
        return np.array(value, dtype=np.float64)

    def number(self, key: str) -> float:
        """Return a finite number."""
        value = self._value(key)
        if not _is_finite(value):
            raise self._error(key, "a number")
        return float(value)

    def items(self, key: str, default: Any = ()) -> list | tuple:
        """Return a list of anything."""
        value = self._value(key, default)
        if not isinstance(value, (list, tuple)):
            raise self._error(key, "a list")
        return value

    def child(self, key: str) -> "JsonObject":
        """Return an object."""
        value = self._value(key)
        if not isinstance(value, dict):
            raise self._error(key, "an object")
        return JsonObject(value, f"{self.name}.{key}" if self.name else key)

    def entry(self, key: str, index: Any) -> "JsonObject":
        """Return an object by its number in a list of objects."""
        items = self.items(key)
        if not isinstance(index, int) or isinstance(index, bool) or not 0 <= index < len(items):
            raise GaussianFileError(
                f"names {key}[{printable_text(str(index), 20)!r}] of {len(items)} {key}"
            )
        if not isinstance(items[index], dict):
            raise GaussianFileError(f"has {key}[{index}]: expected an object")
        return JsonObject(items[index], f"{key}[{index}]")

    def _value(self, key: str, default: Any = _NO_DEFAULT) -> Any:
        """Return a value, or the default where there is none."""
        if key in self.values:
            return self.values[key]
        if default is _NO_DEFAULT:
            raise GaussianFileError(f"has no {key!r} in {self.name or 'its header'}")
        return default

    def _error(self, key: str, expected: str) -> GaussianFileError:
        """Return the error of a value."""
        value = self.values.get(key)
        is_nested = isinstance(value, (list, dict))
        text = "" if is_nested else f" = {printable_text(json.dumps(value), 60)}"
        where = f"{self.name}.{key}" if self.name else key
        return GaussianFileError(f"has {where}{text}: expected {expected}")


def parse_header(data: bytes) -> JsonObject:
    """Return the object that a JSON text holds.

    Raises:
        GaussianFileError: If it is too long, too deeply nested or no JSON object.
    """
    if len(data) > MAX_BYTES:
        raise GaussianFileError(
            f"has a JSON header of {len(data):,} bytes: the most is {MAX_BYTES:,}"
        )
    brackets = np.frombuffer(_STRING.sub(b"", data), np.uint8)
    is_opening = (brackets == ord("[")) | (brackets == ord("{"))
    is_closing = (brackets == ord("]")) | (brackets == ord("}"))
    depth = np.cumsum(is_opening.astype(np.int32) - is_closing, dtype=np.int32).max(initial=0)
    if depth > _MAX_DEPTH:
        raise GaussianFileError(f"has a JSON header nested {depth:,} deep: allowed {_MAX_DEPTH}")
    try:
        value = json.loads(data.decode("utf-8"))
    except (ValueError, RecursionError) as error:
        reason = printable_text(str(error))
        raise GaussianFileError(f"has a JSON header that cannot be read ({reason})") from None
    if not isinstance(value, dict):
        raise GaussianFileError("has a JSON header that is no object")
    return JsonObject(value, "")


def printable_text(text: str, max_length: int = 80) -> str:
    """Return a text of a file on one line, cut at a length."""
    return "".join(c for c in text[:max_length] if c.isprintable())


def _is_finite(value: Any) -> bool:
    """Return whether a value is a finite number that float64 can hold."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:
        return False

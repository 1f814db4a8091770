"""TOML writer for scenes."""

import json
import math
from typing import Any

import numpy as np

from .toml_scan import BARE
from .toml_source import escape_control_characters


def text(top: dict[str, Any], head: list[str], tail: list[str]) -> str:
    """Return a TOML file.

    Args:
        top: Values, tables and lists of tables by name.
        head: Comments at the top.
        tail: Comments at the end.
    """
    out = [f"# {escape_control_characters(line)}".rstrip() for line in head]
    plain = {key: value for key, value in top.items() if not _is_table(value)}
    if plain:
        out += ["", *_lines(plain)]
    for key, value in top.items():
        if isinstance(value, dict) and value and all(isinstance(v, dict) for v in value.values()):
            for name, table in value.items():
                out += ["", f"[{_key(key)}.{_key(name)}]", *_lines(table)]
        elif isinstance(value, dict):
            out += ["", f"[{_key(key)}]", *_lines(value)]
        elif _is_table(value):
            for table in value:
                out += ["", f"[[{_key(key)}]]", *_lines(table)]
    if tail:
        out += ["", *(f"# {escape_control_characters(line)}".rstrip() for line in tail)]
    return "\n".join(out) + "\n"


def _is_table(value: Any) -> bool:
    """Return whether a value is a table or a list of tables."""
    return isinstance(value, dict) or (
        isinstance(value, list) and bool(value) and isinstance(value[0], dict)
    )


def _lines(table: dict[str, Any]) -> list[str]:
    """Return the lines of a table."""
    return [f"{_key(key)} = {_value(value)}" for key, value in table.items()]


def _key(name: str) -> str:
    """Return a key, quoted if necessary."""
    return name if BARE.fullmatch(name) else _string(name)


def _string(value: str) -> str:
    """Return a text in quotes."""
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007F")


def _value(value: Any) -> str:
    """Return a value as TOML."""
    if isinstance(value, bool | np.bool_):
        return "true" if value else "false"
    if isinstance(value, str):
        return _string(value)
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{_key(k)} = {_value(v)}" for k, v in value.items()) + " }"
    if isinstance(value, list | tuple | np.ndarray):
        return "[" + ", ".join(_value(v) for v in value) + "]"
    if isinstance(value, int | np.integer):
        return str(value)
    return number(float(value))


def number(value: float) -> str:
    """Return a float in 12 digits as TOML; rounding errors about 0 become 0."""
    if not math.isfinite(value):
        raise ValueError(f"no scene holds {value}")
    short = 0.0 if abs(value) < 1e-13 else float(f"{value:.12g}")
    return repr(short)

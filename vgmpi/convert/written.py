"""A scene as TOML text."""

import json
import math
import re
from typing import Any

import numpy as np

from vgmpi.source import printable

_BARE = re.compile(r"[A-Za-z0-9_-]+")


def text(top: dict[str, Any], head: list[str], tail: list[str]) -> str:
    """A TOML file. top: values, tables and lists of tables by name; head, tail: comments."""
    out = [f"# {printable(line)}".rstrip() for line in head]
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
        out += ["", *(f"# {printable(line)}".rstrip() for line in tail)]
    return "\n".join(out) + "\n"


def _is_table(value: Any) -> bool:
    return isinstance(value, dict) or (
        isinstance(value, list) and bool(value) and isinstance(value[0], dict)
    )


def _lines(table: dict[str, Any]) -> list[str]:
    return [f"{_key(key)} = {_value(value)}" for key, value in table.items()]


def _key(name: str) -> str:
    return name if _BARE.fullmatch(name) else _string(name)


def _string(value: str) -> str:
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007F")


def _value(value: Any) -> str:
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
    """A float in 12 digits, as TOML has it; differences of places that are meant to be 0 are."""
    if not math.isfinite(value):
        raise ValueError(f"no scene holds {value}")
    short = 0.0 if abs(value) < 1e-13 else float(f"{value:.12g}")
    return repr(short)

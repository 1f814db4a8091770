"""Data of a TOML file, or of a table that a program gives in its place, and where each was written.

The replacements of `--set key=value` are applied.
"""

import json
import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from vgmpi.runtime.user_files import MAX_TEXT_BYTES, read_regular_file

from .schema import SceneError, TomlError, unit
from .toml_scan import BARE, BASIC, LITERAL, MAX_NESTING, TOO_DEEP, find_excess, locate_keys

_LONG_NUMBER = re.compile(r"[0-9_]{4300,}")  # Python refuses longer integers
# a value after "=" or in a list that is no number, without quotes and brackets
_BARE_VALUE = re.compile(r"[=,\[]\s*([^\s=,\[\]{}\"'][^=,\[\]{}\"']{0,100})")
_NUMBER = re.compile(r"[-+]?[0-9][0-9_.]*(?:[eE][-+]?[0-9]+)?\s*([A-Za-z%][^\n]*?)\s*")


class TomlSource:
    """Data of a TOML file and the place where each piece of it was written.

    `text` is the file's text, `data` holds nested dicts and lists with the overrides applied, and
    `folder` is the folder of the file.
    """

    def __init__(
        self,
        path: str | Path,
        overrides: tuple[str, ...] | list[str] = (),
        text: str | None = None,
        error: type[TomlError] = SceneError,
    ):
        """Read a file and apply the overrides.

        Args:
            path: The file.
            overrides: Items "key=value".
            text: Content that is used instead of the file's.
            error: Class raised if the file is not readable, is no TOML or an override fails.
        """
        self.path = Path(path)
        if "\0" in str(path):
            raise error([f"{escape_control_characters(path)}: no file has such a name"])
        self.folder = self.path.resolve().parent
        self._line: dict[tuple, int]  # line of each key
        self.data: dict[str, Any]
        self._set: dict[tuple, str] = {}
        self._read(path, text, error)
        self._refuse_extremes(error)
        messages = [message for item in overrides if (message := self._override(item))]
        if messages:
            raise error([escape_control_characters(message) for message in messages])
        self._refuse_extremes(error)

    def _read(self, path: str | Path, text: str | None, error: type[TomlError]) -> None:
        """Read the file, or the text in its place; set `text`, `data` and the lines."""
        try:
            self.text = (
                read_regular_file(self.path, MAX_TEXT_BYTES).decode() if text is None else text
            )
            excess = find_excess(self.text)
            self.data = {} if excess else tomllib.loads(self.text)
            self._line = {} if excess else locate_keys(self.text)
        except OSError as caught:
            raise error(
                [escape_control_characters(f"{path}: {caught.strerror or caught}")]
            ) from None
        except UnicodeDecodeError as caught:
            raise error(
                [f"{escape_control_characters(path)}: not UTF-8 text (byte {caught.start})"]
            ) from None
        except RecursionError:
            raise error(
                [f"{escape_control_characters(path)}: not valid TOML: nested too deeply"]
            ) from None
        except ValueError as caught:  # no TOML, or a number too long to be read
            raise error(
                [_syntax(escape_control_characters(path), self.text, str(caught))]
            ) from None
        if excess:
            place = escape_control_characters(f"{path}:{excess.line}")
            raise error([f"{place}: cannot be read: {excess.message}"])

    def place(self, path: tuple) -> tuple[int, str]:
        """Return (line for sorting, "file:line" or "--set key=value") of a key or of its holder."""
        for stop in range(len(path), 0, -1):
            if path[:stop] in self._set:
                return 10**9, f"--set {truncate(self._set[path[:stop]])}"
            if path[:stop] in self._line:
                line = self._line[path[:stop]]
                return line, f"{self.path}:{line}"
            for override, item in self._set.items():
                if override[:stop] == path[:stop]:  # this override made the table that holds it
                    return 10**9, f"--set {truncate(item)}"
        return 1, f"{self.path}:1"

    def lines(self, errors: list[tuple[tuple, str]]) -> list[str]:
        """Return one line per error, in the order of the file."""
        located = []
        for path, message in errors:
            path = self._written(path)
            line, where = self._line_head(path)
            located.append((line, escape_control_characters(f"{where}: {message}")))
        located.sort(key=lambda item: item[0])
        return list(dict.fromkeys(message for _, message in located))

    def _line_head(self, path: tuple) -> tuple[int, str]:
        """Return (line for sorting, the text before the message of an error at a key)."""
        line, where = self.place(path)
        return line, f"{where}: {self.key(path)}"

    def key_with_place(self, path: tuple) -> str:
        """Return a key with its location: "material.water.tait_exponent (scene.toml:12)"."""
        return escape_control_characters(f"{self.key(path)} ({self.place(path)[1]})")

    def key(self, path: tuple) -> str:
        """Return the path as a user would write it, with objects by name if they have one."""
        parts = [str(p) if p != "" and "." not in str(p) else f'"{p}"' for p in path]
        if len(path) > 1 and isinstance(path[1], int):
            try:
                name = self.data[path[0]][path[1]]["name"]
                parts[1] = name if isinstance(name, str) else parts[1]
            except (KeyError, TypeError, IndexError):
                pass
        return ".".join(parts)

    def with_place(self, line: str) -> str:
        """Return an error line that begins with a key, with the place of the key before it.

        A line that begins otherwise, or with a key that the file does not have, stays as it is.
        """
        match = re.match(r"([A-Za-z_][\w.]*): ", line)
        path = tuple(match[1].split(".")) if match else ()
        stops = [stop for stop in range(1, len(path) + 1) if path[:stop] in self._line]
        return f"{self.place(path[: stops[-1]])[1]}: {line}" if stops else line

    def _written(self, path: tuple) -> tuple:
        """Return the path as in the file: without the index 0 if one item stands for a list."""
        node: object = self.data
        written: tuple = ()
        for part in path:
            if isinstance(part, int) and isinstance(node, dict | str):
                continue
            written += (part,)
            try:
                node = node[part]  # type: ignore[index]
            except (KeyError, IndexError, TypeError):
                node = None
        return written

    def overridden(self, path: tuple) -> bool:
        """Return whether the value of this key came from the command line."""
        return any(path[:stop] in self._set for stop in range(1, len(path) + 1))

    def _refuse_extremes(self, error: type[TomlError]) -> None:
        """Raise for integers of more than 64 bits, and for deeply nested tables and lists.

        TOML need not support them, and nothing here is made for them.
        """
        wrong: list[tuple[tuple, str]] = []
        pending: list[tuple[tuple, object]] = [((), self.data)]
        while pending:
            path, node = pending.pop()
            if isinstance(node, int) and not -(2**63) <= node < 2**63:
                wrong.append((path, f"must fit in 64 bits; got one of {node.bit_length()} bits"))
            if not isinstance(node, dict | list):
                continue
            if len(path) > MAX_NESTING:
                wrong.append((path[:3], f"is {TOO_DEEP}"))
                continue
            items = node.items() if isinstance(node, dict) else enumerate(node)
            pending += [((*path, k), value) for k, value in items]
        if wrong:
            raise error(self.lines(wrong))

    def _override(self, item: str) -> str:
        """Apply one "key=value"; return what is wrong with it, or ""."""
        prefix = f"--set {truncate(item)}"
        key, sign, text = item.partition("=")
        parts = [part.strip().strip("\"'") for part in key.split(".")]
        if not sign or not all(parts):
            return f"{prefix}: expected key=value, for example domain.cell='1 cm'"
        if len(parts) > MAX_NESTING:
            return f"{prefix}: {TOO_DEEP}"
        if excess := find_excess(text):
            return f"{prefix}: {key.strip()}: {excess.message}"
        node: dict | list = self.data
        path: tuple = ()
        for k, part in enumerate(parts):
            name = part if isinstance(node, dict) else _index(node, part)
            if name is None:
                item_names = [
                    str(x.get("name", i)) for i, x in enumerate(node) if isinstance(x, dict)
                ]
                choices = ", ".join(item_names) or f"{len(node)} items"
                return f"{prefix}: {'.'.join(parts[:k])} has no item '{part}'; it has {choices}"
            path += (name,)
            if k == len(parts) - 1:
                node[name] = _value(text)  # type: ignore[index]
                break
            if isinstance(node, dict):
                node.setdefault(name, {})
            node = node[name]  # type: ignore[index]
            if not isinstance(node, dict | list):
                return f"{prefix}: {'.'.join(parts[: k + 1])} is not a table"
        self._set = {p: text_of for p, text_of in self._set.items() if p[: len(path)] != path}
        self._set[path] = item
        return ""


def escape_control_characters(text: object) -> str:
    """Return the text on one line, with control characters written as escapes."""
    characters = (c if c.isprintable() else c.encode("unicode_escape").decode() for c in str(text))
    return "".join(characters)


def truncate(item: str) -> str:
    """Return at most 200 characters of a text from a file."""
    return item if len(item) <= 200 else f"{item[:197]}..."


def _syntax(path: str, text: str, detail: str) -> str:
    """Return the error line of a text that is no TOML."""
    if "integer string conversion" in detail:
        long = _LONG_NUMBER.search(text)
        lines_before = text.count("\n", 0, long.start()) if long else 0
        return f"{path}:{lines_before + 1}: not valid TOML: an integer must fit in 64 bits"
    match = re.search(r"\(at line (\d+), column (\d+)\)", detail)
    line = match[1] if match else str(max(1, len(text.splitlines())))
    column = f" (column {match[2]})" if match else ""
    hint = _unquoted(text.split("\n")[int(line) - 1][:1000]) if match else ""
    return escape_control_characters(
        f"{path}:{line}: not valid TOML: {detail.partition(' (at ')[0]}{column}{hint}"
    )


def _unquoted(line: str) -> str:
    """Return a hint at the first value of a line that lacks quotes (`0.6 s`, a word), else ""."""
    for value in _BARE_VALUE.findall(BASIC.sub('""', LITERAL.sub('""', line)).partition("#")[0]):
        number, name = _NUMBER.fullmatch(value), value.strip()
        word = BARE.fullmatch(name) and name[0].isalpha()
        if name in ("true", "false", "inf", "nan") or not (number or word):
            continue
        try:
            unit(number[1] if number else "")
        except ValueError:
            continue
        what = "a value with a unit" if number else "a word"
        return f'; {what} needs quotes: "{name}"'
    return ""


def _index(items: list, part: str) -> int | None:
    """Return the index of an item, named by number or by name, or None."""
    if part.isdecimal() and len(part) < 10:
        return int(part) if int(part) < len(items) else None
    names = [item.get("name") if isinstance(item, dict) else None for item in items]
    return names.index(part) if part in names else None


def _value(text: str):
    """Return the TOML value, or the text itself: a shell eats the quotes of "1 cm"."""
    try:
        read = tomllib.loads(f"value = {text}")
    except (ValueError, RecursionError):  # a number too long to be read raises one too
        return text.strip()
    return read["value"] if list(read) == ["value"] else text.strip()


class TableSource(TomlSource):
    """Data of a nested table. Its messages name the path of a key, as there is no line.

    `text` holds the values as JSON.
    """

    def __init__(
        self,
        table: Mapping,
        overrides: tuple[str, ...] | list[str] = (),
        name: str = "scene",
        error: type[TomlError] = SceneError,
    ):
        """Copy a table and apply the overrides.

        Args:
            table: The table; it is not changed.
            overrides: Items "key=value".
            name: Name that stands for the file's.
            error: Class raised if a value is nothing that a TOML file can hold, or an override
                fails.
        """
        self.table = table
        super().__init__(name, overrides, None, error)

    def _read(self, path: str | Path, text: str | None, error: type[TomlError]) -> None:
        """Copy the table; raise `error` for values that no scene can hold."""
        self._line = {}
        wrong: list[tuple[tuple, str]] = []
        self.data = self._plain((), self.table, wrong)
        if wrong:
            raise error(self.lines(wrong))
        self.text = json.dumps(self.data)

    def _plain(self, path: tuple, value: Any, wrong: list[tuple[tuple, str]]) -> Any:
        """Return a value as tomllib would; note what is wrong, and number the key at `path`."""
        self._line[path] = len(self._line)
        if len(path) > MAX_NESTING:
            wrong.append((path[:3], f"is {TOO_DEEP}"))
            return None
        if isinstance(value, np.ndarray | np.generic):
            value = value.tolist()
        if isinstance(value, Mapping):
            if strange := [key for key in value if not isinstance(key, str)]:
                wrong.append((path, f"a key must be a text; got {strange[0]!r}"))
                return {}
            return {key: self._plain((*path, key), item, wrong) for key, item in value.items()}
        if isinstance(value, list | tuple):
            return [self._plain((*path, k), item, wrong) for k, item in enumerate(value)]
        if isinstance(value, Path):
            return str(value)
        if not isinstance(value, str | bool | int | float):
            hint = ": leave the key out" if value is None else ""
            allowed = "must be a number, a text, True or False, a list or a table"
            wrong.append((path, f"{allowed}; got {type(value).__name__}{hint}"))
        return value

    def place(self, path: tuple) -> tuple[int, str]:
        """Return (number for sorting, the key or the override that holds it)."""
        for stop in range(len(path), 0, -1):
            if path[:stop] in self._set:
                return 10**9, f"--set {truncate(self._set[path[:stop]])}"
        for stop in range(len(path), 0, -1):
            if path[:stop] in self._line:
                return self._line[path[:stop]], ".".join(map(str, path[:stop]))
        return 0, str(self.path)

    def _line_head(self, path: tuple) -> tuple[int, str]:
        """Return (number for sorting, the text before the message of an error at a key)."""
        number, where = self.place(path)
        key = self.key(path) or str(self.path)
        return number, f"{where}: {key}" if self.overridden(path) else key

    def key_with_place(self, path: tuple) -> str:
        """Return a key; it is its own place."""
        return self.key(path)

"""Data of a nested table (dicts and lists) that a program gives in the place of a TOML file."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from .schema import SceneError, TomlError
from .text_bounds import MAX_NESTING, TOO_DEEP
from .toml_source import TomlSource, truncate


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

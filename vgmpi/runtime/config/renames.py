"""Renamed keys and values of user files: the old words are read and replaced by the new ones."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple


@dataclass(frozen=True)
class Rename:
    """One renamed key, or the renamed values of one key.

    Attributes:
        path: Path of the old key in a file, with the new names of the tables around it, such as
            "object.motion.interpolation". Items of lists have no part of their own; "*" stands for
            any one key, "**" for any number of keys.
        key: New name of the last part; "" if only values have new names.
        values: New values by old ones, which are texts or booleans.
        where: Values that other keys of the same table must have.
    """

    path: str
    key: str = ""
    values: Mapping[str | bool, Any] = field(default_factory=dict)
    where: Mapping[str, str] = field(default_factory=dict)

    @property
    def pattern(self) -> re.Pattern:
        """Return the pattern of the paths, joined by NUL characters, that this is for."""
        parts = [
            r"(?:[^\0]*\0)*" if part == "**" else
            (r"[^\0]*" if part == "*" else re.escape(part)) + r"\0"
            for part in self.path.split(".")
        ]  # fmt: skip
        return re.compile("".join(parts))


class Replacement(NamedTuple):
    """One place where an old word was replaced.

    Attributes:
        old_path: Path of the key as written: keys and indices.
        new_path: Path of the key in the data now.
        old_value: Value as written if it was replaced, else None.
        new_value: Value in its place, or None.
    """

    old_path: tuple
    new_path: tuple
    old_value: Any = None
    new_value: Any = None


class RenameTable:
    """All renames of one kind of file."""

    def __init__(self, renames: Iterable[Rename] = ()):
        self._patterns = [(rename.pattern, rename) for rename in renames]
        self._candidates: dict[tuple, list[Rename]] = {}

    def find(self, path: tuple, table: Mapping[str, Any]) -> list[Rename]:
        """Return the renames that apply to a key.

        Args:
            path: Path of the key; indices of list items are passed over.
            table: Table that holds the key.
        """
        keys = tuple(part for part in path if isinstance(part, str))
        if keys not in self._candidates:
            text = "".join(f"{part}\0" for part in keys)
            self._candidates[keys] = [r for pattern, r in self._patterns if pattern.fullmatch(text)]
        return [
            rename
            for rename in self._candidates[keys]
            if all(table.get(key) == value for key, value in rename.where.items())
        ]

    def new_key(self, path: tuple, table: Mapping[str, Any]) -> str:
        """Return the new name of the last key of a path; see `find`."""
        for rename in self.find(path, table):
            if rename.key:
                return rename.key
        return str(path[-1])

    def new_value(self, path: tuple, table: Mapping[str, Any], value: Any) -> Any:
        """Return the new word for the value of a key; see `find`."""
        for rename in self.find(path, table):
            value = replaced_value(rename, value)
        return value

    def apply(self, data: Any, path: tuple = ()) -> list[Replacement]:
        """Replace old words in nested tables and lists; return where.

        A key that is there by both names stays: it is refused later as an unknown key.

        Args:
            data: Tables and lists (in/out).
            path: Path of `data` in its file.
        """
        replacements: list[Replacement] = []
        if isinstance(data, list):
            for index, item in enumerate(data):
                replacements += self.apply(item, (*path, index))
        if not isinstance(data, dict):
            return replacements
        for old in list(data):
            key = old
            for rename in self.find((*path, old), data):
                new = rename.key or key
                if new != key and new in data:
                    continue
                value = data.pop(key) if new != key else data[key]
                data[new] = new_value = replaced_value(rename, value)
                changed = (value, new_value) if new_value is not value else (None, None)
                if new != key or changed[1] is not None:
                    replacements.append(Replacement((*path, key), (*path, new), *changed))
                key = new
            replacements += self.apply(data[key], (*path, key))
        return replacements


def list_new_names(replacements: Iterable[Replacement]) -> str:
    """Return "'old' is now 'new', ..." of replaced keys, each once."""
    names = dict.fromkeys((r.old_path[-1], r.new_path[-1]) for r in replacements)
    return ", ".join(f"{old!r} is now {new!r}" for old, new in names)


def replaced_value(rename: Rename, value: Any) -> Any:
    """Return the new word for a text or a boolean, or the value itself if it has none.

    The numbers 0 and 1 have none: they equal booleans only in Python.
    """
    return rename.values.get(value, value) if isinstance(value, str | bool) else value


NO_RENAMES = RenameTable()

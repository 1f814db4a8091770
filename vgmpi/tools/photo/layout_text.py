"""Changes of a layout's text that leave everything else as it was written."""

import os
from pathlib import Path
from typing import Any

from .layout_config import LayoutError


def insert_guesses(text: str, guesses: list[tuple[tuple, Any, str]]) -> str:
    """Insert values that a layout lacks, each with its reason as a comment.

    Everything else stays as it was written.

    Args:
        text: Text of the layout.
        guesses: Path of the key, value and reason of each guess.

    Raises:
        LayoutError: tomlkit is missing.
    """
    tomlkit = import_tomlkit()
    document = tomlkit.parse(text)
    for path, value, reason in guesses:
        table: Any = document
        for part in path[:-1]:
            if isinstance(part, str) and part not in table:
                table[part] = tomlkit.table()
            table = table[part]
        item = tomlkit.item(value)
        if reason and not isinstance(table, tomlkit.items.InlineTable):
            item.comment(" ".join(reason.split()))
        table[path[-1]] = item
    return tomlkit.dumps(document)


def replace_objects(text: str, objects: list[tuple[int | None, dict[str, Any]]]) -> str:
    """Return a layout's text with other objects; what it has besides stays as it was written.

    Args:
        text: Text of the layout.
        objects: Number of each object's table in the text, None for a new one, and its keys; a key
            whose value is None is removed. Tables that are not listed are removed.

    Raises:
        LayoutError: tomlkit is missing.
    """
    tomlkit = import_tomlkit()
    document = tomlkit.parse(text)
    if "object" not in document:
        document.append("object", tomlkit.aot())
    tables: Any = document["object"]
    numbers = sorted(number for number, _ in objects if number is not None)
    for k in reversed(range(len(tables))):
        if k not in numbers:
            del tables[k]
    first_new = len(tables)
    for number, values in objects:
        is_new = number is None
        table = tomlkit.table() if number is None else tables[numbers.index(number)]
        for key, value in values.items():
            if value is None:
                table.pop(key, None)
            elif is_new or table.get(key) != value:
                table[key] = value
        if is_new:
            tables.append(table)
    for table in tables[first_new:]:
        if isinstance(tables, tomlkit.items.AoT):
            table.add(tomlkit.nl())
    return tomlkit.dumps(document)


def import_tomlkit() -> Any:
    """Return the package tomlkit; raise a LayoutError if it is missing."""
    try:
        import tomlkit
    except ImportError:
        message = "writing into a layout needs tomlkit: pip install 'vgmpi[images]'"
        raise LayoutError([message]) from None
    return tomlkit


def relative(path: Path, folder: Path) -> str:
    """Return the path of a file relative to the folder of a layout."""
    return Path(os.path.relpath(path.resolve(), folder.resolve())).as_posix()

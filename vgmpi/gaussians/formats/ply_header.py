"""Header of a .ply file, of Gaussians or of a mesh: elements, types of properties, comments."""

import re
from typing import BinaryIO, NamedTuple

import numpy as np

from .validation import GaussianFileError

_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("half", "float16"), "f2"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": "="}
ENCODINGS = {"<": "binary little-endian", ">": "binary big-endian", "=": "ASCII text"}
_HEADER_LIMIT = 1 << 16  # [bytes] a Gaussian file's header has about 2 KB
_HEADER_END = re.compile(rb"[\r\n]end_header[ \t]*(\r\n|\n|\r)")
_LINE_LIMIT = 200  # [characters] of a header line
_ROW_LIMIT = 4096  # [bytes] of a row; all standard properties take 496
_COMMENT_COUNT, _COMMENT_LENGTH = 8, 120  # bounds of what a record keeps of the comments
_RENDER_MODE = re.compile(  # Brush and splat-transform write the first form, Postshot the second
    r"\s*(?:splatrendermode\s*:\s*(?P<mode>\S+)|antialiased\s+(?P<flag>[01]))\s*", re.IGNORECASE
)


class Layout(NamedTuple):
    """Element of a file as its header describes it.

    Attributes:
        name: Its name.
        row_count: Its number of rows.
        row: Type of a row; empty if the element has no properties or has lists.
        names: Names of its properties in order.
        columns: Types of its properties: one for a scalar, two (of the number of items and of an
            item) for a list.
    """

    name: str
    row_count: int
    row: np.dtype
    names: tuple[str, ...]
    columns: tuple[tuple[np.dtype, ...], ...]

    @property
    def has_lists(self) -> bool:
        """Return whether rows may differ in size."""
        return any(len(column) > 1 for column in self.columns)


class Header(NamedTuple):
    """Contents of a header; `order` is "<" or ">" for binary data and "=" for text."""

    order: str
    elements: tuple[Layout, ...]
    comments: tuple[str, ...]
    data_start: int


def read_header(file: BinaryIO) -> Header:
    """Read the header of a .ply file.

    Raises:
        GaussianFileError: If it is none, or beyond the bounds.
    """
    lines, start = _header_lines(file.read(_HEADER_LIMIT))
    order = None
    comments: list[str] = []
    tables: list[tuple[str, int, list[tuple[str, tuple[str, ...]]]]] = []
    for line in lines:
        words = line.split()
        if not words:
            continue
        if words[0] in ("comment", "obj_info"):
            comments.append(line.split(None, 1)[1] if len(words) > 1 else "")
            continue
        if len(line) > _LINE_LIMIT or not line.isprintable():
            raise GaussianFileError(f"has the unreadable header line {line[:60]!r}")
        if words[0] == "format":
            if len(words) < 2 or words[1] not in _ORDERS:
                raise GaussianFileError(f"has the {line!r}: allowed are {', '.join(_ORDERS)}")
            order = _ORDERS[words[1]]
        elif words[0] == "element" and len(words) == 3:
            if not words[2].isdecimal() or len(words[2]) > 15:
                raise GaussianFileError(f"has the bad number of rows in {line!r}")
            tables.append((words[1], int(words[2]), []))
        elif words[0] == "property" and tables:
            tables[-1][2].append(_property(line, words))
        else:
            raise GaussianFileError(f"has the unreadable header line {line[:60]!r}")
    if order is None:
        raise GaussianFileError("has no 'format' line")
    if len({name for name, _, _ in tables}) < len(tables):
        raise GaussianFileError("names an element twice")
    elements = tuple(_layout(order, *table) for table in tables)
    return Header(order, elements, tuple(comments), start)


def select_comments(comments: tuple[str, ...]) -> tuple[str, ...]:
    """Return the first comments that do not name a render model, printable and cut to a length."""
    others = [text for text in comments if text.strip() and not _RENDER_MODE.fullmatch(text)]
    return tuple(_printable(text) for text in others[:_COMMENT_COUNT])


def find_render_model(comments: tuple[str, ...]) -> tuple[bool, str]:
    """Find the render model that a trainer wrote into the comments; the last one counts.

    Returns:
        Whether the Gaussians are those of antialiased training, and why; (False, "") without such
        a comment.
    """
    is_antialiased, source = False, ""
    for text in comments:
        match = _RENDER_MODE.fullmatch(text)
        if match:
            is_antialiased = match["flag"] == "1" or (match["mode"] or "").lower() == "mip"
            source = f"the file has the comment '{_printable(text)}'"
    return is_antialiased, source


def _printable(text: str) -> str:
    """Return the beginning of a comment without control characters."""
    return "".join(c if c.isprintable() else "?" for c in text.strip()[:_COMMENT_LENGTH])


def _header_lines(head: bytes) -> tuple[list[str], int]:
    """Return the lines of the header after the first, and the offset of the data."""
    if not head.startswith((b"ply\n", b"ply\r")):
        raise GaussianFileError("is not a .ply file (it does not begin with 'ply')")
    end = _HEADER_END.search(head)
    if end is None:
        raise GaussianFileError(f"its header has no end within {_HEADER_LIMIT // 1024} KB")
    text = head[: end.start()].decode("ascii", errors="replace")
    return [line.strip() for line in text.splitlines()[1:]], end.end()


def _property(line: str, words: list[str]) -> tuple[str, tuple[str, ...]]:
    """Return the name of a property and its type, or the two types of a list."""
    kinds = words[2:4] if words[1:2] == ["list"] else words[1:2]
    if len(words) != (5 if len(kinds) == 2 else 3):
        raise GaussianFileError(f"has the unreadable header line {line[:60]!r}")
    for kind in kinds:
        if kind not in _TYPES:
            raise GaussianFileError(
                f"has the unknown type {kind!r} of the property {words[-1]!r}: allowed are"
                f" {', '.join(_TYPES)}"
            )
    if len(kinds) == 2 and _TYPES[kinds[0]][0] == "f":
        raise GaussianFileError(f"has the unreadable header line {line[:60]!r}")
    return words[-1], tuple(_TYPES[kind] for kind in kinds)


def _layout(order: str, name: str, count: int, properties: list) -> Layout:
    """Return an element whose properties are (name, types)."""
    if len({p for p, _ in properties}) < len(properties):
        raise GaussianFileError(f"has repeated properties in element '{name}'")
    columns = tuple(tuple(np.dtype(order + kind) for kind in kinds) for _, kinds in properties)
    has_lists = any(len(column) > 1 for column in columns)
    fields = [(p, column[0]) for (p, _), column in zip(properties, columns)]
    row = np.dtype([] if has_lists else fields)
    if row.itemsize > _ROW_LIMIT:
        raise GaussianFileError(
            f"has rows of {row.itemsize:,} bytes in '{name}': the most is {_ROW_LIMIT:,}"
        )
    return Layout(name, count, row, tuple(p for p, _ in properties), columns)

"""Header and tables of a .ply file, of Gaussians or of a mesh, binary or text.

The header tells the elements, the types of their properties, and comments. Rows are read block by
block. Elements behind the Gaussians are not looked at, except the one with their higher colors.
Lists before the Gaussians have no fixed size: a bounded number of them is skipped one by one.
"""

import os
import re
from collections.abc import Iterator
from typing import BinaryIO, NamedTuple, Protocol

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
_LINE_LENGTH = 200  # [characters] of a header line
_ROW_LIMIT = 4096  # [bytes] of a row; all standard properties take 496
_COMMENT_COUNT, _COMMENT_LENGTH = 8, 120  # bounds of what a record keeps of the comments
_RENDER_MODE = re.compile(  # Brush and splat-transform write the first form, Postshot the second
    r"\s*(?:splatrendermode\s*:\s*(?P<mode>\S+)|antialiased\s+(?P<flag>[01]))\s*", re.IGNORECASE
)
VERTEX = "vertex"
_LIST_LIMIT = 100_000  # [lists] that are skipped before the Gaussians of a binary file
_LINE_LIMIT = 1_000_000  # [lines] that are skipped before the Gaussians of a file of text
_BLANK_LIMIT = 1000  # [lines] without anything that may follow one another
_TEXT_BYTES = 1 << 22  # [bytes] of text that are converted together
_NUMBER_BYTES = 64  # [bytes] of a number and its separator; doubles take up to 25


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
        if len(line) > _LINE_LENGTH or not line.isprintable():
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


class Table(Protocol):
    """Rows of an element."""

    @property
    def row_count(self) -> int:
        """Return the number of rows."""

    @property
    def row(self) -> np.dtype:
        """Return the type of a row."""

    def rows(self, start: int, stop: int) -> np.ndarray:
        """Return a range of rows, cut at the end of the table."""


class BinaryTable:
    """Rows of fixed size, the first at byte `start`."""

    def __init__(self, file: BinaryIO, layout: Layout, start: int):
        self.row_count, self.row = layout.row_count, layout.row
        self._file, self._start = file, start

    def rows(self, start: int, stop: int) -> np.ndarray:
        """Read a range of rows, cut at the end of the table."""
        count = max(min(stop, self.row_count) - start, 0)
        if not self.row.itemsize:
            return np.empty(count, self.row)
        self._file.seek(self._start + start * self.row.itemsize)
        return np.fromfile(self._file, dtype=self.row, count=count)


class TextTable:
    """Rows of text, one a line, read once from the first to the last."""

    def __init__(self, file: BinaryIO, layout: Layout, start: int):
        self.row_count, self.row = layout.row_count, layout.row
        self._names = layout.row.names or ()
        self._lines = _text_lines(file, start, _NUMBER_BYTES * (len(self._names) + 1))

    def rows(self, start: int, stop: int) -> np.ndarray:
        """Read the next rows, which must be those from `start` to `stop`."""
        stop = min(stop, self.row_count)
        blocks = []
        while start < stop:
            lines: list[str] = []
            size = 0
            while start + len(lines) < stop and size < _TEXT_BYTES:
                line = next(self._lines, None)
                if line is None:
                    raise GaussianFileError(
                        f"ends after {start + len(lines):,} of {self.row_count:,} rows of"
                        f" '{VERTEX}': truncated?"
                    )
                lines.append(line)
                size += len(line)
            blocks.append(self._converted(lines, start))
            start += len(lines)
        return np.concatenate(blocks) if blocks else np.empty(0, self.row)

    def _converted(self, lines: list[str], start: int) -> np.ndarray:
        """Convert lines to rows."""
        try:
            numbers = np.loadtxt(lines, dtype=np.float64, comments=None, ndmin=2)
        except ValueError:
            numbers = np.empty((0, 0))
        if numbers.shape != (len(lines), len(self._names)):
            raise GaussianFileError(self._find_invalid_row(lines, start))
        rows = np.empty(len(lines), self.row)
        for k, name in enumerate(self._names):
            kind = self.row[name]
            if kind.kind in "iu":
                bounds = np.iinfo(kind)
                values = numbers[:, k]
                fits = (values >= bounds.min) & (values <= bounds.max) & (values % 1 == 0)
                if not fits.all():
                    row = start + int(np.argmin(fits))
                    raise GaussianFileError(
                        f"row {row:,} of '{VERTEX}' has no integer of {bounds.min:,} to"
                        f" {bounds.max:,} as {name}"
                    )
            rows[name] = numbers[:, k]
        return rows

    def _find_invalid_row(self, lines: list[str], start: int) -> str:
        """Find the first line that does not hold one number for each property, as a message."""
        for k, line in enumerate(lines):
            words = line.split()
            try:
                np.array(words, dtype=np.float64)
            except ValueError:
                return f"row {start + k:,} of '{VERTEX}' has text in place of a number"
            if len(words) != len(self._names):
                return (
                    f"row {start + k:,} of '{VERTEX}' has {len(words)} numbers, expected"
                    f" {len(self._names)}"
                )
        return f"rows {start:,} to {start + len(lines) - 1:,} of '{VERTEX}' are no numbers"


def open_tables(file: BinaryIO, header: Header) -> dict[str, Table]:
    """Return the elements of a file by name, up to the first with lists behind the Gaussians.

    Raises:
        GaussianFileError: If rows lie outside of the file, or lists are where they cannot be read.
    """
    size = os.fstat(file.fileno()).st_size
    for layout in header.elements:
        if layout.name == VERTEX and layout.has_lists:
            raise GaussianFileError(
                f"has lists in element '{VERTEX}': files of Gaussians have only numbers there"
            )
    if header.order == "=":
        return _text_tables(file, header, size)
    tables: dict[str, Table] = {}
    start = header.data_start
    for layout in header.elements:
        if layout.has_lists:
            if VERTEX in tables:
                break
            start = _end_of_lists(file, layout, start, size)
            continue
        tables[layout.name] = BinaryTable(file, layout, start)
        start += layout.row_count * layout.row.itemsize
        if start > size:
            raise _truncated(layout, size)
    return tables


def _text_tables(file: BinaryIO, header: Header, size: int) -> dict[str, Table]:
    """Return the element of the Gaussians of a file of text."""
    skipped, needed = 0, header.data_start - 1  # the last line may lack its end
    for layout in header.elements:
        needed += 2 * layout.row_count * len(layout.columns)
        if needed > size:
            raise _truncated(layout, size)
        if layout.name == VERTEX:
            start = _end_of_lines(file, header.data_start, skipped)
            return {VERTEX: TextTable(file, layout, start)}
        skipped += layout.row_count if layout.columns else 0
    return {}


def _truncated(layout: Layout, size: int) -> GaussianFileError:
    """Return the error of an element that does not fit into a file of `size` bytes."""
    return GaussianFileError(
        f"the header promises {layout.row_count:,} rows of '{layout.name}', the file is too short"
        f" ({size:,} bytes): truncated?"
    )


def _text_lines(file: BinaryIO, start: int, limit: int) -> Iterator[str]:
    """Yield the lines of a file from byte `start` that are not blank.

    Raises:
        GaussianFileError: If one is longer than `limit` bytes.
    """
    file.seek(start)
    blank = 0
    while line := file.readline(limit):
        blank = blank + 1 if line.isspace() else 0
        if blank > _BLANK_LIMIT:
            raise GaussianFileError(f"has more than {_BLANK_LIMIT:,} blank lines")
        if len(line) == limit and not line.endswith(b"\n"):
            raise GaussianFileError(f"has a line of more than {limit:,} bytes: no rows of numbers?")
        if not blank:
            yield line.decode("ascii", errors="replace")


def _end_of_lines(file: BinaryIO, start: int, count: int) -> int:
    """Return the first byte behind `count` lines, of any length.

    Raises:
        GaussianFileError: If there are too many.
    """
    if count > _LINE_LIMIT:
        raise GaussianFileError(
            f"has {count:,} lines before the Gaussians: at most {_LINE_LIMIT:,} are skipped there"
        )
    file.seek(start)
    while count and (line := file.readline(_TEXT_BYTES)):
        count -= line.endswith(b"\n")
    return file.tell()


def _end_of_lists(file: BinaryIO, layout: Layout, start: int, size: int) -> int:
    """Return the first byte behind an element with lists, whose rows are read one by one.

    Raises:
        GaussianFileError: If there are too many, or they lie outside of the file.
    """
    lists = sum(len(column) > 1 for column in layout.columns)
    if layout.row_count * len(layout.columns) > _LIST_LIMIT:
        raise GaussianFileError(
            f"has {layout.row_count * lists:,} lists in element '{layout.name}' before the"
            f" Gaussians: at most {_LIST_LIMIT:,} numbers and lists are skipped there"
        )
    for _ in range(layout.row_count):
        for column in layout.columns:
            items, item = 1, column[-1]
            if len(column) > 1:
                file.seek(start)
                head = file.read(column[0].itemsize)
                if len(head) < column[0].itemsize:
                    raise _truncated(layout, size)
                items = int(np.frombuffer(head, column[0])[0])
                start += column[0].itemsize
            start += items * item.itemsize
            if items < 0 or start > size:
                raise _truncated(layout, size)
    return start

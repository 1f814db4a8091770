"""Rows of the elements of a .ply file, binary or text, read block by block.

Elements behind the Gaussians are not looked at, except the one with their higher colors. Lists
before the Gaussians have no fixed size: a bounded number of them is skipped one by one.
"""

import os
from collections.abc import Iterator
from typing import BinaryIO, Protocol

import numpy as np

from .ply_header import Header, Layout
from .validation import GaussianFileError

VERTEX = "vertex"
_LIST_LIMIT = 100_000  # [lists] that are skipped before the Gaussians of a binary file
_LINE_LIMIT = 1_000_000  # [lines] that are skipped before the Gaussians of a file of text
_BLANK_LIMIT = 1000  # [lines] without anything that may follow one another
_TEXT_BYTES = 1 << 22  # [bytes] of text that are converted together
_NUMBER_BYTES = 64  # [bytes] of a number and its separator; doubles take up to 25


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

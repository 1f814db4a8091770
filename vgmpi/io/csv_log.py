"""Append-only CSV tables of a run: ledger.csv and probe_NAME.csv.

A checksum ends every row, so that a later change is detected and located.
"""

import csv
import errno
import itertools
import logging
import os
import zlib
from collections.abc import Callable, Iterable
from pathlib import Path

from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.runtime import user_files

from . import file_layout, hdf5_writer
from .run_reader import RunError

log = logging.getLogger("vgmpi")

COLUMNS = [d.name for d in file_layout.LEDGER_COLUMNS]
MAX_BYTES = 1 << 32  # [bytes] largest size of a table that is read
# conversion of a word by the type of its column
KINDS: dict[str, Callable] = {"f8": float, "i8": int, "text": str}


class CsvLog:
    """CSV table to which rows are appended. Collective: all ranks call, rank 0 writes.

    Raises StoreError on all ranks if writing fails, and RunError if existing rows are damaged.

    Attributes:
        retained_rows: Rows that were retained at the start, on rank 0.
        sum: Checksum of the last row, which depends on all rows, on rank 0.
    """

    def __init__(
        self,
        path: Path,
        columns: list[file_layout.Dataset],
        ranks: SerialCommunicator,
        last_step: int | None = None,
    ):
        """Create the table, or continue it.

        Args:
            path: File of the table.
            columns: Columns of the table.
            ranks: Communicator.
            last_step: Later rows are dropped; None starts a new table.
        """
        self.path, self.columns, self.ranks = path, columns, ranks
        self.retained_rows: list[dict] = []
        self.sum = 0
        if last_step is not None:
            _on_root(ranks, lambda: self._keep(last_step))
        self._do(self._start)

    def _do(self, action):
        """Run an action on rank 0 and agree on the outcome."""
        error = None
        if self.ranks.rank == 0:
            try:
                action()
            except OSError as caught:
                error = caught
        hdf5_writer.raise_on_all_ranks(self.ranks, error, self.path)

    def _keep(self, last_step):
        """Read the rows to retain."""
        if os.path.lexists(self.path):
            self.retained_rows = [
                r for r in read_rows(self.path, self.columns) if r["step"] <= last_step
            ]
        else:
            log.warning("%s is not there: it begins behind step %d", self.path, last_step)

    def _start(self):
        """Write the header and the retained rows."""
        self.path.parent.mkdir(parents=True, exist_ok=True)
        text, self.sum = _lines(self.retained_rows, self.columns)
        hdf5_writer.replace_text(self.path, _header(self.columns) + "\n" + text)

    def append(self, rows: Iterable[dict]) -> None:
        """Append dicts with all columns; those of rank 0 are written."""

        def write():
            """Write the lines, or none of them."""
            text, after = _lines(rows, self.columns, self.sum)
            flags = os.O_WRONLY | os.O_APPEND | os.O_NOFOLLOW
            handle = os.open(self.path, flags)
            size = os.fstat(handle).st_size
            try:
                with open(handle, "a", encoding="utf-8", closefd=False) as f:
                    f.write(text)
                    f.flush()
                    os.fsync(handle)
            except OSError:
                os.truncate(handle, size)  # removes partial lines
                raise
            finally:
                os.close(handle)
            self.sum = after

        self._do(write)


class ConservationLog(CsvLog):
    """Conservation log ledger.csv: mass, momentum and energy, a row per frame and phase."""

    def __init__(
        self,
        folder: str | Path,
        ranks: SerialCommunicator,
        last_step: int | None = None,
        flows: bool = False,
        liquids: bool = False,
        rigid: bool = False,
    ):
        """Create the ledger, or continue it, with the columns that it has.

        Args:
            folder: Output folder of the run.
            ranks: Communicator.
            last_step: Later rows are dropped; None starts a new ledger.
            flows: True if particles are inserted or removed during the run.
            liquids: True if liquids have phases of their own.
            rigid: True if there are free rigid bodies.
        """
        path = Path(folder) / file_layout.LEDGER
        if last_step is not None:
            present = ranks.rank == 0 and optional_ledger_columns(path, liquids, rigid)
            liquids, rigid = ranks.bcast(present)
        super().__init__(path, ledger_columns(flows, liquids, rigid), ranks, last_step)


def ledger_columns(flows: bool, liquids: bool, rigid: bool = False) -> list[file_layout.Dataset]:
    """Return the columns of ledger.csv.

    Args:
        flows: Whether particles are inserted or removed.
        liquids: Whether liquids have phases of their own.
        rigid: Whether there are free rigid bodies.
    """
    more = file_layout.OPEN_SYSTEM_COLUMNS * flows + file_layout.LIQUID_COLUMNS * liquids
    more += file_layout.RIGID_COLUMNS * rigid
    return [*file_layout.LEDGER_COLUMNS, *more] if more else file_layout.LEDGER_COLUMNS


def optional_ledger_columns(path: Path, liquids: bool, rigid: bool) -> tuple[bool, bool]:
    """Return whether a ledger has the columns of liquids, and those of free rigid bodies.

    Args:
        path: File of the ledger.
        liquids, rigid: Results if there is no readable file.
    """
    try:
        text = user_files.read_regular_file(path, MAX_BYTES, follow=False)
    except OSError:
        return liquids, rigid
    names = text.split(b"\n", 1)[0].split(b",")
    return (
        file_layout.LIQUID_COLUMNS[0].name.encode() in names,
        file_layout.RIGID_COLUMNS[0].name.encode() in names,
    )


def read_probe(path: Path) -> list[dict]:
    """Return the rows of a probe's table; its header tells which quantities it has.

    Raises:
        RunError: No kind of probe has this header, or a row is not what was written.
    """
    try:
        head = user_files.read_regular_file(path, MAX_BYTES, follow=False).split(b"\n", 1)[0]
    except OSError as error:
        raise RunError(f"{path}: {error.strerror}") from None
    for columns in file_layout.PROBE_COLUMNS.values():
        if head == _header(columns).encode():
            return read_rows(path, columns)
    raise RunError(f"{path}:1: damaged: its columns are those of no probe")


def verify_logs(
    tables: dict[Path, list[file_layout.Dataset]],
    ranks: SerialCommunicator,
    step: int,
    sums: dict[str, int],
) -> None:
    """Verify the tables that a run resumed at `step` continues. Collective.

    The check precedes all writing.

    Args:
        tables: Columns of each table, by its path.
        ranks: Communicator.
        step: Step of the checkpoint.
        sums: Checksum CsvLog.sum at that step of each table that existed, by the name of its file.

    Raises:
        RunError: A table is damaged, on all ranks.
    """

    def look():
        """Compare every existing table with its checksum."""
        for path, columns in tables.items():
            if os.path.lexists(path):
                try:
                    _compare(path, columns, step, sums.get(path.name))
                except RunError as error:
                    can = "put a copy of it back, or move it away: then it begins anew"
                    raise RunError(f"{error}; to go on, {can}") from None

    _on_root(ranks, look)


def _compare(path, columns, step, wanted):
    """Compare a table's rows up to `step` with their checksum; a killed run may cut later ones."""
    rows = [row for row in read_rows(path, columns) if row["step"] <= step]
    if wanted is None or _lines(rows, columns)[1] == wanted:
        return
    if rows:
        raise RunError(f"{path}: damaged: its rows up to step {step} are not those of this run")
    log.warning("%s has no rows up to step %d: it begins behind it", path, step)


def _lines(rows, columns, before=0):
    """Return the lines of rows and the checksum of the last; `before` is that of the row above."""
    lines = []
    for row in rows:
        words = ",".join(_word(row[d.name]) for d in columns)
        before = zlib.crc32(words.encode(), before)
        lines.append(f"{words},{before}\n")
    return "".join(lines), before


def _on_root(ranks, action):
    """Run an action on rank 0; its RunError is raised on all ranks."""
    failure = None
    if ranks.rank == 0:
        try:
            action()
        except RunError as error:
            failure = error
    failure = ranks.bcast(failure)
    if failure is not None:
        raise failure


def _word(value):
    """Return a value as a word of CSV."""
    if isinstance(value, str):
        return '"' + value.replace('"', '""') + '"' if set(value) & set(',"\n') else value
    return repr(value.item() if hasattr(value, "item") else value)


def _header(columns):
    """Return the header line."""
    return ",".join(d.name for d in [*columns, file_layout.ROW_CHECKSUM])


def read_rows(
    path: str | Path, columns: list[file_layout.Dataset] = file_layout.LEDGER_COLUMNS
) -> list[dict]:
    """Return the rows of a table; an incomplete last line is omitted.

    Args:
        path: File of the table.
        columns: Columns of the table.

    Raises:
        RunError: A row is not what was written; the text names its line.
    """
    try:
        text = user_files.read_regular_file(path, MAX_BYTES, follow=False)
    except OSError as error:
        link = error.errno == errno.ELOOP
        reason = "is a link to elsewhere" if link else error.strerror
        raise RunError(f"{path}: {reason}") from None
    head, *lines = text.split(b"\n")
    if columns is file_layout.LEDGER_COLUMNS:
        variants = [
            ledger_columns(*present) for present in itertools.product((False, True), repeat=3)
        ]
        columns = next((c for c in variants if head == _header(c).encode()), columns)
    if not lines or head != _header(columns).encode():
        raise RunError(f"{path}:1: damaged: its columns are not {_header(columns)}")
    last, before = lines.pop(), 0  # after the last newline: empty, or an incomplete line
    rows = []
    for number, line in enumerate(lines, 2):
        words, before, is_valid = _split_checksum(line, before)
        row = _parsed(words, columns) if is_valid else None
        if row is None:
            raise RunError(f"{path}:{number}: damaged: this row is not what was written")
        rows.append(row)
    if last:
        words, expected, is_valid = _split_checksum(last, before)
        row = _parsed(words, columns) if is_valid else None
        if row is not None:
            rows.append(row)
        elif not _is_truncated_row(last, words, expected, len(columns)):
            number = len(lines) + 2
            raise RunError(f"{path}:{number}: damaged: this row is not what was written")
    return rows


def _split_checksum(line, before):
    """Return a row's text, the checksum it must have, and True if it has it.

    `before` is the checksum of the row above.
    """
    words, _, stored = line.rpartition(b",")
    expected = zlib.crc32(words, before)
    return words, expected, stored == b"%d" % expected


def _is_truncated_row(line, words, expected, columns):
    """Return True if a line without newline may be the beginning of a row."""
    values = next(csv.reader([line.decode(errors="replace")]), [])
    return len(values) <= columns or (b"%d" % expected).startswith(line[len(words) + 1 :])


def _parsed(words, columns):
    """Return a row as a dict, None if a word is not of its column's type."""
    try:
        (values,) = csv.reader([words.decode()])
        pairs = zip(columns, values, strict=True)
        return {d.name: KINDS[d.dtype](word) for d, word in pairs}
    except (ValueError, csv.Error):
        return None

"""Tables that grow while a run goes on, in a form that opens in anything: ledger.csv and
probe_NAME.csv. A checksum ends every row, so that what was changed since is found, and where."""

import csv
import errno
import logging
import os
import zlib
from collections.abc import Callable, Iterable
from pathlib import Path

from vgmpi import inputs
from vgmpi.domain.ranks import Alone
from vgmpi.output import layout, store
from vgmpi.output.read import RunError

log = logging.getLogger("vgmpi")

COLUMNS = [d.name for d in layout.LEDGER_COLUMNS]
MOST_BYTES = 1 << 32  # of a table
KINDS: dict[str, Callable] = {"f8": float, "i8": int, "text": str}


class Rows:
    """Appends to a CSV file of these columns; `last_step` None starts anew, else rows after that
    step are dropped first. kept: the rows that were not; sum: the checksum of the last row, which
    stands for all; both on rank 0.

    Collective: all ranks call, rank 0 writes. Raises StoreError on all ranks alike, and RunError
    where the rows that are there are damaged.
    """

    def __init__(
        self,
        path: Path,
        columns: list[layout.Dataset],
        ranks: Alone,
        last_step: int | None = None,
    ):
        self.path, self.columns, self.ranks = path, columns, ranks
        self.kept: list[dict] = []
        self.sum = 0
        if last_step is not None:
            _on_root(ranks, lambda: self._keep(last_step))
        self._do(self._start)

    def _do(self, action):
        error = None
        if self.ranks.rank == 0:
            try:
                action()
            except OSError as caught:
                error = caught
        store.agree(self.ranks, error, self.path)

    def _keep(self, last_step):
        if os.path.lexists(self.path):
            self.kept = [r for r in read(self.path, self.columns) if r["step"] <= last_step]
        else:
            log.warning("%s is not there: it begins behind step %d", self.path, last_step)

    def _start(self):
        self.path.parent.mkdir(parents=True, exist_ok=True)
        text, self.sum = _lines(self.kept, self.columns)
        store.replace_text(self.path, _header(self.columns) + "\n" + text)

    def append(self, rows: Iterable[dict]) -> None:
        """Dicts with all columns; those of rank 0 count."""

        def write():
            text, after = _lines(rows, self.columns, self.sum)
            way = os.O_WRONLY | os.O_APPEND | os.O_NOFOLLOW
            handle = os.open(self.path, way)
            size = os.fstat(handle).st_size
            try:
                with open(handle, "a", encoding="utf-8", closefd=False) as f:
                    f.write(text)
                    f.flush()
                    os.fsync(handle)
            except OSError:
                os.truncate(handle, size)  # no half lines
                raise
            finally:
                os.close(handle)
            self.sum = after

        self._do(write)


class Ledger(Rows):
    """ledger.csv: mass, momentum and energy of every phase at every frame, a row per phase."""

    def __init__(
        self, folder: str | Path, ranks: Alone, last_step: int | None = None, flows: bool = False
    ):
        super().__init__(Path(folder) / layout.LEDGER, ledger_columns(flows), ranks, last_step)


def ledger_columns(flows: bool) -> list[layout.Dataset]:
    """Columns of ledger.csv; flows: whether particles come and go."""
    return [*layout.LEDGER_COLUMNS, *layout.FLOW_COLUMNS] if flows else layout.LEDGER_COLUMNS


def check(
    tables: dict[Path, list[layout.Dataset]], ranks: Alone, step: int, sums: dict[str, int]
) -> None:
    """Look at the tables that a run resumed at `step` goes on with, before anything is written.
    Collective.

    tables: columns by the path. sums: what Rows.sum was at that step, by the name of the file, of
    those that were there. Raises RunError on all ranks.
    """

    def look():
        for path, columns in tables.items():
            if os.path.lexists(path):
                try:
                    _compare(path, columns, step, sums.get(path.name))
                except RunError as error:
                    can = "put a copy of it back, or move it away: then it begins anew"
                    raise RunError(f"{error}; to go on, {can}") from None

    _on_root(ranks, look)


def _compare(path, columns, step, wanted):
    """A table ends anywhere in a line where a run was killed, but never before `step`."""
    rows = [row for row in read(path, columns) if row["step"] <= step]
    if wanted is None or _lines(rows, columns)[1] == wanted:
        return
    if rows:
        raise RunError(f"{path}: damaged: its rows up to step {step} are not those of this run")
    log.warning("%s has no rows up to step %d: it begins behind it", path, step)


def _lines(rows, columns, before=0):
    """The lines of rows, and the checksum of their last. before: that of the row above them."""
    lines = []
    for row in rows:
        words = ",".join(_word(row[d.name]) for d in columns)
        before = zlib.crc32(words.encode(), before)
        lines.append(f"{words},{before}\n")
    return "".join(lines), before


def _on_root(ranks, action):
    """action() on rank 0; its RunError is that of all ranks."""
    said = None
    if ranks.rank == 0:
        try:
            action()
        except RunError as error:
            said = error
    said = ranks.bcast(said)
    if said is not None:
        raise said


def _word(value):
    if isinstance(value, str):
        return '"' + value.replace('"', '""') + '"' if set(value) & set(',"\n') else value
    return repr(value.item() if hasattr(value, "item") else value)


def _header(columns, sealed=True):
    return ",".join(d.name for d in [*columns, layout.ROW_SUM][: None if sealed else -1])


def read(path: str | Path, columns: list[layout.Dataset] = layout.LEDGER_COLUMNS) -> list[dict]:
    """Rows of a file of these columns; a last line that was cut off is left out. Raises RunError,
    which names the line of the first row that is not what was written. Rows of earlier versions
    have no checksums: only what is no number is found there."""
    try:
        text = inputs.content(path, MOST_BYTES, follow=False)
    except OSError as error:
        link = error.errno == errno.ELOOP
        said = "is a link to elsewhere" if link else error.strerror
        raise RunError(f"{path}: {said}") from None
    head, *lines = text.split(b"\n")
    if columns is layout.LEDGER_COLUMNS and head == _header(ledger_columns(True)).encode():
        columns = ledger_columns(True)
    sealed = head == _header(columns).encode()
    if not lines or not (sealed or head == _header(columns, sealed=False).encode()):
        raise RunError(f"{path}:1: damaged: its columns are not {_header(columns)}")
    last, before = lines.pop(), 0  # behind the last end of a line: nothing, or what was cut off
    rows = []
    for number, line in enumerate(lines, 2):
        words, before, whole = _unsealed(line, before) if sealed else (line, 0, True)
        row = _parsed(words, columns) if whole else None
        if row is None:
            raise RunError(f"{path}:{number}: damaged: this row is not what was written")
        rows.append(row)
    if last:
        words, wanted, whole = _unsealed(last, before) if sealed else (last, 0, True)
        row = _parsed(words, columns) if whole else None
        if row is not None:
            rows.append(row)
        elif sealed and not _cut(last, words, wanted, len(columns)):
            number = len(lines) + 2
            raise RunError(f"{path}:{number}: damaged: this row is not what was written")
    return rows


def _unsealed(line, before):
    """The row's text, the checksum it must have, and whether that is there. before: that of the row
    above."""
    words, _, told = line.rpartition(b",")
    wanted = zlib.crc32(words, before)
    return words, wanted, told == b"%d" % wanted


def _cut(line, words, wanted, columns):
    """Whether a line without an end may be the beginning of a row."""
    some = next(csv.reader([line.decode(errors="replace")]), [])
    return len(some) <= columns or (b"%d" % wanted).startswith(line[len(words) + 1 :])


def _parsed(words, columns):
    """A row as a dict; None where a word is not of its column's kind."""
    try:
        (found,) = csv.reader([words.decode()])
        pairs = zip(columns, found, strict=True)
        return {d.name: KINDS[d.dtype](word) for d, word in pairs}
    except (ValueError, csv.Error):
        return None

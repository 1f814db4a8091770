"""ledger.csv: mass, momentum and energy of every phase at every frame, in a form that opens in
anything."""

import csv
import os
from collections.abc import Iterable
from pathlib import Path

from vgmpi.domain.ranks import Alone
from vgmpi.output import layout, store

COLUMNS = [d.name for d in layout.LEDGER_COLUMNS]


class Ledger:
    """Appends to ledger.csv; `last_step` None starts anew, else rows after that step are dropped
    first.

    Collective: all ranks call, rank 0 writes. Raises StoreError on all ranks alike.
    """

    def __init__(self, folder: str | Path, ranks: Alone, last_step: int | None = None):
        self.path, self.ranks = Path(folder) / layout.LEDGER, ranks
        self._do(lambda: self._start(last_step))

    def _do(self, action):
        error = None
        if self.ranks.rank == 0:
            try:
                action()
            except OSError as caught:
                error = caught
        store.agree(self.ranks, error, self.path)

    def _start(self, last_step):
        self.path.parent.mkdir(parents=True, exist_ok=True)
        kept = []
        if last_step is not None and self.path.exists():
            kept = [r for r in read(self.path) if r["step"] <= last_step]
        lines = [",".join(COLUMNS), *map(_line, kept)]
        store.replace_text(self.path, "\n".join(lines) + "\n")

    def append(self, rows: Iterable[dict]) -> None:
        """One dict per phase with all columns; those of rank 0 count."""
        text = "".join(_line(row) + "\n" for row in rows)

        def write():
            size = self.path.stat().st_size
            try:
                with open(self.path, "a", encoding="utf-8") as f:
                    f.write(text)
                    f.flush()
                    os.fsync(f.fileno())
            except OSError:
                os.truncate(self.path, size)  # no half lines
                raise

        self._do(write)


def _line(row):
    return ",".join(_word(row[name]) for name in COLUMNS)


def _word(value):
    if isinstance(value, str):
        return '"' + value.replace('"', '""') + '"' if set(value) & set(',"\n') else value
    return repr(value.item() if hasattr(value, "item") else value)


def read(path: str | Path) -> list[dict]:
    """Rows of a ledger; a last line that was cut off is left out."""
    kinds = {d.name: {"f8": float, "i8": int, "text": str}[d.dtype] for d in layout.LEDGER_COLUMNS}
    rows = []
    with open(path, encoding="utf-8", newline="") as f:
        for row in csv.DictReader(f):
            if None in row.values() or None in row:
                continue
            rows.append({name: kinds[name](row[name]) for name in COLUMNS})
    return rows

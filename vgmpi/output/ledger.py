"""Tables that grow while a run goes on, in a form that opens in anything: ledger.csv and
probe_NAME.csv."""

import csv
import os
from collections.abc import Iterable
from pathlib import Path

from vgmpi.domain.ranks import Alone
from vgmpi.output import layout, store

COLUMNS = [d.name for d in layout.LEDGER_COLUMNS]


class Rows:
    """Appends to a CSV file of these columns; `last_step` None starts anew, else rows after that
    step are dropped first. kept: the rows that were not, on rank 0.

    Collective: all ranks call, rank 0 writes. Raises StoreError on all ranks alike.
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
        if last_step is not None and self.path.exists():
            self.kept = [r for r in read(self.path, self.columns) if r["step"] <= last_step]
        lines = [",".join(d.name for d in self.columns), *map(self._line, self.kept)]
        store.replace_text(self.path, "\n".join(lines) + "\n")

    def append(self, rows: Iterable[dict]) -> None:
        """Dicts with all columns; those of rank 0 count."""
        text = "".join(self._line(row) + "\n" for row in rows)

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

    def _line(self, row):
        return ",".join(_word(row[d.name]) for d in self.columns)


class Ledger(Rows):
    """ledger.csv: mass, momentum and energy of every phase at every frame, a row per phase."""

    def __init__(self, folder: str | Path, ranks: Alone, last_step: int | None = None):
        super().__init__(Path(folder) / layout.LEDGER, layout.LEDGER_COLUMNS, ranks, last_step)


def _word(value):
    if isinstance(value, str):
        return '"' + value.replace('"', '""') + '"' if set(value) & set(',"\n') else value
    return repr(value.item() if hasattr(value, "item") else value)


def read(path: str | Path, columns: list[layout.Dataset] = layout.LEDGER_COLUMNS) -> list[dict]:
    """Rows of a file of these columns; a last line that was cut off is left out."""
    kinds = {d.name: {"f8": float, "i8": int, "text": str}[d.dtype] for d in columns}
    rows = []
    with open(path, encoding="utf-8", newline="") as f:
        for row in csv.DictReader(f):
            if None in row.values() or row.keys() != kinds.keys():
                continue
            rows.append({name: kind(row[name]) for name, kind in kinds.items()})
    return rows

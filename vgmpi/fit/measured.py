"""A table as the target: a probe's of another run, or what was measured or published."""

import csv
import math
from pathlib import Path

import numpy as np

from .. import inputs
from ..misspelt import nearest
from ..output import layout, ledger
from ..output.read import RunError
from ..solver.probes import files
from ..study.errors import AXIS
from .settings import FitFile, FitFileError
from .target import Target, held_out


class Measured(Target):
    """Columns of a table, and of one of the scene's probes."""

    def __init__(self, file: FitFile):
        super().__init__()
        self.file, asked = file, file.settings.target
        self.said = "rms of the difference over the range of what was measured"
        self.path = file.folder / str(asked.table)
        tables = {p.stem.removeprefix("probe_"): p for p in files(file.scene, Path())}
        if asked.probe not in tables:
            said = f"there is no probe '{asked.probe}'{nearest(asked.probe, tables)}"
            raise file.wrong(
                ("target", "probe"), f"{said}; the scene has {', '.join(tables) or 'none'}"
            )
        self.name = tables[str(asked.probe)].name
        self.columns = files(file.scene, Path())[tables[str(asked.probe)]]
        head, rows = self._rows()
        self.pairs = self._pairs(head)
        times = self._numbers(rows, asked.time) * asked.time_unit + asked.time_zero
        held = held_out(np.argsort(np.argsort(times, kind="stable")), asked.hold_out)
        table = {p: self._numbers(rows, t) * asked.value_unit for p, t in self.pairs.items()}
        self._check_times(times, table)
        self.times = times
        self.spans = _spans(table)
        self.known = {p: np.isfinite(v) for p, v in table.items()}
        parts = [(v / self.spans[p])[self.known[p]] for p, v in table.items()]
        self.values = [np.concatenate(parts)]
        self.held = [np.concatenate([held[self.known[p]] for p in table])]

    def _check_times(self, times: np.ndarray, table: dict[str, np.ndarray]) -> None:
        end, where = self.file.scene.time.end, ("target", "table")
        if not len(times) or not all(np.isfinite(v).any() for v in table.values()):
            raise self.file.wrong(where, "has no row to fit to")
        if not np.isfinite(times).all() or times.min() < 0 or times.max() > end * (1 + 1e-9):
            said = f"has times from {times.min():g} to {times.max():g} s"
            raise self.file.wrong(where, f"{said}; the scene runs from 0 to {end:g} s")

    def _rows(self) -> tuple[list[str], list[tuple[int, dict[str, str]]]]:
        """The header, and rows with their lines, of those that are asked for."""
        asked = self.file.settings.target
        try:
            text = inputs.content(self.path, inputs.MOST_TEXT).decode()
        except (OSError, UnicodeDecodeError) as error:
            said = getattr(error, "strerror", None) or "not UTF-8 text"
            raise self.file.wrong(("target", "table"), f"{said}; got '{asked.table}'") from None
        lines = [(k, line) for k, line in enumerate(text.splitlines(), 1)]
        lines = [(k, line) for k, line in lines if line.strip() and not line.startswith("#")]
        cells = [(k, next(csv.reader([line]))) for k, line in lines]
        head = [word.strip() for word in cells[0][1]] if cells else []
        if head[-1:] == [layout.ROW_SUM.name]:
            self._verify()
        for column in (asked.time, *asked.where):
            if column not in head:
                key = ("target", "time") if column == asked.time else ("target", "where", column)
                raise self.file.wrong(key, self._no_column(column, head))
        rows = []
        for line, words in cells[1:]:
            if len(words) != len(head):
                said = f"{len(words)} columns, the header has {len(head)}"
                raise FitFileError([f"{self.path}:{line}: {said}"])
            row = dict(zip(head, (word.strip() for word in words)))
            if all(row[column] == word for column, word in asked.where.items()):
                rows.append((line, row))
        return head, rows

    def _verify(self) -> None:
        """A run's own table has checksums. Raises FitFileError."""
        try:
            ledger.read(self.path, self.columns)
        except RunError as error:
            raise self.file.wrong(("target", "table"), str(error)) from None

    def _no_column(self, column: str, head: list[str]) -> str:
        return f"{self.path.name} has no column '{column}'; it has {', '.join(head)}"

    def _pairs(self, head: list[str]) -> dict[str, str]:
        """Table's column by probe's column."""
        asked = self.file.settings.target.columns
        own = [c.name for c in self.columns if c.name not in ("time", "step")]
        if asked is None:
            pairs = {name: name for name in own if name in head}
            if not pairs:
                said = f"no column of {self.path.name} is one of the probe's, {', '.join(own)}"
                raise self.file.wrong(("target", "table"), f"{said}: give columns")
            return pairs
        pairs = dict(asked) if isinstance(asked, dict) else {name: name for name in asked}
        if not pairs:
            raise self.file.wrong(("target", "columns"), "must name one column or more")
        for k, (name, column) in enumerate(pairs.items()):
            key = name if isinstance(asked, dict) else k
            if name not in own:
                said = f"the probe has no column '{name}'{nearest(name, own)}"
                raise self.file.wrong(
                    ("target", "columns", key), f"{said}; it has {', '.join(own)}"
                )
            if column not in head:
                raise self.file.wrong(("target", "columns", key), self._no_column(column, head))
        return pairs

    def _numbers(self, rows: list[tuple[int, dict[str, str]]], column: str) -> np.ndarray:
        found = []
        for line, row in rows:
            try:
                found.append(float(row[column]) if row[column] else math.nan)
            except ValueError:
                said = f"{column}: '{row[column][:40]}' is no number"
                raise FitFileError([f"{self.path}:{line}: {said}"]) from None
        return np.array(found)

    def of(self, folder: Path, stage: int) -> np.ndarray:
        rows = ledger.read(folder / self.name, self.columns)
        times = np.array([row["time"] for row in rows])
        parts = []
        for name, known in self.known.items():
            values = np.array([row[name] for row in rows])
            there = np.isfinite(values)
            if not there.any():
                raise RunError(f"{folder / self.name}: {name} is no number in any row")
            at = np.interp(self.times[known], times[there], values[there])
            parts.append(at / self.spans[name])
        return np.concatenate(parts)


def _spans(table: dict[str, np.ndarray]) -> dict[str, float]:
    """The range of each column; a vector's components have that of the one that changes most."""
    spans = {p: float(np.nanmax(v) - np.nanmin(v)) for p, v in table.items()}
    found = {}
    for p in table:
        beside = max(spans[q] for q in table if AXIS.sub("", q) == AXIS.sub("", p))
        found[p] = beside or float(np.nanmax(np.abs(table[p]))) or 1.0
    return found

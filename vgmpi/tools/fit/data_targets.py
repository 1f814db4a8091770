"""Targets made of data: a table (measured, published, of a probe), or frames of another run."""

import csv
import math
from pathlib import Path

import numpy as np

from vgmpi.io import csv_log, file_layout
from vgmpi.io.run_reader import RunError
from vgmpi.runtime import user_files
from vgmpi.runtime.message_text import did_you_mean
from vgmpi.solver.diagnostics.probe_sampling import files
from vgmpi.tools.tradeoff.error_measures import AXIS, RunOutcome

from .fit_config import FitFile, FitFileError
from .target_base import MAX_DISPLAY_SIZE, Pictures, Target, held_out, nearest_frames

TIME_TOLERANCE = 1e-6  # [frame intervals]


class RunTarget(Target):
    """Share of each body's mass in the bins of a lattice, in frames of another run."""

    def __init__(self, file: FitFile):
        super().__init__()
        settings, self.scene = file.settings.target, file.scene
        self.loss_description = (
            "rms of what of a body is in another bin, over the rms of what is in them"
        )
        folder = file.folder / str(settings.run)
        body_names = {o.name for o in self.scene.object if o.role == "body"}
        wanted = settings.bodies or tuple(sorted(body_names))
        for k, name in enumerate(wanted):
            if name not in body_names:
                message = f"there is no body '{name}'{did_you_mean(name, body_names)}"
                raise file.wrong(
                    ("target", "bodies", k), f"{message}; known: {', '.join(body_names)}"
                )
        try:
            other = RunOutcome(folder)
            names = [o["name"] for o in other.run.objects]
            missing = [name for name in wanted if name not in names]
            if missing:
                raise RunError(f"has no body '{missing[0]}'; it has {', '.join(names)}")
            if not np.allclose(other.size, self.scene.domain.size, rtol=1e-9):
                size = " x ".join(f"{x:g}" for x in other.size)
                raise RunError(f"is of another domain, {size} m")
            self.wanted, self.times = wanted, other.times
            raw = [
                self._shares(other, bins, range(len(other.times))) for bins in settings.density_bins
            ]
        except RunError as error:
            raise file.wrong(("target", "run"), f"{error}; got '{settings.run}'") from None
        self.bins, self.correlated_counts = settings.density_bins, [1.0] * len(raw)
        self.unit = [float(np.sqrt(np.mean(shares**2))) for shares in raw]
        self.values = [shares.ravel() / unit for shares, unit in zip(raw, self.unit)]
        holdout = held_out(np.arange(len(self.times)), settings.holdout_every)
        self.holdout_mask = [np.repeat(holdout, shares[0].size) for shares in raw]
        self._check_times(file)
        self.other = folder
        if settings.render is not None:
            self.pictures = Pictures(file.folder / settings.render, MAX_DISPLAY_SIZE)

    def _check_times(self, file: FitFile) -> None:
        """Pair frames by their times. Raises FitFileError if one has no counterpart."""
        time = file.scene.time
        nearest, distance = nearest_frames(time, self.times, range(time.frames))
        is_unmatched = distance > TIME_TOLERANCE
        if is_unmatched.any():
            message = (
                f"has a frame at {self.times[is_unmatched][0]:g} s, of which the scene has none"
            )
            raise file.wrong(("target", "run"), f"{message}: its time.end and time.frames say when")
        self.frames = [int(k) for k in nearest]

    def images(self) -> np.ndarray:
        """Return images of the other run."""
        assert self.pictures is not None
        return self.pictures.render_run(self.other, list(range(len(self.times))))

    def _shares(self, outcome: RunOutcome, bins: int, frames) -> np.ndarray:
        """Return the share of each body's mass in bins, (frames, bodies, bins)."""
        names = [o["name"] for o in outcome.run.objects]
        rows = [names.index(name) for name in self.wanted]
        total = outcome.body_masses[rows]
        return np.stack(
            [outcome.mass_in_boxes(int(k), bins)[rows] / total[:, None] for k in frames]
        )

    def observe(self, folder: Path, stage: int) -> np.ndarray:
        """Return the scaled shares of a run in the bins of a stage, shape (n,)."""
        shares = self._shares(RunOutcome(folder), self.bins[stage], self.frames)
        return shares.ravel() / self.unit[stage]


class TableTarget(Target):
    """Columns of a table, compared with those of a probe of the scene."""

    def __init__(self, file: FitFile):
        super().__init__()
        self.file, settings = file, file.settings.target
        self.loss_description = "rms of the difference over the range of what was measured"
        self.path = file.folder / str(settings.table)
        tables = {p.stem.removeprefix("probe_"): p for p in files(file.scene, Path())}
        if settings.probe not in tables:
            message = f"there is no probe '{settings.probe}'{did_you_mean(settings.probe, tables)}"
            raise file.wrong(
                ("target", "probe"), f"{message}; the scene has {', '.join(tables) or 'none'}"
            )
        self.name = tables[str(settings.probe)].name
        self.columns = files(file.scene, Path())[tables[str(settings.probe)]]
        head, rows = self._rows()
        self.pairs = self._pairs(head)
        times = self._numbers(rows, settings.time) * settings.time_scale + settings.time_offset
        is_held_out = held_out(np.argsort(np.argsort(times, kind="stable")), settings.holdout_every)
        table = {p: self._numbers(rows, t) * settings.value_scale for p, t in self.pairs.items()}
        self._check_times(times, table)
        self.times = times
        self.spans = _spans(table)
        self.valid = {p: np.isfinite(v) for p, v in table.items()}
        parts = [(v / self.spans[p])[self.valid[p]] for p, v in table.items()]
        self.values = [np.concatenate(parts)]
        self.holdout_mask = [np.concatenate([is_held_out[self.valid[p]] for p in table])]

    def _check_times(self, times: np.ndarray, table: dict[str, np.ndarray]) -> None:
        """Refuse a table without rows or with times outside the run."""
        end, where = self.file.scene.time.end, ("target", "table")
        if not len(times) or not all(np.isfinite(v).any() for v in table.values()):
            raise self.file.wrong(where, "has no row to fit to")
        if not np.isfinite(times).all() or times.min() < 0 or times.max() > end * (1 + 1e-9):
            message = f"has times from {times.min():g} to {times.max():g} s"
            raise self.file.wrong(where, f"{message}; the scene runs from 0 to {end:g} s")

    def _rows(self) -> tuple[list[str], list[tuple[int, dict[str, str]]]]:
        """Return the header and the selected rows with their line numbers."""
        settings = self.file.settings.target
        try:
            text = user_files.read_regular_file(self.path, user_files.MAX_TEXT_BYTES).decode()
        except (OSError, UnicodeDecodeError) as error:
            message = getattr(error, "strerror", None) or "not UTF-8 text"
            raise self.file.wrong(
                ("target", "table"), f"{message}; got '{settings.table}'"
            ) from None
        lines = [(k, line) for k, line in enumerate(text.splitlines(), 1)]
        lines = [(k, line) for k, line in lines if line.strip() and not line.startswith("#")]
        cells = [(k, next(csv.reader([line]))) for k, line in lines]
        head = [word.strip() for word in cells[0][1]] if cells else []
        if head[-1:] == [file_layout.ROW_CHECKSUM.name]:
            self._verify()
        for column in (settings.time, *settings.filter):
            if column not in head:
                key = (
                    ("target", "time") if column == settings.time else ("target", "filter", column)
                )
                raise self.file.wrong(key, self._no_column(column, head))
        rows = []
        for line, words in cells[1:]:
            if len(words) != len(head):
                message = f"{len(words)} columns, the header has {len(head)}"
                raise FitFileError([f"{self.path}:{line}: {message}"])
            row = dict(zip(head, (word.strip() for word in words)))
            if all(row[column] == word for column, word in settings.filter.items()):
                rows.append((line, row))
        return head, rows

    def _verify(self) -> None:
        """Verify the checksums of a table written by a run. Raises FitFileError."""
        try:
            csv_log.read_rows(self.path, self.columns)
        except RunError as error:
            raise self.file.wrong(("target", "table"), str(error)) from None

    def _no_column(self, column: str, head: list[str]) -> str:
        """Return the message about a missing column."""
        return f"{self.path.name} has no column '{column}'; it has {', '.join(head)}"

    def _pairs(self, head: list[str]) -> dict[str, str]:
        """Return the table's column for each compared column of the probe."""
        columns = self.file.settings.target.columns
        own = [c.name for c in self.columns if c.name not in ("time", "step")]
        if columns is None:
            pairs = {name: name for name in own if name in head}
            if not pairs:
                message = f"no column of {self.path.name} is one of the probe's, {', '.join(own)}"
                raise self.file.wrong(("target", "table"), f"{message}: give columns")
            return pairs
        pairs = dict(columns) if isinstance(columns, dict) else {name: name for name in columns}
        if not pairs:
            raise self.file.wrong(("target", "columns"), "must name one column or more")
        for k, (name, column) in enumerate(pairs.items()):
            key = name if isinstance(columns, dict) else k
            if name not in own:
                message = f"the probe has no column '{name}'{did_you_mean(name, own)}"
                raise self.file.wrong(
                    ("target", "columns", key), f"{message}; it has {', '.join(own)}"
                )
            if column not in head:
                raise self.file.wrong(("target", "columns", key), self._no_column(column, head))
        return pairs

    def _numbers(self, rows: list[tuple[int, dict[str, str]]], column: str) -> np.ndarray:
        """Return a column as numbers, nan for empty cells. Raises FitFileError."""
        numbers = []
        for line, row in rows:
            try:
                numbers.append(float(row[column]) if row[column] else math.nan)
            except ValueError:
                message = f"{column}: '{row[column][:40]}' is no number"
                raise FitFileError([f"{self.path}:{line}: {message}"]) from None
        return np.array(numbers)

    def observe(self, folder: Path, stage: int) -> np.ndarray:
        """Return the scaled probe values of a run at the times of the table, shape (n,)."""
        rows = csv_log.read_rows(folder / self.name, self.columns)
        times = np.array([row["time"] for row in rows])
        parts = []
        for name, is_valid in self.valid.items():
            values = np.array([row[name] for row in rows])
            is_finite = np.isfinite(values)
            if not is_finite.any():
                raise RunError(f"{folder / self.name}: {name} is no number in any row")
            interpolated = np.interp(self.times[is_valid], times[is_finite], values[is_finite])
            parts.append(interpolated / self.spans[name])
        return np.concatenate(parts)


def _spans(table: dict[str, np.ndarray]) -> dict[str, float]:
    """Return the scale of each column, which is its range.

    Components of a vector share the range of the one that changes most.
    """
    spans = {p: float(np.nanmax(v) - np.nanmin(v)) for p, v in table.items()}
    scales = {}
    for p in table:
        span = max(spans[q] for q in table if AXIS.sub("", q) == AXIS.sub("", p))
        scales[p] = span or float(np.nanmax(np.abs(table[p]))) or 1.0
    return scales

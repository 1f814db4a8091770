"""Tables of a run as plots: the conservation log and the probes."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from vgmpi.io import csv_log, file_layout
from vgmpi.runtime import user_files

MAX_POINTS = 1000  # of a curve; more are thinned out
MAX_CURVES = 6
ENERGIES = ("kinetic_energy", "elastic_energy", "potential_energy")
# quantities of ledger.csv: their columns, whose values are added over the phases
LEDGER_PLOTS = {
    "mass": ("mass",),
    "momentum": ("momentum_x", "momentum_y", "momentum_z"),
    "angular momentum": ("angular_momentum_x", "angular_momentum_y", "angular_momentum_z"),
    "energy": ENERGIES,
}
FULLEST_CELL = "fullest_cell"  # the largest value of the phases is shown


class Plot(NamedTuple):
    """Curves over the simulated time."""

    title: str
    time: np.ndarray  # (n,) [s]
    curves: dict[str, np.ndarray]  # (n,) each, by their labels


def list_plots(folder: Path) -> list[str]:
    """Return the names of the plots that the tables of a run hold now."""
    names = []
    if (head := _header(folder / file_layout.LEDGER)) is not None:
        names += [name for name, columns in LEDGER_PLOTS.items() if set(columns) <= set(head)]
        names += ["fullest cell"] if FULLEST_CELL in head else []
    for path in sorted(folder.glob(file_layout.PROBE_NAME.format("*"))):
        head = _header(path) or []
        quantities = dict.fromkeys(_quantity(column) for column in head)
        names += [f"{_probe_name(path)}: {q}" for q in quantities if q not in _UNPLOTTED]
    return names


_UNPLOTTED = ("time", "step", file_layout.CRC)  # columns that are no quantity


def plot_file(folder: Path, name: str) -> Path:
    """Return the file of a plot with a name of `list_plots`."""
    probe, separator, _ = name.rpartition(": ")
    is_probe = bool(separator)
    return folder / (file_layout.PROBE_NAME.format(probe) if is_probe else file_layout.LEDGER)


def read_plot(folder: Path, name: str) -> Plot:
    """Return a plot.

    Args:
        folder: Folder of the run.
        name: A name of `list_plots`.

    Raises:
        RunError: The table is damaged or absent.
    """
    path = plot_file(folder, name)
    if path.name == file_layout.LEDGER:
        return _ledger_plot(csv_log.read_rows(path), name)
    rows, quantity = csv_log.read_probe(path), name.rpartition(": ")[2]
    columns = [c for c in (rows[0] if rows else ()) if _quantity(c) == quantity][:MAX_CURVES]
    units = {d.name: d.unit for table in file_layout.PROBE_COLUMNS.values() for d in table}
    unit = units.get(columns[0], "1") if columns else "1"
    title = name if unit in ("", "1") else f"{name} [{unit}]"
    time = np.array([row["time"] for row in rows], dtype=np.float64)
    curves = {c: np.array([row[c] for row in rows], dtype=np.float64) for c in columns}
    return _thinned(Plot(title, time, curves))


def _ledger_plot(rows: list[dict], name: str) -> Plot:
    """Return a plot of the conservation log, over all phases."""
    times, index = np.unique([row["time"] for row in rows], return_inverse=True)
    units = {d.name: d.unit for d in file_layout.LEDGER_COLUMNS}
    if name == "fullest cell":
        values = np.full(len(times), np.nan)
        for k, row in zip(index, rows):
            values[k] = np.fmax(values[k], row[FULLEST_CELL])  # nan for phases without one
        return _thinned(Plot("fullest cell", times, {"fullest cell": values}))
    curves = {}
    for column in LEDGER_PLOTS[name]:
        values = np.zeros(len(times))
        rigid = f"rigid_{column}"
        for k, row in zip(index, rows):
            values[k] += row[column] + row.get(rigid, 0.0)
        curves[column.removesuffix("_energy")] = values
    if name == "energy":
        curves["total"] = np.sum(list(curves.values()), axis=0)
    return _thinned(Plot(f"{name} [{units[LEDGER_PLOTS[name][0]]}]", times, curves))


def _thinned(plot: Plot) -> Plot:
    """Return a plot of numbers with at most about MAX_POINTS points, the last of them included.

    Curves without numbers and times without a number in one of the others are left out: the charts
    of browsers have no place for them.
    """
    curves = {k: v for k, v in plot.curves.items() if np.isfinite(v).any()}
    is_complete = np.ones(len(plot.time), dtype=bool)
    for values in curves.values():
        is_complete &= np.isfinite(values)
    rows = np.flatnonzero(is_complete)
    rows = rows[::-1][:: max(len(rows) // MAX_POINTS, 1)][::-1]
    return Plot(plot.title, plot.time[rows], {k: v[rows] for k, v in curves.items()})


def _header(path: Path) -> list[str] | None:
    """Return the columns of a table, None if it cannot be read."""
    try:
        text = user_files.read_regular_file(path, csv_log.MAX_BYTES, follow=False)
    except OSError:
        return None
    return text.split(b"\n", 1)[0].decode(errors="replace").split(",")


def _probe_name(path: Path) -> str:
    """Return the name of a probe from that of its file."""
    before, after = file_layout.PROBE_NAME.split("{}")
    return path.name[len(before) : len(path.name) - len(after)]


def _quantity(column: str) -> str:
    """Return the quantity of a column: force_x and force_y are components of force."""
    name, _, component = column.rpartition("_")
    return name if component in ("w", "x", "y", "z") and name else column

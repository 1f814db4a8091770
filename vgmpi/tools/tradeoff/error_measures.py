"""Difference of two runs of a scene: places of bodies, kinetic energy, probes."""

import functools
import re
from pathlib import Path

import numpy as np

from vgmpi.io import csv_log, file_layout
from vgmpi.io.run_reader import RunError, RunReader

AXIS = re.compile("_[xyz]$")  # suffix of a vector component in the name of a column
ROUNDING = 1e-6  # [-] smaller relative changes are rounding
BOXES = 16  # of the lattice that compares bodies, along the longest edge


class RunOutcome:
    """Results of a finished run in `folder`.

    They are the frame times (frames,) [s], the places of the bodies, their kinetic energy and the
    probes. probes: files of the probes with their columns (probe_sampling.files).
    """

    def __init__(self, folder: Path, probes: dict[Path, list[file_layout.Dataset]] | None = None):
        self.folder, self.run = folder, RunReader(folder)
        self.probes = {path.name: columns for path, columns in (probes or {}).items()}
        self.times = self.run.times
        self.size = np.array(self.run.scene["domain"]["size"], float)
        self._of = np.asarray(self.run.gaussians.object)
        density = [self._density(o) for o in self.run.objects]
        self._mass = np.asarray(self.run.gaussians.vol0, float) * np.array(density)[self._of]
        for part in (part for o in self.run.objects for part in o.get("regions", ())):
            rows = slice(part["first_row"], part["first_row"] + part["row_count"])
            material = self.run.scene["material"][part["material"]]
            self._mass[rows] = self.run.gaussians.vol0[rows] * float(material["density"])

    def _density(self, entry: dict) -> float:
        entities = [*self.run.scene["object"], *self.run.scene.get("inlet", [])]
        material = {str(o["name"]): o.get("material") for o in entities}[str(entry["name"])]
        return float(self.run.scene["material"][material]["density"]) if material else 0.0

    @functools.cache  # noqa: B019  every other run needs that of the finest one
    def mass_in_boxes(self, frame: int, along: int = BOXES) -> np.ndarray:
        """Return the mass [kg] of each body in each box of a lattice, shape (bodies, boxes).

        The distribution is linear in position, so that no mass jumps between boxes. along: boxes
        along the longest edge.
        """
        fields = self.run.frame(frame)
        edge = self.size.max() / along
        shape = np.ceil(self.size / edge).astype(int) + 2
        positions = np.asarray(fields["positions"], float) / edge + 0.5
        low = np.floor(positions).astype(int)
        fraction = positions - low
        owner, mass = self._of[fields["id"]], self._mass[fields["id"]]
        boxes = int(np.prod(shape))
        total = np.zeros((int(self._of.max()) + 1) * boxes)
        for corner in np.ndindex(2, 2, 2):
            weight = np.where(corner, fraction, 1 - fraction).prod(axis=1)
            box = np.ravel_multi_index(tuple((low + corner).clip(0, shape - 1).T), tuple(shape))
            total += np.bincount(owner * boxes + box, weight * mass, len(total))
        return total.reshape(-1, boxes)

    @functools.cached_property
    def body_masses(self) -> np.ndarray:
        """Return the mass [kg] of each body including later inflow, shape (bodies,)."""
        return np.bincount(self._of, self._mass)

    def probe(self, name: str) -> dict[str, np.ndarray]:
        """Return the columns of a probe's file without the steps.

        Raises:
            RunError: The file is unreadable.
        """
        columns = self.probes[name]
        rows = csv_log.read_rows(self.folder / name, columns)
        return {
            c.name: np.array([row[c.name] for row in rows]) for c in columns if c.name != "step"
        }

    def kinetic(self) -> tuple[np.ndarray, np.ndarray]:
        """Return times [s] and total kinetic energy [J] of all bodies from the ledger."""
        rows = csv_log.read_rows(self.folder / file_layout.LEDGER)
        times, index = np.unique([row["time"] for row in rows], return_inverse=True)
        return times, np.bincount(index.ravel(), weights=[row["kinetic_energy"] for row in rows])


def mass_displacement(run: RunOutcome, reference: RunOutcome) -> float:
    """Return the fraction of mass in another place than in the reference run.

    It is half the sum of absolute differences in boxes of 1 / BOXES of the longest edge, averaged
    over the common frames.
    """
    fractions = []
    for k in range(1, min(len(run.times), len(reference.times))):
        a, b = run.mass_in_boxes(k), reference.mass_in_boxes(k)
        fractions.append(0.5 * np.abs(a - b).sum() / max(b.sum(), 1e-300))
    return float(np.mean(fractions)) if fractions else 0.0


def _normalized_rms(times, values, other_times, others, span: float | None = None) -> float:
    """Return the RMS difference over the range of the reference, or over `span`.

    Values are interpolated to the times of the reference; entries that are not finite, as of probes
    without material, are skipped.

    Args:
        times: Times [s].
        values: Values at these times.
        other_times: Times of the reference [s].
        others: Values of the reference.
        span: Range to divide by, or None.
    """
    valid, other_valid = np.isfinite(values), np.isfinite(others)
    if not (valid.any() and other_valid.any()):
        return 0.0
    times, values = times[valid], values[valid]
    other_times, others = other_times[other_valid], others[other_valid]
    interpolated = np.interp(other_times, times, values)
    span = _span(others) if span is None else span
    return float(np.sqrt(np.mean((interpolated - others) ** 2))) / span if span > 0 else 0.0


def _span(values: np.ndarray) -> float:
    """Return the range of values, 0 if they only differ by rounding."""
    finite = values[np.isfinite(values)]
    span = float(np.ptp(finite)) if len(finite) else 0.0
    return span if span > ROUNDING * np.abs(finite).max(initial=0.0) else 0.0


def energy(run: RunOutcome, reference: RunOutcome) -> float:
    """Return the RMS difference of the kinetic energy over the range of the reference."""
    return _normalized_rms(*run.kinetic(), *reference.kinetic())


def probe(run: RunOutcome, reference: RunOutcome) -> float:
    """Return the largest RMS difference of all probes over the range of the reference."""
    differences = [0.0]
    for name in reference.probes:
        a, b = run.probe(name), reference.probe(name)
        for key in b:
            if key != "time":
                # a vector's components have the range of the one that changes most
                components = [b[k] for k in b if AXIS.sub("", k) == AXIS.sub("", key)]
                span = max(_span(component) for component in components)
                differences.append(_normalized_rms(a["time"], a[key], b["time"], b[key], span))
    return max(differences)


def curve(run: RunOutcome, column: str, times: np.ndarray, values: np.ndarray) -> float:
    """Return the RMS difference of a probe's column from a given curve.

    Args:
        run: The run.
        column: "probe_NAME.csv:COLUMN".
        times: Times of the curve [s].
        values: Values of the curve.

    Raises:
        RunError: The run has no such column.
    """
    name, _, key = column.partition(":")
    if name not in run.probes:
        valid = ", ".join(run.probes) or "none"
        raise RunError(f"--column {column}: no probe of the scene writes it; there are: {valid}")
    table = run.probe(name)
    if key not in table:
        valid = ", ".join(k for k in table if k != "time")
        raise RunError(f"{run.folder / name}: no column '{key}'; it has {valid}")
    return _normalized_rms(table["time"], table[key], times, values)

"""How far two runs of a scene are apart: where its bodies are, how they move, what probes tell."""

import functools
import re
from pathlib import Path

import numpy as np

from ..output import layout, ledger
from ..output.read import RunError, RunFiles

AXIS = re.compile("_[xyz]$")  # of a column
ROUNDING = 1e-6  # of values: what is no change
BOXES = 16  # of the lattice on which bodies are compared, along the longest edge


class Outcome:
    """What a finished run in `folder` says: times (frames,) [s], where each body is then, its
    kinetic energy, what its probes measured. probes: their files with the columns
    (solver.probes.files)."""

    def __init__(self, folder: Path, probes: dict[Path, list[layout.Dataset]] | None = None):
        self.folder, self.run = folder, RunFiles(folder)
        self.probes = {path.name: columns for path, columns in (probes or {}).items()}
        self.times = self.run.times
        self.size = np.array(self.run.scene["domain"]["size"], float)
        self._of = np.asarray(self.run.gaussians.object)
        density = [self._density(o) for o in self.run.objects]
        self._mass = np.asarray(self.run.gaussians.vol0, float) * np.array(density)[self._of]

    def _density(self, entry: dict) -> float:
        things = [*self.run.scene["object"], *self.run.scene.get("source", [])]
        made_of = {str(o["name"]): o.get("material") for o in things}[str(entry["name"])]
        return float(self.run.scene["material"][made_of]["density"]) if made_of else 0.0

    @functools.cache  # noqa: B019  that of the finest run is asked for by every other
    def spread(self, frame: int, along: int = BOXES) -> np.ndarray:
        """Mass [kg] of each body in each box of the lattice (bodies, boxes), linear in between, so
        that nothing jumps from one to the next. along: boxes along the longest edge."""
        fields = self.run.frame(frame)
        edge = self.size.max() / along
        shape = np.ceil(self.size / edge).astype(int) + 2
        at = np.asarray(fields["x"], float) / edge + 0.5
        low = np.floor(at).astype(int)
        share = at - low
        owner, mass = self._of[fields["id"]], self._mass[fields["id"]]
        boxes = int(np.prod(shape))
        total = np.zeros((int(self._of.max()) + 1) * boxes)
        for corner in np.ndindex(2, 2, 2):
            weight = np.where(corner, share, 1 - share).prod(axis=1)
            box = np.ravel_multi_index(tuple((low + corner).clip(0, shape - 1).T), tuple(shape))
            total += np.bincount(owner * boxes + box, weight * mass, len(total))
        return total.reshape(-1, boxes)

    @functools.cached_property
    def whole(self) -> np.ndarray:
        """Mass [kg] of each body with all that will come of it (bodies,)."""
        return np.bincount(self._of, self._mass)

    def probe(self, name: str) -> dict[str, np.ndarray]:
        """Columns of a probe's file, but the steps. Raises RunError."""
        columns = self.probes[name]
        rows = ledger.read(self.folder / name, columns)
        return {
            c.name: np.array([row[c.name] for row in rows]) for c in columns if c.name != "step"
        }

    def kinetic(self) -> tuple[np.ndarray, np.ndarray]:
        """Times [s] and kinetic energy [J] of all bodies together, from the ledger."""
        rows = ledger.read(self.folder / layout.LEDGER)
        times, at = np.unique([row["time"] for row in rows], return_inverse=True)
        return times, np.bincount(at.ravel(), weights=[row["kinetic"] for row in rows])


def elsewhere(one: Outcome, other: Outcome) -> float:
    """Share of the mass that is in another place than in the other run, mean over the frames that
    both have: half of the sum of differences in boxes of a sixteenth of the longest edge."""
    found = []
    for k in range(1, min(len(one.times), len(other.times))):
        a, b = one.spread(k), other.spread(k)
        found.append(0.5 * np.abs(a - b).sum() / max(b.sum(), 1e-300))
    return float(np.mean(found)) if found else 0.0


def _apart(times, values, other_times, others, span: float | None = None) -> float:
    """Root of the mean square of the difference over the range of the others, or `span`, at their
    times; what is no number, as what is measured where nothing is, is left out."""
    some, known = np.isfinite(values), np.isfinite(others)
    if not (some.any() and known.any()):
        return 0.0
    times, values = times[some], values[some]
    other_times, others = other_times[known], others[known]
    there = np.interp(other_times, times, values)
    span = _span(others) if span is None else span
    return float(np.sqrt(np.mean((there - others) ** 2))) / span if span > 0 else 0.0


def _span(values: np.ndarray) -> float:
    """The range of values; 0 where they are the same but for rounding."""
    known = values[np.isfinite(values)]
    span = float(np.ptp(known)) if len(known) else 0.0
    return span if span > ROUNDING * np.abs(known).max(initial=0.0) else 0.0


def energy(one: Outcome, other: Outcome) -> float:
    """How far the kinetic energy is off, root of the mean square over its range."""
    return _apart(*one.kinetic(), *other.kinetic())


def probe(one: Outcome, other: Outcome) -> float:
    """The same of what probes say: the worst of all."""
    found = [0.0]
    for name in other.probes:
        a, b = one.probe(name), other.probe(name)
        for key in b:
            if key != "time":
                # a vector's components have the range of the one that changes most
                beside = [b[k] for k in b if AXIS.sub("", k) == AXIS.sub("", key)]
                span = max(_span(one) for one in beside)
                found.append(_apart(a["time"], a[key], b["time"], b[key], span))
    return max(found)


def curve(one: Outcome, column: str, times: np.ndarray, values: np.ndarray) -> float:
    """How far a probe's column, "probe_NAME.csv:COLUMN", is off a curve given from elsewhere."""
    name, _, key = column.partition(":")
    if name not in one.probes:
        known = ", ".join(one.probes) or "none"
        raise RunError(f"--column {column}: no probe of the scene writes it; there are: {known}")
    table = one.probe(name)
    if key not in table:
        known = ", ".join(k for k in table if k != "time")
        raise RunError(f"{one.folder / name}: no column '{key}'; it has {known}")
    return _apart(table["time"], table[key], times, values)

"""How far two runs of a scene are apart: where its bodies are, how they move, what probes tell."""

import csv
from pathlib import Path

import numpy as np

from ..output.read import RunError, RunFiles

BOXES = 16  # of the lattice on which bodies are compared, along the longest edge


class Outcome:
    """What a finished run in `folder` says: times (frames,) [s], where each body is then, its
    kinetic energy, what its probes measured."""

    def __init__(self, folder: Path):
        self.folder, self.run = folder, RunFiles(folder)
        self.times = self.run.times
        self.size = np.array(self.run.scene["domain"]["size"], float)
        self._of = np.asarray(self.run.gaussians.object)
        density = [self._density(o) for o in self.run.objects]
        self._mass = np.asarray(self.run.gaussians.vol0, float) * np.array(density)[self._of]

    def _density(self, entry: dict) -> float:
        things = [*self.run.scene["object"], *self.run.scene.get("source", [])]
        made_of = {str(o["name"]): o.get("material") for o in things}[str(entry["name"])]
        return float(self.run.scene["material"][made_of]["density"]) if made_of else 0.0

    def spread(self, frame: int) -> np.ndarray:
        """Mass [kg] of each body in each box of the lattice (bodies, boxes), linear in between, so
        that nothing jumps from one to the next."""
        fields = self.run.frame(frame)
        edge = self.size.max() / BOXES
        shape = np.ceil(self.size / edge).astype(int) + 2
        at = np.asarray(fields["x"], float) / edge + 0.5
        low = np.floor(at).astype(int)
        share = at - low
        owner, mass = self._of[fields["id"]], self._mass[fields["id"]]
        total = np.zeros((int(self._of.max()) + 1, int(np.prod(shape))))
        for corner in np.ndindex(2, 2, 2):
            weight = np.where(corner, share, 1 - share).prod(axis=1)
            box = np.ravel_multi_index(tuple((low + corner).clip(0, shape - 1).T), tuple(shape))
            np.add.at(total, (owner, box), weight * mass)
        return total

    def table(self, name: str) -> dict[str, np.ndarray]:
        """Columns of a CSV file of the run that are numbers. Raises RunError."""
        try:
            with open(self.folder / name) as file:
                rows = list(csv.DictReader(file))
        except OSError as error:
            raise RunError(f"{self.folder / name}: {error.strerror}") from None
        found = {}
        for key in rows[0] if rows else ():
            try:
                found[key] = np.array([float(row[key]) for row in rows])
            except ValueError:
                continue
        return found

    def kinetic(self) -> tuple[np.ndarray, np.ndarray]:
        """Times [s] and kinetic energy [J] of all bodies together, from the ledger."""
        table = self.table("ledger.csv")
        times, at = np.unique(table["time"], return_inverse=True)
        return times, np.bincount(at.ravel(), weights=table["kinetic"])

    def probes(self) -> list[str]:
        """Names of the files that probes wrote."""
        return sorted(path.name for path in self.folder.glob("probe_*.csv"))


def elsewhere(one: Outcome, other: Outcome) -> float:
    """Share of the mass that is in another place than in the other run, mean over the frames that
    both have: half of the sum of differences in boxes of a sixteenth of the longest edge."""
    frames = [k for k in range(1, min(len(one.times), len(other.times)))]
    found = []
    for k in frames:
        a, b = one.spread(k), other.spread(k)
        found.append(0.5 * np.abs(a - b).sum() / max(b.sum(), 1e-300))
    return float(np.mean(found)) if found else 0.0


def _apart(times, values, other_times, others) -> float:
    """Root of the mean square of the difference over the range of the others, at their times."""
    there = np.interp(other_times, times, values)
    span = float(np.ptp(others))
    return float(np.sqrt(np.mean((there - others) ** 2))) / span if span > 0 else 0.0


def energy(one: Outcome, other: Outcome) -> float:
    """How far the kinetic energy is off, root of the mean square over its range."""
    return _apart(*one.kinetic(), *other.kinetic())


def probe(one: Outcome, other: Outcome) -> float:
    """The same of what probes say: the worst of all."""
    found = [0.0]
    for name in other.probes():
        a, b = one.table(name), other.table(name)
        for key in b:
            if key not in ("time", "step", "crc") and key in a:
                found.append(_apart(a["time"], a[key], b["time"], b[key]))
    return max(found)


def curve(one: Outcome, column: str, times: np.ndarray, values: np.ndarray) -> float:
    """How far a probe's column, "probe_NAME.csv:COLUMN", is off a curve given from elsewhere."""
    name, _, key = column.partition(":")
    table = one.table(name)
    if key not in table:
        known = ", ".join(k for k in table if k not in ("time", "step", "crc"))
        raise RunError(f"{one.folder / name}: no column '{key}'; it has {known}")
    return _apart(table["time"], table[key], times, values)

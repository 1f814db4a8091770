"""python -m tests.benchmarks.levels [CASE ...]: error and cost of the accuracy levels.

Runs the scenes of runs/accuracy at each level and compares them with theory or published results.
Writes vgmpi/planning/cost/accuracy_benchmarks.csv, which --plan quotes, and the table of
docs/how-to/choose-accuracy.md; rows of cases that are not named stay. Existing runs are kept
(runs/accuracy/out/levels). Tolerances are those of the validation (tests/physics). Time is
processor time from the second step on.
"""

import argparse
import csv
from collections.abc import Callable
from pathlib import Path

import numpy as np

from tests.physics.test_dam_break import FRONT_DEPTH, MPS, rms
from tests.physics.test_poiseuille import starting
from tests.support.oscillation import period
from vgmpi.planning.cost.plan_details import COLUMNS, PATH
from vgmpi.scene.accuracy_presets import LEVELS
from vgmpi.scene.loader import load
from vgmpi.tools.tradeoff.error_measures import RunOutcome
from vgmpi.tools.tradeoff.parameter_sweep import Setting
from vgmpi.tools.tradeoff.study_runs import Study

ROOT = Path(__file__).parents[2]
SCENES = ROOT / "runs" / "accuracy"
PAGE = ROOT / "docs" / "how-to" / "choose-accuracy.md"
BEGIN, END = "<!-- made by: python -m tests.benchmarks.levels -->", "<!-- end of what is made -->"


def last(found: RunOutcome, frame: int = -1) -> tuple[np.ndarray, np.ndarray]:
    """Places (n, 3) [m] and velocities (n, 3) [m/s], in the order of the particles' numbers."""
    fields = found.run.frame(len(found.run) + frame if frame < 0 else frame)
    order = np.argsort(fields["id"])
    return tuple(np.asarray(fields[key], float)[order] for key in ("positions", "velocity"))


def dam_break(found: RunOutcome) -> float:
    """Root of the mean square, over the widths of the column, of where the front is."""
    width, deep = 0.146, 0.146
    dx, unit = found.run.scene["domain"]["cell"], np.sqrt(width / (2 * 9.8))
    fronts, volume = [], np.asarray(found.run.gaussians.vol0)
    for k in range(len(found.run)):
        at = (2 * last(found, k)[0][:, 0] / dx).astype(int)
        dry = np.bincount(at, volume, 400) / (dx / 2 * deep) < FRONT_DEPTH * dx
        fronts.append(np.argmax(dry) * dx / 2 / width)
    times = found.times / unit
    return rms(MPS[MPS[:, 0] <= times[-1]], times, np.array(fronts))


def sand_column(found: RunOutcome) -> float:
    """Share of the run-out, to where sand lies deeper than 1/40 of the column."""
    length, wide = 0.16, 0.14
    dx = found.run.scene["domain"]["cell"]
    volume = np.bincount((last(found)[0][:, 0] / dx).astype(int), found.run.gaussians.vol0)
    depth = np.append(volume / (dx * wide), 0.0)
    end = int(np.argmax(depth < length / 40))
    high, low = depth[end - 1], depth[end]
    out = (end - 0.5 + (high - length / 40) / (high - low)) * dx / length - 1
    return abs(out / 1.2 - 1)


def bar(found: RunOutcome) -> float:
    """Share of the frequency."""
    table = found.probe("probe_mean.csv")
    return abs(period(table["time"], table["velocity_x"]) * 2.5 - 1)


def cantilever(found: RunOutcome) -> float:
    """Share of how far the tip sinks, mean of the last half period."""
    begin, _ = last(found, 0)
    tip = begin[:, 0] > 0.98
    sunk = [
        (begin[tip, 2] - last(found, k)[0][tip, 2]).mean()
        for k in range(len(found.run))
        if found.times[k] >= 9.29
    ]
    return abs(float(np.mean(sunk)) / 0.30172 - 1)


def hydrostatic(found: RunOutcome) -> float:
    """Largest error of the mean pressure over that at the floor."""
    off = []
    for name, z in (("low", 0.02), ("middle", 0.08), ("high", 0.14)):
        pressure = found.probe(f"probe_{name}.csv")["pressure"]
        off.append(abs(pressure[1:].mean() / 9.8e3 - (0.16 - z)) / 0.16)
    return max(off)


def vortices(found: RunOutcome) -> float:
    """Share of the rate by which the vortices die out."""
    k, left = np.pi / 0.1, []
    for frame in range(len(found.run)):
        x, v = last(found, frame)
        s, c = np.sin(k * x[:, ::2]), np.cos(k * x[:, ::2])
        shape = np.stack([s[:, 0] * c[:, 1], -c[:, 0] * s[:, 1]], 1)
        left.append((shape * v[:, ::2]).sum() / (shape**2).sum())
    rate = -np.polyfit(found.times, np.log(left), 1)[0]
    return abs(rate / (2e-3 * k**2) - 1)


def poiseuille(found: RunOutcome) -> float:
    """Share of the speed: the best factor on the profile half way up."""
    x, v = last(found)
    middle = np.abs(x[:, 2] - 0.05) < 0.01
    want = starting(np.abs(x[middle, 0] - 0.01) / 0.01, found.times[-1] / 0.1)
    top = 0.02 * 0.01**2 / 2e-3
    return abs(float((-v[middle, 2] / top * want).sum() / (want**2).sum()) - 1)


def bounce(found: RunOutcome) -> float:
    """Share of the speed that is lost."""
    return abs(last(found)[1][:, 2].mean() / 0.3 - 1)


# family of materials, what is told, and its tolerance in the validation
CASES: dict[Callable[[RunOutcome], float], tuple[str, str, float]] = {
    dam_break: ("fluid", "dam break: front, rms in widths", 0.05),
    hydrostatic: ("fluid", "water at rest: pressure", 0.01),
    vortices: ("fluid", "Taylor-Green vortices: rate", 0.03),
    poiseuille: ("fluid", "flow between plates: speed", 0.03),
    bar: ("solid", "bar: frequency", 1e-3),
    cantilever: ("solid", "cantilever: deflection", 0.02),
    bounce: ("solid", "ball and wall: speed after", 0.1),
    sand_column: ("sand", "column of sand: run-out", 0.1),
}


def measure(case: Callable[[RunOutcome], float], ranks: int) -> list[dict]:
    """Rows of accuracy_benchmarks.csv, one for each level."""
    scene = load(SCENES / f"{case.__name__}.toml")
    study = Study(scene, SCENES / "out" / "levels" / case.__name__, ranks)
    family, what, tolerance = CASES[case]
    rows = []
    for level in LEVELS:
        setting = Setting((("level", level),), (f"accuracy.level={level}",))
        cpu = study.run(setting)
        error = case(study.outcome(setting))
        values = (case.__name__, family, what, tolerance, level, f"{error:.2g}", f"{cpu:.3g}")
        rows.append(dict(zip(COLUMNS, map(str, values), strict=True)))
        print(*rows[-1].values(), sep="  ", flush=True)
    return rows


def table(rows: list[dict]) -> list[str]:
    """Lines of Markdown: a row of the table for each case."""
    out = [
        "| case | tolerance | draft | standard | high | time: draft | standard | high |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for name in dict.fromkeys(row["case"] for row in rows):
        mine = {row["level"]: row for row in rows if row["case"] == name}
        first = next(iter(mine.values()))
        off = [f"{100 * float(mine[level]['error']):.2g} %" for level in LEVELS]
        cpu = [f"{float(mine[level]['cpu']):.3g} s" for level in LEVELS]
        tolerance = f"{100 * float(first['tolerance']):g} %"
        out.append(f"| {' | '.join([first['what'], tolerance, *off, *cpu])} |")
    return out


def main() -> None:
    known = {case.__name__: case for case in CASES}
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    p.add_argument("cases", nargs="*", metavar="CASE", help=", ".join(known))
    p.add_argument("--ranks", type=int, default=1, help="of each run")
    given = p.parse_args()
    for name in set(given.cases) - set(known):
        p.error(f"there is no {name}; allowed: {', '.join(known)}")
    measured = {name: measure(known[name], given.ranks) for name in given.cases or known}
    with open(PATH, newline="") as file:
        before = list(csv.DictReader(file))
    rows = []
    for name in known:
        rows += measured.get(name) or [row for row in before if row["case"] == name]
    with open(PATH, "w", newline="") as file:
        written = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        written.writeheader()
        written.writerows(rows)
    head, _, rest = PAGE.read_text().partition(BEGIN)
    after = rest.partition(END)[2]
    PAGE.write_text("\n".join([head + BEGIN, "", *table(rows), "", END + after]))


if __name__ == "__main__":
    main()

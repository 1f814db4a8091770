"""Scenes in which one number shows, for fits that have to find it again from an honest reference:
a run in cells half as large, of another seed, in the other precision, with noise on what it tells.

python -m tests.recovery [NAME ...] [--repeats 10] prints what each fit finds.
"""

import argparse
import csv
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.fitted import made
from vgmpi import api
from vgmpi.fit.find import find, interval
from vgmpi.fit.runs import Runs
from vgmpi.fit.settings import FitFile
from vgmpi.fit.targets import target_of
from vgmpi.fit.trials import Trials

NOISE = 0.05  # of a column's range

ROOM = """
[domain]
size = {size}
cell = {cell}
boundary = {walls}
gravity = {gravity}
[time]
end = {end}
frames = 2
[accuracy]
precision = "single"
"""
DOWN = [0, 0, -9.81]


@dataclass(frozen=True)
class Case:
    """A scene, what is looked for in it, its true value, range and start, and the probe's columns
    that show it."""

    scene: str
    key: str
    true: float
    range: tuple[float, float]
    start: float
    probe: str
    columns: tuple[str, ...]


def room(size, cell, end, walls='"slip"', gravity=DOWN):
    return ROOM.format(size=size, cell=cell, end=end, walls=walls, gravity=gravity)


# a column that stands fast is pulled for a moment and swings along its axis
STIFFNESS = Case(
    room([0.08, 0.08, 0.28], 0.01, 0.12, '{ default = "slip", floor = "stick" }', [0, 0, 0])
    + """
[material.rubber]
kind = "elastic"
youngs_modulus = 2e4
[[object]]
name = "column"
material = "rubber"
shape = { box = [[0.02, 0.02, 0], [0.06, 0.06, 0.2]] }
[[load]]
object = "column"
acceleration = [0, 0, 2]
[[probe]]
name = "it"
object = "column"
rate = 500
""",
    "material.rubber.youngs_modulus", 2e4, (2e3, 4e5), 2e5, "it", ("center_z",),
)  # fmt: skip

# vortices in a box die out (Taylor and Green 1937)
VISCOSITY = Case(
    room([0.1, 0.05, 0.1], 0.00625, 0.25, gravity=[0, 0, 0])
    + """
[material.oil]
kind = "fluid"
density = 1000
bulk_modulus = 200
viscosity = 1
[[object]]
name = "oil"
material = "oil"
shape = { box = [[0, 0, 0], [0.1, 0.05, 0.1]] }
mode = [
    { amplitude = [0.005, 0, -0.005], wave = [31.41592653589793, 0, 31.41592653589793] },
    { amplitude = [0.005, 0, 0.005], wave = [31.41592653589793, 0, -31.41592653589793] },
]
[[probe]]
name = "it"
velocity = [0.05, 0.025, 0.0875]
rate = 100
""",
    "material.oil.viscosity", 1.0, (0.1, 10.0), 8.0, "it", ("velocity_x",),
)  # fmt: skip

# a block that slides until it stops
FRICTION = Case(
    room([0.4, 0.16, 0.12], 0.01, 0.3,
         '{ default = "slip", floor = { kind = "separate", friction = 0.3 } }')
    + """
[material.clay]
kind = "elastic"
youngs_modulus = 2e5
[[object]]
name = "block"
material = "clay"
shape = { box = [[0.03, 0.04, 0], [0.11, 0.12, 0.04]] }
velocity = [0.8, 0, 0]
[[probe]]
name = "it"
object = "block"
rate = 200
""",
    "domain.boundary.floor.friction", 0.3, (0.02, 1.5), 0.05, "it", ("center_x", "velocity_x"),
)  # fmt: skip

# a block that is thrown down and does not get up again
YIELD = Case(
    room([0.2, 0.2, 0.16], 0.01, 0.05, gravity=[0, 0, 0])
    + """
[material.putty]
kind = "plasticine"
density = 1500
youngs_modulus = 5e5
yield_stress = 8e3
[[object]]
name = "block"
material = "putty"
shape = { box = [[0.06, 0.06, 0.01], [0.14, 0.14, 0.13]] }
velocity = [0, 0, -3]
[[probe]]
name = "it"
object = "block"
rate = 1000
""",
    "material.putty.yield_stress", 8e3, (5e2, 1e5), 6e4, "it", ("center_z", "velocity_z"),
)  # fmt: skip

# a column of sand that runs out between walls
ANGLE = Case(
    room([0.48, 0.08, 0.16], 0.01, 0.5, '{ default = "slip", floor = "stick" }')
    + """
[material.grains]
kind = "sand"
youngs_modulus = 1e6
friction_angle = "32 deg"
[[object]]
name = "column"
material = "grains"
shape = { box = [[0, 0, 0], [0.1, 0.08, 0.14]] }
[[probe]]
name = "it"
object = "column"
rate = 100
""",
    "material.grains.friction_angle", 0.5585, (0.06, 1.1), 0.08, "it", ("center_x", "center_z"),
)  # fmt: skip

# a block that comes to float
DENSITY = Case(
    room([0.16, 0.16, 0.2], 0.01, 0.5)
    + """
[material.water]
kind = "fluid"
bulk_modulus = 5e4
[material.wood]
kind = "elastic"
density = 500
youngs_modulus = 1e5
[[object]]
name = "pool"
material = "water"
shape = { box = [[0, 0, 0], [0.16, 0.16, 0.08]] }
[[object]]
name = "block"
material = "wood"
shape = { box = [[0.05, 0.05, 0.085], [0.11, 0.11, 0.145]] }
[[probe]]
name = "it"
object = "block"
rate = 100
""",
    "material.wood.density", 500.0, (60.0, 950.0), 90.0, "it", ("center_z",),
)  # fmt: skip

# sand full of water is pressed, and the water seeps out of it (Terzaghi)
PERMEABILITY = Case(
    room([0.08, 0.08, 0.48], 0.02, 0.3, gravity=[0, 0, 0])
    + """
[material.water]
kind = "fluid"
bulk_modulus = 1e6
[material.grains]
kind = "sand"
density = 2650
porosity = 0.4
youngs_modulus = 1.5e5
[[object]]
name = "pores"
material = "water"
shape = { box = [[0, 0, 0], [0.08, 0.08, 0.4]] }
fraction = 0.4
[[object]]
name = "sand"
material = "grains"
shape = { box = [[0, 0, 0], [0.08, 0.08, 0.4]] }
[[load]]
object = "sand"
pressure = 500
face = "top"
ramp = 0.035
[[coupling]]
between = ["water", "grains"]
kind = "drag"
permeability = 1e-2
[[probe]]
name = "it"
pressure = [0.04, 0.04, 0.02]
rate = 100
""",
    "coupling.0.permeability", 1e-2, (1e-3, 0.2), 1e-1, "it", ("pressure",),
)  # fmt: skip

CASES = {
    "stiffness": STIFFNESS,
    "viscosity": VISCOSITY,
    "friction": FRICTION,
    "yield stress": YIELD,
    "friction angle": ANGLE,
    "density": DENSITY,
    "permeability": PERMEABILITY,
}


def honest(case: Case, folder: Path) -> dict[str, np.ndarray]:
    """What the probe tells of a run in cells half as large, of another seed, in the other
    precision: times [s] and the columns."""
    scene = api.load(folder / "scene.toml", (), case.scene)
    changes = {"domain.cell": scene.domain.cell / 2, "accuracy.precision": "double", "seed": 2}
    run = api.run(api.load(folder / "scene.toml", changes, case.scene))
    assert run.code == 0
    rows = run.probes[case.probe]
    return {c: np.array([r[c] for r in rows]) for c in ("time", *case.columns)}


def noisy(rows: dict[str, np.ndarray], columns, path: Path, seed: int) -> None:
    """The table with noise of NOISE of each column's range."""
    chance = np.random.default_rng(seed)
    out = dict(rows)
    for c in columns:
        width = np.nanmax(rows[c]) - np.nanmin(rows[c])
        out[c] = rows[c] + NOISE * width * chance.normal(size=len(rows[c]))
    with open(path, "w", newline="") as f:
        csv.writer(f).writerows([list(out), *zip(*out.values())])


@dataclass(frozen=True)
class Result:
    """What a fit found, its interval of 95 %, and how many runs it took."""

    value: float
    interval: tuple[float, float]
    runs: int
    seconds: float

    def covers(self, true: float) -> bool:
        return self.interval[0] <= true <= self.interval[1]


def recover(case: Case, folder: Path, rows: dict[str, np.ndarray], seed: int) -> Result:
    """A fit to the reference with that noise."""
    text = f"""
[[parameter]]
key = "{case.key}"
range = [{case.range[0]!r}, {case.range[1]!r}]
start = {case.start!r}
[target]
table = "noisy.csv"
probe = "{case.probe}"
columns = {list(case.columns)}
"""
    scene, fit = made(folder, case.scene, text.replace("'", '"'))
    noisy(rows, case.columns, folder / "noisy.csv", seed)
    file = FitFile(fit, api.load(scene))
    began = time.perf_counter()
    runs = Runs(file.scene, folder / "runs")
    trials = Trials(runs, file.axes, target_of(file), file.settings.method.runs)
    found = find(file, trials)
    took = time.perf_counter() - began
    ends = interval(found, file, 0) or (np.nan, np.nan)
    return Result(found.best.values[0], ends, len(trials.all), took)


def main() -> int:
    p = argparse.ArgumentParser(description=__doc__)
    p.add_argument("names", nargs="*", choices=[*CASES, []])
    p.add_argument("--repeats", type=int, default=1)
    given = p.parse_args()
    for name in given.names or CASES:
        case = CASES[name]
        with tempfile.TemporaryDirectory() as place:
            rows, inside, off = honest(case, Path(place)), 0, []
            for seed in range(given.repeats):
                one = recover(case, Path(place), rows, seed)
                inside, off = inside + one.covers(case.true), [*off, one.value / case.true - 1]
                ends = " .. ".join(f"{x:.5g}" for x in one.interval)
                said = f"{one.value:.5g} ({100 * off[-1]:+.2f} %), {ends}, {one.runs} runs"
                print(f"{name}: {said}, {one.seconds:.0f} s", flush=True)
            worst = 100 * max(map(abs, off))
            print(f"{name}: worst {worst:.2f} %, {inside} of {len(off)} cover {case.true:g}")
    return 0


if __name__ == "__main__":
    sys.exit(main())

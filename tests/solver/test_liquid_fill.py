"""How full liquids make their cells: against sums over particles in plain NumPy, on any ranks, in
the ledger and at a run's end."""

import csv
import math

import numpy as np
import pytest

from tests.benchmarks.liquid_volume import nodal_fullness
from tests.support.launch import mpirun
from tests.support.simulate import advance, begin, by_id
from vgmpi.commands import cli
from vgmpi.io import csv_log, file_layout
from vgmpi.solver.diagnostics.conservation import conservation_rows
from vgmpi.solver.diagnostics.liquid_fill import changed_volume_lines, liquid_fill
from vgmpi.solver.restart import run_files

SCENE = """
[domain]
size = [0.32, 0.16, 0.24]
cell = 0.02
boundary = { default = "slip", east = { kind = "separate", friction = 0.2 } }
[time]
end = 0.3
frames = 4
[accuracy]
pressure = "explicit"
precision = "single"
volume_correction = "CORRECTION"
[material.water]
kind = "fluid"
tait_coefficient = "60 kPa"
[material.oil]
kind = "fluid"
density = 800
tait_coefficient = "60 kPa"
[material.rubber]
kind = "elastic"
density = 700
youngs_modulus = 2e5
[[object]]
name = "pool"
material = "water"
shape = { box = [[0, 0, 0], [0.14, 0.16, 0.16]] }
[[object]]
name = "slick"
material = "oil"
shape = { box = [[0.2, 0, 0], [0.32, 0.16, 0.1]] }
[[object]]
name = "ball"
material = "rubber"
shape = { sphere = { center = [0.17, 0.08, 0.05], radius = 0.03 } }
"""


def expected(simulation, volume):
    """Fullest cell, filled and occupied volume [m3] of the liquids, objects 0 and 1."""
    plan = simulation.plan
    (x,) = by_id(simulation, "x")
    fullness = nodal_fullness(x[: len(volume)], volume, plan.cells, plan.dx)
    share = np.ones(fullness.shape)
    for axis, n in enumerate(plan.cells):
        np.moveaxis(share, axis, 0)[[0, n]] *= 0.5
    part = np.clip((fullness - 0.15) / 0.7, 0.0, 1.0)
    filled, occupied = ((share * a).sum() * plan.dx**3 for a in (np.minimum(fullness, 1.0), part))
    return fullness.max(), filled, occupied


@pytest.mark.parametrize("engine", ["cpu", "numpy"])
def test_fill_is_that_of_the_particles(tmp_path, engine):
    simulation, made = begin(tmp_path, SCENE.replace("CORRECTION", "none"), engine=engine)
    liquid = made.vol0[made.object < 2]
    for time in (0.0, 0.05) if engine == "numpy" else (0.0, 0.2, 0.3):
        advance(simulation, time)
        ((phase, fill),) = liquid_fill(simulation).items()
        assert simulation.plan.phases[phase].families == ("fluid",)
        fullest, filled, occupied = expected(simulation, liquid)
        assert fill.fullest_cell == pytest.approx(fullest, rel=1e-6)
        assert fill.filled_volume == pytest.approx(filled, rel=1e-6)
        assert fill.occupied_volume == pytest.approx(occupied, rel=1e-6)
        assert fill.rest_volume == pytest.approx(liquid.sum(), rel=1e-7)
    rows = {row["phase"]: row for row in conservation_rows(simulation)}
    (solid,) = (row for name, row in rows.items() if name != simulation.plan.phases[phase].name)
    assert math.isnan(solid["fullest_cell"]) and math.isnan(solid["filled_volume"])


def ledger(folder):
    """The words of the two columns of a ledger, a row per frame and phase."""
    with open(folder / "ledger.csv", encoding="utf-8") as file:
        return [(row["fullest_cell"], row["filled_volume"]) for row in csv.DictReader(file)]


@pytest.mark.slow
def test_any_ranks_tell_the_same(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(SCENE.replace("CORRECTION", "shifting"))
    rows = []
    for ranks in (1, 2, 3):
        out = tmp_path / str(ranks)
        job = mpirun(ranks, "-m", "vgmpi", path, "-q", "-o", out)
        assert job.returncode == 0, job.stderr
        rows.append(ledger(out))
    assert rows[0] == rows[1] == rows[2]
    assert len({word for row in rows[0] for word in row}) > 6


def test_a_run_says_what_a_liquid_has_lost(tmp_path, capsys):
    path = tmp_path / "scene.toml"
    path.write_text(SCENE.replace("CORRECTION", "none").replace("end = 0.3", "end = 1"))
    assert cli.main([str(path), "-o", str(tmp_path / "none")]) == 0
    said = capsys.readouterr()
    print(said.out, said.err)
    lines = (said.out + said.err).splitlines()
    (line,) = (text for text in lines if text.startswith("  volume  "))
    assert "fluid fills 9" in line and "times what fits into it" in line
    rows = csv_log.read_rows(tmp_path / "none" / "ledger.csv")
    last = [row for row in rows if row["step"] == rows[-1]["step"]]
    assert f"{next(r for r in last if r['phase'] == 'fluid')['fullest_cell']:.2f} times" in line
    full = {"phase": "water", "rest_volume": 1.0, "filled_volume": 0.99, "fullest_cell": 1.2}
    assert changed_volume_lines([full]) == []
    assert len(changed_volume_lines([full | {"filled_volume": 0.97}])) == 1
    (line,) = changed_volume_lines([full | {"occupied_volume": 1.04}])
    assert line == "  volume     water takes 104.0 % of its volume: there are voids in it, or froth"


@pytest.mark.parametrize("stretch", [1.0, 1.06])
def test_a_liquid_takes_the_volume_of_its_cells(tmp_path, stretch):
    """At rest its own, whatever its depth; with its particles drawn apart that of its box."""
    for depth in (0.1, 0.11, 0.14):
        box = f"shape = {{ box = [[0, 0, 0], [0.32, 0.16, {depth}]] }}"
        text = SCENE.replace("CORRECTION", "none").split("[[object]]")[0]
        text += f'[[object]]\nname = "pool"\nmaterial = "water"\n{box}\n'
        simulation, _ = begin(tmp_path, text)
        group = simulation.groups[0]
        index, floor = group.index(), 1 << group.bits
        block = np.repeat(group.block, group.count, axis=0)[:, 2]
        height = group.xi[2, index] + (4 * block * floor + 3 * floor // 2)  # of 2^-bits cells
        group.xi[2, index] += ((stretch - 1.0) * height).astype(group.xi.dtype)
        (fill,) = liquid_fill(simulation).values()
        assert fill.occupied_volume / fill.rest_volume == pytest.approx(stretch, abs=0.012)


def test_a_ledger_without_the_columns_goes_on_without_them(tmp_path, monkeypatch):
    """A changed scene may have other liquids than the run began with."""
    path = tmp_path / "scene.toml"
    path.write_text(SCENE.replace("CORRECTION", "shifting"))
    out = tmp_path / "out"
    with monkeypatch.context() as patch:
        patch.setattr(run_files, "liquid_phases", lambda plan: [])
        assert cli.main([str(path), "-q", "-o", str(out), "--stop-after", "30 steps"]) == 75
    liquids, _ = csv_log.optional_ledger_columns(out / "ledger.csv", True, False)
    assert not liquids
    assert cli.main([str(path), "-q", "-o", str(out), "--resume"]) == 0
    names = (out / "ledger.csv").read_text().splitlines()[0].split(",")
    assert file_layout.LIQUID_COLUMNS[0].name not in names
    assert len(csv_log.read_rows(out / "ledger.csv")) == 2 * 4

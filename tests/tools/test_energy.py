"""The study of energy: what is left of a motion, held to motions of known energy."""

import csv

import numpy as np
import pytest

from tests.support.small_scenes import write
from vgmpi.commands import cli
from vgmpi.tools.tradeoff import energy_drift

SCENE = """
[domain]
size = [0.32, 0.32, 0.32]
cell = 0.02
gravity = [0, 0, WEIGHT]
[time]
end = 0.05
frames = 6
dt = 2.5e-4
[material.rubber]
kind = "elastic"
density = 1000
youngs_modulus = 1e5
[[object]]
name = "drop"
material = "rubber"
shape = { box = [[0.14, 0.14, 0.14], [0.18, 0.18, 0.18]] }
"""
FLIES = SCENE.replace("WEIGHT", "0") + "velocity = [0.5, 0, 0]\n"
FALLS = SCENE.replace("WEIGHT", "-9.8") + "velocity = [0, 0, 0.4]\n"
SPINS = SCENE.replace("WEIGHT", "0") + "angular_velocity = [0, 0, 20]\n"


def left(folder, text, transfer):
    """What is left at each frame of a run."""
    path = write(folder, f'{text}[accuracy]\ntransfer = "{transfer}"\n')
    assert cli.main([str(path), "-q", "--overwrite", "-o", str(folder / "out")]) == 0
    rows = energy_drift.remaining_energy(folder / "out")
    assert list(rows[:, 0]) == [0, 40, 80, 120, 160, 200]
    assert np.allclose(rows[:, 1], 2.5e-4 * rows[:, 0])
    return rows[:, 2]


@pytest.mark.parametrize("transfer", ["apic", "pic"])
def test_free_flight_keeps_all(tmp_path, transfer):
    assert np.allclose(left(tmp_path, FLIES, transfer), 1, atol=1e-9)


def test_height_counts(tmp_path):
    """Thrown up it turns and falls: kinetic energy is all but gone in between, the whole is not."""
    assert np.allclose(left(tmp_path, FALLS, "apic"), 1, atol=0.01)


def test_pic_takes_a_spin(tmp_path):
    pic, apic = (left(tmp_path, SPINS, transfer) for transfer in ("pic", "apic"))
    assert pic[-1] < 0.2 and apic[-1] > 0.9 and pic[0] == apic[0] == 1


def test_the_study_is_told(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(energy_drift, "TRANSFERS", ("apic-corrected",))
    text = FLIES + '[accuracy]\nprecision = "double"\n'
    assert energy_drift.main([str(write(tmp_path, text))]) == 0
    assert "| transfer | 200 steps | most |" in capsys.readouterr().out
    with open(tmp_path / "tradeoff" / "scene" / "energy.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert {(row["scene"], row["transfer"]) for row in rows} == {("scene", "apic-corrected")}
    assert [int(row["step"]) for row in rows] == [0, 40, 80, 120, 160, 200]
    assert all(abs(float(row["left"]) - 1) < 1e-9 for row in rows)


def test_a_wrong_scene_is_told(tmp_path, capsys):
    path = write(tmp_path, FLIES.replace("end = 0.05", "end = -1"))
    assert energy_drift.main([str(path)]) == 2 and "time.end" in capsys.readouterr().err


def test_the_table_tells_the_marks_and_the_most():
    rows = np.array([[0, 0.0, 1.0], [1000, 0.1, 0.8], [10_000, 1.0, 1.05], [12_000, 1.2, 0.1]])
    assert energy_drift.table({"pic": rows})[0::2] == (
        ["| transfer | 1,000 steps | 10,000 steps | most |", "| pic | 0.8000 | 1.0500 | 1.0500 |"]
    )

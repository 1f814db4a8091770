"""What would make a scene cheaper: said with key and line where it is right, and nowhere else."""

import csv
import re

import numpy as np
import pytest

from tests.support.small_scenes import write
from vgmpi.commands import cli
from vgmpi.planning.cost import tradeoff_results
from vgmpi.planning.cost.plan_report import format_plan
from vgmpi.planning.plan import time_step_bounds
from vgmpi.preprocess.scene_builder import build_scene
from vgmpi.scene.loader import load
from vgmpi.solver.diagnostics.post_run_advice import RunObserver, advice
from vgmpi.solver.initial_particles import known_of, plan_for

SCENE = """
[accuracy]
pressure = "explicit"
[domain]
size = [0.4, 0.2, 0.2]
cell = 0.02
gravity = [0, 0, 0]
[time]
end = 1e-3
frames = 6
[material.water]
kind = "fluid"
max_speed = 20
[[object]]
name = "drop"
material = "water"
shape = { box = [[0.02, 0.02, 0.02], [0.08, 0.08, 0.08]] }
velocity = [0.5, 0, 0]
"""
TABLE = """
[material.wood]
kind = "elastic"
density = 500
youngs_modulus = MODULUS
[[object]]
name = "table"
material = "wood"
shape = { box = [[0.2, 0.04, 0.04], [0.3, 0.14, 0.14]] }
"""


def planned(folder, text, *overrides):
    scene = load(write(folder, text), overrides)
    return scene, plan_for(scene, known_of(scene, build_scene(scene)))


def stiffer(folder, text, *overrides):
    """The line of --plan, or None."""
    scene, plan = planned(folder, text, *overrides)
    lines = [s for s in format_plan(scene, plan, 1).splitlines() if s.startswith("  advice")]
    assert len(lines) < 2
    return lines[0] if lines else None


def seen_of(scene, plan, speed=0.5, elastic=0.0, kinetic=0.0, sinks=0.0):
    """A run in which every phase had these energies per mass [J/kg] and sank by so much [J/kg]."""
    seen = RunObserver()
    seen.speed = speed
    for k in range(6):
        seen.frame(
            [
                {
                    "phase": phase.name, "mass": 2.0, "kinetic_energy": 2.0 * kinetic,
                    "elastic_energy": 2.0 * elastic, "potential_energy": 2.0 * sinks * k / 5,
                }
                for phase in plan.phases
            ]
        )  # fmt: skip
    return seen


def test_the_stiff_material_is_named_with_its_line(tmp_path):
    text = SCENE.replace("max_speed = 20", "max_speed = 2") + TABLE.replace("MODULUS", "1e7")
    line, at = stiffer(tmp_path, text), text.splitlines().index("youngs_modulus = 1e7") + 1
    found = re.search(r"without material 'wood' steps would be (\S+) times as long", line)
    assert f"material.wood.youngs_modulus ({tmp_path}/scene.toml:{at})" in line
    scene, plan = planned(tmp_path, text)
    alone = planned(tmp_path, text.split("[material.wood]")[0])
    longer = time_step_bounds(*alone)[0][0] / time_step_bounds(scene, plan)[0][0]
    assert float(found[1]) == pytest.approx(longer, rel=0.03) and longer > 3


def test_a_liquid_or_its_viscosity_is_named_by_the_key_that_says_it(tmp_path):
    soft = TABLE.replace("MODULUS", "1e4")
    assert "material.water.max_speed (" in stiffer(tmp_path, SCENE + soft)
    stiff = SCENE.replace("max_speed = 20", "tait_coefficient = 1e8")
    assert "material.water.tait_coefficient (" in stiffer(tmp_path, stiff + soft)
    thick = SCENE.replace("max_speed = 20", "viscosity = 1e4")
    assert "material.water.viscosity (" in stiffer(tmp_path, thick + soft)
    assert "(--set material.water.tait_coefficient=1e9)" in stiffer(
        tmp_path, SCENE.replace("max_speed = 20", "") + soft, "material.water.tait_coefficient=1e9"
    )


@pytest.mark.parametrize(
    ("text", "override"),
    [
        (SCENE, ()),  # nothing else would set another step
        (SCENE.replace("= 20", "= 2") + TABLE.replace("MODULUS", "2.2e5"), ()),  # alike
        (SCENE + TABLE.replace("MODULUS", "1e4"), ("time.dt=1e-6",)),
    ],
)
def test_where_no_material_stands_out_nothing_is_said(tmp_path, text, override):
    assert stiffer(tmp_path, text, *override) is None


def test_a_liquid_stiffer_than_its_motion_asks_for(tmp_path):
    """What is proposed makes steps as long as told, and holds 1 % of compression at that speed."""
    scene, plan = planned(tmp_path, SCENE)
    (line,) = advice(scene, plan, seen_of(scene, plan))
    at = SCENE.splitlines().index("max_speed = 20") + 1
    assert line.startswith("advice: nothing moved faster than 0.5 m/s: material.water.max_speed (")
    assert f"scene.toml:{at}) could be 0.6 m/s instead of 20" in line
    told = float(re.search(r"steps (\S+) times as long", line)[1])
    softer = planned(tmp_path, SCENE, "material.water.max_speed=0.6")
    assert time_step_bounds(*softer)[0][0] / time_step_bounds(scene, plan)[0][0] == pytest.approx(
        told, rel=0.05
    )
    assert told > 10


def test_by_its_bulk_modulus_it_is_told_the_same(tmp_path):
    given = 1000 * 20**2 / (0.01 * 7)
    scene, plan = planned(tmp_path, SCENE.replace("max_speed = 20", f"tait_coefficient = {given}"))
    (line,) = advice(scene, plan, seen_of(scene, plan))
    value = float(re.search(r"tait_coefficient \(\S+\) could be (\S+) Pa", line)[1])
    assert value == pytest.approx(1000 * 0.6**2 / (0.01 * 7), rel=0.1)


def test_what_weighs_on_a_liquid_keeps_it_stiff(tmp_path):
    """Under a weight that compresses it by .5 % at the bottom, .29 % in the mean, only half as
    stiff would do; at .8 % nothing is said."""
    scene, plan = planned(tmp_path, SCENE)
    modulus = 1000 * 20**2 / 0.01

    def lines(compression):
        mean = compression / np.sqrt(3)
        return advice(scene, plan, seen_of(scene, plan, elastic=0.5 * modulus * mean**2 / 1000))

    (line,) = lines(0.003)
    assert "could be 11 m/s" in line
    assert lines(0.008) == []


@pytest.mark.parametrize(
    ("text", "speed"),
    [
        (SCENE, 15.0),
        (SCENE.replace("max_speed = 20", "max_depth = 1000"), 0.5),
        (SCENE.replace("frames = 6", "frames = 6\ndt = 1e-6"), 0.5),
        (SCENE + TABLE.replace("MODULUS", "1e10"), 0.5),  # which sets the step
        (SCENE.replace('"fluid"', '"elastic"').replace("max_speed", "youngs_modulus"), 0.5),
    ],
)
def test_a_liquid_as_stiff_as_it_should_be(tmp_path, text, speed):
    scene, plan = planned(tmp_path, text)
    assert advice(scene, plan, seen_of(scene, plan, speed, kinetic=1e3)) == []


def test_a_body_that_stood_still_could_be_scenery(tmp_path):
    text = SCENE.replace("= 20", "= 2") + TABLE.replace("MODULUS", "2e5")
    scene, plan = planned(tmp_path, text)
    (line,) = advice(scene, plan, seen_of(scene, plan, 2.0))
    at = len(text.splitlines()) - TABLE.splitlines()[::-1].index("[[object]]")
    assert "body 'table' neither moved nor deformed: as scenery with collider = true" in line
    assert f"object.table ({tmp_path}/scene.toml:{at})" in line
    assert f"{plan.count[1]:,} of {plan.particles:,} particles" in line


@pytest.mark.parametrize(
    "how",
    [
        {"kinetic": 0.5 * 3.0**2},  # 3 m/s for a ms: 3 mm
        {"elastic": 0.5 * 400 * 2e-3**2},  # strains of 2e-3
        {"sinks": 9.81 * 3e-3},
    ],
)
def test_a_body_that_moved_or_was_bent_is_none(tmp_path, how):
    text = SCENE.replace("= 20", "= 2") + TABLE.replace("MODULUS", "2e5")
    text = text.replace("gravity = [0, 0, 0]", "")
    scene, plan = planned(tmp_path, text)
    assert advice(scene, plan, seen_of(scene, plan, 2.0)) != []
    assert advice(scene, plan, seen_of(scene, plan, 2.0, **how)) == []


def test_a_body_whose_motion_is_given_is_none(tmp_path):
    text = SCENE.replace("= 20", "= 2") + TABLE.replace("MODULUS", "2e5") + "release_time = 0.5\n"
    scene, plan = planned(tmp_path, text)
    assert advice(scene, plan, seen_of(scene, plan, 2.0)) == []


def test_the_command_says_it_at_the_end(tmp_path, capsys):
    """A drop that flies past a table; not where the run was stopped, or only went on."""
    path = str(write(tmp_path, SCENE + TABLE.replace("MODULUS", "1e5")))
    run = [path, "--engine", "numpy", "-o", str(tmp_path / "out")]
    assert cli.main([*run, "--stop-after", "2 steps"]) == 75
    assert "advice:" not in capsys.readouterr().out
    assert cli.main([*run, "--resume"]) == 0
    assert "advice:" not in capsys.readouterr().out
    assert cli.main([*run, "--overwrite"]) == 0
    lines = [s for s in capsys.readouterr().out.splitlines() if s.startswith("advice:")]
    assert len(lines) == 2
    speed = float(re.search(r"faster than (\S+) m/s", lines[0])[1])
    # of one axis, and the drop's corners breathe a little
    assert 0.5 <= speed <= 0.5 * np.sqrt(3) * 1.1 and "water.max_speed" in lines[0]
    assert "'table' neither moved" in lines[1]


ROWS = [  # setting, cells, processor time [s], error, what is set
    ("baseline", 20, 10.0, 0.02, ""),
    ("precision-single", 20, 5.0, 0.0201, "accuracy.precision=single"),
    ("transfer-apic", 20, 7.0, 0.05, "accuracy.transfer=apic"),
    ("cfl-0.2", 20, 20.0, 0.01, "time.cfl=0.2"),
]


def studied_lines(folder, rows=ROWS, of=None, overrides=()):
    path = write(folder, SCENE)
    plain = load(path)
    (folder / tradeoff_results.FOLDER).mkdir(exist_ok=True)
    with open(folder / tradeoff_results.FOLDER / tradeoff_results.TABLE, "w", newline="") as file:
        out = csv.writer(file)
        out.writerows(
            [
                tradeoff_results.COLUMNS,
                *((*row, of or tradeoff_results.fingerprint(plain)) for row in rows),
            ]
        )
    scene = load(path, overrides)
    plan = plan_for(scene, known_of(scene, build_scene(scene)))
    return [s for s in format_plan(scene, plan, 1).splitlines() if "in the study" in s]


def test_a_study_beside_the_scene_is_quoted(tmp_path):
    (line,) = studied_lines(tmp_path)  # not what is worse, nor what is dearer
    assert "accuracy.precision (" in line and "with single instead it took 0.50 of the time" in line
    assert "2 % off instead of 2 % in the study (tradeoff/tradeoff.csv)" in line
    assert re.search(r"scene\.toml:\d+\)", line)


@pytest.mark.parametrize(
    "how",
    [
        {"overrides": ("domain.cell=0.04",)},  # another scene
        {"of": "0123456789abcdef"},
        {"rows": ROWS[:1]},
        {"rows": ROWS[1:]},  # one that was stopped before its table was whole
        {"rows": [ROWS[0], ("precision-single", 20, "fast", "", "accuracy.precision=single")]},
    ],
)
def test_no_study_of_this_scene_is_quoted_where_there_is_none(tmp_path, how):
    assert studied_lines(tmp_path, **how) == []

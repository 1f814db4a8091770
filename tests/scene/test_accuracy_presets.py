"""Levels of accuracy: what they set, what they leave alone, and what is told of them."""

import copy
import tomllib

import pytest

from tests.benchmarks import levels as measured
from tests.support.small_scenes import write
from vgmpi.planning.cost.plan_details import accuracy_benchmarks, preset_accuracy_lines
from vgmpi.runtime.config.schema import SceneError
from vgmpi.scene.accuracy_presets import LEVELS, apply_accuracy_preset
from vgmpi.scene.loader import load
from vgmpi.tools.tradeoff.parameter_sweep import Setting
from vgmpi.tools.tradeoff.study_runs import Study

SCENE = """
[domain]
size = ["0.8 m", "40 cm", 0.3]
[time]
end = 1
[accuracy]
level = "draft"
[material.water]
kind = "fluid"
max_speed = 2
[material.oil]
kind = "fluid"
tait_coefficient = 1e5
[material.wood]
kind = "elastic"
density = 500
youngs_modulus = 1e6
[[object]]
name = "drop"
material = "water"
shape = { box = [[0.1, 0.1, 0.1], [0.2, 0.2, 0.2]] }
"""


@pytest.mark.parametrize("level, cells", [("draft", 32), ("standard", 64), ("high", 96)])
def test_a_level_sets_what_is_not_given(tmp_path, level, cells):
    scene = load(write(tmp_path, SCENE), [f"accuracy.level={level}"])
    assert scene.domain.cells == (cells, cells // 2, 3 * cells // 8)
    assert scene.accuracy.precision == LEVELS[level].precision
    assert scene.material["water"].max_compression == LEVELS[level].max_compression
    assert scene.material["oil"].tait_coefficient == 1e5


def test_what_is_given_wins(tmp_path):
    given = ["domain.cell=0.02", "accuracy.precision=double", "material.water.max_compression=0.05"]
    scene = load(write(tmp_path, SCENE), given)
    assert scene.domain.cells == (40, 20, 15) and scene.accuracy.precision == "double"
    assert scene.material["water"].max_compression == 0.05


CUP = """
[[object]]
name = "cup"
material = "wood"
mesh = "cup.stl"
height = 0.1
position = [0.5, 0.2, 0.1]
"""
LEFT = [
    'prune = "off"',
    'prune = "versagauss"\nprune_scale = 0.3',
    'role = "scenery"',
]


@pytest.mark.parametrize("level, how", [("draft", "auto"), ("standard", "off"), ("high", "off")])
def test_draft_prunes_what_may_be_pruned(tmp_path, level, how):
    (tmp_path / "cup.stl").touch()
    scene = load(write(tmp_path, SCENE + CUP), [f"accuracy.level={level}"])
    assert [thing.prune for thing in scene.object] == ["off", how]


@pytest.mark.parametrize("line", LEFT)
def test_draft_leaves_pruning_that_is_given_and_scenery(tmp_path, line):
    (tmp_path / "cup.stl").touch()
    text = SCENE + CUP + line + "\n"
    text = text.replace('material = "wood"\nmesh', "mesh") if "scenery" in line else text
    cup = load(write(tmp_path, text)).object[1]
    plain = load(
        write(
            tmp_path, text.replace('level = "draft"', "").replace("[time]", "cell = 0.025\n[time]")
        )
    ).object[1]
    assert cup == plain


def test_without_a_level_nothing_changes():
    data = tomllib.loads(SCENE.replace('level = "draft"', ""))
    assert apply_accuracy_preset(data) is data


def test_the_tables_of_the_file_stay_as_they_are():
    data = tomllib.loads(SCENE)
    before = copy.deepcopy(data)
    assert apply_accuracy_preset(data) != data and data == before


@pytest.mark.parametrize(
    "size, cells",
    [
        ("[1, 0.7, 0.3]", (40, 28, 12)),  # the first from 32 on that fits all three
        ("[1, 0.1, 0.1]", (40, 4, 4)),  # fewer than four cells are none
        ("[0.37, 0.61, 0.8]", (37, 61, 80)),
    ],
)
def test_every_edge_is_a_whole_number_of_cells(tmp_path, size, cells):
    text = SCENE.replace('["0.8 m", "40 cm", 0.3]', size).replace("0.2]]", "0.1]]")
    data = apply_accuracy_preset(tomllib.loads(text))
    edges = tomllib.loads(f"x = {size}")["x"]
    assert tuple(round(edge / data["domain"]["cell"]) for edge in edges) == cells


@pytest.mark.parametrize(
    "size", ["[1, 0.3719, 0.2]", "[1, 0.001, 1]", "[1, -1, 1]", '"wide"', "[]"]
)
def test_edges_that_no_cells_fit_are_refused(tmp_path, size):
    text = SCENE.replace('["0.8 m", "40 cm", 0.3]', size)
    with pytest.raises(SceneError) as refused:
        load(write(tmp_path, text))
    assert any("domain.cell" in line for line in refused.value.lines)


def test_a_level_that_is_none(tmp_path):
    with pytest.raises(SceneError) as refused:
        load(write(tmp_path, SCENE), ["accuracy.level=best"])
    assert any("draft, standard, high" in line for line in refused.value.lines)


def test_the_plan_tells_of_the_cases_near_its_materials(tmp_path):
    more = SCENE[SCENE.index("[[object]]") :].replace("drop", "log").replace('"water"', '"wood"')
    path = write(tmp_path, SCENE + more)
    both = "\n".join(preset_accuracy_lines(load(path)))
    assert "dam break" in both and "cantilever" in both and "sand" not in both
    assert "of draft being 1: standard " in both and ", high " in both
    wood = preset_accuracy_lines(
        load(write(tmp_path, SCENE.replace('material = "water"', 'material = "wood"')))
    )
    assert "dam break" not in wood[0] and "cantilever" in wood[0]
    plain = SCENE.replace("0.3]\n", "0.3]\ncell = 0.02\n").replace('level = "draft"', "")
    assert preset_accuracy_lines(load(write(tmp_path, plain))) == []


def test_the_table_has_every_case_at_every_level():
    found = {(row["case"], row["level"]) for row in accuracy_benchmarks()}
    assert found == {(case.__name__, level) for case in measured.CASES for level in LEVELS}
    assert len(measured.CASES) >= 8


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("case", measured.CASES)
def test_a_case_is_right_as_it_stands(case, level):
    scene = load(measured.SCENES / f"{case.__name__}.toml", [f"accuracy.level={level}"])
    cells = max(scene.domain.cells)
    assert LEVELS[level].cells <= cells <= 1.1 * LEVELS[level].cells
    assert scene.accuracy.precision == LEVELS[level].precision


@pytest.mark.parametrize("case", [measured.poiseuille, measured.bounce])
def test_a_mark_is_what_a_run_shows(tmp_path, case):
    scene = load(measured.SCENES / f"{case.__name__}.toml")
    study = Study(scene, tmp_path)
    setting = Setting((("level", "draft"),), ("accuracy.level=draft",))
    assert study.run(setting) > 0
    (mark,) = [
        r for r in accuracy_benchmarks() if (r["case"], r["level"]) == (case.__name__, "draft")
    ]
    assert case(study.outcome(setting)) == pytest.approx(float(mark["error"]), rel=0.1)

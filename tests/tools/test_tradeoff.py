"""The study of accuracy and time: what it varies, what it measures, what it chooses."""

import csv
import os
import re
import shutil
import subprocess

import numpy as np
import pytest

from tests.support.launch import ROOT
from tests.support.small_scenes import scene, write
from vgmpi.scene.loader import load
from vgmpi.tools.tradeoff import parameter_sweep, setting_study
from vgmpi.tools.tradeoff.cost_error_model import CostError, CostErrorModel, pareto_front
from vgmpi.tools.tradeoff.error_measures import RunOutcome, energy, mass_displacement
from vgmpi.tools.tradeoff.parameter_sweep import BASELINE, Setting
from vgmpi.tools.tradeoff.setting_study import DEFAULT
from vgmpi.tools.tradeoff.study_runs import Study, StudyError

SCENE = """
[accuracy]
pressure = "explicit"
precision = "double"
[domain]
size = [0.32, 0.16, 0.24]
cell = 0.02
[time]
end = 0.05
frames = 3
[material.water]
kind = "fluid"
max_speed = 2
[[object]]
name = "block"
material = "water"
shape = { box = [[0, 0, 0], [0.1, 0.16, 0.16]] }
"""

RUBBER = 'kind = "elastic"\ndensity = 900\nyoungs_modulus = 1e5'
DUCK = """
[[object]]
name = "duck"
material = "water"
gaussians = "duck.ply"
height = 0.1
position = [0.1, 0.08, 0.05]
"""


@pytest.fixture
def block(tmp_path):
    return scene(tmp_path, SCENE)


def test_cells_are_near_steps_of_sqrt_2_and_whole(block):
    # 16 x 8 x 12: the longest edge is a multiple of 4 cells
    assert parameter_sweep.cells(block) == [8, 12, 16, 24]
    for count in parameter_sweep.cells(block):
        (override,) = parameter_sweep.with_cells(block, count).overrides
        cell = float(override.partition("=")[2])
        assert all(abs(edge / cell - round(edge / cell)) < 1e-9 for edge in block.domain.size)


def test_liquids_are_made_softer_by_the_key_that_the_scene_has(tmp_path, block):
    softer, stiffer = parameter_sweep.alternatives(block, "stiffness")
    assert softer.overrides == ("material.water.max_compression=0.04",)
    assert stiffer.overrides == ("material.water.max_compression=0.0025",)
    plain = scene(tmp_path, SCENE.replace("max_speed = 2", "tait_coefficient = 1e5"))
    softer, _ = parameter_sweep.alternatives(plain, "stiffness")
    assert softer.overrides == ("material.water.tait_coefficient=25000.0",)


def test_knobs_with_nothing_to_turn_are_left_out(tmp_path):
    text = SCENE.replace('kind = "fluid"\nmax_speed = 2', 'kind = "elastic"\nyoungs_modulus = 1e5')
    rubber = scene(tmp_path, text.replace("end = 0.05", "end = 0.05\ndt = 1e-4"))
    assert (
        parameter_sweep.alternatives(rubber, "stiffness")
        == []
        == parameter_sweep.alternatives(rubber, "cfl")
    )


def test_the_later_of_two_settings_wins():
    coarse = Setting((("cells", "8"),), ("domain.cell=0.04",))
    single = Setting((("precision", "single"),), ("accuracy.precision=single",))
    fine = Setting((("cells", "32"),), ("domain.cell=0.01",))
    both = coarse.and_then(single).and_then(fine)
    assert both.name == "precision-single_cells-32"
    assert both.overrides == ("accuracy.precision=single", "domain.cell=0.01")


def test_the_best_are_beaten_by_none():
    runs = [
        CostError(Setting((("k", str(k)),), ()), cpu, error, 8)
        for k, (cpu, error) in enumerate([(1, 0.5), (2, 0.6), (3, 0.2), (4, 0.2), (5, 0.1)])
    ]
    assert [m.cpu for m in pareto_front(runs)] == [1, 3, 5]


def measured(block):
    """As if time went with the fourth power of the cells, and the error as their size."""
    single = parameter_sweep.alternatives(block, "precision")[0]
    runs = []
    for n in (8, 16, 24):
        setting = BASELINE if n == 16 else parameter_sweep.with_cells(block, n)
        runs.append(CostError(setting, (n / 16) ** 4 * 10.0, 0.0 if n == 24 else 0.16 / n, n))
    return [*runs, CostError(single, 5.0, 0.01000001, 16)]


def test_cells_between_those_that_were_run_are_found(block):
    model = CostErrorModel(block, measured(block), [8, 12, 16, 20, 24])
    cheap = model.within(0.0134, None)
    assert dict(cheap.setting.knobs) == {"cells": "12", "precision": "single"}
    assert cheap.cpu == pytest.approx(0.5 * 10 * 0.75**4, rel=1e-6)
    assert cheap.error == pytest.approx(0.16 / 12, rel=1e-3)
    good = model.within(None, 12.3)
    assert dict(good.setting.knobs) == {"cells": "20", "precision": "single"}
    assert model.within(1e-4, None) is None and model.within(None, 1e-3) is None


def test_what_was_run_corrects_what_is_expected(block):
    """Half the error at other cells than was expected, and twice the time: so it is there, and less
    so between there and the scene's own cells."""
    found = measured(block)
    before = {c.setting: c for c in CostErrorModel(block, found, [8, 12, 16]).choices()}
    both = parameter_sweep.with_cells(block, 8).and_then(
        parameter_sweep.alternatives(block, "precision")[0]
    )
    was = before[both]
    found.append(CostError(both, 2 * was.cpu, was.error / 2, 8))
    after = {c.setting: c for c in CostErrorModel(block, found, [8, 12, 16]).choices()}
    assert after[both] == found[-1]
    ratios = []
    for n in (12, 16):
        one = parameter_sweep.grid(block, n).and_then(
            parameter_sweep.alternatives(block, "precision")[0]
        )
        ratios.append((after[one].cpu / before[one].cpu, after[one].error / before[one].error))
    assert 1.3 < ratios[0][0] < 1.6 and 0.6 < ratios[0][1] < 0.8 and ratios[1] == (1, 1)
    # what was not turned is as it was
    assert (
        after[parameter_sweep.with_cells(block, 12)]
        == before[parameter_sweep.with_cells(block, 12)]
    )


class Jumping:
    """A study of runs whose error jumps where a line between two runs sees nothing of it."""

    def __init__(self, scene):
        self.scene, self.ran = scene, []

    def run(self, setting):
        self.ran.append(setting.name)
        return 10.0 * (self.cells(setting) / 16) ** 4

    def cells(self, setting):
        return int(dict(setting.knobs).get("cells", 16))

    def deviation(self, setting):
        return 0.16 / self.cells(setting) * (3 if self.cells(setting) == 12 else 1)


@pytest.mark.parametrize(
    "aim, cells, ran",
    [((0.0134, None), 16, 1), ((0.021, None), 8, 0), (((1e-5), None), None, 0)],
)
def test_a_choice_that_is_not_as_expected_is_replaced(block, aim, cells, ran):
    study = Jumping(block)
    found = [m for m in measured(block) if m.setting.of_grid]
    choice, known = setting_study.choose(study, found, study.deviation, aim, 5)
    assert (choice and choice.cells) == cells and len(study.ran) == ran
    assert len(known) == len(found) + ran


def test_after_some_tries_the_choice_is_among_what_was_run(block):
    study = Jumping(block)
    found = measured(block)  # 12 cells in double precision are thought of as well
    choice, known = setting_study.choose(study, found, lambda one: 1.0, (0.0134, None), 1)
    assert study.ran == ["cells-12_precision-single"] and choice == found[-1]


def test_the_finest_run_may_be_what_is_chosen(block):
    """Its error is not known, but it is not run again."""
    study = Jumping(block)
    found = [m for m in measured(block) if m.setting.of_grid]
    choice, _ = setting_study.choose(study, found, study.deviation, (None, 52.0), 5)
    assert choice.cells == 24 and choice.error > 0 and study.ran == []


def test_pruning_is_varied_where_there_is_something_to_prune(tmp_path, block):
    assert parameter_sweep.alternatives(block, "pruning") == []
    scenes = {}
    (tmp_path / "duck.ply").touch()
    for how in ('prune = "off"', 'prune = "versagauss"\nprune_scale = 0.2'):
        text = SCENE.split("[[object]]")[0].replace('kind = "fluid"\nmax_speed = 2', RUBBER)
        scenes[how[9:12]] = scene(tmp_path, f"{text}{DUCK}{how}\n")
    assert [
        dict(s.knobs)["pruning"] for s in parameter_sweep.alternatives(scenes["off"], "pruning")
    ] == (["auto", "0.5", "0.2", "0.05"])
    turned = parameter_sweep.alternatives(scenes["ver"], "pruning")
    assert [dict(s.knobs)["pruning"] for s in turned] == ["off", "0.5", "0.05"]
    for one in turned:  # each is a scene
        assert load(tmp_path / "scene.toml", one.overrides).object[0].prune in ("off", "versagauss")
    # all Gaussians are what the others are held to
    _, finest = parameter_sweep.sweep(scenes["ver"], ("cell", "pruning"))
    assert finest.overrides[-1] == "object.duck.prune=off" and dict(finest.knobs)["cells"] == "24"


def test_colors_are_varied(tmp_path, block):
    (step,) = parameter_sweep.alternatives(block, "colors")
    assert step.overrides == ("appearance.color_transfer=step",)
    text = SCENE + '[appearance]\ncolor_transfer = "step"\n'
    degrees = parameter_sweep.alternatives(scene(tmp_path, text), "colors")
    assert [s.name for s in degrees] == ["colors-1", "colors-3"]


def test_a_run_of_two_precisions_is_told_and_a_scene_is_written(tmp_path, capsys):
    path = write(tmp_path, SCENE)
    flags = [str(path), "-o", str(tmp_path / "study"), "--vary", "precision", "--budget", "1 h"]
    assert setting_study.main(flags) == 0
    said = capsys.readouterr().out
    assert "precision single" in said and "scene_chosen.toml" in said
    with open(tmp_path / "study" / "tradeoff.csv") as file:
        rows = {row["setting"]: row for row in csv.DictReader(file)}
    assert set(rows) == {"baseline", "precision-single"}
    assert 0 < float(rows["precision-single"]["error"]) < 1e-4
    assert load(tmp_path / "scene_chosen.toml").domain.cell == 0.02
    # again: nothing is run, the same is said
    stamps = {p: p.stat().st_mtime_ns for p in (tmp_path / "study").glob("*/ledger.csv")}
    assert len(stamps) == 2 and setting_study.main(flags) == 0
    assert capsys.readouterr().out == said
    assert all(p.stat().st_mtime_ns == t for p, t in stamps.items())
    assert setting_study.main([*flags, "--run"]) == 0
    assert re.search(
        r"chosen.toml: .* 0 % off, as was found: as it stands", capsys.readouterr().out
    )
    # a run that is no more is made again
    shutil.rmtree(tmp_path / "study" / "precision-single")
    assert setting_study.main(flags) == 0
    one, other = (RunOutcome(tmp_path / "study" / n) for n in ("baseline", "precision-single"))
    assert mass_displacement(one, one) == 0 == energy(one, one)
    assert 0 < mass_displacement(other, one) < 1e-4


def test_a_table_so_far_follows_each_run(tmp_path, capsys):
    """Its errors are relative to the finest run so far; --quick makes three runs."""
    path = write(tmp_path, SCENE.replace("end = 0.05", "end = 0.02").replace("double", "single"))
    flags = [str(path), "-o", str(tmp_path / "study"), "--quick"]
    assert setting_study.main(flags) == 0
    told = capsys.readouterr()
    assert [dict(s.knobs) for s in parameter_sweep.quick_sweep(load(path))[0]] == (
        [{"cells": "12"}, {}, {"cells": "24"}]
    )
    first, second = told.err.split("so far, ")[1:]
    assert first.startswith("1 of 3 runs, compared with the finest of them (cells-12)\n")
    assert second.startswith("2 of 3 runs, compared with the finest of them (baseline)\n")
    assert re.search(r"\| cells 12 \| [\d.]+ s \| held to \|", first)
    assert re.search(r"\| the scene \| [\d.]+ s \| held to \|", second)
    found = re.search(r"\| cells 12 \| [\d.]+ s \| ([\d.e-]+) % \|", second)
    one, other = (RunOutcome(tmp_path / "study" / n) for n in ("cells-12", "baseline"))
    assert float(found[1]) > 0
    assert float(found[1]) == pytest.approx(100 * mass_displacement(one, other), rel=5e-3)
    # the table at the end is alone on standard output, and of all runs
    assert "so far" not in told.out and re.search(r"\| cells 24 \| .* \| held to \|", told.out)
    # a call that finds all runs has nothing new to tell
    assert setting_study.main(flags) == 0
    assert "so far" not in capsys.readouterr().err


def test_a_table_so_far_measures_no_run_twice(tmp_path, block, monkeypatch):
    settings, finest = parameter_sweep.sweep(block, DEFAULT[:3])
    args = setting_study.parse_arguments([str(tmp_path / "scene.toml")])
    asked = []

    def error_function(study, args, reference):
        return lambda setting: asked.append((setting.name, reference.name)) or 0.0

    monkeypatch.setattr(setting_study, "error_function", error_function)
    interim = setting_study.InterimTable(Study(block, tmp_path), args, finest, len(settings))
    for count in range(1, len(settings) + 1):
        lines = interim.lines(dict.fromkeys(settings[:count], 1.0))
        assert sum(line.endswith((" best |", "|  |")) for line in lines) == count
    assert len(set(asked)) == len(asked)
    # single and other transfers at the scene's own cells replace no reference
    assert list(dict.fromkeys(reference for _, reference in asked)) == (
        ["cells-8", "cells-12", "baseline", "cells-24"]
    )


def test_quick_needs_other_cells_that_divide_the_domain(tmp_path, capsys):
    text = SCENE.replace("[0.32, 0.16, 0.24]", "[0.34, 0.22, 0.26]").replace(
        "0.1, 0.16", "0.1, 0.2"
    )
    assert setting_study.main([str(write(tmp_path, text)), "--quick"]) == 2
    said = capsys.readouterr().err
    assert (
        "scene.toml:7: domain.cell" in said
        and "as --quick requires: its 17 x 11 x 13 cells have" in said
    )


def test_an_array_of_jobs_shares_the_runs(tmp_path, monkeypatch):
    """slurm/study.sbatch, where every run is noted and none is made."""
    path, ran = write(tmp_path, SCENE), []
    monkeypatch.setattr(Study, "run", lambda study, setting: ran.append(setting.name) or 1.0)
    flags = [str(path), "-o", str(tmp_path / "study"), "--vary", "cell,precision,transfer"]
    for part in ("1/3", "2/3", "3/3"):
        before = len(ran)
        assert setting_study.main([*flags, "--part", part]) == 0
        assert len(ran) > before
    assert len(set(ran)) == len(ran) == len(parameter_sweep.sweep(load(path), DEFAULT[:3])[0])
    told = tmp_path / "told"
    told.write_text('#!/bin/bash\necho "$@"\n')
    told.chmod(0o755)
    env = {
        **os.environ,
        "PYTHON": str(told),
        "SLURM_ARRAY_TASK_ID": "2",
        "SLURM_ARRAY_TASK_MAX": "8",
    }
    made = subprocess.run(
        ["bash", ROOT / "slurm" / "study.sbatch", "a.toml", "--vary", "cell"],
        env=env, capture_output=True, text=True,
    )  # fmt: skip
    assert made.stdout.split() == (
        ["-m", "vgmpi", "tradeoff", "a.toml", "--vary", "cell", "--part", "2/8"]
    )


def test_a_run_that_is_refused_is_left_out(tmp_path, capsys):
    """In coarse cells an open wall eats the block."""
    text = SCENE.replace("cell = 0.02", 'cell = 0.02\nboundary = { east = "open" }')
    path = write(tmp_path, text.replace("[0.1, 0.16", "[0.3, 0.16"))
    study = Study(load(path), tmp_path / "study")
    coarse = parameter_sweep.with_cells(study.scene, 8)
    assert study.all([coarse], set()) == {}
    assert "left out: cells-8: " in capsys.readouterr().err
    with pytest.raises(StudyError, match="an outlet that removes a body"):
        study.all([coarse], {coarse})


def test_mass_that_is_elsewhere_is_counted(tmp_path, monkeypatch):
    moved = np.array([[0.3, 0.1, 0.0], [0.0, 0.4, 0.2]])
    still = np.array([[0.4, 0.0, 0.0], [0.0, 0.4, 0.2]])

    class Told:
        times = np.zeros(2)

        def __init__(self, spread):
            self.masses = spread

        def mass_in_boxes(self, frame):
            return self.masses

    assert mass_displacement(Told(moved), Told(still)) == pytest.approx(0.1)


@pytest.mark.parametrize(
    "flags, said",
    [
        (["--vary", "cells"], "unknown: cells"),
        (["--budget", "5 kg"], "'kg' does not measure a time"),
        (["--error", "0"], "must be > 0"),
        (["--curve", "a.csv"], "go together"),
        (["--run"], "is for --budget and --error"),
        (["--quick", "--vary", "cfl"], "give --quick or --vary"),
        (["--part", "3/2"], "K from 1 to N"),
        (["--part", "two"], "K from 1 to N"),
    ],
)
def test_wrong_flags_are_told(tmp_path, capsys, flags, said):
    with pytest.raises(SystemExit) as ended:
        setting_study.main([str(write(tmp_path, SCENE)), *flags])
    assert ended.value.code == 2 and said in capsys.readouterr().err


def test_a_scene_that_is_wrong_is_told(tmp_path, capsys):
    path = write(tmp_path, SCENE.replace("end = 0.05", "end = -1"))
    assert setting_study.main([str(path)]) == 2
    assert "scene.toml:9: time.end" in capsys.readouterr().err

"""Fits: what is put in is found again, a fit that was killed goes on with the same bits, and what
cannot be told apart is refused."""

import json
import os
import random
import shutil
import time
from types import SimpleNamespace

import numpy as np
import pytest
import pyvista

from tests.support import launch
from tests.support.fit_scenes import BALL, FIT, bits, command, go, reference, rows, write_fit
from vgmpi.scene.loader import load
from vgmpi.tools.fit import __main__ as fit
from vgmpi.tools.fit import optimizers, parameter_space, workflow
from vgmpi.tools.fit.parameter_space import ParameterAxis, value_at
from vgmpi.tools.fit.run_pool import RECORD, RunPool

KEY = "material.rubber.youngs_modulus"
DENSITY = """
[[parameter]]
key = "material.rubber.density"
range = [200, 5000]
initial = 400
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """With a reference run."""
    found = tmp_path_factory.mktemp("fit")
    reference(found, BALL)
    return found


@pytest.fixture(scope="module")
def whole(folder):
    """The folder of a fit that nobody stopped."""
    scene, file = write_fit(folder, BALL, FIT)
    assert fit.main([str(scene), str(file), "-o", str(folder / "whole")]) == 0
    return folder / "whole"


def test_what_was_put_in_is_found(folder, whole):
    found = load(whole / "fitted.toml").material["rubber"].youngs_modulus
    assert found == pytest.approx(2e4, rel=2e-3)
    told = rows(whole)
    assert len(told) <= 40 and float(told[0][KEY]) == pytest.approx(2e5)
    assert min(float(row["loss"]) for row in told) < 1e-3 < 0.1 < float(told[0]["loss"])
    assert all(0 <= float(row["holdout_loss"]) < 2 for row in told)
    report = (whole / "report.md").read_text()
    assert f"| {KEY} | {found:.6g} |" in report and "Held out: " in report
    assert f"Runs: {len(told)}." in report


def test_what_is_done_is_not_done_again(folder, whole):
    before, stamps = bits(whole), {p: p.stat().st_mtime_ns for p in whole.glob("runs/*/fit.json")}
    assert len(stamps) == len(before[0])
    assert fit.main([str(folder / "scene.toml"), str(folder / "fit.toml"), "-o", str(whole)]) == 0
    assert bits(whole) == before
    assert all(p.stat().st_mtime_ns == stamp for p, stamp in stamps.items())


@pytest.mark.parametrize("seed", [1, *(pytest.param(k, marks=pytest.mark.slow) for k in (2, 3, 4))])
def test_a_killed_fit_goes_on_with_the_same_bits(folder, whole, seed):
    """By SIGKILL, at moments of no choice: between two runs, in one, while a file is written."""
    out, random_ = folder / f"killed{seed}", random.Random(seed)
    for _ in range(3):
        count = len(list(out.glob(f"runs/*/{RECORD}")))
        begun = launch.start(command(folder / "scene.toml", folder / "fit.toml", out))
        goal = count + random_.randint(1, 3)
        launch.until(lambda goal=goal: len(list(out.glob(f"runs/*/{RECORD}"))) >= goal, "a run")
        time.sleep(random_.uniform(0, 0.3))
        assert begun.poll() is None  # it was not done before
        begun.kill()
        begun.communicate()
    kept = {p: p.stat().st_mtime_ns for p in out.glob(f"runs/*/{RECORD}")}
    done = go(folder / "scene.toml", folder / "fit.toml", out)
    assert done.returncode == 0, done.stderr
    assert bits(out) == bits(whole)
    assert len(kept) >= 3 and all(p.stat().st_mtime_ns == stamp for p, stamp in kept.items())


def test_a_run_that_is_half_there_is_made_again(folder, whole):
    """Its record is what counts: without it, or with another scene's, files are made anew."""
    out = folder / "half"
    shutil.copytree(whole, out)
    one, other = sorted(out.glob("runs/*"))[:2]
    (one / RECORD).unlink()
    (one / "probe_ball.csv").write_text("")
    (other / RECORD).write_text(json.dumps({"set": ["a=1"], "whole": True, "seconds": 1}))
    assert fit.main([str(folder / "scene.toml"), str(folder / "fit.toml"), "-o", str(out)]) == 0
    assert bits(out) == bits(whole)


def test_a_scene_that_was_changed_is_run_anew(folder, whole):
    scene = folder / "changed.toml"
    scene.write_text(BALL.replace("end = 0.06", "end = 0.055"))
    out = folder / "changed"
    shutil.copytree(whole, out)
    text = FIT.replace("reference/probe", str(folder / "reference/probe"))
    text = text.replace("max_runs = 40", "max_runs = 12")
    (folder / "short.toml").write_text(text.replace('"center_z", "velocity_z"', '"center_z"'))
    assert fit.main([str(scene), str(folder / "short.toml"), "-o", str(out)]) == 2  # rows at 0.06
    scene.write_text(BALL.replace("velocity = [0, 0, -1.0]", "velocity = [0, 0, -1.1]"))
    assert fit.main([str(scene), str(folder / "short.toml"), "-o", str(out)]) == 0
    assert not {r["folder"] for r in rows(out)} & {r["folder"] for r in rows(whole)}


def test_a_file_that_was_changed_is_run_anew(tmp_path):
    """A mesh of another shape under the same name, of the same size and time."""
    cube = pyvista.Cube(center=(0.12, 0.12, 0.08), x_length=0.08, y_length=0.08, z_length=0.08)
    cube.triangulate().save(tmp_path / "body.stl")
    shape = "shape = { sphere = { center = [0.12, 0.12, 0.06], radius = 0.05 } }"
    text = BALL.replace(shape, 'mesh = "body.stl"\nposition = [0.12, 0.12, 0.04]')
    assert text != BALL
    scene, _ = write_fit(tmp_path, text, FIT)
    setting = parameter_space.setting(
        [parameter_space.ParameterAxis(KEY, 4e3, 4e5, 2e5, "log")], [0.5]
    )
    runs = RunPool(load(scene), tmp_path / "runs")
    (done,) = runs.all([setting])
    assert RunPool(load(scene), tmp_path / "runs").done(setting) == done
    before = (tmp_path / "body.stl").stat()
    cube.scale((1, 1, 1.2), inplace=True)
    cube.triangulate().save(tmp_path / "body.stl")
    os.utime(tmp_path / "body.stl", ns=(before.st_atime_ns, before.st_mtime_ns))
    assert (tmp_path / "body.stl").stat().st_size == before.st_size
    assert RunPool(load(scene), tmp_path / "runs").done(setting) is None


def test_frames_are_fitted_and_a_runs_mass_tells_nothing(folder, capsys):
    """From coarse bins to fine ones. Of the other run only where things are counts: it is twice as
    heavy and as stiff, and what is found is the stiffness at the scene's own density."""
    reference(folder, BALL, {"material.rubber.density": 2000, KEY: 4e4}, "heavy")
    text = FIT[: FIT.index("[target]")] + (
        '[target]\nrun = "heavy"\n[method]\ndiscretization_check = "none"\n'
    )
    scene, file = write_fit(folder, BALL, text)
    out = folder / "frames"
    assert fit.main([str(scene), str(file), "-o", str(out)]) == 0
    assert load(out / "fitted.toml").material["rubber"].youngs_modulus == pytest.approx(2e4, 5e-3)


def test_two_that_cannot_be_told_apart_are_refused(folder, capsys):
    """A free body shows its stiffness over its density, neither alone."""
    text = FIT[: FIT.index("[target]")] + DENSITY + FIT[FIT.index("[target]") :]
    scene, file = write_fit(folder, BALL, text)
    out = folder / "pair"
    assert fit.main([str(scene), str(file), "-o", str(out)]) == 2
    told = capsys.readouterr().err.strip()
    assert told.startswith(f"{file}:5: parameter.1: ") or told.startswith(f"{file}:6: parameter.1")
    assert f"{KEY} ({file}:1)" in told and "material.rubber.density" in told
    assert "cannot be told apart" in told and not (out / "fitted.toml").exists()


def test_two_that_can_be_told_apart_are_found(folder):
    """The same two, where a force is measured: the stiffness and the density both show."""
    text = FIT[: FIT.index("[target]")] + DENSITY + FIT[FIT.index("[target]") :]
    text = text.replace('"center_z", "velocity_z"', '"center_z", "momentum_z"')
    scene, file = write_fit(folder, BALL, text)
    out = folder / "both"
    assert fit.main([str(scene), str(file), "-o", str(out)]) == 0
    found = load(out / "fitted.toml").material["rubber"]
    assert found.youngs_modulus == pytest.approx(2e4, rel=1e-2)
    assert found.density == pytest.approx(1000, rel=1e-2)


def test_what_changes_nothing_is_refused(folder, capsys):
    text = FIT.replace(f'"{KEY}"', '"domain.boundary.top.friction"')
    text = text.replace('["4 kPa", "400 kPa"]\ninitial = "200 kPa"', "[0.01, 1]\ninitial = 0.1")
    walls = 'boundary = { default = "slip", top = { kind = "separate", friction = 0.1 } }'
    scene, file = write_fit(folder, BALL.replace('boundary = "slip"', walls), text)
    assert fit.main([str(scene), str(file), "-o", str(folder / "blind")]) == 2
    told = capsys.readouterr().err
    assert told.startswith(f"{file}:2: parameter.0.key: ") and "nothing that the target" in told


class InCells:
    """Runs that are off by so much in u as the cells are large (of the scene's: 1)."""

    def __init__(self, scene, slope):
        self.runs, self.target = SimpleNamespace(scene=scene), SimpleNamespace(stages=1)
        self.purpose, self.slope, self.calls = "", slope, []

    def evaluate(self, points, extra_setting):
        cells = dict(extra_setting.knobs)["cells"]
        self.calls.append((cells, self.purpose))
        return [SimpleNamespace(done=SimpleNamespace(completed=True), cells=int(cells))]

    def residual(self, trial, stage):
        return self.slope * 0.01 * 12 / trial.cells


@pytest.mark.parametrize("grid, count", [("coarser", 6), ("finer", 24)])
def test_cells_have_part_in_the_interval(folder, grid, count):
    """Thrice what the cells of the scene are off by, told by larger ones or by smaller ones, of an
    error that falls with their size (Roache 1994)."""
    slope = np.array([[1.0], [-2.0], [0.5]])
    trials = InCells(load(write_fit(folder, BALL, FIT)[0]), slope[:, 0])
    best = SimpleNamespace(u=(0.5,), cells=12)
    shift, beside = workflow.discretization_shift(trials, best, slope, grid)
    assert beside == count and trials.calls == [(str(count), f"{grid} cells")]
    assert shift == pytest.approx([3 * 0.01])
    assert (
        workflow.discretization_shift(trials, best, slope, "none")[1] is None
        and len(trials.calls) == 1
    )


def test_numbers_that_err_together_count_less(folder):
    """An interval from n numbers, of which so many beside each other err together, is wider by
    their root; by it least squares of smooth noise cover as they should."""
    trials = InCells(
        load(write_fit(folder, BALL, FIT)[0]), np.random.default_rng(0).normal(size=400)
    )
    best = SimpleNamespace(u=(0.5,), cells=12)
    noise = []
    for together in (1.0, 4.0):
        trials.target.correlated_counts = [together]
        noise.append(
            workflow.estimate_uncertainty(trials, best, np.ones((400, 1)), "none").noise_halfwidth[
                0
            ]
        )
    assert noise[1] == pytest.approx(2 * noise[0], rel=0.03)


def test_a_run_in_other_cells_is_told(folder):
    text = FIT.replace('check = "none"', 'check = "finer"')
    scene, file = write_fit(folder, BALL, text)
    assert fit.main([str(scene), str(file), "-o", str(folder / "finer")]) == 0
    last = rows(folder / "finer")[-1]
    assert last["cells"] == "24" and last["purpose"] == "finer cells"
    report = (folder / "finer" / "report.md").read_text()
    assert "from one run with 24 cells along the longest edge instead of 12" in report
    low, high = report.split(f"| {KEY} | ")[1].split(" | ")[1].split(" .. ")
    assert float(low) < 2e4 < float(high)


def test_one_run_that_is_left_tells_nothing_of_a_parameter():
    """Where all others blew up: it is not refused as one that changes nothing."""

    class Left:
        axes, target = [None], SimpleNamespace(stages=1)
        all = {
            k: SimpleNamespace(u=(u,), done=SimpleNamespace(completed=whole), misfit=residual)
            for k, (u, whole, residual) in enumerate([(0.1, False, 9.0), (0.5, True, 1.0)])
        }

        def residual(self, trial, stage):
            return np.array([trial.misfit])

    left = Left()
    assert optimizers.insensitive_parameters(left) == []
    left.all = {**left.all, 2: SimpleNamespace(u=(0.9,), done=left.all[1].done, misfit=1.0)}
    assert optimizers.insensitive_parameters(left) == [0]


def test_axes_go_there_and_back():
    for axis in (
        ParameterAxis("a", 2.0, 200.0, 2.0, "log"),
        ParameterAxis("a", -2.0, 3.0, 0.0, "linear"),
    ):
        for u in (0.0, 0.3, 1.0):
            assert axis.to_unit(axis.from_unit(u)) == pytest.approx(u, abs=1e-12)
    log = ParameterAxis("a", 2.0, 200.0, 2.0, "log")
    assert log.from_unit(0.3 + log.step(0.02)) == pytest.approx(1.02 * log.from_unit(0.3))
    assert log.interval(0.5, log.step(1.0)) == pytest.approx((10, 40))


def test_values_are_found_by_their_keys(folder):
    scene = load(folder / "scene.toml")
    assert value_at(scene, KEY) == 2e4 and value_at(scene, "object.ball.velocity.2") == -1.0
    assert value_at(scene, "object.0.velocity.2") == -1.0
    assert value_at(scene, "object.boll.velocity") is None
    assert np.isfinite(value_at(scene, "time.end"))

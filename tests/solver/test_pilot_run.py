"""A scene played in coarser cells tells the steps of its own, and what they cost where things meet.

Costs are those of one told pace, so that no clock has a say: of the run itself, looked at as often,
and of the rehearsal.
"""

import logging
import math
import re
import time
from types import SimpleNamespace

import numpy as np
import pytest

import vgmpi
from tests.support.small_scenes import write
from vgmpi.commands import cli, run_report
from vgmpi.io.run_reader import RunReader
from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.planning.cost import feature_costs, pilot_result
from vgmpi.planning.cost.feature_costs import step_ns
from vgmpi.planning.cost.pilot_result import CoarseStep, PilotRun, Snapshot
from vgmpi.planning.cost.plan_report import format_plan
from vgmpi.planning.cost.run_estimate import FRAME_SECONDS
from vgmpi.planning.cost.throughput import Throughput
from vgmpi.solver.diagnostics import progress
from vgmpi.solver.estimates import pilot_run as pilot_module
from vgmpi.solver.estimates.pilot_run import _coarse_step, _snapshot, pilot_run
from vgmpi.solver.initial_particles import plan_for, prepare
from vgmpi.solver.run import prepared_run
from vgmpi.solver.run_options import Options

PACE = Throughput(70.0, 80.0, "as told")
FALLS = """
[domain]
size = [0.64, 0.16, 0.32]
cell = 0.016
[time]
end = 0.5
frames = 6
[accuracy]
pressure = "explicit"
precision = "single"
[material.water]
kind = "fluid"
max_speed = 2
[material.rubber]
kind = "elastic"
density = 900
youngs_modulus = 2e4
[[object]]
name = "column"
material = "water"
shape = { box = [[0, 0, 0], [0.16, 0.16, 0.24]] }
[[object]]
name = "block"
material = "rubber"
shape = { box = [[0.4, 0.032, 0], [0.48, 0.128, 0.08]] }
"""
BLOCK = "box = [[0.4, 0.032, 0], [0.48, 0.128, 0.08]]"
CRUMB = "sphere = { center = [0.405, 0.085, 0.095], radius = 0.007 }"
TAP = """
[[inlet]]
name = "tap"
material = "water"
disc = { center = [0.56, 0.08, 0.2], radius = 0.03 }
direction = [0, 0, -1]
speed = 1
"""


def seen(folder, text):
    """The scene, its plan, what a rehearsal shows and what the run itself does (steps, ns)."""
    scene = vgmpi.load(write(folder, text))
    known = prepare(scene, SerialCommunicator(), None)
    plan = plan_for(scene, known)
    spent, done = 0.0, 0
    with prepared_run(scene, SerialCommunicator(), Options(None)) as run:

        def look(run):
            nonlocal spent, done
            simulation = run.simulation
            if run.frame:
                now = _snapshot(
                    scene, plan, known, simulation, simulation.step - done, CoarseStep()
                )
                as_now = plan.with_particles(now.number, now.proximity)
                spent += now.steps * step_ns(scene, as_now, PACE)
                done = simulation.step

        run.options.watchers.append(look)
        run.run()
    return scene, plan, pilot_run(scene, plan, known), done, spent


def at(time, steps):
    return Snapshot(time, steps, (), ())


@pytest.mark.parametrize("text", [FALLS, FALLS + TAP], ids=["falls", "pours"])
def test_steps_and_their_cost_are_those_of_the_run(tmp_path, text):
    scene, plan, found, steps, spent = seen(tmp_path, text)
    assert found.cell > 1.5 * scene.domain.cell
    told, at_the_start = (
        found.work(scene, plan, PACE).sum(),
        steps * step_ns(scene, plan, PACE),
    )
    print(f"steps {found.steps:.0f} of {steps}, cost {told / spent:.3f}", at_the_start / spent)
    assert found.steps == pytest.approx(steps, rel=0.08)
    assert told == pytest.approx(spent, rel=0.2)
    if text is FALLS:
        assert at_the_start < 0.8 * spent  # nothing touches yet
    said = format_plan(scene, plan, 1, pace=PACE, rehearsal=found)
    assert f"about {math.ceil(found.steps):,} for" in said
    seconds = float(re.search(r"time  +about (\d+) s on", said)[1])
    besides = found.mean_overhead(PACE) * found.steps + FRAME_SECONDS * 6
    assert seconds == pytest.approx(1e-9 * told + besides, abs=1)


def test_what_comes_counts_from_when_it_is_there(tmp_path):
    scene, plan, found, *_ = seen(tmp_path, FALLS + TAP)
    comes = [moment.number[2] for moment in found.moments]
    assert comes == sorted(comes) and comes[0] < 0.4 * comes[-1]
    assert comes[-1] == pytest.approx(plan.count[2], rel=0.1)
    assert found.moments[-1].proximity[2].blocks > found.moments[0].proximity[2].blocks


def test_a_fixed_step_gives_its_steps(tmp_path):
    text = FALLS.replace("end = 0.5", "end = 0.1\ndt = 2e-4")
    _, _, found, steps, _ = seen(tmp_path, text)
    assert steps >= 500 and found.steps == pytest.approx(steps, rel=0.05)


FLOATS = """
[accuracy]
pressure = "explicit"
[domain]
size = [0.4, 0.2, 0.2]
cell = 0.02
[time]
end = 0.1
frames = 2
[material.water]
kind = "fluid"
[material.foam]
kind = "elastic"
density = 7e-28
youngs_modulus = 1e6
[[object]]
name = "float"
material = "foam"
rigid = true
shape = { sphere = { center = [0.2, 0.1, 0.15], radius = 0.04 } }
[[object]]
name = "pool"
material = "water"
shape = { box = [[0, 0, 0], [0.4, 0.2, 0.1]] }
"""


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (FALLS.replace("cell = 0.016", "cell = 0.032"), "it has too few cells"),
        (FALLS.replace("0.016", "0.02").replace(BLOCK, CRUMB), "too small or thin"),
        (FALLS + TAP.replace("0.2]", "0.287]"), "the nozzle leaves the domain"),
        (FLOATS, "in cells of 0.0\\d+ m the run ends early"),
    ],
)  # fmt: skip
def test_it_says_why_it_cannot(tmp_path, caplog, text, why):
    scene = vgmpi.load(write(tmp_path, text))
    known = prepare(scene, SerialCommunicator(), None)
    with caplog.at_level("WARNING", "vgmpi"):
        assert pilot_run(scene, plan_for(scene, known), known) is None
    said = "no pilot run in coarser cells is possible"
    assert re.search(f"{said}: (\\S+: \\S+: )?{why}", caplog.text)


def test_it_is_given_up_where_it_takes_too_long(tmp_path, caplog):
    scene = vgmpi.load(write(tmp_path, FALLS))
    known = prepare(scene, SerialCommunicator(), None)
    with caplog.at_level("WARNING", "vgmpi"):
        assert pilot_run(scene, plan_for(scene, known), known, max_seconds=1e-6) is None
    assert caplog.text.count("is possible: it takes more than 1e-06 s") == 1


def test_what_it_reaches_in_its_time_is_enough(tmp_path, monkeypatch):
    """Given up after five of its ten frames, it tells steps and particles of all of the run."""
    text = FALLS.replace("frames = 6", "frames = 11") + TAP
    scene = vgmpi.load(write(tmp_path, text))
    known = prepare(scene, SerialCommunicator(), None)
    plan = plan_for(scene, known)
    whole = pilot_run(scene, plan, known)
    frames, clock = [], time.process_time

    def later(scene, *rest):
        frames.append(1)
        return _coarse_step(scene, *rest)

    monkeypatch.setattr(pilot_module, "_coarse_step", later)
    monkeypatch.setattr(time, "process_time", lambda: clock() + 100.0 * (len(frames) >= 5))
    part = pilot_run(scene, plan, known, max_seconds=50.0)
    assert whole.reached == pytest.approx(0.5) and part.reached == pytest.approx(0.25)
    assert len(part.moments) == 6
    assert part.moments[-1].time == pytest.approx(0.5)
    assert part.steps == pytest.approx(whole.steps, rel=0.1)
    assert part.moments[-1].number[2] > 1.2 * part.moments[-2].number[2]  # the inlet goes on
    said = format_plan(scene, plan, 1, pace=PACE, rehearsal=part)
    assert "; the pilot run was ended at 0.25 of 0.5 s: what meets" in said
    assert "ended at" not in format_plan(scene, plan, 1, pace=PACE, rehearsal=whole)


def test_what_a_step_takes_besides_particles_is_measured(tmp_path):
    """A pilot run with a dearer step tells a dearer run; it cannot be less than nothing."""
    step = CoarseStep(2e-3, 1000.0, 500.0)
    assert step.overhead(PACE) == pytest.approx(2e-3 - 1e-9 * (1000 * 70 + 500 * 80))
    assert step._replace(seconds=0.0).overhead(PACE) == feature_costs.STEP_SECONDS


def test_it_has_room_where_no_coarser_cells_fit(tmp_path):
    """41 by 11 by 23 cells have no coarser ones that divide them all."""
    text = FALLS.replace("[0.64, 0.16, 0.32]", "[0.656, 0.176, 0.368]")
    scene = vgmpi.load(write(tmp_path, text.replace("end = 0.5", "end = 0.1")))
    known = prepare(scene, SerialCommunicator(), None)
    found = pilot_run(scene, plan_for(scene, known), known)
    assert 2.0 <= found.cell / scene.domain.cell <= 2.75


def test_it_is_silent_about_the_coarser_cells(tmp_path, caplog):
    """A wall of 3 cells is less than 2 of the pilot run's."""
    wall = "box = [[0.56, 0, 0], [0.608, 0.16, 0.2]]"
    text = (
        FALLS
        + f'[[object]]\nname = "wall"\nrole = "scenery"\ncollider = true\nshape = {{ {wall} }}\n'
    )
    scene = vgmpi.load(write(tmp_path, text.replace("end = 0.5", "end = 0.02")))
    known = prepare(scene, SerialCommunicator(), None)
    with caplog.at_level("INFO", "vgmpi"):
        assert pilot_run(scene, plan_for(scene, known), known) is not None
        assert caplog.text.count("pilot run in cells of") == 1 and "cells thick" not in caplog.text
        assert logging.getLogger("vgmpi").level == logging.INFO


def test_what_is_ahead_adds_up_to_all_of_it(monkeypatch):
    """100, 200 and 200 steps in turns of .1 s, of 7 ns each."""
    monkeypatch.setattr(pilot_result, "step_ns", lambda scene, plan, pace: 7.0)
    found = PilotRun(0.1, 0.0, (at(0.1, 100.0), at(0.2, 200.0), at(0.3, 200.0)))
    plan = SimpleNamespace(with_particles=lambda count, proximity: None)
    work, often = found.remaining_cost(None, plan, PACE)
    times = np.linspace(0.0, 0.3, 3001)
    assert np.mean([often(time) for time in times]) * 0.3 == pytest.approx(500.0, rel=0.03)
    assert work(0.1) == 7.0 + 1e5 and often(0.3) == often(9.0) == pytest.approx(2000.0)


@pytest.mark.parametrize("flags", [["--check"], ["--prepare"], ["--plan", "--resume"]])
def test_it_is_for_plan_and_from_the_start(tmp_path, capsys, flags):
    with pytest.raises(SystemExit) as ended:
        cli.main([str(write(tmp_path, FALLS)), "--pilot", *flags])
    assert ended.value.code == 2
    assert "--pilot is for a run from the start, or for --plan" in capsys.readouterr().err


def test_nothing_is_written(tmp_path, capsys):
    path = write(tmp_path, FALLS.replace("end = 0.5", "end = 0.05"))
    assert cli.main([str(path), "--plan", "--pilot"]) == 0
    assert list(tmp_path.iterdir()) == [path]
    assert "vgmpi: pilot run in cells of 0.04 m" in capsys.readouterr().err


def test_a_run_tells_its_time_by_it(tmp_path, monkeypatch, capsys):
    """What a run says that is left, and its files, which are those of one without."""
    path = write(tmp_path, FALLS.replace("end = 0.5", "end = 0.05"))
    given = []

    class Seen(progress.Progress):
        def __init__(self, run, quiet, left=None):
            super().__init__(run, quiet, left)
            given.append(left)

    monkeypatch.setattr(run_report, "Progress", Seen)
    assert cli.main([str(path), "--pilot", "-o", str(tmp_path / "with")]) == 0
    assert cli.main([str(path), "-o", str(tmp_path / "without")]) == 0
    assert cli.main([str(path), "--pilot", "-q", "-o", str(tmp_path / "quiet")]) == 0
    assert given[0].steps_per_second(0.02) > 1 and given[1:] == [
        None,
        None,
    ]  # nobody is told, none is played
    one, other = (RunReader(tmp_path / name).frame(-1) for name in ("with", "without"))
    assert all(np.array_equal(one[key], other[key]) for key in one)
    assert capsys.readouterr().err.count("pilot run in cells of") == 1

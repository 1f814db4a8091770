"""What --plan says of steps and precision, and what a run says of the time left."""

import logging
import re
from types import SimpleNamespace

import pytest

import vgmpi
from tests.support.small_scenes import write
from vgmpi.materials import registry
from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.planning.cost.feature_costs import step_ns, step_overhead
from vgmpi.planning.cost.plan_report import format_plan
from vgmpi.planning.cost.run_estimate import (
    FRAME_SECONDS,
    SECONDS_PER_WRITTEN_PARTICLE,
    mean_counts,
    rank_overhead,
)
from vgmpi.planning.cost.throughput import ASSUMED_THROUGHPUT, Throughput
from vgmpi.solver import initial_particles
from vgmpi.solver.diagnostics import progress as report
from vgmpi.solver.initial_particles import plan_for, prepare

SNOWBALL = """
[domain]
size = [0.32, 0.16, 0.16]
cell = 0.02
gravity = [0, 0, 0]
[time]
end = 0.025
frames = 2
[accuracy]
pressure = "explicit"
precision = "single"
[material.snow]
kind = "snow"
youngs_modulus = 1.4e5
hardening_coefficient = 10
max_hardening_factor = 20
[[object]]
name = "ball"
material = "snow"
shape = { sphere = { center = [0, 0, 0], radius = 0.05 } }
position = [0.08, 0.08, 0.03]
velocity = [-6, 0, 0]
"""


def said_of(path):
    scene = vgmpi.load(path)
    plan = plan_for(scene, prepare(scene, SerialCommunicator(), None))
    return format_plan(scene, plan, 1, pace=Throughput(90.0, 126.0, "of a test"))


def test_snow_that_packs_takes_as_many_steps_as_the_plan_says(tmp_path):
    path = write(tmp_path, SNOWBALL)
    said = said_of(path)
    few, many = (
        int(n.replace(",", "")) for n in re.search(r"([\d,]+) to ([\d,]+) for", said).groups()
    )
    assert "where material 'snow' hardens" in said
    assert re.search(r"time +(\d+) s to (\d+) s on", said)
    run = vgmpi.run(vgmpi.load(path), None)
    print(f"{few} to {many} steps said, {run.step} taken")
    assert 1.2 * few < run.step < many


def test_other_laws_take_one_number_of_steps(tmp_path):
    text = SNOWBALL.replace('kind = "snow"', 'kind = "elastic"').replace(
        "hardening_c", "# hardening_c"
    )
    text = text.replace("max_hardening", "# max_hardening")
    said = said_of(write(tmp_path, text.replace("youngs", "density = 400\nyoungs")))
    assert re.search(r"steps +about [\d,]+ for 0.025 s", said) and "hardens" not in said
    assert "precision   single: numbers of 7 digits" in said


def test_a_fixed_step_is_no_range(tmp_path):
    said = said_of(write(tmp_path, SNOWBALL.replace("frames = 2", "frames = 2\ndt = 1e-5")))
    assert "steps       about 2,500 for" in said and "set by time.dt" in said


PLATE = """
[accuracy]
pressure = "explicit"
precision = "double"
[domain]
size = [0.32, 0.16, 0.16]
cell = 0.01
[time]
end = 0.025
[material.rubber]
kind = "elastic"
density = 400
youngs_modulus = 1e5
[material.water]
kind = "fluid"
max_speed = 2
[[object]]
name = "plate"
material = "rubber"
shape = { box = [[-0.06, -0.06, 0], [0.06, 0.06, 0.03]] }
rotation = { axis = "x", angle = "40 deg" }
position = [0.15, 0.08, 0.03]
[[object]]
name = "ball"
material = "rubber"
shape = { sphere = { center = [0.26, 0.08, 0.1], radius = 0.04 } }
"""
POOL = """
[[object]]
name = "pool"
material = "water"
shape = { box = [[0, 0, 0], [0.32, 0.16, 0.02]] }
"""


def test_solids_too_thin_for_fluids_are_named(tmp_path, monkeypatch):
    """However they are turned; where there is nothing to float in, nobody measures them."""
    (line,) = [s for s in said_of(write(tmp_path, PLATE + POOL)).splitlines() if "cells thick" in s]
    found = re.fullmatch(r"  note        plate (\S+) cells thick, under 6: how .* inexact", line)
    assert float(found[1]) == pytest.approx(3.0, abs=0.6)
    monkeypatch.delattr(initial_particles, "_thickness")
    assert "cells thick" not in said_of(write(tmp_path, PLATE))


def line_of(said, name):
    found = [s for s in said.splitlines() if s.startswith(f"  {name} ")]
    return found[0] if found else None


def test_what_motion_restored_costs_is_named(tmp_path):
    """Every two steps by the default of solids, every three at 0.4 cells; not with APIC."""
    line = line_of(said_of(write(tmp_path, PLATE)), "transfer")
    assert "given back every 2 steps" in line and '"apic" takes 0.74 of the time' in line
    shorter = PLATE.replace("end = 0.025", "end = 0.025\ncfl = 0.4")
    line = line_of(said_of(write(tmp_path, shorter)), "transfer")
    assert "given back every 3 steps" in line and '"apic" takes 0.81 of the time' in line
    apic = PLATE.replace("precision", 'transfer = "apic"\nprecision')
    assert line_of(said_of(write(tmp_path, apic)), "transfer") is None


def test_solids_of_few_particles_are_named(tmp_path):
    """Those that bend too easily, not what flows."""
    line = line_of(said_of(write(tmp_path, PLATE + POOL)), "bending")
    assert line.startswith("  bending     8 particles per cell of solids") and "27: 6 %" in line
    finer = PLATE.replace('material = "rubber"', 'material = "rubber"\nparticles_per_cell = 27')
    assert line_of(said_of(write(tmp_path, finer + POOL)), "bending") is None


def test_the_time_left_follows_the_pace_of_now(monkeypatch, caplog):
    """10 s to the middle, and from there ten times as slow."""
    run = SimpleNamespace(
        times=[0.0, 1.0], ranks=SerialCommunicator(), frame=1, simulation=SimpleNamespace(time=0.0),
        plan=SimpleNamespace(has_sources=False),
    )  # fmt: skip
    now = [0.0]
    monkeypatch.setattr(report.time, "monotonic", lambda: now[0])
    progress = report.Progress(run, quiet=False)
    with caplog.at_level(logging.INFO, "vgmpi"):
        for wall in range(1, 101):
            now[0] = float(wall)
            at = 0.05 * wall if wall <= 10 else 0.5 + 0.005 * (wall - 10)
            progress(SimpleNamespace(time=at, step=wall))
    left = [int(re.search(r"(\d+) s left", line)[1]) for line in caplog.messages]
    assert left[0] == 10
    assert left[-1] == pytest.approx(0.05 / 0.005, abs=2)  # from the whole run: 5


def test_the_time_is_that_of_the_processor(tmp_path):
    """With what a step takes beside its particles; ranks share it, but for what faces cost."""
    scene = vgmpi.load(write(tmp_path, PLATE + POOL))
    plan = plan_for(scene, prepare(scene, SerialCommunicator(), None))

    def takes(pace, ranks=1):
        said = format_plan(scene, plan, ranks, pace=pace)
        steps = re.search(r"steps +about ([\d,]+) for", said)[1].replace(",", "")
        line = line_of(said, "time       ")
        what = "what meets, spreads or breaks later may cost more: --pilot finds out how much"
        assert line.endswith(f" s on {ranks} rank(s), one core each, as told; {what}")
        return float(re.search(r"about (\d+) s on", line)[1]), int(steps)

    pace = Throughput(6e3, 8.4e3, "as told")
    seconds, steps = takes(pace)
    written = len(plan.times) * (FRAME_SECONDS + SECONDS_PER_WRITTEN_PARTICLE * plan.particles)
    takes_step = 1e-9 * step_ns(scene, plan, pace) + step_overhead(scene, plan)
    assert seconds == pytest.approx(steps * takes_step + written, abs=1)
    half = takes(Throughput(3e3, 4.2e3, "as told"))[0] - written
    assert half == pytest.approx((seconds - written) / 2, rel=0.03)
    share = (seconds - written) / 4 * rank_overhead(plan, 4)
    four = takes(pace, ranks=4)[0] - len(plan.times) * FRAME_SECONDS
    assert four == pytest.approx(share, rel=0.1)


def test_what_ranks_cost_beside_their_share(tmp_path):
    """Nothing on one rank; surface over volume: half in pieces of eight times the blocks."""
    scene = vgmpi.load(write(tmp_path, PLATE + POOL))
    plan = plan_for(scene, prepare(scene, SerialCommunicator(), None))
    assert rank_overhead(plan, 1) == 1.0
    blocks = sum(around.blocks for around in plan.measures.proximity)
    many = [around._replace(blocks=8 * around.blocks) for around in plan.measures.proximity]
    assert blocks > 0
    small = rank_overhead(plan, 2) - 1.0
    large = rank_overhead(plan.with_particles(plan.count, tuple(many)), 2) - 1.0
    assert large == pytest.approx(small / 2)
    assert rank_overhead(plan, 16) - 1.0 == pytest.approx(small * 2 * (15 / 16) / (1 / 2))


def test_other_laws_go_by_their_cost_beside_an_elastic_one():
    pace = Throughput(20.0, 28.0, "")
    assert pace.law(registry["fluid"](kind="fluid")) == 20.0
    assert pace.law(registry["sand"](kind="sand", youngs_modulus=1e5)) == pytest.approx(50.0)
    for assumed in ASSUMED_THROUGHPUT.values():
        assert assumed.elastic == pytest.approx(assumed.fluid * registry["elastic"].cost)


HELD_BEAM = """
[accuracy]
pressure = "explicit"
[domain]
size = [0.4, 0.2, 0.2]
cell = 0.01
[time]
end = 0.01
[material.rubber]
kind = "elastic"
youngs_modulus = 1e5
[[object]]
name = "beam"
material = "rubber"
shape = { box = [[0.05, 0.05, 0.05], [0.3, 0.1, 0.1]] }
pinned = { box = [[0.04, 0.04, 0.04], [0.08, 0.11, 0.11]], to = "world" }
"""


def test_pinned_particles_count_for_the_part_that_holds_them(tmp_path):
    """3 of the beam's 25 cells are held, of 25 times 8 particles each."""
    text = said_of(write(tmp_path, HELD_BEAM))
    counts = re.findall(r"phase +beam: ([\d,]+ (?:pinned )?particles of \w+)", text)
    assert counts == ["4,400 particles of rubber", "600 pinned particles of rubber"]
    assert re.search(r"\(pinned to world\)/rubber: carried by what holds it +9\.0", text), text


def test_pinned_particles_that_move_cost_more(tmp_path):
    moves = HELD_BEAM.replace('to = "world"', "motion = { velocity = [0, 0, 0.01] }")
    text = said_of(write(tmp_path, moves))
    assert re.search(r"\(pinned to world\)/rubber: carried by what holds it +121\.5", text), text


POURED = (
    HELD_BEAM.replace("end = 0.01", "end = 1")
    + """
[material.water]
kind = "fluid"
max_speed = 2
[[inlet]]
name = "tap"
material = "water"
disc = { center = [0.2, 0.1, 0.17], radius = 0.03 }
speed = 0.5
end_time = 0.4
"""
)


def test_the_time_of_what_pours_onto_bodies_is_a_lower_bound(tmp_path):
    """The inlet is named, unless nothing is below it or a pilot run saw what it meets."""
    line = line_of(said_of(write(tmp_path, POURED)), "time       ")
    assert re.match(r"  time        at least \d+ s on 1 rank", line), line
    assert "what pours from tap costs more where it meets bodies" in line
    line = line_of(said_of(write(tmp_path, HELD_BEAM)), "time       ")
    assert "at least" not in line and "pours" not in line


def test_particles_of_inlets_count_from_when_they_enter(tmp_path):
    """A pour from 0 to 0.4 s of 1 s: four fifths of its particles are there in the mean."""
    scene = vgmpi.load(write(tmp_path, POURED))
    plan = plan_for(scene, prepare(scene, SerialCommunicator(), None))
    beam, water = mean_counts(plan)
    assert beam == plan.count[0]
    assert water == pytest.approx(0.8 * plan.count[1], rel=0.02)

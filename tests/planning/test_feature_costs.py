"""The price of each feature: lines of what the scene has and nothing else, and how bodies stand."""

from dataclasses import astuple, replace

import numpy as np
import pytest

from tests.benchmarks import feature_cost as study
from tests.support import small_scenes
from tests.support.simulate import begin
from vgmpi.planning.cost import feature_costs
from vgmpi.planning.cost.throughput import Throughput
from vgmpi.planning.step_costs import COSTS, StageCost
from vgmpi.preprocess.scene_builder import build_scene
from vgmpi.scene.loader import load
from vgmpi.solver.initial_particles import known_of, plan_for

PACE = Throughput(20.0, 28.0, "of one told")
TANK = """
[domain]
size = [0.32, 0.32, 0.32]
cell = 0.01
[time]
end = 1
[accuracy]
pressure = "explicit"
precision = "single"
transfer = "TRANSFER"
[material.water]
kind = "fluid"
[material.clay]
kind = "elastic"
density = 900
youngs_modulus = 1e5
[material.sand]
kind = "sand"
youngs_modulus = 1e5
[[object]]
name = "pool"
material = "water"
color = "#2040ff"
shape = { box = [[0.06, 0.06, 0.02], [0.26, 0.26, 0.14]] }
"""
BALL = """
[[object]]
name = "ball"
material = "clay"
shape = { sphere = { center = [0.16, 0.16, HEIGHT], radius = 0.04 } }
"""
RIGID_BALL = BALL.replace("HEIGHT", "0.19") + "rigid = true\n"
DYE = """
[[object]]
name = "dye"
material = "water"
color = "#ff2000"
shape = { box = [[0.06, 0.06, 0.14], [0.26, 0.26, 0.18]] }
[appearance]
color_transfer = "step"
"""
BED = """
[[object]]
name = "bed"
material = "sand"
shape = { box = [[0.06, 0.06, 0.02], [0.26, 0.26, 0.06]] }
[[coupling]]
between = ["water", "sand"]
kind = "drag"
hydraulic_conductivity = 1e-3
"""
MILK = """
[material.milk]
kind = "fluid"
[[object]]
name = "milk"
material = "milk"
shape = { box = [[0.06, 0.06, 0.14], [0.26, 0.26, 0.18]] }
[[coupling]]
between = ["water", "milk"]
kind = "mixing"
"""
POST = """
[[object]]
name = "post"
role = "scenery"
collider = true
shape = { box = [[0.27, 0.1, 0.02], [0.3, 0.2, 0.2]] }
"""
WATER = "law fluid", "particle shifting"
MOVES = "motion = { velocity = [0, 0, 0.01] }\n"
PROBE = '[[probe]]\nname = "felt"\ncollider = "post"\nsampling_rate = 10\n'


def planned(folder, more="", transfer="apic"):
    scene = load(small_scenes.write(folder, TANK.replace("TRANSFER", transfer) + more))
    return scene, plan_for(scene, known_of(scene, build_scene(scene)))


def names(folder, more="", transfer="apic"):
    """Of the features of all groups, without what they are by the number."""
    scene, plan = planned(folder, more, transfer)
    found = [feature_costs.group_features(scene, plan, g, PACE) for g in range(len(plan.groups))]
    return [one.name.split(",")[0] for rows in found for one in rows if "blocks of" not in one.name]


@pytest.mark.parametrize(
    ("more", "transfer", "has"),
    [
        ("", "apic", ["law fluid", "particle shifting"]),
        ("", "apic-corrected", ["law fluid", "apic-corrected transfer", "particle shifting"]),
        ("", "aflip", ["law fluid", "aflip transfer", "particle shifting"]),
        (DYE, "apic", ["law fluid", "colors that travel", "particle shifting"]),
        (
            BALL.replace("HEIGHT", "0.19"),
            "apic",
            ["law elastic", "contact", "law fluid", "particle shifting", "contact"],
        ),
        (BED, "apic", [*WATER, "drag", "law sand", "drag"]),
        (MILK, "apic", [*WATER, "mixing", *WATER, "mixing"]),
        (POST, "apic", ["law fluid", "particle shifting", "colliders"]),
        (
            POST + MOVES,
            "apic",
            ["law fluid", "particle shifting", "colliders", "colliders that move"],
        ),
        (
            POST + PROBE,
            "apic",
            ["law fluid", "particle shifting", "colliders", "probes of what colliders give"],
        ),
        (RIGID_BALL, "apic", ["law fluid", "particle shifting", "free rigid bodies"]),
        (
            RIGID_BALL + POST,
            "apic",
            ["law fluid", "particle shifting", "colliders", "free rigid bodies"],
        ),
    ],
)
def test_only_what_the_scene_has_is_priced(tmp_path, more, transfer, has):
    assert names(tmp_path, more, transfer) == has


def test_what_stands_far_away_costs_no_time(tmp_path):
    """Its surface takes memory."""
    scene, plan = planned(tmp_path, BALL.replace("HEIGHT", "0.27"))
    found = {one.name: one for one in feature_costs.group_features(scene, plan, 0, PACE)}
    assert found["contact, none near"][1:] == (StageCost(), 40, 2)


def test_every_byte_and_all_time_is_in_a_line(tmp_path):
    more = BALL.replace("HEIGHT", "0.19") + DYE + BED.replace("1e-3", "1e-2") + POST + PROBE
    scene, plan = planned(tmp_path, more, "apic-corrected")
    total = 0.0
    for g in range(len(plan.groups)):
        found = feature_costs.group_features(scene, plan, g, PACE)
        assert sum(one.bytes for one in found) == plan.bytes_per_particle(g)
        mine = [n for n, of in zip(plan.count, plan.group_of, strict=True) if of == g]
        total += sum(mine) * sum(one.ns for one in found)
    assert feature_costs.step_ns(scene, plan, PACE) == pytest.approx(total)
    lines = feature_costs.feature_table(scene, plan, PACE)
    assert len(lines) == 2 + sum(
        len(feature_costs.group_features(scene, plan, g, PACE)) for g in range(len(plan.groups))
    )
    (line,) = [line for line in lines if "water: law fluid" in line]
    law = [f"{20.0 * share:.1f}" for share in astuple(COSTS.law)]
    assert line.split()[-6:] == ["20.0", *law, "76"]
    mean = lines[-1].split()
    assert mean[:4] == ["mean", "of", "all", "particles"]
    assert float(mean[4]) == pytest.approx(total / plan.particles, abs=0.06)
    assert sum(map(float, mean[5:])) == pytest.approx(total / plan.particles, abs=0.3)
    assert all(len(line) < 100 for line in lines)


def test_surroundings_are_those_of_the_solvers_tables(tmp_path):
    """A ball over a pool beside a post: as many particles as are asked for what contact needs."""
    text = TANK.replace("TRANSFER", "apic") + BALL.replace("HEIGHT", "0.19") + POST
    simulation, made = begin(tmp_path, text)
    scene = load(tmp_path / "scene.toml")
    plan = plan_for(scene, known_of(scene, made))
    tables = simulation.exchange.tables
    for g, group in enumerate(simulation.groups):
        asked = tables.contributes["offsets"][tables.group == g]
        share = group.count[asked].sum() / group.count.sum()
        (k,) = (k for k, of in enumerate(plan.group_of) if of == g)
        (near,), collider = plan.measures.proximity[k].phases, plan.measures.proximity[k].collider
        phase = near.share
        print(f"{group.plan.name}: {share:.3f} asked, {phase:.3f} and {collider:.3f} near")
        assert plan.measures.proximity[k].blocks == len(group.count)
        assert max(phase, collider) <= share + 1e-12 and share <= phase + collider + 1e-12
        assert 0.1 < share < 0.95


def test_what_both_reach_are_the_solvers_blocks_of_nodes(tmp_path):
    """Those of places where more than one phase has some."""
    text = TANK.replace("TRANSFER", "apic") + BALL.replace("HEIGHT", "0.19")
    simulation, made = begin(tmp_path, text)
    scene = load(tmp_path / "scene.toml")
    plan = plan_for(scene, known_of(scene, made))
    tables = simulation.exchange.tables
    shared = int((np.diff(tables.first) > 1).sum())
    for k in range(2):
        (near,) = plan.measures.proximity[k].phases
        assert near.nodes == shared > 10
        code = simulation.groups[plan.group_of[k]].block
        assert 0 < near.blocks <= len(code) == plan.measures.proximity[k].blocks


def test_what_meets_in_thin_blocks_costs_more(tmp_path):
    """The same share of the particles, a quarter of them in each block."""
    scene, plan = planned(tmp_path, BALL.replace("HEIGHT", "0.19"))

    def contact(plan):
        found = {
            one.name.split(",")[0]: one
            for one in feature_costs.group_features(scene, plan, 0, PACE)
        }
        return found["contact"].ns

    fewer = replace(plan, count=tuple(n // 4 for n in plan.count))
    assert contact(fewer) > 2.0 * contact(plan) > 0.0


def test_a_block_that_is_not_full_costs_more(tmp_path):
    thin = TANK.replace("0.14]", "0.03]").replace("TRANSFER", "apic")
    scene = load(small_scenes.write(tmp_path, thin))
    plan = plan_for(scene, known_of(scene, build_scene(scene)))
    (found,) = [
        f for f in feature_costs.group_features(scene, plan, 0, PACE) if "blocks of" in f.name
    ]
    per = plan.particles / plan.measures.proximity[0].blocks
    assert found.ns == pytest.approx(20.0 * COSTS.block.total * (1 / per - 1 / 300))


def test_the_studys_scenes_are_scenes(tmp_path):
    """Both of a pair have the particles that are compared."""
    for feature in study.PAIRS:
        found = []
        for case in (feature.without, feature.having):
            scene = load(small_scenes.write(tmp_path, study.text_of(case, 4096, "single")))
            found.append(len(build_scene(scene).x))
        assert found[0] == found[1] > 1000


def test_the_study_tells_what_a_particle_that_is_near_costs():
    rows = [{"name": "contact", "near": 0.5, "rounds": [[20, 30, 40], [20, 31, 43], [10, 30, 42]]}]
    (line,) = [line for line in study.text(rows).splitlines() if line.startswith("contact")]
    assert line.split()[1:5] == ["30.0", "42.0", "0.50", "1.20"]

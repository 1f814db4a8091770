"""What the cost of a step grows with: phases, colliders, bodies, inlets, and blocks."""

import pytest

import vgmpi
from tests.solver.test_pilot_run import FALLS, PACE, TAP
from tests.support.small_scenes import write
from vgmpi.features.inlets_outlets.plan import INLET_SECONDS
from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.planning.cost import feature_costs
from vgmpi.planning.cost.feature_costs import step_ns
from vgmpi.planning.cost.run_estimate import predicted_seconds
from vgmpi.solver.initial_particles import plan_for, prepare

WALL = """
[[object]]
name = "wall"
role = "scenery"
collider = true
shape = { box = [[0.56, 0, 0], [0.64, 0.16, 0.1]] }
"""
MOVES = WALL + "motion = { velocity = [0, 0, 0.1] }\n"
FREE = """
[[object]]
name = "stone"
material = "rubber"
rigid = true
shape = { box = [[0.24, 0.032, 0], [0.32, 0.128, 0.08]] }
"""


def planned(folder, text):
    scene = vgmpi.load(write(folder, text))
    return scene, plan_for(scene, prepare(scene, SerialCommunicator(), None))


@pytest.mark.parametrize(
    ("more", "seconds"),
    [
        (TAP, INLET_SECONDS),
        (WALL, feature_costs.COLLIDER_SECONDS),
        (MOVES, feature_costs.MOVING_COLLIDER_SECONDS),
        (FREE, feature_costs.MOVING_COLLIDER_SECONDS),
    ],
    ids=["inlet", "collider", "moving", "rigid"],
)
def test_a_step_takes_more_with_everything_in_the_scene(tmp_path, more, seconds):
    alone = feature_costs.step_overhead(*planned(tmp_path, FALLS))
    assert alone == feature_costs.STEP_SECONDS + feature_costs.PHASE_SECONDS  # two phases
    assert feature_costs.step_overhead(*planned(tmp_path, FALLS + more)) == pytest.approx(
        alone + seconds
    )


def test_the_same_particles_in_more_blocks_cost_more(tmp_path):
    scene, plan = planned(tmp_path, FALLS)
    around = tuple(proximity.scaled(4.0) for proximity in plan.measures.proximity)
    spread = plan.with_particles(plan.count, around)
    assert around[0].blocks == 4 * plan.measures.proximity[0].blocks
    assert step_ns(scene, spread, PACE) > 1.5 * step_ns(scene, plan, PACE)
    assert predicted_seconds(scene, spread, 1, PACE) > predicted_seconds(scene, plan, 1, PACE)

"""Joints of free rigid bodies in what flows.

Momentum and angular momentum of jointed bodies are exact, light ones in water are stable, and the
halves of a body that a joint holds together move as the whole one does.
"""

import numpy as np
import pytest

import tests.physics.test_free_bodies as free
from tests.physics.test_joints import box, distances, joint
from tests.support.simulate import begin, by_id
from tests.support.validation_record import held


@pytest.mark.parametrize(
    ("kind", "more"),
    [
        ("hinge", 'axis = "y"\nmotor = { speed = 4, torque = 0.2 }\nlimits = [-0.05, 0.1]'),
        ("slider", 'axis = "z"\nlimits = ["-1 mm", "1 mm"]'),
        ("spring", "to = [0.24, 0.2, 0.3]\nstiffness = 200\ndamping = 1"),
        ("fixed", ""),
    ],
)
def test_momentum_of_jointed_bodies_that_a_drop_hits(tmp_path, kind, more):
    text = free.SPLASH.format(kind="fluid", more="tait_coefficient = 2e4")
    lid = "[[0.2, 0.16, 0.25], [0.26, 0.24, 0.36]]"
    text += free.BODY.format(k=1, bounce=0, shape=f"box = {lid}")
    text += joint(kind, ["block", "body1"], (0.23, 0.2, 0.25), more)
    simulation, _ = begin(tmp_path, text)
    bodies, joints = (
        simulation.features["rigid_bodies"].bodies,
        simulation.features["rigid_bodies"].joints,
    )
    start, before = free.totals(simulation), bodies.momentum.copy()
    while simulation.time < 0.07:
        simulation.advance(simulation.bound())
    end = free.totals(simulation)
    scale = np.abs(start[0]).max()
    assert np.abs(bodies.momentum - before).max(axis=1).min() > 0.01 * scale, "one was not hit"
    assert distances(joints) < 1e-2 * simulation.plan.dx
    for k, (name, arm) in enumerate((("momentum", 1.0), ("angular momentum", 0.2))):
        error = float(np.abs(end[k] - start[k]).max() / (arm * scale))
        held(f"two rigid bodies with a {kind} hit by a drop: {name}", error, 0.0, 1e-12,
             kind="absolute", source="conservation", note="double precision")  # fmt: skip


WHEEL = """
[accuracy]
pressure = "explicit"
[domain]
size = [0.32, 0.16, 0.32]
cell = 0.01
[time]
end = 10
[material.water]
kind = "fluid"
tait_coefficient = 2e4
[material.foam]
kind = "elastic"
density = 100
youngs_modulus = 1e5
[[object]]
name = "pool"
material = "water"
initial_pressure = "hydrostatic"
shape = { box = [[0, 0, 0], [0.32, 0.16, 0.28]] }
[[object]]
name = "wheel"
material = "foam"
rigid = true
angular_velocity = [0, 5, 0]
[[object.shape.union]]
box = [[0.1, 0.04, 0.12], [0.22, 0.12, 0.16]]
[[object.shape.union]]
box = [[0.14, 0.04, 0.08], [0.18, 0.12, 0.2]]
[[joint]]
kind = "hinge"
between = ["wheel"]
at = [0.16, 0.08, 0.14]
axis = "y"
"""


def test_a_light_wheel_in_water_is_stable(tmp_path):
    """A tenth as dense as water: most of its spin goes into the water, and none comes back."""
    simulation, _ = begin(tmp_path, WHEEL)
    bodies, joints = (
        simulation.features["rigid_bodies"].bodies,
        simulation.features["rigid_bodies"].joints,
    )
    apart, spin, lift = 0.0, [], 0.0
    while simulation.time < 0.1:
        dt = simulation.bound()
        simulation.advance(dt)
        apart = max(apart, distances(joints))
        spin.append(abs(bodies.v[0, 4]))
        lift = -joints.rows.impulse[2] / dt
    (v,) = by_id(simulation, "v")
    held("wheel of a tenth of water's density on a hinge in water: largest spin over that before",
         max(spin) / 5, 1.0, 1.0, kind="below", source="no energy comes in")  # fmt: skip
    assert spin[-1] < 1.0 and np.abs(v).max() < 1.0
    assert 0 < lift < 1.2 * 9 * bodies.mass[0] * 9.8
    assert apart < 1e-3 * 0.01


def test_two_halves_in_water_move_as_the_whole(tmp_path):
    """A hundredth as dense as water, so that the water alone says how they accelerate.

    Later their speeds differ by 8 to 14 %: each half has a face at the seam, which nodes see.
    """
    pool = WHEEL[: WHEEL.index('[[object]]\nname = "wheel"')].replace("= 100", "= 10")
    low, middle, high = (0.1, 0.04, 0.08), (0.16, 0.08, 0.1), (0.22, 0.12, 0.12)
    halves = box("a", low, (0.16, 0.12, 0.12), material="foam")
    halves += box("b", (0.16, 0.04, 0.08), high, material="foam")
    speeds = []
    for bodies in (
        box("whole", low, high, material="foam"),
        halves + joint("fixed", ["a", "b"], middle),
    ):
        simulation, _ = begin(tmp_path, pool + bodies)
        for _ in range(4):
            simulation.advance(simulation.bound())
        speeds.append(simulation.features["rigid_bodies"].bodies.v[:, 2].copy())
    held("two halves fixed to each other in water: speed after release over that of the whole",
         float(speeds[1].mean() / speeds[0][0]), 1.0, 0.05, source="the whole body",
         note="density 0.01, after 4 steps")  # fmt: skip
    assert abs(speeds[1][0] - speeds[1][1]) < 0.05 * speeds[0][0]

"""Solids with an implicit elasticity: long waves, momentum, collisions, and beside liquids.

The numbers from outside are the frequency of an axial bar, Archimedes' draught of a ball, and the
sums of momenta.
"""

import numpy as np
import pytest

from tests.physics.test_bar import EXACT, RHO, E, L, frequency_and_step
from tests.support.simulate import advance, begin, by_id, totals
from vgmpi.features.implicit_elasticity import solid_system
from vgmpi.features.implicit_elasticity.kernels import solid_nodes

G, DX = 9.81, 0.01  # [m/s2], [m]
SCENE = """
[domain]
size = [0.24, 0.24, 0.24]
cell = 0.01
boundary = "WALLS"
gravity = [0, 0, GRAVITY]
[time]
end = 4
frames = 3
[accuracy]
ACCURACY
precision = "double"
[material.water]
kind = "fluid"
max_speed = 1.5
[material.rubber]
kind = "elastic"
density = 400
youngs_modulus = 2e4
friction = 0
"""
BALL = """
[[object]]
name = "NAME"
material = "rubber"
velocity = [SPEED, 0, 0]
shape = { sphere = { center = [X, 0.12, Z], radius = 0.05 } }
"""


def scene(*objects, accuracy='pressure = "implicit"', walls="slip", gravity=-G):
    """Text of a scene."""
    text = SCENE.replace("ACCURACY", accuracy).replace("WALLS", walls)
    return text.replace("GRAVITY", str(gravity)) + "".join(objects)


def ball(name, x, z, speed=0.0):
    """A ball of rubber."""
    text = BALL.replace("NAME", name).replace("SPEED", str(speed))
    return text.replace("X,", f"{x},").replace("Z]", f"{z}]")


@pytest.mark.parametrize("number, error", [(1.0, 0.005), (3.0, 0.02)])
def test_long_waves_keep_their_speed(tmp_path, number, error):
    """An axial bar of 32 cells, fixed at one end."""
    keys = f'elasticity = "implicit"\nelastic_courant_number = {number}\n'
    frequency, dt = frequency_and_step(tmp_path, 32, keys)
    assert abs(dt * np.sqrt(E / RHO) / (L / 32) / number - 1) < 0.01
    assert abs(frequency / EXACT - 1) < error


def test_sweeps_keep_momentum_and_answer_as_the_matrix_does():
    """The polynomial of the sweeps is 1 at the eigenvalue 1, and near 1 / eigenvalue up to all."""
    for stiffness in (1e-3, 0.1, 1.0, 4.5, 50.0):
        weights = solid_system.sweep_weights(stiffness)
        eigenvalues = np.linspace(1, 1 + solid_system.MAX_EIGENVALUE * stiffness, 500)
        w = np.zeros_like(eigenvalues)
        for weight in weights:
            w += weight * (1 - eigenvalues * w)
        assert weights[0] == 1
        assert abs(w[0] - 1) < 1e-14
        assert np.abs(w * eigenvalues - 1).max() < 1.01 * solid_system.MAX_ERROR


@pytest.mark.parametrize(
    "keys, energy", [
        ('elasticity = "implicit"', 0.23),
        ('elasticity = "implicit"\nelastic_courant_number = 1', 0.61),
        ("", 0.84),
    ], ids=["3 cells", "1 cell", "explicit"],
)  # fmt: skip
def test_two_balls_collide(tmp_path, keys, energy):
    """Momentum is that before, and energy is not more; this part of it is left."""
    text = scene(
        ball("left", 0.18, 0.12, 0.6), ball("right", 0.3, 0.13, -0.2),
        accuracy=keys, walls="open", gravity=0,
    )  # fmt: skip
    text = text.replace("size = [0.24", "size = [0.48")
    simulation, _ = begin(tmp_path, text)
    before = totals(simulation)
    most = before["energy"]
    while simulation.time < 0.1:
        simulation.advance(simulation.bound())
        most = max(most, totals(simulation)["energy"])
    after = totals(simulation)["momentum"]
    mass = 400 * 4 / 3 * np.pi * 0.05**3
    assert np.abs(after - before["momentum"]).max() < 1e-10 * mass
    assert most < 1.01 * before["energy"]
    assert abs(totals(simulation)["energy"] / before["energy"] - energy) < 0.05
    speeds = [by_id(simulation, "v")[0][:, 0][half].mean() for half in halves(simulation)]
    assert speeds[0] - speeds[1] < 0.1 * 0.8  # they have met, and hardly approach any more


def test_a_drop_meets_a_ball(tmp_path):
    """In empty space: the momentum of both is that before."""
    drop = """
[[object]]
name = "drop"
material = "water"
velocity = [1, 0, 0.2]
shape = { sphere = { center = [0.06, 0.12, 0.12], radius = 0.04 } }
"""
    text = scene(drop, ball("ball", 0.17, 0.13), walls="open", gravity=0)
    simulation, _ = begin(tmp_path, text)
    before = totals(simulation)["momentum"]
    advance(simulation, 0.1)
    after = totals(simulation)["momentum"]
    assert np.abs(after - before).max() < 1e-10 * np.abs(before).max()
    speed = by_id(simulation, "v")[0][:, 0]
    assert speed[halves(simulation)[1]].mean() > 0.2  # the ball has been hit


def test_a_ball_floats(tmp_path):
    """Archimedes' draught to a tenth of a cell, and the water around it is still."""
    water = """
[[object]]
name = "water"
material = "water"
initial_pressure = "hydrostatic"
subtract = true
shape = { box = [[0, 0, 0], [0.24, 0.24, 0.12]] }
"""
    height = np.linspace(-0.05, 0.05, 20001)  # of the center over the level
    wet = np.pi * (0.05 - height) ** 2 * (0.1 + height) / 3
    exact = height[np.argmin(np.abs(wet - 0.4 * 4 / 3 * np.pi * 0.05**3))]
    level = 0.12
    simulation, made = begin(tmp_path, scene(water, ball("ball", 0.12, level + exact)))
    own = made.object == 1
    level = (made.vol0[~own].sum() + 0.4 * made.vol0[own].sum()) / 0.24**2
    heights, speeds = [], []
    while simulation.time < 1.0:
        simulation.advance(simulation.bound())
        x, v = by_id(simulation, "x", "v")
        heights.append(x[own, 2].mean() - level)
        speeds.append(np.sqrt((v[~own] ** 2).sum(1).mean()))
    assert abs(np.mean(heights[len(heights) // 4 :]) - exact) < 0.1 * DX
    assert np.mean(speeds[len(speeds) // 2 :]) < 0.005 * np.sqrt(G * 0.12)


def halves(simulation):
    """Particles of the first object, and of the second one."""
    count = len(by_id(simulation, "v")[0])
    first = simulation.plan.count[0]
    return np.arange(count) < first, np.arange(count) >= first


def test_friction_of_a_wall_slows_a_block_by_coulombs_law(tmp_path):
    """The wall feels the weight of all of it, up to what the sweeps leave."""
    text = scene(accuracy='elasticity = "implicit"').replace(
        "[0.24, 0.24, 0.24]", "[0.4, 0.12, 0.12]"
    )
    text = (
        text.replace(
            'boundary = "slip"',
            'boundary = { default = "slip", bottom = { kind = "separate", friction = 0.3 } }',
        )
        + """
[[object]]
name = "block"
material = "rubber"
velocity = [0.6, 0, 0]
shape = { box = [[0.05, 0.02, 0], [0.13, 0.1, 0.06]] }
"""
    )
    simulation, _ = begin(tmp_path, text)
    for t in (0.05, 0.1, 0.15):
        advance(simulation, t)
        (v,) = by_id(simulation, "v")
        assert 0.6 - v[:, 0].mean() == pytest.approx(0.3 * G * t, rel=0.15)


def test_a_block_between_separating_walls_comes_to_rest(tmp_path):
    """It fills the space between them, and leans in the wind of a sideways gravity.

    Where walls stop single nodes it has a hundred times its energy after these steps.
    """
    block = """
[[object]]
name = "block"
material = "rubber"
shape = { box = [[0.12, 0, 0], [0.18, 0.04, 0.18]] }
"""
    text = scene(block, accuracy='elasticity = "implicit"', walls="WALLS").replace(
        '"WALLS"', '{ bottom = "stick" }'
    )
    text = text.replace("size = [0.24, 0.24, 0.24]", "size = [0.28, 0.04, 0.24]")
    text = text.replace("gravity = [0,", "gravity = [3,").replace("density = 400", "density = 1000")
    text = text.replace("youngs_modulus = 2e4", "youngs_modulus = 1e6")
    simulation, _ = begin(tmp_path, text)
    before = totals(simulation)["energy"]
    for _ in range(420):
        simulation.advance(simulation.bound())
    assert totals(simulation)["energy"] < 1.1 * before
    (v,) = by_id(simulation, "v")
    assert np.abs(v).max() < 0.05


def test_nodes_of_no_mass_do_not_answer_alone():
    """They follow others, and no cell around them has any stiffness."""
    real = np.dtype(np.float32)
    fields = solid_nodes.solid_fields(1, real)
    one, first = np.array([21]), np.array([0, 1])
    ties = solid_nodes.Ties(one, first, one + 1, np.ones(1, real))
    solid_nodes.set_relative_response(np.arange(1), ties, np.zeros(1, real), fields)
    assert fields.relative_response[21] == 0

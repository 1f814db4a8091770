"""Free rigid bodies in a liquid with an implicit pressure: release, floating, momentum, joints.

The numbers from outside are the added mass of a sphere, by images in the walls, Archimedes' draught
and the sums of momenta.
"""

import numpy as np
import pytest

from tests.support.simulate import advance, begin, by_id

G, DX = 9.81, 0.01  # [m/s2], [m]
SCENE = """
[domain]
size = [SIZE, SIZE, HEIGHT]
cell = 0.01
boundary = "slip"
gravity = [0, 0, GRAVITY]
[time]
end = 4
frames = 3
[accuracy]
pressure = "implicit"
precision = "PRECISION"
[material.water]
kind = "fluid"
max_speed = 2
[material.wood]
kind = "elastic"
density = DENSITY
youngs_modulus = "1 GPa"
friction = 0
[[object]]
name = "water"
material = "water"
initial_pressure = "INITIAL"
subtract = true
shape = { box = WATER }
VELOCITY
"""
BODY = """
[[object]]
name = "NAME"
material = "wood"
rigid = true
"""


def scene(body, **values):
    """Text of a scene with water and bodies."""
    text = SCENE + body
    defaults = {
        "GRAVITY": -G, "PRECISION": "single", "INITIAL": "hydrostatic", "VELOCITY": "",
    }  # fmt: skip
    for key, value in (defaults | values).items():
        text = text.replace(key, str(value))
    return text


def bodies_of(simulation):
    """The free bodies of a run."""
    return simulation.features["rigid_bodies"].bodies


def added_mass(radius, edge):
    """Added mass over displaced mass of a sphere at the center of a box that moves along z.

    The images in the walls are dipoles, which point the other way after an odd number of mirrors
    across z (Lamb, Hydrodynamics, articles 92 and 98).
    """
    i = np.arange(-40, 41)
    x, y, z = np.meshgrid(i, i, i, indexing="ij")
    squared = (x * x + y * y + z * z).astype(float)
    squared[40, 40, 40] = np.inf
    terms = (-1.0) ** np.abs(z) * (3 * z * z / squared - 1) / squared**1.5
    field = terms[squared <= 1600].sum() / edge**3
    return 1.5 / (1 + 0.5 * radius**3 * field) - 1


@pytest.mark.parametrize("density", [0.01, 0.1, 2])
def test_a_released_sphere(tmp_path, density):
    """Its acceleration is that of its weight and of its mass with what it moves along."""
    edge, radius = 0.4, 0.08
    ball = BODY + f"shape = {{ sphere = {{ center = [0.203, 0.2, 0.198], radius = {radius} }} }}\n"
    text = scene(ball, SIZE=edge, HEIGHT=edge, DENSITY=1000 * density,
                 WATER=[[0, 0, 0], [edge] * 3])  # fmt: skip
    simulation, _ = begin(tmp_path, text)
    for _ in range(4):
        simulation.advance(simulation.bound())
    exact = G * (1 - density) / (density + added_mass(radius, edge))
    assert abs(bodies_of(simulation).v[0, 2] / simulation.time / exact - 1) < 0.03


@pytest.mark.parametrize("offset, limit", [(0.0, 0.1), (-0.005, 0.25)], ids=["rest", "bobs"])
def test_a_block_floats(tmp_path, offset, limit):
    """At half its height in the water: begun there, and half a cell too deep, on the mean."""
    low = 0.095 + offset
    block = BODY + f"shape = {{ box = [[0.05, 0.05, {low}], [0.19, 0.19, {low + 0.05}]] }}\n"
    text = scene(block, SIZE=0.24, HEIGHT=0.24, DENSITY=500, WATER=[[0, 0, 0], [0.24, 0.24, 0.12]])
    simulation, _ = begin(tmp_path, text)
    bodies, heights = bodies_of(simulation), []
    while simulation.time < 1.0:
        simulation.advance(simulation.bound())
        heights.append(bodies.x[0, 2])
    assert abs(np.mean(heights) - 0.12) < limit * DX
    assert max(np.abs(np.array(heights) - 0.12)) < abs(offset) + 0.1 * DX


def test_a_stone_lies_on_the_floor(tmp_path):
    """The water around it comes to rest: the floor holds it while the pressure is found."""
    stone = BODY + "shape = { box = [[0.08, 0.08, 0], [0.16, 0.16, 0.06]] }\n"
    text = scene(stone, SIZE=0.24, HEIGHT=0.24, DENSITY=3000, WATER=[[0, 0, 0], [0.24, 0.24, 0.12]])
    simulation, _ = begin(tmp_path, text)
    times, speeds = [], []
    while simulation.time < 0.3:
        simulation.advance(simulation.bound())
        times.append(simulation.time)
        speeds.append(np.sqrt((by_id(simulation, "v")[0] ** 2).sum(1).mean()))
    # after the stone has met the floor, by 0.04 s, and come to rest; 0.017 if it is never known
    assert max(speeds[np.searchsorted(times, 0.1) :]) < 0.005 * np.sqrt(G * 0.12)


@pytest.mark.parametrize("viscosity", ["explicit", "implicit"])
@pytest.mark.parametrize("domain", ["[domain]", "[domain]\nambient_pressure = 300"])
def test_momentum(tmp_path, domain, viscosity):
    """Of a drop that hits a tilted block in empty space and slides off it, to rounding."""
    block = (
        BODY
        + """
rotation = { axis = [1, 2, 0], angle = "25 deg" }
position = [0.12, 0.12, 0.08]
shape = { box = [[-0.05, -0.04, -0.02], [0.05, 0.04, 0.02]] }
"""
    )
    text = scene(block, SIZE=0.24, HEIGHT=0.24, DENSITY=200, GRAVITY=0, PRECISION="double",
                 INITIAL="zero", VELOCITY="velocity = [0.1, 0, -1]",
                 WATER=[[0.09, 0.09, 0.12], [0.15, 0.14, 0.18]])  # fmt: skip
    if viscosity == "implicit":
        text = text.replace("[accuracy]", '[accuracy]\nviscosity = "implicit"')
        text = text.replace("max_speed = 2", "max_speed = 2\nviscosity = 5")
    simulation, _ = begin(tmp_path, text.replace("[domain]", domain))
    bodies = bodies_of(simulation)

    def total():
        v, volume = by_id(simulation, "v", "vol0")
        return 1000.0 * (v * volume.reshape(-1, 1)).sum(0) + bodies.momentum.sum(0)

    before = total()
    advance(simulation, 0.085)  # it reaches the domain's walls soon after
    assert bodies.v[0, 2] < -0.1  # it was hit
    np.testing.assert_allclose(total(), before, rtol=0, atol=1e-10 * np.abs(before).max())


def test_joined_halves_are_one_body(tmp_path):
    """A block, and two parts of it that a joint holds together, rise alike."""
    whole = BODY + "shape = { box = [[0.08, 0.08, 0.07], [0.16, 0.16, 0.15]] }\n"
    low, high = BODY.replace("NAME", "low"), BODY.replace("NAME", "high")
    parts = (
        low + "shape = { box = [[0.08, 0.08, 0.07], [0.13, 0.16, 0.15]] }\n"
        + high + "shape = { box = [[0.13, 0.08, 0.07], [0.16, 0.16, 0.15]] }\n"
        + '[[joint]]\nkind = "fixed"\nbetween = ["low", "high"]\nat = [0.13, 0.12, 0.11]\n'
    )  # fmt: skip
    found = []
    for body in (whole, parts):
        water = [[0, 0, 0], [0.24, 0.24, 0.18]]
        simulation, _ = begin(
            tmp_path, scene(body, SIZE=0.24, HEIGHT=0.24, DENSITY=300, WATER=water)
        )
        for _ in range(8):
            simulation.advance(0.004)
        bodies = bodies_of(simulation)
        found.append((bodies.mass @ bodies.v[:, :3]) / bodies.mass.sum())
    alone, joined = found
    np.testing.assert_allclose(joined, alone, rtol=0, atol=0.02 * alone[2])
    np.testing.assert_allclose(*bodies.v[:, 3:], rtol=0, atol=1e-5)  # they turn as one
    arm = np.array([0.04, 0.0, 0.0])  # [m] between their centers
    turn = np.cross(bodies.v[0, 3:], arm)
    np.testing.assert_allclose(bodies.v[1, :3] - bodies.v[0, :3], turn, rtol=0, atol=1e-4)

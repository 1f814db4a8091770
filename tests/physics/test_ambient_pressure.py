"""Suction that liquids bear with an implicit pressure: ceilings, lifted plates, full boxes.

The numbers from outside are those of free fall, hydrostatics and Poiseuille's flow.
"""

import numpy as np
import pytest

from tests.support.dense_multigrid import dense_values
from tests.support.simulate import advance, begin, by_id, totals
from tests.support.small_scenes import scene
from vgmpi.runtime.config.schema import SceneError

G = 9.8  # [m/s2]
SCENE = """
[domain]
size = SIZE
cell = 0.01
AMBIENT
[time]
end = 1
frames = 3
[accuracy]
pressure = "implicit"
KEYS
[material.water]
kind = "fluid"
max_speed = 2
viscosity = 1e-3
[[object]]
name = "water"
material = "water"
shape = WATER
"""
COLLIDER = """
[[object]]
name = "collider"
role = "scenery"
collider = true
SLIP
shape = SHAPE
"""
AIR = "ambient_pressure = 101325"


def filled(text, **places):
    """Text in which values replace names in capitals; a box is written as its two corners."""
    for name, value in places.items():
        text = text.replace(name, value if isinstance(value, str) else f"{{ box = {value} }}")
    return text


def pressures(simulation, dt):
    """Pressures [Pa] of the cells that have one."""
    stage = simulation.features["implicit_pressure"]
    phi, fill = (
        dense_values(stage.solver, values, 1) for values in (stage.fields.phi, stage.fields.filled)
    )
    unit = stage.liquids.mass_of_cell / simulation.plan.dx / dt
    return unit * phi[fill > 0] / fill[fill > 0]


def lowest_pressure(simulation, end):
    """Lowest pressure [Pa] of all cells in the steps until a time [s]."""
    lowest = np.inf
    while simulation.time < end:
        dt, sorts = simulation.bound(), simulation.sorts
        simulation.advance(dt)
        if simulation.sorts == sorts:
            lowest = min(lowest, pressures(simulation, dt).min())
    return lowest


ROOF = filled(
    SCENE + COLLIDER, SIZE="[0.16, 0.08, 0.44]", WATER=[[0, 0, 0.28], [0.16, 0.08, 0.40]],
    SHAPE=[[-0.1, -0.1, 0.40], [0.3, 0.2, 0.6]], KEYS="",
)  # fmt: skip


@pytest.mark.parametrize(
    "ambient, slip, falls",
    [
        ("", "", True),
        ("ambient_pressure = 0", "", True),
        ("ambient_pressure = 0", "slip_length = 0", True),
        (AIR, "", False),
        ("", "slip_length = 0", False),
        (AIR, "slip_length = 0", False),
    ],
)
def test_water_below_a_roof(tmp_path, ambient, slip, falls):
    """It falls freely and gains no energy, or hangs, where it wets the roof or air presses."""
    simulation, _ = begin(tmp_path, filled(ROOF, AMBIENT=ambient, SLIP=slip))
    start, energy = by_id(simulation, "x")[0][:, 2].mean(), totals(simulation)["energy"]
    lowest = lowest_pressure(simulation, 0.1)
    x, v = by_id(simulation, "x", "v")
    time = simulation.time if falls else 0
    assert v[:, 2].mean() == pytest.approx(-G * time, abs=0.01)
    assert v[:, 2].std() < 0.01
    assert start - x[:, 2].mean() == pytest.approx(0.5 * G * time**2, rel=0.1, abs=0.001)
    if falls:
        assert lowest > -5
        assert totals(simulation)["energy"] < energy
    else:
        assert lowest == pytest.approx(-1000 * G * 0.12, rel=0.2)


def test_water_that_hits_a_slip_wall_of_the_domain(tmp_path):
    """Such a wall is a plane of symmetry: it holds water, but for the suction that water bears."""
    places = {"SIZE": "[0.16, 0.08, 0.40]", "WATER": [[0, 0, 0.28], [0.16, 0.08, 0.40]]}
    for ambient, speed in (("", 0.0), (AIR, 0.0), ("ambient_pressure = 0", -G * 0.1)):
        text = filled(SCENE, KEYS="", AMBIENT=ambient, **places)
        simulation, _ = begin(tmp_path, text)
        advance(simulation, 0.1)
        (v,) = by_id(simulation, "v")
        assert v[:, 2].mean() == pytest.approx(speed, rel=0.05, abs=0.01)


PLATE = filled(
    SCENE + COLLIDER, SIZE="[0.32, 0.08, 0.32]", KEYS="",
    WATER='{ box = [[0, 0, 0], [0.32, 0.08, 0.12]] }\nsubtract = true\n'
    'initial_pressure = "hydrostatic"',
    SHAPE='{ box = [[0.08, -0.1, 0.115], [0.24, 0.2, 0.16]] }\n'
    "motion = { keyframes = [{ time = 0.05 }, { time = 0.3, translation = [0, 0, 0.125] }] }",
)  # fmt: skip


@pytest.mark.parametrize(
    "ambient, pressure", [("", 0), ("ambient_pressure = 3000", 3000), (AIR, 101325)]
)
def test_a_plate_that_is_lifted_off_water(tmp_path, ambient, pressure):
    """Water stays where it is, or follows as far as its surroundings press it up."""
    simulation, _ = begin(tmp_path, filled(PLATE, AMBIENT=ambient, SLIP=""))
    lowest = lowest_pressure(simulation, 0.15)
    assert lowest > -1.02 * pressure - 5
    x, v = by_id(simulation, "x", "v")
    lifted = np.mean(x[:, 2] > 0.13)
    if pressure == 0:
        assert lifted == 0
        assert np.sqrt((v**2).sum(1).mean()) < 0.03
    elif pressure > 1e5:
        assert lifted > 0.03
        assert lowest < -1000


HOLLOW = """{ difference = [
  { box = [[-0.1, -0.1, -0.1], [0.4, 0.2, 0.4]] },
  { box = [[0.04, -0.2, 0.04], [0.20, 0.3, 0.20]] },
] }"""


@pytest.mark.parametrize("ambient", ["", "ambient_pressure = 0", AIR])
def test_a_full_box_does_not_tear(tmp_path, ambient):
    """Its water stays at rest at any pressure, also where gravity is that of a box that moves."""
    gravity = "\ngravity = [6, 0, -9.8]"
    text = filled(
        SCENE + COLLIDER, SIZE="[0.24, 0.08, 0.24]", WATER=[[0.04, 0, 0.04], [0.2, 0.08, 0.2]],
        SHAPE=HOLLOW, KEYS="", SLIP="", AMBIENT=ambient + gravity,
    )  # fmt: skip
    simulation, _ = begin(tmp_path, text)
    lowest = lowest_pressure(simulation, 0.2)
    assert lowest < -500  # of a pressure that is known but for a constant
    assert not simulation.features["implicit_pressure"].suction.is_open.any()
    assert np.sqrt((by_id(simulation, "v")[0] ** 2).sum(1).mean()) < 0.003


def test_oil_in_a_level_pipe_keeps_its_profile(tmp_path):
    """Poiseuille's, along a pipe to which it sticks, in air: no cell opens."""
    radius, viscosity = 0.06, 20.0
    text = filled(
        SCENE + COLLIDER, SIZE="[0.84, 0.18, 0.18]", AMBIENT=AIR + f"\ngravity = [{G}, 0, 0]",
        KEYS='viscosity = "implicit"', SLIP="slip_length = 0",
        WATER=f"{{ cylinder = {{ endpoints = [[0.04, 0.09, 0.09], [0.68, 0.09, 0.09]], radius = {radius} }} }}",  # noqa: E501
        SHAPE=f"""{{ difference = [
  {{ box = [[-0.5, -0.1, -0.1], [1.5, 0.3, 0.3]] }},
  {{ cylinder = {{ endpoints = [[-0.6, 0.09, 0.09], [1.6, 0.09, 0.09]], radius = {radius} }} }},
] }}""",
    )  # fmt: skip
    simulation, _ = begin(tmp_path, text.replace("viscosity = 1e-3", f"viscosity = {viscosity}"))
    advance(simulation, 0.25)
    x, v = by_id(simulation, "x", "v")
    r = np.hypot(x[:, 1] - 0.09, x[:, 2] - 0.09)
    middle = np.abs(x[:, 0] - np.median(x[:, 0])) < 0.1
    want = 1000 * G * (radius**2 - np.minimum(r[middle], radius) ** 2) / (4 * viscosity)
    assert (v[middle, 0] * want).sum() / (want**2).sum() == pytest.approx(1, abs=0.03)
    assert np.sqrt(np.mean((v[middle, 0] - want) ** 2)) < 0.03 * want.max()
    assert not simulation.features["implicit_pressure"].suction.is_open.any()


def test_without_colliders_and_key_nothing_is_solved_again(tmp_path):
    """A scene without such contact takes no part in it."""
    text = filled(SCENE, SIZE="[0.16, 0.08, 0.16]", WATER=[[0, 0, 0], [0.1, 0.08, 0.1]])
    simulation, _ = begin(tmp_path, filled(text, KEYS="", AMBIENT=""))
    assert simulation.features["implicit_pressure"].suction is None


def test_the_key_needs_an_implicit_pressure(tmp_path):
    """With an explicit one, the law of the liquid says what tension it bears."""
    text = filled(SCENE, SIZE="[0.16, 0.08, 0.16]", WATER=[[0, 0, 0], [0.1, 0.08, 0.1]])
    text = filled(text, KEYS="", AMBIENT=AIR).replace('"implicit"', '"explicit"')
    with pytest.raises(SceneError, match=r"domain.ambient_pressure: needs accuracy.pressure"):
        begin(tmp_path, text)
    assert scene(tmp_path, text).domain.ambient_pressure == 101325

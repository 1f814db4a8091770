"""Liquids that stick to colliders, with an implicit pressure.

The numbers from outside are those of Couette's and Poiseuille's flows, of the momentum, and of the
liquid in a dish. Tolerances: 1 % of a shear rate, 5 % of a flow between plates
four widths long, 3 % of one in a pipe seven diameters long.
"""

import numpy as np
import pytest

from tests.physics import test_poiseuille, test_surface_slip
from tests.physics.test_implicit_pressure_colliders import DAM, DISC, G, probes
from tests.physics.test_surface_slip import MIDDLE, OMEGA
from tests.support.simulate import advance, begin, by_id
from tests.support.validation_record import held

IMPLICIT = 'pressure = "implicit"\n'
PRESSURE, BOTH = (f'{IMPLICIT}viscosity = "{name}"\n' for name in ("explicit", "implicit"))
EACH_VISCOSITY = pytest.mark.parametrize(
    "keys", [PRESSURE, BOTH], ids=["explicit viscosity", "implicit viscosity"]
)


def name_of(keys):
    """Name of the keys in rows of results."""
    return "implicit pressure and viscosity" if keys == BOTH else "implicit pressure"


def test_shear_between_a_wall_and_a_lid_that_turns(tmp_path):
    """Both hold the liquid; the lid lies among the nodes."""
    high = 0.0945
    text = test_surface_slip.plates(0.0, high, "slip_length = 0").split("[[probe]]")[0]
    floor, lid = text.index('[[object]]\nname = "floor"'), text.index('[[object]]\nname = "lid"')
    text = (text[:floor] + text[lid:]).replace("[accuracy]\n", "[accuracy]\n" + BOTH)
    wall = 'cell = 0.01\nboundary = { default = "slip", bottom = "stick" }\n'
    text = text.replace("cell = 0.01\n", wall).replace("viscosity = 50", "viscosity = 200")
    simulation, _ = begin(tmp_path, text)
    advance(simulation, 0.1)
    x, v = by_id(simulation, "x", "v")
    r = np.hypot(x[:, 0] - MIDDLE, x[:, 1] - MIDDLE)
    inner = (r > 0.02) & (r < 0.07)
    turn = (x[:, 0] - MIDDLE) * v[:, 1] - (x[:, 1] - MIDDLE) * v[:, 0]
    spin = turn[inner] / r[inner] ** 2 / OMEGA
    slope, start = np.polyfit(x[inner, 2] / high, spin, 1)
    case = f"wall and turning lid that honey sticks to, {name_of(BOTH)}"
    held(f"{case}: shear rate", float(slope), 1.0, 0.01, source="Couette")
    held(f"{case}: turning at the wall", float(start), 0.0, 0.01, kind="absolute", source="no slip")


HALF, ANGLE, MU = 0.06, 17.0, 60.0  # [m], [deg], [Pa s]
CHANNEL = f"""
[domain]
size = [0.5, 0.04, 0.72]
cell = 0.01
[time]
end = 1
[accuracy]
KEYS
[material.oil]
kind = "fluid"
density = 1000
viscosity = {MU}
max_speed = 1
[[object]]
name = "oil"
material = "oil"
shape = {{ box = [[-{HALF}, -0.02, -0.2], [{HALF}, 0.02, 0.28]] }}
TURNED
[[object]]
name = "left"
role = "scenery"
collider = true
slip_length = 0
shape = {{ box = [[-0.4, -0.1, -0.6], [-{HALF}, 0.1, 0.6]] }}
TURNED
[[object]]
name = "right"
role = "scenery"
collider = true
slip_length = 0
shape = {{ box = [[{HALF}, -0.1, -0.6], [0.4, 0.1, 0.6]] }}
TURNED
"""
TURNED = f"""rotation = {{ axis = "y", angle = "{ANGLE} deg" }}
origin = [0.25, 0.02, 0.36]
"""


@EACH_VISCOSITY
def test_flow_between_oblique_plates(tmp_path, keys):
    """Poiseuille's flow from rest to the steady one, along plates 12 cells apart."""
    text = CHANNEL.replace("KEYS", keys).replace("TURNED", TURNED)
    simulation, _ = begin(tmp_path, text)
    c, s = np.cos(np.radians(ANGLE)), np.sin(np.radians(ANGLE))
    top = 1000 * G * c * HALF**2 / (2 * MU)
    for time in (0.5, 2.5) if keys == PRESSURE else (2.5,):  # its steps are long
        advance(simulation, time * 1000 * HALF**2 / MU)
        x, v = by_id(simulation, "x", "v")
        x = x - [0.25, 0.02, 0.36]
        across, along = c * x[:, 0] - s * x[:, 2], s * x[:, 0] + c * x[:, 2]
        assert np.abs(across).max() < HALF + 0.005
        middle = np.abs(along - np.median(along)) < 0.04
        u = -(s * v[:, 0] + c * v[:, 2])[middle]
        want = top * test_poiseuille.starting(across[middle] / HALF, time)
        held(
            f"flow between oblique plates after {time} h2/nu, {name_of(keys)}",
            float((u * want).sum() / (want**2).sum()), 1.0, 0.05, unit="of the speed",
            source=test_poiseuille.BIRD + "sections 2.3, 4.1", note="12 cells",
        )  # fmt: skip
        assert np.sqrt(np.mean((u - want) ** 2)) < 0.05 * top


RADIUS, LONG, OIL = 0.06, 0.84, 20.0  # [m], [m], [Pa s]
PIPE = f"""
[domain]
size = [0.18, 0.18, {LONG + 0.24}]
cell = 0.01
[time]
end = 1
[accuracy]
KEYS
[material.oil]
kind = "fluid"
density = 1000
viscosity = {OIL}
max_speed = 1
[[object]]
name = "oil"
material = "oil"
shape = {{ cylinder = {{ endpoints = [[0.09, 0.09, 0.2], [0.09, 0.09, {LONG + 0.2}]], radius = {RADIUS} }} }}
[[object]]
name = "pipe"
role = "scenery"
collider = true
slip_length = 0
shape = {{ difference = [
  {{ box = [[-0.05, -0.05, -0.05], [0.23, 0.23, 1.5]] }},
  {{ cylinder = {{ endpoints = [[0.09, 0.09, -0.2], [0.09, 0.09, 1.6]], radius = {RADIUS} }} }},
] }}
"""  # noqa: E501


@pytest.mark.parametrize(
    "keys",
    [pytest.param(PRESSURE, marks=pytest.mark.slow), BOTH],
    ids=["explicit viscosity", "implicit viscosity"],
)
def test_oil_that_falls_in_a_pipe(tmp_path, keys):
    """The steady profile holds; with an explicit pressure the oil tears and falls freely."""
    simulation, _ = begin(tmp_path, PIPE.replace("KEYS", keys))
    for time in (0.2, 0.4):
        advance(simulation, time)
        x, v = by_id(simulation, "x", "v")
        r = np.hypot(x[:, 0] - 0.09, x[:, 1] - 0.09)
        assert r.max() < RADIUS + 0.01
        middle = np.abs(x[:, 2] - np.median(x[:, 2])) < 0.1
        u = -v[middle, 2]
        want = 1000 * G * (RADIUS**2 - np.minimum(r[middle], RADIUS) ** 2) / (4 * OIL)
        held(
            f"oil that sticks to a pipe after {time} s, {name_of(keys)}",
            float((u * want).sum() / (want**2).sum()), 1.0, 0.03, unit="of the speed",
            source=test_poiseuille.BIRD + "section 2.3", note="12 cells in diameter",
        )  # fmt: skip
        assert np.sqrt(np.mean((u - want) ** 2)) < 0.03 * want.max()


def test_what_honey_loses_walls_and_colliders_take(tmp_path):
    """Momentum of honey that breaks around a disc to which it sticks: all reactions and gravity."""
    text = DAM + DISC.replace("0.32, ", "0.2, ") + "slip_length = 0\n"
    text += probes(collider="collider")
    text = text.replace('kind = "fluid"', 'kind = "fluid"\nviscosity = 20')
    text = text.replace(IMPLICIT, IMPLICIT + 'precision = "double"\n')
    simulation, _ = begin(tmp_path, text)
    advance(simulation, 0.2)
    v, volume = by_id(simulation, "v", "vol0")
    momentum = 1000 * (v * volume.reshape(-1, 1)).sum(0)
    weight = 1000 * volume.sum() * np.array([0, 0, -G])
    taken = simulation.features["reactions"].totals[:, :3].sum(0)
    scale = np.abs(weight * simulation.time).max()
    np.testing.assert_allclose(momentum, weight * simulation.time + taken, atol=1e-6 * scale)


DISH = """
[domain]
size = [0.40, 0.40, 0.32]
cell = 0.02
boundary = "open"
[time]
end = 1
[accuracy]
pressure = "implicit"
[material.water]
kind = "fluid"
max_speed = 2
[[object]]
name = "water"
material = "water"
shape = { box = [[0.12, 0.12, 0.1], [0.28, 0.28, 0.22]] }
[[object]]
name = "dish"
role = "scenery"
collider = true
shape = { difference = [
  { box = [[LOW, LOW, BOTTOM], [HIGH, HIGH, 0.3]] },
  { box = [[0.12, 0.12, 0.1], [0.28, 0.28, 0.5]] },
] }
"""


@pytest.mark.parametrize("cells", [2, 2.5, 3])
def test_a_thin_dish_holds_water(tmp_path, cells):
    """Nothing is pressed through its floor and sides, beyond which there is air."""
    places = {"LOW": 0.12, "HIGH": 0.28, "BOTTOM": 0.1}
    text = DISH
    for name, place in places.items():
        wall = 0.02 * cells * (1 if name == "HIGH" else -1)
        text = text.replace(name, f"{place + wall:g}")
    simulation, _ = begin(tmp_path, text)
    advance(simulation, 1.0)
    (x,) = by_id(simulation, "x")
    assert len(x) == 8**2 * 6 * 8
    assert x[:, 2].min() > 0.1 - 0.015
    assert np.abs(x[:, :2] - 0.2).max() < 0.08 + 0.015


TRAY = """
[domain]
size = [0.72, 0.6, 0.72]
cell = 0.012
boundary = { default = "open", bottom = "stick" }
[time]
end = 2
[accuracy]
pressure = "implicit"
[material.honey]
preset = "honey"
kind = "fluid"
max_speed = 3
[[object]]
name = "tray"
role = "scenery"
collider = true
slip_length = 0
[object.shape]
difference = [
  { box = [[0.1, 0.09, 0], [0.62, 0.51, 0.16]] },
  { box = [[0.14, 0.13, 0.04], [0.58, 0.47, 0.4]] },
]
[[inlet]]
name = "jet"
material = "honey"
disc = { center = [0.27, 0.3, 0.62], radius = 0.035 }
speed = 0.9
"""


@pytest.mark.slow
def test_a_jet_of_honey_on_a_tray(tmp_path):
    """Nothing is faster than the jet as it lands: what gets into the tray does not speed up.

    Where the velocity of nodes is continued from 1.5 cells inside, drops there have 6 m/s.
    """
    simulation, _ = begin(tmp_path, TRAY)
    landing, fastest = np.sqrt(0.9**2 + 2 * G * 0.58), 0.0
    while simulation.time < 0.9:
        simulation.advance(simulation.bound())
        fastest = max(fastest, np.sqrt((by_id(simulation, "v")[0] ** 2).sum(1).max()))
    assert fastest < 1.05 * landing

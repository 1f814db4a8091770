"""Thin walls keep apart what lies on their two sides, and feel its pressure.

A plate stands across a tank, with water or sand on one side or on both, or moves into it; a cup is
carried and turned. No particle may end beyond the face of its own side. The force of water at rest
is rho g (h1^2 - h2^2) / 2 per width of the plate: 10 %, as the levels are uncertain by half a cell.
"""

import numpy as np
import pytest

from tests.support.simulate import advance, begin, by_id

DX, G, DENSITY, WIDTH = 0.01, 9.8, 1000.0, 0.04  # [m], [m/s2], [kg/m3], [m]
CREEP = 0.1  # [cells] by which particles may be inside a wall
TANK = """
[accuracy]
pressure = "explicit"
[domain]
size = [{size}, 0.04, 0.32]
cell = 0.01
boundary.default = "slip"
gravity = [0, 0, -9.8]
[time]
end = 1
[material.water]
kind = "fluid"
density = 1000
max_depth = 0.24
max_compression = 0.02
[material.sand]
kind = "sand"
preset = "dry sand"
[[object]]
name = "plate"
role = "scenery"
collider = true
thin = {thin}
shape = {{ box = [[{low}, -0.1, -0.1], [{high}, 0.2, 0.5]] }}
{motion}
[[probe]]
name = "plate"
sampling_rate = 100
collider = "plate"
"""
BODY = """
[[object]]
name = "{name}"
material = "{material}"
{pressure}
shape = {{ box = [[{start}, 0, 0], [{stop}, 0.04, {depth}]] }}
"""
MOVING = 'motion = { velocity = ["-0.2 m/s", 0, 0] }'
CUP = """
[accuracy]
pressure = "explicit"
[domain]
size = [0.4, 0.24, 0.4]
cell = 0.01
boundary.default = "slip"
gravity = [0, 0, -9.8]
[time]
end = 1
[material.water]
kind = "fluid"
density = 1000
max_depth = 0.16
max_compression = 0.02
[material.sand]
kind = "sand"
preset = "dry sand"
[[object]]
name = "cup"
role = "scenery"
collider = true
thin = true
shape = {{ difference = [
  {{ cylinder = {{ endpoints = [[0.16, 0.12, {bottom}], [0.16, 0.12, 0.28]], radius = {outer} }} }},
  {{ cylinder = {{ endpoints = [[0.16, 0.12, 0.06], [0.16, 0.12, 0.4]], radius = 0.08 }} }},
] }}
[object.motion]
pivot = [0.16, 0.12, 0.14]
axis = "y"
keyframes = [
  {{ time = 0.1, translation = [0, 0, 0], angle = 0 }},
  {{ time = 0.5, translation = [0.08, 0, 0.02], angle = "25 deg" }},
  {{ time = 0.9, translation = [0.04, 0, 0], angle = 0 }},
]
[[object]]
name = "content"
material = "{material}"
shape = {{ cylinder = {{ endpoints = [[0.16, 0.12, 0.06], [0.16, 0.12, 0.15]], radius = 0.08 }} }}
"""


def slow(*values):
    return pytest.param(*values, marks=pytest.mark.slow)


def tank(cells, wall, depths, material="water", motion="", thin=True, middle=None) -> str:
    """A tank so many cells long with a plate across it and depths [cells] on both sides."""
    middle = (middle or cells / 2 + 0.3) * DX
    low, high = middle - wall * DX / 2, middle + wall * DX / 2
    text = TANK.format(
        size=cells * DX, low=low, high=high, motion=motion, thin="true" if thin else "false"
    )
    pressure = 'initial_pressure = "hydrostatic"' if material == "water" else ""
    ends = (("left", 0.0, low), ("right", high, cells * DX))
    for (name, start, stop), depth in zip(ends, depths, strict=True):
        if depth:
            text += BODY.format(
                name=name, material=material, pressure=pressure, start=start, stop=stop,
                depth=depth * DX,
            )  # fmt: skip
    return text


def lost(simulation, made, wall: float, middle: float) -> int:
    """Number of particles deeper than CREEP within the plate, or beyond it."""
    (x,) = by_id(simulation, "x")
    names = np.array([thing["name"] for thing in made.objects])[made.object]
    beyond = np.where(names == "left", 1.0, -1.0) * (x[:, 0] - middle) / DX
    return int((beyond > CREEP - wall / 2).sum())


def force_on_plate(simulation, end: float) -> float:
    """Mean force [N] along x in the last half of the time from now to `end` [s]."""
    start = simulation.time
    advance(simulation, 0.5 * (start + end))
    before, since = -simulation.features["reactions"].totals[0, 0], simulation.time
    advance(simulation, end)
    return (-simulation.features["reactions"].totals[0, 0] - before) / (simulation.time - since)


@pytest.mark.parametrize(
    "wall, depths, cells, end",
    [(0.5, (24, 12), 16, 0.3)]
    + [slow(wall, depths, 40, 1.0) for wall in (2, 1, 0.5) for depths in ((24, 0), (24, 12))],
)
def test_a_plate_holds_water_and_feels_its_weight(tmp_path, wall, depths, cells, end):
    simulation, made = begin(tmp_path, tank(cells, wall, depths))
    theory = DENSITY * G * (depths[0] ** 2 - depths[1] ** 2) / 2 * DX**2 * WIDTH
    force = force_on_plate(simulation, end)
    print(f"plate of {wall} cells, {depths}: force over theory {force / theory:.3f}")
    assert lost(simulation, made, wall, (cells / 2 + 0.3) * DX) == 0
    assert force == pytest.approx(theory, rel=0.1)


@pytest.mark.parametrize("wall, end", [(0.5, 0.2), slow(2, 0.8), slow(1, 0.8), slow(0.5, 0.8)])
def test_nothing_passes_a_plate_that_moves_into_water(tmp_path, wall, end):
    middle = 36.3
    text = tank(40, wall, (16, 0), motion=MOVING, middle=middle)
    simulation, made = begin(tmp_path, text)
    advance(simulation, end)
    assert lost(simulation, made, wall, middle * DX - 0.2 * end) == 0


@pytest.mark.slow
def test_without_the_key_water_passes_half_a_cell(tmp_path):
    text = tank(40, 0.5, (16, 0), motion=MOVING, middle=36.3, thin=False)
    simulation, made = begin(tmp_path, text)
    advance(simulation, 0.8)
    (x,) = by_id(simulation, "x")
    assert (x[:, 0] > 0.363 - 0.16 + 0.25 * DX).sum() > 100


@pytest.mark.slow
@pytest.mark.parametrize("wall", [2, 1, 0.5])
def test_a_plate_holds_sand(tmp_path, wall):
    simulation, made = begin(tmp_path, tank(24, wall, (24, 0), material="sand"))
    advance(simulation, 1.0)
    assert lost(simulation, made, wall, 12.3 * DX) == 0


@pytest.mark.parametrize(
    "wall, material, end",
    [(0.5, "water", 0.25)]
    + [slow(wall, material, 1.0) for wall in (1, 0.5) for material in ("water", "sand")],
)
def test_a_cup_that_is_carried_and_turned_loses_nothing(tmp_path, wall, material, end):
    text = CUP.format(bottom=0.06 - wall * DX, outer=0.08 + wall * DX, material=material)
    simulation, _ = begin(tmp_path, text)
    advance(simulation, end)
    simulation.collider_nodes.place(simulation.time)
    table = simulation.collider_nodes.table
    (x,) = by_id(simulation, "x")
    own = (x - table.about[0] - table.move[0]) @ table.rotation[0] + table.about[0]
    r = np.hypot(own[:, 0] - 0.16, own[:, 1] - 0.12)
    assert r.max() < 0.08 + CREEP * DX
    assert own[:, 2].min() > 0.06 - CREEP * DX

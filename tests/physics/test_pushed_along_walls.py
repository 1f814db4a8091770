"""What a collider or a body with prescribed motion pushes along a wall stays ahead of it.

A plate that reaches beyond the walls sweeps a channel: with friction or without slip on the walls,
nothing may get into the plate or behind it. Tolerance: 0.6 cells, the reach of a particle's stencil
beyond its own cell; a particle that walls hold back is more than a cell inside after a sweep of ten
cells.
"""

import numpy as np
import pytest

from tests.support.simulate import advance, begin, by_id

CELL = 0.02
SCENE = """
[accuracy]
pressure = "explicit"
precision = "double"
[domain]
size = {size}
cell = 0.02
boundary = {{ default = {walls} }}
[time]
end = 1
[material.stuff]
{stuff}
[[object]]
name = "bed"
material = "stuff"
shape = {{ box = {bed} }}
[[object]]
name = "plate"
role = "scenery"
collider = true
shape = {{ box = {plate} }}
motion = {{ velocity = {velocity}, end_time = "0.4 s" }}
"""
SAND, WATER = 'kind = "sand"', 'kind = "fluid"\nmax_speed = "2 m/s"'
ROUGH = '{ kind = "separate", friction = 0.5 }'
ROUGHER = ROUGH.replace("0.5", "1.5")
# material, walls, whether the channel lies along y
CASES = {
    "sand": (SAND, ROUGH, False),
    "sand along y": (SAND, ROUGH, True),
    "sand, much friction": (SAND, ROUGHER, False),
    "sand without slip": (SAND, '"stick"', False),
    "water without slip": (WATER, '"stick"', False),
}


def box(low, high, turned):
    order = [1, 0, 2] if turned else [0, 1, 2]
    return [[corner[a] for a in order] for corner in (low, high)]


@pytest.mark.parametrize("name", CASES)
def test_nothing_gets_into_a_plate_that_sweeps_a_channel(tmp_path, name):
    stuff, walls, turned = CASES[name]
    text = SCENE.format(
        stuff=stuff, walls=walls, size=box([0.6, 0.12, 0.2], [0] * 3, turned)[0],
        bed=box([0.1, 0, 0], [0.6, 0.12, 0.08], turned),
        plate=box([-0.08, -0.08, -0.08], [0.08, 0.2, 0.3], turned),
        velocity=box([0.5, 0, 0], [0] * 3, turned)[0],
    )  # fmt: skip
    simulation, made = begin(tmp_path, text)
    advance(simulation, 0.4)
    (x,) = by_id(simulation, "x")
    along = x[:, 1 if turned else 0]
    assert len(x) == len(made.x)
    assert (0.08 + 0.2 - along).max() < 0.6 * CELL
    assert along.max() > 0.55 and x[:, 2].max() > 0.12  # it was pushed together


def test_a_closed_drum_with_a_blade_keeps_all_its_sand(tmp_path):
    """The blade turns with the drum; the sand is poured over it, and it is cut out."""
    text = """
[accuracy]
pressure = "explicit"
precision = "double"
[domain]
size = [0.36, 0.36, 0.16]
cell = 0.02
[time]
end = 1
[material.sand]
kind = "sand"
[[object]]
name = "bed"
material = "sand"
subtract = ["drum"]
shape = { cylinder = { endpoints = [[0.18, 0.18, 0], [0.18, 0.18, 0.16]], radius = 0.12 } }
[[object]]
name = "drum"
role = "scenery"
collider = true
motion = { angular_velocity = "30 rpm", axis = "z", pivot = [0.18, 0.18, 0.08] }
[object.shape]
union = [
  { difference = [
    { cylinder = { endpoints = [[0.18, 0.18, -0.1], [0.18, 0.18, 0.26]], radius = 0.17 } },
    { cylinder = { endpoints = [[0.18, 0.18, -0.2], [0.18, 0.18, 0.36]], radius = 0.12 } },
  ] },
  { box = [[0.155, 0, -0.1], [0.205, 0.16, 0.26]] },
]
"""
    simulation, made = begin(tmp_path, text)
    blade = made.colliders[0].distance(made.x)
    assert blade.min() >= 0.0
    advance(simulation, 0.5)
    (x,) = by_id(simulation, "x")
    assert len(x) == len(made.x)
    radius = np.hypot(x[:, 0] - 0.18, x[:, 1] - 0.18)
    assert radius.max() < 0.12 + 0.5 * CELL

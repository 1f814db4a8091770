"""A soft ball that hits a wall or a collider faster than its contact layer can carry stays outside.

The layer of contact is as soft as two and a half cells and carries a tenth of the modulus
(LAYER_MAX_OVERLAP in kernels/grid/contact_impulses.py). Plane waves reach rho c v: at a third of
the wave speed more than that. Beyond it no node on the surface or a cell behind it may approach. A
particle half a cell beyond a wall of the domain ends the run. Both boundaries follow one rule.
"""

import pytest

from tests.support.simulate import advance, begin, by_id
from tests.support.validation_record import held

CELL, RADIUS, SIDE, COLLIDER_TOP = 0.01, 0.055, 0.24, 0.04
WAVE_SPEED = 16.4  # [m/s] of the rubber below: sqrt((1 - nu) E / (1 + nu) / (1 - 2 nu) / rho)
MAX_DEPTH = 0.4  # [cells]
SCENE = """
[domain]
size = [0.24, 0.24, 0.24]
cell = 0.01
boundary = {{ default = "open", bottom = {bottom} }}
[time]
end = 0.06
[material.rubber]
kind = "elastic"
density = 1000
youngs_modulus = 2e5
poisson_ratio = 0.3
friction = 0.6
[[object]]
name = "ball"
material = "rubber"
velocity = [0, 0, {speed}]
shape = {{ sphere = {{ center = [0.12, 0.12, {z}], radius = 0.055 }} }}
"""
COLLIDER = """
[[object]]
name = "floor"
role = "scenery"
collider = true
friction = 0.4
shape = { box = [[0, 0, 0], [0.24, 0.24, 0.04]] }
"""


def lowest_particle(folder, on, speed):
    """Least height [cells] of any particle above the floor during an impact at a speed [m/s]."""
    top, bottom = 0.0, '{ kind = "separate", friction = 0.4 }'
    if on == "collider":
        top, bottom = COLLIDER_TOP, '"open"'
    text = SCENE.format(bottom=bottom, speed=-speed, z=round(top + RADIUS + 1.8 * CELL, 9))
    simulation, _ = begin(folder, text + COLLIDER * (on == "collider"))
    lowest = SIDE
    for k in range(1, 61):
        advance(simulation, 1.8 * CELL / speed + k / 60 * 1.5 * 2 * RADIUS / WAVE_SPEED)
        (x,) = by_id(simulation, "x")
        lowest = min(lowest, x[:, 2].min() - top)
    return lowest / CELL


@pytest.mark.parametrize("on", ["wall", "collider"])
@pytest.mark.parametrize("share", [0.33, 0.9])
def test_stays_outside(tmp_path, on, share):
    depth = -lowest_particle(tmp_path, on, share * WAVE_SPEED)
    held(
        f"soft ball hits a {on} at {share} of its wave speed: deepest particle", depth, 0.0,
        MAX_DEPTH, kind="below", unit="cells", source="outside", note="ball of 5.5 cells in radius",
    )  # fmt: skip

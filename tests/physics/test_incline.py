"""A block on an incline: contact with Coulomb friction, held to Newton and Coulomb.

Theory: a = g (sin angle - mu cos angle) while it slides, 0 where mu > tan angle. Gravity is tilted
instead of the floor, which is a `separate` wall, the top of a box collider that lies between nodes,
or the top of an elastic slab. A block of 6 x 4 x 4 cells, gravity grows within .05 s, so that it
does not bounce; elastic shear has come to rest when creep is counted. Tolerance: 1 % of the
acceleration; creep below .01 cells in .7 s. Single precision.
"""

import numpy as np
import pytest

from tests.support.simulate import advance, begin, by_id
from tests.support.validation_record import held

DX, G, ANGLE = 0.02, 9.8, np.radians(30.0)  # tan 30 deg = .577
SCENE = """
[domain]
size = [0.8, 0.16, 0.24]
cell = 0.02
gravity = [{along!r}, 0, {down!r}]
gravity_ramp_time = 0.05
boundary = {{ default = "slip", bottom = {floor} }}
[time]
end = 1
[accuracy]
precision = "single"
[material.rubber]
kind = "elastic"
density = {density}
youngs_modulus = 5e5
friction = {mu}
[material.base]
kind = "elastic"
density = 1000
youngs_modulus = 5e5
friction = 0
[[object]]
name = "block"
material = "rubber"
shape = {{ box = [[0.1, 0.04, {low!r}], [0.22, 0.12, {high!r}]] }}
"""
COLLIDER = """
[[object]]
name = "incline"
role = "scenery"
collider = true
shape = { box = [[-0.1, -0.1, -0.1], [1.0, 0.26, 0.046]] }
"""
SLAB = """
[[object]]
name = "incline"
material = "base"
shape = { box = [[0, 0, 0], [0.8, 0.16, 0.04]] }
"""
# where the block stands, and what is below it
FLOORS = {"wall": (0.0, ""), "collider": (0.046, COLLIDER), "slab": (0.04, SLAB)}


def slide(folder, floor, mu, end, density=1000):
    """Times (n,) [s], the block's mean speed (n,) [m/s] and position (n,) [m] down the incline."""
    low, below = FLOORS[floor]
    wall = f'{{ kind = "separate", friction = {mu} }}' if floor == "wall" else '"stick"'
    text = SCENE.format(
        along=float(G * np.sin(ANGLE)), down=float(-G * np.cos(ANGLE)), floor=wall, mu=mu,
        low=low, high=low + 0.08, density=density,
    )  # fmt: skip
    simulation, made = begin(folder, text + below)
    block = made.object == 0
    rows = []
    while simulation.time < end - 1e-9:
        advance(simulation, simulation.time + 0.01)
        x, v = by_id(simulation, "x", "v")
        rows.append((simulation.time, v[block, 0].mean(), x[block, 0].mean()))
    return np.array(rows).T


@pytest.mark.parametrize("floor", FLOORS)
@pytest.mark.parametrize("mu", [0.0, 0.3])
def test_slides(tmp_path, floor, mu):
    t, u, _ = slide(tmp_path, floor, mu, 0.35)
    late = t > 0.15
    found = np.polyfit(t[late], u[late], 1)[0]
    held(
        f"block on an incline, {floor}, friction {mu}",
        found,
        float(G * (np.sin(ANGLE) - mu * np.cos(ANGLE))),
        0.01,
        unit="m/s2",
        source="a = g (sin - mu cos)",
        note="30 deg, block of 6 x 4 x 4 cells",
        curves={"speed [m/s]": (t, u)},
        axes=("time [s]", "speed [m/s]"),
    )


@pytest.mark.parametrize("floor", FLOORS)
def test_sticks(tmp_path, floor):
    """Friction .6, 4 % above the limit."""
    t, _, x = slide(tmp_path, floor, 0.6, 1.0)
    creep = np.abs(x[t > 0.3] - x[t <= 0.3][-1]).max() / DX
    held(
        f"block on an incline, {floor}, creep below the limit",
        creep,
        0.0,
        0.01,
        kind="absolute",
        unit="cells",
        source="it sticks for mu > tan",
        note="30 deg, friction 0.6, within 0.7 s",
    )


def test_heavier_than_the_slab(tmp_path):
    """What slides must not depend on which of the two is heavier: 6.1 kg on 5.1 kg."""
    t, u, _ = slide(tmp_path, "slab", 0.3, 0.35, density=8000)
    late = t > 0.15
    held(
        "block on an incline, heavier than the slab, friction 0.3",
        np.polyfit(t[late], u[late], 1)[0],
        float(G * (np.sin(ANGLE) - 0.3 * np.cos(ANGLE))),
        0.01,
        unit="m/s2",
        source="a = g (sin - mu cos)",
        note="the larger body gives the normals, not the heavier one",
    )

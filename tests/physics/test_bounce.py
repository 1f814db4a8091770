"""A rubber ball jumps off a wall, a rigid collider and a slab: held to Hertz.

Theory: a sphere of mass m and radius R that meets a flat of a much larger mass at the speed v is
pressed in by delta = (15 m v^2 / (16 E* sqrt(R)))^(2/5), 1 / E* the sum of (1 - nu^2) / E over
both, stays for 2.94 delta / v, and leaves with v but for what is left in waves (Johnson, Contact
Mechanics, sections 4.2 and 11.4). No gravity; at .3 m/s the ball is pressed in by a tenth of its
radius. It touches when the force is 2 % of its largest. The wall is `separate`, the collider lies
between nodes (at 4.6 cells), the slab is as thick as the ball's radius and four times as stiff.
Tolerances: the gap at which it touches .3 cells, contact time 10 % of Hertz at 16 cells in radius,
restitution .9 at 8 and at 16. Single precision.
"""

import numpy as np
import pytest

from tests.support.rigid_kinematics import middle
from tests.support.simulate import begin
from tests.support.validation_record import held

DX, SPEED, YOUNG, NU, STIFF = 0.01, 0.3, 1e5, 0.3, 4e5
SCENE = """
[domain]
size = [{long!r}, {long!r}, {high!r}]
cell = 0.01
gravity = [0, 0, 0]
boundary = {{ default = "slip", bottom = {floor} }}
[time]
end = 10
[accuracy]
precision = "single"
[material.rubber]
kind = "elastic"
density = 1000
youngs_modulus = 1e5
poisson_ratio = 0.3
friction = 0
[material.hard]
kind = "elastic"
density = 1000
youngs_modulus = 4e5
poisson_ratio = 0.3
friction = 0
[[object]]
name = "ball"
material = "rubber"
velocity = [0, 0, -0.3]
shape = {{ sphere = {{ center = [{half!r}, {half!r}, {z!r}], radius = {radius!r} }} }}
"""
BELOW = """
[[object]]
name = "floor"
{role}
shape = {{ box = [[0, 0, 0], [{long!r}, {long!r}, {top!r}]] }}
"""
# where its top is, the ball's radius if None, and what it is
FLOORS = {
    "wall": (0.0, ""),
    "collider": (0.046, 'role = "scenery"\ncollider = true'),
    "slab": (None, 'material = "hard"'),
}


def hertz(radius, on):
    """(how deep the ball is pressed in [m], how long it stays [s])."""
    soft = (1 - NU**2) / YOUNG + ((1 - NU**2) / STIFF if on == "slab" else 0.0)
    mass = 4 / 3 * np.pi * radius**3 * 1000
    deep = (15 * mass * SPEED**2 * soft / (16 * np.sqrt(radius))) ** 0.4
    return deep, 2.94 * deep / SPEED


def bounce(folder, cells, on):
    """Times (n,) [s] of the steps, and speeds (n,) [m/s] upwards of the ball's middle, which begins
    a cell above what it meets."""
    radius, (top, role) = round(cells * DX, 9), FLOORS[on]
    top = radius if top is None else top
    long, high = (_blocks(s) for s in (2 * radius + 0.04, 2 * radius + top + 0.05))
    floor = '{ kind = "separate" }' if on == "wall" else '"stick"'
    z = round(radius + top + DX, 9)
    text = SCENE.format(long=long, high=high, floor=floor, half=long / 2, z=z, radius=radius)
    if role:
        text += BELOW.format(role=role, long=long, top=top)
    simulation, made = begin(folder, text)
    rows = [(0.0, -SPEED)]
    while simulation.time < DX / SPEED + 2 * hertz(radius, on)[1]:
        simulation.advance(simulation.bound())
        rows.append((simulation.time, middle(simulation, made, "ball")[1][2]))
    return np.array(rows).T


def _blocks(size):
    """A length [m] that is no shorter than size and whole blocks of 4 cells."""
    return round(float(np.ceil(size / DX / 4 - 1e-9)) * 4 * DX, 9)


@pytest.mark.parametrize("cells", [8, pytest.param(16, marks=pytest.mark.slow)])
@pytest.mark.parametrize("on", FLOORS)
def test_jumps_off(tmp_path, on, cells):
    t, u = bounce(tmp_path, cells, on)
    force = np.diff(u) / np.diff(t)
    pressed = np.flatnonzero(force > 0.02 * force.max())
    begins, ends = t[pressed[0]], t[pressed[-1]]
    stays = hertz(cells * DX, on)[1]
    say = {
        "source": "Johnson, Contact Mechanics, section 11.4",
        "note": f"ball of {cells} cells in radius, 0.3 m/s",
    }
    case = f"ball of {cells} cells on a {on}"
    held(f"{case}: gap at contact", (DX - SPEED * begins) / DX, 0.0, 0.3,
         kind="absolute", unit="cells", **say)  # fmt: skip
    if cells == 16:
        held(f"{case}: contact time", ends - begins, float(stays), 0.1, unit="s", **say)
    held(f"{case}: restitution", u[-1] / SPEED, 1.0, 0.9, kind="above", **say,
         curves={"speed upwards": (t, u)}, axes=("time [s]", "speed [m/s]"))  # fmt: skip
    assert u[-1] <= SPEED

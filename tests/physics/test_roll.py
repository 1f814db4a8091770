"""A cylinder that slides or rolls down an incline, held to Newton, Euler and Coulomb.

Theory: of a full cylinder, I = m R^2 / 2, on an incline with friction mu: while mu < tan(angle) / 3
it slides with a = g (sin - mu cos) and turns faster by 2 mu g cos / R, beyond that it rolls with
a = 2/3 g sin and v = omega R (Landau and Lifshitz, Mechanics, section 39). Gravity is tilted by
20 deg over a `separate` wall, the top of a box collider that lies between nodes (at 4.6 cells), or
the top of an elastic slab of 4 cells; a slice of 4 cells between slip walls. Rolling, what is
pressed ahead must give back behind all it took, and all points of contact brake or drive.
Tolerances: acceleration and v over omega R 3 %, spin 10 % of 8 cells and 5 % of 16. Single
precision.
"""

import numpy as np
import pytest

from tests.held import held
from tests.simulate import advance, begin
from tests.turning import middle, spin

DX, G, ANGLE, END = 0.01, 9.81, np.radians(20.0), 0.5
SLIDES, ROLLS = 0.1, 0.5  # friction; tan(20 deg) / 3 = .12
SCENE = """
[domain]
size = [{long!r}, 0.04, {high!r}]
cell = 0.01
gravity = [{along!r}, 0, {down!r}]
boundary = {{ default = "slip", floor = {floor} }}
[time]
end = 10
[accuracy]
precision = "single"
[material.rubber]
kind = "elastic"
density = 1000
youngs_modulus = 1e6
poisson_ratio = 0.3
friction = {mu}
[[object]]
name = "wheel"
material = "rubber"
shape = {{ cylinder = {{ ends = [[{x!r}, 0, {z!r}], [{x!r}, 0.04, {z!r}]], radius = {radius!r} }} }}
"""
BELOW = """
[[object]]
name = "incline"
{role}
shape = {{ box = [[0, 0, 0], [{long!r}, 0.04, {top!r}]] }}
"""
FLOORS = {
    "wall": (0.0, ""),
    "collider": (0.046, 'role = "scenery"\ncollider = true'),
    "slab": (0.04, 'material = "rubber"'),
}
SHORT = ["wall", "collider", pytest.param("slab", marks=pytest.mark.slow)]


def exact(mu, radius):
    """Acceleration [m/s2] and that of the spin [rad/s2]."""
    if mu < np.tan(ANGLE) / 3:
        push = mu * G * np.cos(ANGLE)
        return float(G * np.sin(ANGLE) - push), float(2 * push / radius)
    return float(2 / 3 * G * np.sin(ANGLE)), float(2 / 3 * G * np.sin(ANGLE) / radius)


def roll(folder, cells, on, mu):
    """Times (n,) [s], speeds (n,) [m/s] and spins (n,) [rad/s] of a cylinder of so many cells in
    radius."""
    radius, (top, role) = round(cells * DX, 9), FLOORS[on]
    far = 0.5 * exact(mu, radius)[0] * END**2
    long, high = (_blocks(s) for s in (far + 2 * radius + 0.08, 2 * radius + top + 0.03))
    floor = f'{{ kind = "separate", friction = {mu} }}' if on == "wall" else '"stick"'
    text = SCENE.format(
        long=long, high=high, along=float(G * np.sin(ANGLE)), down=float(-G * np.cos(ANGLE)),
        floor=floor, mu=mu, x=radius + 0.0313, z=radius + top, radius=radius,
    )  # fmt: skip
    if role:
        text += BELOW.format(role=role, long=long, top=top)
    simulation, made = begin(folder, text)
    rows = []
    for time in np.linspace(0, END, 26)[1:]:
        advance(simulation, float(time))
        speed = middle(simulation, made, "wheel")[1][0]
        rows.append((time, speed, spin(simulation, made, "wheel", "y")))
    return np.array(rows).T


def _blocks(size):
    """A length [m] that is no shorter than size and whole blocks of 4 cells."""
    return round(float(np.ceil(size / DX / 4 - 1e-9)) * 4 * DX, 9)


def rates(t, u, w):
    """Accelerations of speed and spin, after the wheel has settled."""
    late = t > 0.3 * END
    return np.polyfit(t[late], u[late], 1)[0], np.polyfit(t[late], w[late], 1)[0]


def noted(cells, t, u, w):
    return {
        "source": "Newton and Euler, full cylinder",
        "note": f"{cells} cells in radius, 20 deg",
        "curves": {"speed [m/s]": (t, u), "omega R [m/s]": (t, w * cells * DX)},
        "axes": ("time [s]", "speed [m/s]"),
    }


@pytest.mark.parametrize("on", SHORT)
def test_slides_and_turns(tmp_path, on):
    t, u, w = roll(tmp_path, 8, on, SLIDES)
    along, turn = rates(t, u, w)
    say, (a, alpha) = noted(8, t, u, w), exact(SLIDES, 8 * DX)
    held(f"cylinder sliding on a {on}: acceleration", along, a, 0.03, unit="m/s2", **say)
    held(f"cylinder sliding on a {on}: spin", turn, alpha, 0.1, unit="rad/s2", **say)


@pytest.mark.parametrize("on", SHORT)
def test_rolls(tmp_path, on):
    t, u, w = roll(tmp_path, 8, on, ROLLS)
    along, turn = rates(t, u, w)
    say, (a, alpha) = noted(8, t, u, w), exact(ROLLS, 8 * DX)
    held(f"cylinder rolling on a {on}: acceleration", along, a, 0.03, unit="m/s2", **say)
    held(f"cylinder rolling on a {on}: spin", turn, alpha, 0.1, unit="rad/s2", **say)
    ratio = u[-1] / (w[-1] * 8 * DX)
    held(f"cylinder rolling on a {on}: v over omega R", ratio, 1.0, 0.03, **say)


@pytest.mark.slow
@pytest.mark.parametrize("mu", [SLIDES, ROLLS])
def test_on_a_finer_grid(tmp_path, mu):
    """What slides is known to be turned too little still: by 6 % at 16 cells."""
    t, u, w = roll(tmp_path, 16, "wall", mu)
    along, turn = rates(t, u, w)
    say, (a, alpha) = noted(16, t, u, w), exact(mu, 16 * DX)
    way = "sliding" if mu == SLIDES else "rolling"
    held(f"cylinder {way} on a wall, 16 cells: acceleration", along, a, 0.03, unit="m/s2", **say)
    held(f"cylinder {way} on a wall, 16 cells: spin", turn, alpha, 0.05, unit="rad/s2", **say,
         expected=mu == ROLLS)  # fmt: skip

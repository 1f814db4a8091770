"""Of a body in a simulation: where its middle is, how fast that goes, and how fast it turns. A
cylinder that slides or rolls down an incline, which may move along itself.
"""

import numpy as np

from tests.support.simulate import advance, begin
from vgmpi.solver.restart.state_io import by_id

PLANES = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}
DX, G, ANGLE, END = 0.01, 9.81, np.radians(20.0), 0.5
SLIDES, ROLLS = 0.1, 0.5  # friction; tan(20 deg) / 3 = .12
SCENE = """
[domain]
size = [{long!r}, 0.04, {high!r}]
cell = 0.01
gravity = [{along!r}, 0, {down!r}]
boundary = {{ default = "slip", bottom = {floor} }}
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
shape.cylinder = {{ endpoints = [[{x!r}, 0, {z!r}], [{x!r}, 0.04, {z!r}]], radius = {radius!r} }}
"""
BELOW = """
[[object]]
name = "incline"
{role}
shape = {{ box = [[{west!r}, 0, 0], [{east!r}, 0.04, {top!r}]] }}
"""
FLOORS = {
    "wall": (0.0, ""),
    "collider": (0.046, 'role = "scenery"\ncollider = true'),
    "slab": (0.04, 'material = "rubber"'),
}


def middle(simulation, made, name) -> tuple[np.ndarray, np.ndarray]:
    """Centre of mass (3,) [m] of the body of that name, and its velocity (3,) [m/s]."""
    x, v, volume = _of(simulation, made, name, "x", "v", "vol0")
    share = volume[:, None] / volume.sum()
    return (share * x).sum(axis=0), (share * v).sum(axis=0)


def spin(simulation, made, name, axis) -> float:
    """Angular momentum over moment of inertia [rad/s] about an axis through its centre."""
    momentum, inertia = angular(simulation, made, name, axis)
    return momentum / inertia


def angular(simulation, made, name, axis) -> tuple[float, float]:
    """Angular momentum [rad m5/s] and moment of inertia [m5] over density about an axis through its
    centre, with what the particles themselves turn by (APIC: C at a quarter of a cell squared)."""
    x, v, C, m = _of(simulation, made, name, "x", "v", "C", "vol0")
    at, u = middle(simulation, made, name)
    a, b = PLANES[axis]
    r, w, C, own = x - at, v - u, C.reshape(-1, 3, 3), simulation.plan.dx**2 / 4
    momentum = r[:, a] * w[:, b] - r[:, b] * w[:, a] + own * (C[:, b, a] - C[:, a, b])
    return float((m * momentum).sum()), float((m * (r[:, a] ** 2 + r[:, b] ** 2 + 2 * own)).sum())


def _of(simulation, made, name, *fields) -> list[np.ndarray]:
    mine = made.object == [thing["name"] for thing in made.objects].index(name)
    return [field[mine] for field in by_id(simulation, *fields)]


def exact(mu, radius):
    """Acceleration [m/s2] and that of the spin [rad/s2]."""
    if mu < np.tan(ANGLE) / 3:
        push = mu * G * np.cos(ANGLE)
        return float(G * np.sin(ANGLE) - push), float(2 * push / radius)
    return float(2 / 3 * G * np.sin(ANGLE)), float(2 / 3 * G * np.sin(ANGLE) / radius)


def roll(folder, cells, on, mu, drive=0.0):
    """Times (n,) [s], speeds (n,) [m/s] and spins (n,) [rad/s] of a cylinder of so many cells in
    radius, at rest at the start. drive [m/s]: of a collider, along itself."""
    radius, (top, role) = round(cells * DX, 9), FLOORS[on]
    up, down = max(-drive * END, 0.0), max(drive * END, 0.0)
    far = 0.5 * exact(mu, radius)[0] * END**2 + up + down
    long, high = (_blocks(s) for s in (far + 2 * radius + 0.08, 2 * radius + top + 0.03))
    floor = f'{{ kind = "separate", friction = {mu} }}' if on == "wall" else '"stick"'
    text = SCENE.format(
        long=long, high=high, along=float(G * np.sin(ANGLE)), down=float(-G * np.cos(ANGLE)),
        floor=floor, mu=mu, x=radius + 0.0313 + up, z=radius + top, radius=radius,
    )  # fmt: skip
    if drive:
        role += f'\nmotion = {{ velocity = [{drive}, 0, 0], end_time = "1 s" }}'
    if role:
        text += BELOW.format(role=role, west=-down, east=long + up, top=top)
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

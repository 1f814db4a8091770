"""A viscous liquid in a cylinder that turns about its upright axis comes to turn with it.

Theory: turning as one, a liquid has the surface z = z0 + omega^2 r^2 / 2 g, and rises by
omega^2 R^2 / 2 g from the axis to the wall (Landau and Lifshitz, Fluid Mechanics, section 5). The
cylinder is a collider, a cylinder without another, whose wall is 4 cells thick; liquids slip along
colliders, so that two vanes of 4 cells drive it, which reach from the wall to .5 R. It speeds up in
half a second and turns on evenly. Heights: of the highest particles of columns of a cell's area
that are more than two cells away from vanes and wall; a line is fitted to them over r^2, and its
slope times R^2 is the rise. Tolerances: 5 % of the rise, 1 % of omega.
"""

import numpy as np
import pytest

from tests.support.simulate import advance, begin, by_id
from tests.support.validation_record import held

G, RADIUS, DEPTH = 9.8, 0.1, 0.08  # [m/s2], [m], [m]
OMEGA, SPEEDS_UP = 9.0, 0.5  # [rad/s], [s]
WALL, INNER = 4, 0.5  # thickness [cells] of wall and vanes, and where these end [radii]
SCENE = """
[domain]
size = [{wide!r}, {wide!r}, {high!r}]
cell = {dx!r}
gravity = [0, 0, -9.8]
boundary = "slip"
[time]
end = 100
[accuracy]
pressure = "explicit"
precision = "single"
[material.syrup]
kind = "fluid"
tait_coefficient = 6e3
viscosity = 5
[[object]]
name = "liquid"
material = "syrup"
initial_pressure = "hydrostatic"
shape = {{ difference = [
  {{ cylinder = {{ endpoints = [[{m}, {m}, 0], [{m}, {m}, 0.08]], radius = 0.1 }} }},
  {vanes}] }}
[[object]]
name = "cylinder"
role = "scenery"
collider = true
shape = {{ union = [{{ difference = [
  {{ cylinder = {{ endpoints = [[{m}, {m}, {low}], [{m}, {m}, {top}]], radius = {outer} }} }},
  {{ cylinder = {{ endpoints = [[{m}, {m}, {lower}], [{m}, {m}, {upper}]], radius = 0.1 }} }}] }},
  {vanes}] }}
[object.motion]
pivot = [{m}, {m}, 0]
axis = "z"
interpolation = "linear"
keyframes = [{keys}]
"""


def spun(folder, cells, ends):
    """Of columns of the liquid in cylinders of so many cells in radius, in the last quarter of a
    second until `ends` [s]: squared distances (n,) [m2] from the axis and heights (n,) [m]; mean
    angular velocity [rad/s]; the largest share of particles that was half a cell in the wall."""
    dx = RADIUS / cells
    wide = round(2 * RADIUS + 8 * dx, 9)
    m = wide / 2
    inner, half, far = INNER * RADIUS, WALL / 2 * dx, RADIUS + WALL * dx
    vanes = ", ".join(
        f"{{ box = [{[*np.round([m + a, m - half], 9).tolist(), -0.1]},"
        f" {[*np.round([m + b, m + half], 9).tolist(), 0.3]}] }}"
        for a, b in ((-far, -inner), (inner, far))
    )
    # evenly faster until it turns by OMEGA
    times = np.append(np.linspace(0, SPEEDS_UP, 26)[1:], 100.0)
    angles = _angle(times)
    text = SCENE.format(
        wide=wide, high=0.16, dx=dx, m=m, vanes=vanes, low=-0.1, top=0.3, lower=-0.2, upper=0.4,
        outer=far,
        keys=", ".join(
            f"{{ time = {t!r}, angle = {a!r} }}"
            for t, a in zip(times.tolist(), angles.tolist(), strict=True)
        ),
    )  # fmt: skip
    simulation, _ = begin(folder, text)
    strayed, columns = 0.0, []
    for time in np.linspace(ends - 0.25, ends, 6):
        advance(simulation, float(time))
        x, v = by_id(simulation, "x", "v")
        x[:, :2] -= m
        strayed = max(strayed, (np.hypot(*x[:, :2].T) > RADIUS + dx / 2).mean())
        columns.append(_columns(x, dx, _angle(time)))
    turns = (x[:, 0] * v[:, 1] - x[:, 1] * v[:, 0]).sum() / (x[:, :2] ** 2).sum()
    return *np.concatenate(columns, axis=1), turns, strayed


def _angle(time):
    """By which the cylinder has turned."""
    return OMEGA * np.where(time <= SPEEDS_UP, time**2 / (2 * SPEEDS_UP), time - SPEEDS_UP / 2)


def _columns(x, dx, angle):
    """(2, n) squared distances from the axis [m2] and heights [m] of the highest particles of
    columns. x (n, 3): from the axis [m]."""
    _, of = np.unique(np.floor(x[:, :2] / dx), axis=0, return_inverse=True)
    order = np.lexsort((x[:, 2], of.ravel()))
    last = np.append(np.diff(of.ravel()[order]) > 0, True)
    top = x[order[last]]
    r, c, s = np.hypot(*top[:, :2].T), np.cos(angle), np.sin(angle)
    along, across = np.abs(top[:, :2] @ [c, s]), np.abs(top[:, :2] @ [-s, c])
    near = (across < (WALL / 2 + 2) * dx) & (along > INNER * RADIUS - 2 * dx)
    whole = (r < RADIUS - 2 * dx) & ~near
    return np.array([r[whole] ** 2, top[whole, 2] + dx / 4])


def _rise(squares, heights):
    return np.polyfit(squares, heights, 1)[0] * RADIUS**2


@pytest.mark.parametrize("cells, ends", [(10, 1.4)])
def test_rises(tmp_path, cells, ends):
    squares, heights, turns, strayed = spun(tmp_path, cells, ends)
    name = f"liquid in a turning cylinder of {cells} cells in radius"
    say = {"source": "z = omega^2 r^2 / 2 g", "note": f"{strayed:.2%} strayed into the wall"}
    held(f"{name}: angular velocity", turns, OMEGA, 0.01, unit="rad/s", **say)
    held(f"{name}: rise", _rise(squares, heights), OMEGA**2 * RADIUS**2 / (2 * G), 0.05, unit="m",
         curves={"highest particles [m]": (squares, heights)}, axes=("r^2 [m2]", "height [m]"),
         **say)  # fmt: skip

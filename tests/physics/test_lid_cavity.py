"""A lid drags a liquid around a closed box: velocities beside those of Ghia, Ghia and Shin.

Ghia et al. 1982 (J. Comput. Phys. 48, 387-411), tables I and II, Re 100: u on the vertical
centerline and v on the horizontal one, over the speed of the lid. Here the box is 4 cells deep
between slip walls, the other walls stick, and the lid is a collider that moves along its face.
Means of five times from 8 to 10 L / U. Tolerance: 2 % of the norm of the published values.

An explicit pressure misses it: cells below the lid's downstream end run empty while others hold
twice their volume, and the flow does not become steady.
"""

import numpy as np
import pytest

from tests.support.simulate import advance, begin, by_id
from tests.support.validation_record import held

SOURCE = "Ghia et al. 1982"
HEIGHTS = [0.0547, 0.0625, 0.0703, 0.1016, 0.1719, 0.2813, 0.4531, 0.5, 0.6172, 0.7344, 0.8516,
           0.9531, 0.9609, 0.9688, 0.9766]  # fmt: skip
U = [-0.03717, -0.04192, -0.04775, -0.06434, -0.1015, -0.15662, -0.2109, -0.20581, -0.13641,
     0.00332, 0.23151, 0.68717, 0.73722, 0.78871, 0.84123]  # fmt: skip
LENGTHS = [0.0625, 0.0703, 0.0781, 0.0938, 0.1563, 0.2266, 0.2344, 0.5, 0.8047, 0.8594, 0.9063,
           0.9453, 0.9531, 0.9609, 0.9688]  # fmt: skip
V = [0.09233, 0.10091, 0.1089, 0.12317, 0.16077, 0.17507, 0.17527, 0.05454, -0.24533, -0.22445,
     -0.16914, -0.10313, -0.08864, -0.07391, -0.05906]  # fmt: skip
SCENE = """
[domain]
size = [1, {wide!r}, {high!r}]
cell = {dx!r}
gravity = [0, 0, 0]
boundary = {{ default = "stick", south = "slip", north = "slip" }}
[time]
end = 10
[accuracy]
pressure = "{pressure}"
[material.liquid]
kind = "fluid"
max_speed = 1
viscosity = 10
[[object]]
name = "liquid"
material = "liquid"
shape = {{ box = [[0, 0, 0], [1, {wide!r}, 1]] }}
[[object]]
name = "lid"
role = "scenery"
collider = true
slip_length = 0
shape = {{ box = [[-20, -1, 1], [10, 2, 2]] }}
motion = {{ velocity = [1, 0, 0] }}
"""


def velocities(x, v, points, dx):
    """Velocities (n, 3) at points (n, 2): planes through the particles within a cell."""
    values = []
    for point in points:
        away = x[:, ::2] - point
        weight = np.sqrt(np.prod(np.maximum(0, 1 - np.abs(away) / dx), 1))
        near = weight > 0
        matrix = np.column_stack([np.ones(near.sum()), away[near]]) * weight[near, None]
        values.append(np.linalg.lstsq(matrix, v[near] * weight[near, None], rcond=None)[0][0])
    return np.array(values)


@pytest.mark.parametrize(
    "pressure, cells, tolerance",
    [
        ("implicit", 24, 0.03),
        pytest.param("implicit", 32, 0.02, marks=pytest.mark.slow),
        pytest.param("explicit", 24, 0.02, marks=pytest.mark.slow),
    ],
)
def test_velocities_on_the_centerlines(tmp_path, pressure, cells, tolerance):
    dx = 1 / cells
    text = SCENE.format(dx=dx, wide=4 * dx, high=1 + 8 * dx, pressure=pressure)
    simulation, _ = begin(tmp_path, text)
    lines = {"u": [(0.5, z) for z in HEIGHTS], "v": [(x, 0.5) for x in LENGTHS]}
    means = {"u": 0, "v": 0}
    for time in (8, 8.5, 9, 9.5, 10):
        advance(simulation, time)
        x, v = by_id(simulation, "x", "v")
        for name, points in lines.items():
            means[name] += velocities(x, v, points, dx)[:, 2 * (name == "v")] / 5
    errors = {
        name: float(np.linalg.norm(means[name] - published) / np.linalg.norm(published))
        for name, published in (("u", U), ("v", V))
    }
    misses = pressure == "explicit"
    for name, error in errors.items():
        held(f"lid-driven cavity, Re 100: error of {name} (L2), {cells} cells, {pressure} pressure",
             error, 0.0, tolerance, kind="below", source=SOURCE, expected=not misses,
             deviation=misses)  # fmt: skip

"""Dam break against a square column: force on it, and speed of the water before it.

Yeh and Petroff's bore, after Raad and Bidoae 2005 (J. Comput. Phys. 203, 668-699, figures 17 and
18), as PySPH read it (pysph/examples/db_exp_data.py): water of 0.4 m x 0.61 m x 0.3 m in a tank of
1.6 m x 0.61 m, a column of 0.12 m x 0.12 m whose face is at 0.9 m, water of 1 cm on the floor.

Here one half between slip walls, with the column in the middle; the impact is when the force rises
above 5 N. All numbers are beside the measured ones without a tolerance: the experiment's gate opens
in a time that is not known, and the layer on the floor is thinner than a cell.
"""

import numpy as np
import pytest

import vgmpi
from tests.support.validation_record import held

SOURCE = "Raad and Bidoae 2005"
RISE, PEAK, MEAN, LATE = 0.353, 33.1, 26.8, 17.7  # [s], [N], [N], [N]
SCENE = """
[domain]
size = [{length!r}, 0.305, {high!r}]
cell = {dx!r}
gravity = [0, 0, -9.81]
boundary = "slip"
[time]
end = 0.75
frames = 2
[accuracy]
pressure = "{pressure}"
[material.water]
kind = "fluid"
max_speed = 3
[[object]]
name = "water"
material = "water"
initial_pressure = "hydrostatic"
shape = {{ box = [[0, 0, 0], [0.4, 0.305, 0.3]] }}
[[object]]
name = "layer"
material = "water"
shape = {{ difference = [
  {{ box = [[0.4, 0, 0], [{length!r}, 0.305, 0.01]] }},
  {{ box = [[0.9, 0.245, -0.1], [1.02, 0.4, 0.1]] }},
] }}
[[object]]
name = "column"
role = "scenery"
collider = true
shape = {{ box = [[0.9, 0.245, -0.2], [1.02, 0.5, 1]] }}
[[probe]]
name = "force"
sampling_rate = 1000
collider = "column"
"""


@pytest.mark.parametrize(
    "cells, pressure",
    [
        (12, "implicit"),
        pytest.param(12, "explicit", marks=pytest.mark.slow),
        pytest.param(20, "implicit", marks=pytest.mark.slow),
        pytest.param(20, "explicit", marks=pytest.mark.slow),
    ],
)
def test_force_on_the_column(tmp_path, cells, pressure):
    dx, end = 0.305 / cells, f"{cells} cells per half width, {pressure} pressure"
    length, high = round(1.6 / dx) * dx, float(np.ceil(0.6 / dx) * dx)
    text = SCENE.format(length=length, high=high, dx=dx, pressure=pressure)
    run = vgmpi.run(vgmpi.load(tmp_path / "scene.toml", text=text))
    assert run.code == 0
    rows = run.probes["force"]
    times = np.array([row["time"] for row in rows])
    forces = 2 * np.nan_to_num([row["force_x"] for row in rows])  # on both halves
    forces = np.convolve(forces, np.full(10, 0.1), "same")  # over 0.01 s
    rise = float(times[np.argmax(forces > 5)])
    name = "dam break against a column"
    held(f"{name}: impact, {end}", rise, RISE, np.inf, unit="s", source=SOURCE)
    after = (times >= rise) & (times <= rise + 0.1)
    late = (times >= 0.6) & (times <= 0.7)
    for what, value, reference in (
        ("largest force of 0.01 s", forces.max(), PEAK),
        ("force, mean of 0.1 s after the impact", forces[after].mean(), MEAN),
        ("force, mean from 0.6 s to 0.7 s", forces[late].mean(), LATE),
    ):
        held(f"{name}: {what}, {end}", float(value), reference, np.inf, unit="N", source=SOURCE)

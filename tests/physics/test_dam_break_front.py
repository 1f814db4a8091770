"""Dam break on a long floor: the front beside that of Martin and Moyce.

Martin & Moyce 1952 (Phil. Trans. R. Soc. A 244, 312-324), figure 3, n2 = 2, a = 2.25 in, as PySPH
read it (pysph/examples/db_exp_data.py): a column a wide and 2 a high, z = front / a over
T = t sqrt(2 g / a). Here a slab 4 cells deep between slip walls, and the front is what 1 % of
the water has passed: the tip is thinner than a cell. Without friction it is ahead of the
experiment. Tolerance: 12 % of the speed; the rest is beside the experiment without one.
"""

import numpy as np
import pytest

from tests.support.simulate import advance, begin, by_id
from tests.support.validation_record import held

SOURCE = "Martin and Moyce 1952"
A, GRAVITY = 0.05715, 9.81  # [m], [m/s2]
MARTIN_MOYCE = np.array(
    [[0.832, 1.217], [1.219, 1.474], [1.997, 2.292], [2.547, 2.995], [3.345, 4.134],
     [4.034, 4.944], [4.418, 5.881], [5.091, 6.98], [5.685, 7.945], [6.306, 8.966],
     [6.822, 9.986], [7.439, 10.963], [8.031, 11.977], [8.633, 13.005], [9.237, 13.97]]
)  # fmt: skip
AHEAD = 0.01  # of the water lies ahead of what is measured as the front
SCENE = """
[domain]
size = [{length!r}, {wide!r}, {high!r}]
cell = {dx!r}
gravity = [0, 0, -9.81]
boundary = "slip"
[time]
end = 1
[accuracy]
pressure = "{pressure}"
[material.water]
kind = "fluid"
max_speed = 2.5
[[object]]
name = "column"
material = "water"
initial_pressure = "hydrostatic"
shape = {{ box = [[0, 0, 0], [0.05715, {wide!r}, 0.1143]] }}
"""


@pytest.mark.parametrize("pressure", ["explicit", "implicit"])
@pytest.mark.parametrize("cells", [10, pytest.param(20, marks=pytest.mark.slow)])
def test_front(tmp_path, pressure, cells):
    dx = A / cells
    sizes = {"length": 17 * cells * dx, "high": round(2.4 * cells) * dx, "wide": 4 * dx}
    simulation, _ = begin(tmp_path, SCENE.format(dx=dx, pressure=pressure, **sizes))
    times, fronts = [0.0], [1.0]
    for time in np.arange(1, 47) / 5:
        advance(simulation, time * np.sqrt(A / (2 * GRAVITY)))
        (x,) = by_id(simulation, "x")
        times.append(time)
        fronts.append(np.quantile(x[:, 0], 1 - AHEAD) / A)
    arrival = np.interp(MARTIN_MOYCE[:, 1], fronts, times)
    end = f"{cells} cells per width, {pressure} pressure"
    unbounded = {"tolerance": np.inf, "source": SOURCE}
    for k, name in ((4, "4.13"), (14, "13.97")):
        held(f"dam break: front at {name} a, {end}", float(arrival[k]), float(MARTIN_MOYCE[k, 0]),
             unit="sqrt(a / 2 g)", **unbounded)  # fmt: skip
    speed, reference = (
        float(np.polyfit(t[7:], MARTIN_MOYCE[7:, 1], 1)[0]) for t in (arrival, MARTIN_MOYCE[:, 0])
    )
    held(f"dam break: speed of the front from 7 a to 14 a, {end}", speed, reference, 0.12,
         unit="sqrt(2 g a)", source=SOURCE)  # fmt: skip

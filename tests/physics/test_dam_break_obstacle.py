"""Dam break around a block: pressures on its face, and the height of the water behind.

Kleefsman et al. 2005 (J. Comput. Phys. 206, 363-393; SPHERIC test 2): water of 1.228 m x 1 m x
0.55 m in a tank of 3.22 m x 1 m, a block of 0.161 m x 0.403 m x 0.161 m whose face is at 2.3955 m.
Gauges on the face, 21 and 101 mm above the floor, and the height of the water at 0.582 m. Numbers
from the measured curves, those of means as PySPH read them (pysph/examples/db_exp_data.py).

Here one half between slip walls; with 13 cells the tank is 11 mm too long.
Tolerances: 6 % of the time of the impact, 4 % of the height; the pressures are beside the measured
ones without a tolerance.
"""

import numpy as np
import pytest

import vgmpi
from tests.support.validation_record import held

SOURCE = "Kleefsman et al. 2005"
RISE, HEIGHT = 0.393, 0.427  # [s], [m] at 0.5 s
PEAKS = {21: 11.24, 101: 6.57}  # [kPa]
MEANS = {21: 7.93, 101: 5.03}  # [kPa] of 0.1 s after the impact
LATE = {21: 6.48}  # [kPa] at 0.5 s
SCENE = """
[domain]
size = [{length!r}, 0.5, {high!r}]
cell = {dx!r}
gravity = [0, 0, -9.81]
boundary = "slip"
[time]
end = 0.55
frames = 2
[accuracy]
pressure = "{pressure}"
[material.water]
kind = "fluid"
max_speed = 4
[[object]]
name = "water"
material = "water"
initial_pressure = "hydrostatic"
shape = {{ box = [[0, 0, 0], [1.228, 0.5, 0.55]] }}
[[object]]
name = "block"
role = "scenery"
collider = true
shape = {{ box = [[2.3955, 0.2985, -0.2], [2.5565, 0.7015, 0.161]] }}
[[probe]]
name = "height"
sampling_rate = 1000
surface_height = [0.582, 0.25]
"""
PROBE = """
[[probe]]
name = "gauge {z}"
sampling_rate = 2000
pressure = [2.3945, 0.471, {height!r}]
"""


def curve(rows, column):
    """Times [s] and values of a probe; 0 without water."""
    return np.nan_to_num(np.array([[row["time"], row[column]] for row in rows]).T)


@pytest.mark.parametrize("pressure", ["explicit", "implicit"])
@pytest.mark.parametrize("cells", [13, pytest.param(25, marks=pytest.mark.slow)])
def test_gauges_on_the_block(tmp_path, pressure, cells):
    dx, end = 0.5 / cells, f"{cells} cells per half width, {pressure} pressure"
    high = float(np.ceil(1 / dx) * dx)
    text = SCENE.format(length=round(3.22 / dx) * dx, high=high, dx=dx, pressure=pressure)
    text += "".join(PROBE.format(z=z, height=z / 1000) for z in PEAKS)
    run = vgmpi.run(vgmpi.load(tmp_path / "scene.toml", text=text))
    assert run.code == 0
    unbounded = {"tolerance": np.inf, "unit": "kPa", "source": SOURCE}
    times, heights = curve(run.probes["height"], "surface_height")
    held(f"dam break around a block: height at 0.5 s, {end}", float(np.interp(0.5, times, heights)),
         HEIGHT, 0.04, unit="m", source=SOURCE)  # fmt: skip
    for z, peak in PEAKS.items():
        times, pressures = curve(run.probes[f"gauge {z}"], "pressure")
        pressures /= 1000
        rise = times[np.argmax(pressures > 2)]
        name = f"dam break around a block, gauge at {z} mm"
        if z == 21:
            held(f"{name}: impact, {end}", float(rise), RISE, 0.06, unit="s", source=SOURCE)
        held(f"{name}: peak, {end}", float(pressures.max()), peak, **unbounded)
        after = pressures[(times >= rise) & (times <= rise + 0.1)]
        held(f"{name}: mean of 0.1 s after the impact, {end}", float(after.mean()), MEANS[z],
             **unbounded)  # fmt: skip
        if z in LATE:
            late = pressures[(times >= 0.49) & (times <= 0.51)]
            held(
                f"{name}: mean of 0.02 s at 0.5 s, {end}", float(late.mean()), LATE[z], **unbounded
            )

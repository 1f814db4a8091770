"""Ponded infiltration into dry sand (Green and Ampt 1911, no suction).

Water of depth h0 stands on dry sand and seeps in with a sharp front at depth z: Darcy's flux q = k
(z + h) / z with h = h0 - n z left above, dz/dt = q / n. Compared is the centre of mass of the water
over time, as a share of how far it has sunk; tolerance 10 %. The pond stands under gravity that is
ramped within 0.1 s, which the theory follows. The error is an offset of a quarter of a cell from
the first moments, when the front is thinner than a cell; the speed after that is right to 1 %.
"""

import numpy as np
import pytest

from tests.support.simulate import advance, begin, by_id
from tests.support.validation_record import held

G, N, K, POND, SAND, RAMP = 9.80665, 0.4, 2e-2, 0.2, 0.4, 0.1
SCENE = f"""
[accuracy]
pressure = "explicit"
precision = "double"
[domain]
size = [0.04, 0.04, {POND + SAND + 0.04!r}]
cell = 0.01
boundary.default = "slip"
gravity = [0, 0, {-G}]
gravity_ramp_time = {RAMP}
[time]
end = 10
[material.water]
kind = "fluid"
tait_coefficient = 1e5
[material.grains]
kind = "sand"
density = 2650
porosity = {N}
youngs_modulus = 1e6
[[object]]
name = "pond"
material = "water"
shape = {{ box = [[0, 0, {SAND}], [0.04, 0.04, {SAND + POND}]] }}
[[object]]
name = "sand"
material = "grains"
shape = {{ box = [[0, 0, 0], [0.04, 0.04, {SAND}]] }}
[[coupling]]
between = ["water", "grains"]
kind = "drag"
hydraulic_conductivity = {K}
"""


def sinking(times):
    """How far [m] the water's centre of mass has sunk."""
    z, t, found, dt = 1e-6, 0.0, [], 1e-5
    for end in times:
        while t < end:
            g = G / 9.80665 * (0.5 - 0.5 * np.cos(np.pi * min(t / RAMP, 1.0)))
            # implicit in 1 / z: the first flux has no bound
            z = 0.5 * (z + np.sqrt(z**2 + 4 * dt * K * g * (z + POND - N * z) / N))
            t += dt
        wet = N * z
        middle = (wet * (SAND - z / 2) + (POND - wet) * (SAND + (POND - wet) / 2)) / POND
        found.append(SAND + POND / 2 - middle)
    return np.array(found)


@pytest.mark.slow
def test_water_sinks_as_green_and_ampt_say(tmp_path):
    simulation, made = begin(tmp_path, SCENE)
    water = made.object == 0
    times, found = np.arange(0.1, 0.81, 0.1), []
    for t in times:
        advance(simulation, t)
        (x,) = by_id(simulation, "x")
        found.append(SAND + POND / 2 - float(x[water, 2].mean()))
    exact, found = sinking(times), np.array(found)
    print(np.round(exact, 4), np.round(found, 4), sep="\n")
    late = times >= 0.4
    worst = float(np.abs(found / exact - 1.0)[late].max())
    held("ponded infiltration: error of the depth", worst, 0.0, 0.10, kind="absolute",
         source="Green and Ampt 1911", note="largest relative error from 0.4 s on",
         curves={"theory": (times, exact), "solver": (times, found)},
         axes=("time [s]", "centre of mass sunk [m]"))  # fmt: skip

"""Sand in whose pores liquid flows, with an implicit pressure: drag, seepage, rest and momentum.

The numbers from outside are Darcy's law, Terzaghi's consolidation, the infiltration of Green and
Ampt (their scenes are those of test_drag.py, test_terzaghi.py and test_infiltration.py), buoyant
weight, and sums of momenta.
"""

import numpy as np
import pytest

from tests.physics import test_drag, test_infiltration, test_terzaghi
from tests.support.simulate import advance, begin, by_id, totals

N, RHO_S, RHO_W = test_drag.N, test_drag.RHO_S, test_drag.RHO_W
G, DX, HEIGHT, DEEP = 9.80665, 0.01, 0.2, 0.3
TANK = f"""
[accuracy]
precision = "double"
pressure = "implicit"
[domain]
size = [0.08, 0.08, 0.4]
cell = {DX}
boundary.default = "slip"
gravity = [0, 0, {-G}]
[time]
end = 10
[material.water]
kind = "fluid"
max_speed = 1
[material.grains]
kind = "sand"
density = {RHO_S}
porosity = {N}
youngs_modulus = 1e6
[[coupling]]
between = ["water", "grains"]
kind = "drag"
hydraulic_conductivity = CONDUCTIVITY
"""
BED = f"""
[[object]]
name = "pores"
material = "water"
volume_fraction = {N}
initial_pressure = "zero"
shape = {{ box = [[0, 0, 0], [0.08, 0.08, {HEIGHT}]] }}
[[object]]
name = "sand"
material = "grains"
shape = {{ box = [[0, 0, 0], [0.08, 0.08, {HEIGHT}]] }}
[[object]]
name = "pond"
material = "water"
initial_pressure = "zero"
shape = {{ box = [[0, 0, {HEIGHT}], [0.08, 0.08, {DEEP}]] }}
"""


def implicit(text):
    """The text of a scene with an implicit pressure."""
    text = text.replace('pressure = "explicit"\n', "")
    return text.replace('precision = "double"', 'precision = "double"\npressure = "implicit"')


@pytest.mark.parametrize("conductivity", [1e-2, 1e-4, 1e-7])
def test_grains_settle_by_darcys_law(tmp_path, conductivity):
    """The steps are 400 times as long as those of the explicit test, and the drag as it is."""
    height, ramp = 0.4, 0.2
    text = test_drag.SCENE.format(
        size=[0.04, 0.04, height], cell=0.01, gravity=-test_drag.G, ramp=ramp, k=1e5, E=1.0,
        kind="drag", box=[[0, 0, 0], [0.04, 0.04, height]], velocity=[0, 0, 0],
        conductivity=conductivity,
    )  # fmt: skip
    simulation, made = begin(tmp_path, implicit(text))
    water, slips = made.object == 0, []
    advance(simulation, ramp)
    while simulation.time < ramp + 0.1:
        simulation.advance(2e-3)
        x, v = by_id(simulation, "x", "v")
        middle = np.abs(x[:, 2] - height / 2) < 0.06
        slips.append(v[middle & water, 2].mean() - v[middle & ~water, 2].mean())
    exact = (1 - N) / N * (RHO_S / RHO_W - 1) * conductivity
    assert np.mean(slips) == pytest.approx(exact, rel=2e-3)
    assert np.std(slips) < 2e-3 * exact


def test_a_load_on_saturated_sand_passes_from_water_to_grains(tmp_path):
    simulation, _ = begin(tmp_path, implicit(test_terzaghi.SCENE))
    c_v = test_terzaghi.PERMEABILITY * test_terzaghi.MODULUS / (1000.0 * test_terzaghi.G)
    found, exact = [], []
    for factor in np.arange(0.06, 0.301, 0.02):
        advance(simulation, factor * test_terzaghi.HEIGHT**2 / c_v)
        found.append(test_terzaghi.base_pressure(simulation) / test_terzaghi.LOAD)
        exact.append(test_terzaghi.ramped(simulation.time, c_v))
    assert np.sqrt(np.mean((np.array(found) - exact) ** 2)) < 0.015
    assert simulation.step < 60


@pytest.mark.slow
def test_water_sinks_into_dry_sand(tmp_path):
    """As fast as Green and Ampt say, to 10 % from 0.4 s on, as with an explicit pressure."""
    simulation, made = begin(tmp_path, implicit(test_infiltration.SCENE))
    water, times, found = made.object == 0, np.arange(0.1, 0.81, 0.1), []
    full = test_infiltration.SAND + test_infiltration.POND / 2
    for t in times:
        advance(simulation, t)
        (x,) = by_id(simulation, "x")
        found.append(full - float(x[water, 2].mean()))
    errors = np.array(found) / test_infiltration.sinking(times) - 1
    assert np.abs(errors[times >= 0.4]).max() < 0.1


@pytest.mark.parametrize("conductivity", [1e-2, 1e-7])
def test_saturated_sand_at_rest_bears_its_weight(tmp_path, conductivity):
    """A bed of sand under water: in fine sand, the water still bears most of the grains' weight."""
    simulation, made = begin(tmp_path, TANK.replace("CONDUCTIVITY", str(conductivity)) + BED)
    sand, sums, times = made.object == 1, np.zeros(3), np.arange(0.52, 1.01, 0.02)
    advance(simulation, 0.5)
    for t in times:
        advance(simulation, t)
        x, v, p, stress = by_id(simulation, "x", "v", "pressure", "stress")
        low = (x[:, 2] > 0.02) & (x[:, 2] < 0.1)
        buoyant = (1 - N) * (RHO_S - RHO_W) * G * (HEIGHT - x[low & sand, 2]).mean()
        head = RHO_W * G * (DEEP - x[low & ~sand, 2]).mean()
        sums += (
            (p[low & ~sand].mean() - head) / buoyant, -stress[low & sand, 2].mean() / buoyant,
            np.sqrt((v**2).sum(1).mean() / (G * DEEP)),
        )  # fmt: skip
    of_water, of_grains, speed = sums / len(times)
    if conductivity > 1e-4:
        assert of_water == pytest.approx(0.0, abs=0.02)
    else:  # all of it, but for what the first steps leave of the divergence
        assert 0.7 < of_water <= 1.0
    assert of_water + of_grains == pytest.approx(1.0, abs=0.02)
    assert speed < 1e-4


@pytest.mark.parametrize("conductivity", [1e-2, 1e-8])
def test_a_drop_that_hits_sand_in_empty_space_keeps_momentum(tmp_path, conductivity):
    text = TANK.replace(f"{-G}", "0").replace("[0.08, 0.08, 0.4]", "[0.2, 0.2, 0.3]")
    text = (
        text.replace("CONDUCTIVITY", str(conductivity))
        + """
[[object]]
name = "drop"
material = "water"
velocity = [0.1, 0, -1]
shape = { sphere = { center = [0.1, 0.1, 0.19], radius = 0.03 } }
[[object]]
name = "heap"
material = "grains"
shape = { box = [[0.06, 0.06, 0.1], [0.14, 0.14, 0.16]] }
"""
    )
    simulation, made = begin(tmp_path, text)
    before, water = totals(simulation)["momentum"], made.object == 0
    advance(simulation, 0.06)
    (v,) = by_id(simulation, "v")
    assert np.abs(totals(simulation)["momentum"] - before).max() < 1e-10 * np.abs(before).max()
    assert v[~water, 2].mean() < -0.05  # the heap is hit
    assert np.abs(v).max() < 1.5

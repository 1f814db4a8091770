"""Waves that zones make and take up, against linear theory, and what their table refuses."""

import math

import numpy as np
import pytest

from tests.support.simulate import advance, begin
from tests.support.small_scenes import write
from vgmpi.features.wave_zones.feature import OUTER_FACES, max_height, wave_number
from vgmpi.features.wave_zones.plan import WaveZonesPlan
from vgmpi.runtime.config.schema import SceneError
from vgmpi.scene import loader
from vgmpi.solver.restart.state_io import by_id

G = 9.80665
PERIOD, DEPTH = 0.8, 0.2
ZONE = """
[[wave_zone]]
name = "{name}"
box = [[{low}, 0, 0], [{high}, 0.05, 0.3]]
outer = "{outer}"
period = 0.8
level = 0.2
depth = 0.2
height = {height}
"""
TANK = """
[domain]
size = [{length}, 0.05, 0.3]
cell = {cell}
boundary = "slip"
[time]
end = 10
[accuracy]
pressure = "implicit"
[material.water]
kind = "fluid"
[[object]]
name = "water"
material = "water"
shape = {{ box = [[0, 0, 0], [{length}, 0.05, 0.2]] }}
initial_pressure = "hydrostatic"
"""


@pytest.mark.parametrize(
    "period, depth, wavelength",
    [  # Dean and Dalrymple (1991), deep water and the shallow limit; k h = 1.0 by hand
        (10.0, 1000.0, 9.80665 * 100.0 / (2.0 * math.pi)),
        (100.0, 1.0, 100.0 * math.sqrt(9.80665)),
        (2.0 * math.pi / math.sqrt(G * math.tanh(1.0)), 1.0, 2.0 * math.pi),
    ],
)
def test_the_wavelength_is_that_of_linear_theory(period, depth, wavelength):
    assert 2.0 * math.pi / wave_number(period, depth, G) == pytest.approx(wavelength, rel=2e-3)


def test_waves_break_at_the_height_of_miche():
    """A seventh of the wavelength in deep water, 0.89 of the depth in shallow water."""
    assert max_height(1.0, 100.0, G) == pytest.approx(0.142 * G / (2.0 * math.pi), rel=1e-3)
    assert max_height(100.0, 1.0, G) == pytest.approx(0.142 * 2.0 * math.pi, rel=1e-3)


def tank(tmp_path, length, zones, cell=0.0125):
    """Start a tank with zones."""
    text = TANK.format(length=length, cell=cell) + "".join(ZONE.format(**zone) for zone in zones)
    return begin(tmp_path, text)[0]


def zone(name, low, high, outer, height):
    """Return the keys of a zone."""
    return {"name": name, "low": low, "high": high, "outer": outer, "height": height}


def test_a_zone_moves_water_as_the_wave_does(tmp_path):
    """After some relaxation times the particles at the outer face have the velocity of theory."""
    simulation = tank(tmp_path, 0.6, [zone("maker", 0.0, 0.6, "west", 0.02)])
    plan = simulation.plan.feature(WaveZonesPlan)
    (each,) = plan.zones
    assert OUTER_FACES["west"] == (each.axis, each.direction)
    simulation.features["wave_zones"].zones = (each._replace(zone=each.zone.model_copy(
        update={"rate": 1e6, "ramp_time": 0.0})),)  # fmt: skip
    advance(simulation, simulation.bound())
    span_end = simulation.time
    simulation.features["wave_zones"].push_particles(_span(span_end))
    x, v, C = by_id(simulation, "x", "v", "C")
    inside = x[:, 0] < 0.3
    k, w, a = each.number, each.frequency, 0.01
    z = np.minimum(x[:, 2] - DEPTH, 0.0)
    angle = k * x[:, 0] - w * span_end
    wide = a * w * np.cosh(k * (z + DEPTH)) / math.sinh(k * DEPTH)
    tall = a * w * np.sinh(k * (z + DEPTH)) / math.sinh(k * DEPTH)
    np.testing.assert_allclose(v[inside, 0], (wide * np.cos(angle))[inside], atol=1e-5)
    np.testing.assert_allclose(v[inside, 2], (tall * np.sin(angle))[inside], atol=1e-5)
    assert not v[inside, 1].any()
    np.testing.assert_allclose(C[inside, 0], (-k * wide * np.sin(angle))[inside], atol=1e-3)
    np.testing.assert_allclose(C[inside, 2], (k * tall * np.cos(angle))[inside], atol=1e-3)
    np.testing.assert_allclose((C[:, 0] + C[:, 8])[inside], 0.0, atol=1e-3)  # it keeps volumes


def _span(time):
    """Return a step that ends at a time, with a long relaxation."""
    from vgmpi.kernels.step_records import StepSpan

    return StepSpan(1, time - 1.0, time, 1.0)


def elevation(simulation, x_bins):
    """Return the surface's height over the level at rest by columns [m], from their volume."""
    x, vol0 = by_id(simulation, "x", "vol0")
    volume, _ = np.histogram(x[:, 0], x_bins, weights=vol0.reshape(-1))
    return volume / (0.05 * np.diff(x_bins)) - DEPTH


@pytest.mark.slow
def test_waves_run_as_linear_theory_says_and_a_beach_takes_them_up(tmp_path):
    """Height and length of the waves in a tank; what returns from its beach."""
    simulation = tank(
        tmp_path, 4.2, [zone("maker", 0, 0.9, "west", 0.03), zone("beach", 3.0, 4.2, "east", 0)]
    )
    edges = np.arange(1.0, 2.9001, 0.05)
    center = 0.5 * (edges[1:] + edges[:-1])
    advance(simulation, 6.4)
    rows, times = [], []
    for k in range(1, 33):  # two periods
        advance(simulation, 6.4 + k * PERIOD / 16.0)
        rows.append(elevation(simulation, edges))
        times.append(simulation.time)
    phase = np.exp(1j * 2.0 * math.pi / PERIOD * np.array(times))
    wave = 2.0 / len(rows) * (np.array(rows) * phase[:, None]).sum(0)  # first harmonic by place
    k = wave_number(PERIOD, DEPTH, G)

    def residual(number):
        basis = np.stack([np.exp(1j * number * center), np.exp(-1j * number * center)], 1)
        found, *_ = np.linalg.lstsq(basis, wave, rcond=None)
        return np.abs(wave - basis @ found).sum(), np.abs(found)

    numbers = np.linspace(0.8 * k, 1.2 * k, 401)
    best = min(numbers, key=lambda number: residual(number)[0])
    there, back = residual(best)[1]
    print(f"height {2 * there:.4f} m, k / theory {best / k:.3f}, reflected {back / there:.3f}")
    assert abs(best / k - 1.0) < 0.03
    assert abs(2.0 * there / 0.03 - 1.0) < 0.15
    assert back / there < 0.1


WRONG = {
    "a gravity that is not along z": (("[domain]\n", "[domain]\ngravity = [1, 0, -9.8]\n"),
                                      "wave_zone.maker: needs constant domain.gravity along -z"),
    "a box outside": (("box = [[0.0, 0, 0], [0.6,", "box = [[1.0, 0, 0], [1.6,"),
                      "wave_zone.maker.box: is outside of the domain, 0 to 0.6 m"),
    "a box without extent": (("[0.6, 0.05, 0.3]]\nouter", "[0.0, 0.05, 0.3]]\nouter"),
                             "must have an extent along each axis"),
    "waves that break": (("height = 0.02", "height = 0.2"),
                         "wave_zone.maker.height: waves of this period and depth break at"),
    "a face that is none": (('outer = "west"', 'outer = "up"'), "wave_zone.maker.outer: "),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_zone_is_one_line(tmp_path, name):
    (old, new), message = WRONG[name]
    text = TANK.format(length=0.6, cell=0.0125)
    text += ZONE.format(**zone("maker", 0.0, 0.6, "west", 0.02))
    assert old in text
    with pytest.raises(SceneError) as error:
        loader.load(write(tmp_path, text.replace(old, new)))
    lines = str(error.value).splitlines()
    assert any(message in line and "scene.toml:" in line for line in lines), lines

"""Waves that zones make and take up, against linear theory, and what their table refuses."""

import math
import time

import numpy as np
import pytest
from scipy.linalg import solve_banded

from tests.support.simulate import advance, begin
from tests.support.small_scenes import write
from vgmpi.features.wave_zones.feature import (
    BEACH_RATE,
    FEATURE,
    MAKER_RATE,
    OUTER_FACES,
    max_height,
    wave_number,
)
from vgmpi.features.wave_zones.plan import WaveZonesPlan
from vgmpi.kernels.step_records import StepSpan
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


CUBE = """
[accuracy]
pressure = "explicit"
[domain]
size = [0.3, 0.3, 0.3]
cell = 0.025
boundary = "slip"
[time]
end = 10
[material.water]
kind = "fluid"
[[object]]
name = "water"
material = "water"
shape = { box = [[0, 0, 0], [0.3, 0.3, 0.2]] }
"""


@pytest.mark.parametrize("outer", OUTER_FACES)
def test_a_zone_moves_water_as_the_wave_does(tmp_path, outer):
    """After many relaxation times, velocities and gradients are those of theory."""
    text = ZONE.format(**zone("maker", 0.0, 0.3, outer, 0.02)).replace("0.05, 0.3]]", "0.3, 0.3]]")
    simulation = begin(tmp_path, CUBE + text + "rate = 1e6\nramp_time = 0\n")[0]
    (each,) = simulation.plan.feature(WaveZonesPlan).zones
    end = 0.3
    simulation.features["wave_zones"].push_particles(StepSpan(1, end - 1.0, end, 1.0))
    x, v, C = by_id(simulation, "x", "v", "C")
    axis, direction = OUTER_FACES[outer]
    along = x[:, axis] if direction > 0 else 0.3 - x[:, axis]
    inside = along < 0.2  # the relaxation ends at the inner face
    k, w, a = each.number, each.frequency, 0.01
    z = np.minimum(x[:, 2] - DEPTH, 0.02)
    angle = k * along - w * end
    wide = a * w * np.cosh(k * (z + DEPTH)) / math.sinh(k * DEPTH)
    tall = a * w * np.sinh(k * (z + DEPTH)) / math.sinh(k * DEPTH)
    velocity, gradient = np.zeros((len(x), 3)), np.zeros((len(x), 3, 3))
    velocity[:, axis], velocity[:, 2] = direction * wide * np.cos(angle), tall * np.sin(angle)
    gradient[:, axis, axis] = -k * wide * np.sin(angle)
    gradient[:, 2, 2] = k * wide * np.sin(angle)
    gradient[:, axis, 2] = gradient[:, 2, axis] = direction * k * tall * np.cos(angle)
    np.testing.assert_allclose(v[inside], velocity[inside], atol=1e-6)
    np.testing.assert_allclose(C[inside], gradient.reshape(-1, 9)[inside], atol=1e-5)
    assert np.hypot(v[inside, axis], v[inside, 2]).max() > 0.03


def test_a_beach_at_rest_leaves_water_at_rest_and_stops_what_moves(tmp_path):
    simulation = begin(tmp_path, CUBE.replace(
        'shape = { box', 'velocity = [1, 2, 3]\nshape = { box') + ZONE.format(
        **zone("beach", 0.0, 0.3, "east", 0)).replace("0.05, 0.3]]", "0.15, 0.3]]"))[0]  # fmt: skip
    simulation.features["wave_zones"].push_particles(StepSpan(1, 0.0, 0.1, 0.1))
    x, v = by_id(simulation, "x", "v")
    np.testing.assert_allclose(v[x[:, 1] > 0.15], np.float32([1, 2, 3]) + 0 * v[x[:, 1] > 0.15])
    outer = (x[:, 1] < 0.15) & (x[:, 0] > 0.28)
    share = math.exp(-12.0 / PERIOD * 0.1)  # at the very face
    np.testing.assert_allclose(v[outer], share * np.float32([1, 2, 3]) + 0 * v[outer], rtol=0.03)


@pytest.mark.parametrize("depth, period", [(0.2, 0.01), (0.2, 0.8)])
def test_deep_water_is_no_overflow(tmp_path, depth, period):
    """k h is 8,000 with the shorter period."""
    text = ZONE.format(**zone("maker", 0.0, 0.3, "west", 1e-6)).replace("= 0.8", f"= {period}")
    simulation = begin(tmp_path, CUBE + text)[0]
    advance(simulation, 2.0 * simulation.bound())
    (v,) = by_id(simulation, "v")
    assert np.isfinite(v).all()


def test_groups_without_particles_are_no_fault(tmp_path):
    """Water that is held at first has a group that is empty at the start."""
    text = CUBE.replace("shape = { box", 'release_time = "1 s"\nshape = { box')
    simulation = begin(tmp_path, text + ZONE.format(**zone("a", 0.0, 0.3, "west", 0.02)))[0]
    assert not all(len(group) for group in simulation.groups)
    for feature in simulation.features.values():
        feature.compile_kernels()
    advance(simulation, 2.0 * simulation.bound())


def reply(rate, length, is_beach):
    """Return the wave in units of the wanted one: made by a zone, or returned by a beach.

    The linear problem of shallow water, (1 + i rate w / omega) k^2 u + u'' = what drives it, by
    finite differences; lengths in wavelengths, rates times the period.
    """
    k, count = 2.0 * math.pi, 4000
    x = np.linspace(0.0, length + 1.0, count)
    h = x[1] - x[0]
    place = np.clip((x - 1.0) / length if is_beach else 1.0 - x / length, 0.0, 1.0)
    damping = 1j * rate / (2.0 * math.pi) * place**2 * (3.0 - 2.0 * place)
    bands = np.full((3, count), 1.0 / h**2, complex)
    bands[1] = -2.0 / h**2 + k * k * (1.0 + damping)
    drive = np.zeros(count, complex)
    wall, far = (-1, 0) if is_beach else (0, -1)
    if not is_beach:
        drive[:] = k * k * damping * np.exp(1j * k * x)
    bands[1, wall], drive[wall], drive[far] = 1.0, 0.0, 2j * k * is_beach
    if is_beach:  # the wave comes in at 0
        bands[2, -2], bands[1, 0], bands[0, 1] = 0.0, -1 / h + 0.5j * k, 1 / h + 0.5j * k
    else:
        bands[0, 1], bands[1, -1], bands[2, -2] = 0.0, 1 / h - 0.5j * k, -1 / h - 0.5j * k
    u = solve_banded((1, 1), bands, drive)
    if not is_beach:
        return abs(u[-10])
    free = x < 0.9
    basis = np.stack([np.exp(1j * k * x[free]), np.exp(-1j * k * x[free])], 1)
    come, back = np.abs(np.linalg.lstsq(basis, u[free], rcond=None)[0])
    return back / come


@pytest.mark.parametrize(
    "length, made, returned", [(0.5, 0.94, 0.09), (1.0, 1.01, 0.04), (1.5, 1.00, 0.012)]
)
def test_the_default_rates_make_and_take_up_waves(length, made, returned):
    """The numbers of docs/explanation/wave-zones.md."""
    assert reply(MAKER_RATE, length, False) == pytest.approx(made, abs=0.005)
    assert reply(BEACH_RATE, length, True) == pytest.approx(returned, abs=0.004)


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
    zones, begin_time = simulation.features["wave_zones"], time.process_time()
    push, spent = zones.push_particles, []

    def timed(span):
        begin = time.process_time()
        bound = push(span)
        spent.append(time.process_time() - begin)
        return bound

    zones.push_particles = timed
    advance(simulation, 6.4)
    share = sum(spent) / (time.process_time() - begin_time)
    print(f"the zones take {share:.1%} of the processor time")
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
    assert abs(best / k - 1.0) < 0.02
    assert abs(2.0 * there / 0.03 - 1.0) < 0.05
    assert back / there < 0.05


WRONG = {
    "a gravity that is not along z": ("[domain]\n", "[domain]\ngravity = [1, 0, -9.8]\n",
        "domain.gravity: must be constant and along -z"),
    "a gravity that grows": ("[domain]\n", '[domain]\ngravity_ramp_time = "1 s"\n',
        "domain.gravity: must be constant and along -z"),
    "a box outside": ("box = [[0.0, 0, 0], [0.6,", "box = [[1.0, 0, 0], [1.6,",
        "wave_zone.maker.box: is outside of the domain, 0 to 0.6 m along x"),
    "a box beside": ("[0.6, 0.05, 0.3]]\nouter", "[0.6, -0.5, 0.3]]\nouter",
        "wave_zone.maker.box: is outside of the domain, 0 to 0.05 m along y"),
    "a box without extent": ("[0.6, 0.05, 0.3]]\nouter", "[0.0, 0.05, 0.3]]\nouter",
        "must have an extent along each axis"),
    "an outer face outside": ("box = [[0.0, 0, 0]", "box = [[-5.0, 0, 0]",
        "wave_zone.maker.outer: the face is at -5 m, outside of the domain"),
    "a level above": ("level = 0.2", "level = 2", "wave_zone.maker.level: must be above"),
    "a depth below": ("depth = 0.2", "depth = 2",
        "wave_zone.maker.depth: reaches below the domain: at most 0.2 m"),
    "waves that break": ("height = 0.02", "height = 0.2",
        "wave_zone.maker.height: waves of this period and depth break at"),
    "a face that is none": ('outer = "west"', 'outer = "up"', "wave_zone.maker.outer: "),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_zone_is_one_line(tmp_path, name):
    old, new, message = WRONG[name]
    text = TANK.format(length=0.6, cell=0.0125)
    text += ZONE.format(**zone("maker", 0.0, 0.6, "west", 0.02))
    assert old in text
    with pytest.raises(SceneError) as error:
        loader.load(write(tmp_path, text.replace(old, new)))
    lines = str(error.value).splitlines()
    assert any(message in line and "scene.toml:" in line for line in lines), lines


def test_a_balance_of_all_walls_and_the_cuda_engine_are_refused(tmp_path):
    text = CUBE + ZONE.format(**zone("maker", 0.0, 0.3, "west", 0.02))
    probe = '[[probe]]\nname = "walls"\nwall = "all"\nsampling_interval = "1 ms"\n'
    with pytest.raises(SceneError, match="probe.walls.wall: is not for scenes with a wave zone"):
        loader.load(write(tmp_path, text + probe))
    assert "cuda" in FEATURE.missing_engines

"""Regions of a body: axial vibration of a bar of two materials, mass, center and momentum.

Theory: a bar of two segments in series is fixed at x = 0 and free at x = L. With the wave numbers
k = omega / c, c = sqrt(E / rho), and the impedances Z = sqrt(E rho) of the segments of the lengths
L1 and L2, the first mode has tan(k1 L1) tan(k2 L2) = Z1 / Z2 (Meirovitch, Fundamentals of
Vibrations, 2001, section 8.7: continuous displacement and force where they meet). Poisson's ratio
is 0. Tolerance: 0.3 % with 12 cells in each segment.
"""

import numpy as np
import pytest
from scipy.optimize import brentq

from tests.support import oscillation
from tests.support.simulate import advance, begin, by_id, totals
from tests.support.validation_record import held

SOFT, STIFF = (1e5, 1000.0), (8e5, 2000.0)  # E [Pa], rho [kg/m3]
HALF = 0.5  # [m] length of each segment
BAR = """
[accuracy]
precision = "double"
[domain]
size = [1.25, WIDTH, WIDTH]
cell = CELL
gravity = [0, 0, 0]
boundary = { default = "slip", west = "stick" }
[time]
end = 100
cfl = 0.3
[material.first]
kind = "elastic"
density = RHO1
youngs_modulus = E1
poisson_ratio = 0.0
[material.second]
kind = "elastic"
density = RHO2
youngs_modulus = E2
poisson_ratio = 0.0
[[object]]
name = "bar"
material = "first"
shape = { box = [[0, 0, 0], [1, WIDTH, WIDTH]] }
[[object.region]]
material = "second"
box = [[0.5, -1, -1], [2, 1, 1]]
"""


def first_frequency(one, other):
    """Angular frequency [rad/s] of the first mode, by the equation of the module's head."""
    (k1, z1), (k2, z2) = ((np.sqrt(rho / E), np.sqrt(rho * E)) for E, rho in (one, other))

    def excess(omega):
        return np.tan(omega * k1 * HALF) * np.tan(omega * k2 * HALF) - z1 / z2

    return brentq(excess, 1e-6, 0.999999 * 0.5 * np.pi / (max(k1, k2) * HALF))


def measured_frequency(folder, one, other, cells):
    """Angular frequency [rad/s] of the bar set off in its first mode."""
    omega, dx = first_frequency(one, other), HALF / cells
    text = BAR.replace("WIDTH", repr(4 * dx)).replace("CELL", repr(dx))
    for name, value in zip(("E1", "RHO1", "E2", "RHO2"), (*one, *other), strict=True):
        text = text.replace(name, repr(value))
    k1, k2 = (omega * np.sqrt(rho / E) for E, rho in (one, other))

    def mode(x):
        ratio = np.sin(k1 * HALF) / np.cos(k2 * HALF)
        return np.where(x < HALF, np.sin(k1 * x), ratio * np.cos(k2 * (2 * HALF - x)))

    def velocity(x):
        v = np.zeros_like(x)
        v[:, 0] = 1e-3 * mode(x[:, 0])
        return v

    simulation, made = begin(folder, text, velocity=velocity)
    density = np.where(made.x[:, 0] < HALF, one[1], other[1])
    weights = density * mode(made.x[:, 0])  # modes are orthogonal with the density as weight
    times, values = [], []
    dt = simulation.bound()
    while simulation.time < 2.3 * 2 * np.pi / omega:
        (v,) = by_id(simulation, "v")
        times.append(simulation.time)
        values.append(float((v[:, 0] * weights).sum()))
        simulation.advance(dt)
    return 2 * np.pi / oscillation.period(times, values)


@pytest.mark.parametrize("order", ["soft at the wall", "stiff at the wall"])
def test_a_bar_of_two_materials_has_its_exact_frequency(tmp_path, order):
    segments = (SOFT, STIFF) if order.startswith("soft") else (STIFF, SOFT)
    measured, exact = measured_frequency(tmp_path, *segments, 12), first_frequency(*segments)
    source = "tan(k1 L1) tan(k2 L2) = Z1 / Z2"
    held(f"bar of two materials, {order}: frequency", measured, exact, 0.003, unit="rad/s",
         source=source, note="12 cells each")  # fmt: skip


FREE = """
[accuracy]
precision = "double"
[domain]
size = [1, 1, 1]
cell = 0.05
gravity = [0, 0, 0]
[time]
end = 1
[material.oak]
kind = "elastic"
density = 700
youngs_modulus = 1e5
[material.iron]
kind = "elastic"
density = 2800
youngs_modulus = 8e5
[[object]]
name = "hammer"
material = "oak"
shape = { box = [[0.3, 0.4, 0.4], [0.7, 0.6, 0.6]] }
velocity = [0.3, 0.1, 0]
angular_velocity = [1, 2, 5]
[[object.region]]
material = "iron"
box = [[0.6, 0, 0], [1, 1, 1]]
"""


def test_mass_center_and_momentum_are_exact(tmp_path):
    """A spinning body of 0.012 m3 of oak and 0.004 m3 of iron: 8.4 and 11.2 kg around x = 0.45 and
    0.65 m."""
    simulation, made = begin(tmp_path, FREE)
    start = totals(simulation)
    assert start["mass"] == pytest.approx(19.6, rel=1e-14)
    assert np.allclose(start["momentum"], 19.6 * np.array([0.3, 0.1, 0.0]), rtol=0, atol=1e-12)
    density = np.where(made.x[:, 0] < 0.6, 700.0, 2800.0)
    center = ((density * made.vol0)[:, None] * made.x).sum(0) / 19.6
    exact = np.array([(8.4 * 0.45 + 11.2 * 0.65) / 19.6, 0.5, 0.5])
    assert np.allclose(center, exact, rtol=0, atol=1e-14)
    spin = np.cross([1.0, 2.0, 5.0], made.x - exact) + [0.3, 0.1, 0.0]  # about the center of mass
    assert np.allclose(made.v0, spin, rtol=0, atol=1e-13)
    advance(simulation, 0.1)
    end, scale = totals(simulation), 19.6 * np.hypot(0.3, 0.1)
    assert simulation.step > 50
    assert end["mass"] == pytest.approx(start["mass"], rel=1e-14)
    assert np.abs(end["momentum"] - start["momentum"]).max() < 1e-12 * scale
    x, _ = by_id(simulation, "x", "v")
    moved = ((density * made.vol0)[:, None] * x).sum(0) / 19.6 - center
    assert np.allclose(moved, simulation.time * np.array([0.3, 0.1, 0.0]), rtol=0, atol=1e-12)

"""A square bar that twists to and fro: its frequency, and how long it lasts.

Theory: the first mode of a free bar of length L and edge a turns its sections by cos(pi z / L)
with frequency f = sqrt(G J / (rho I)) / (2 L), where J = .1406 a^4 is its torsion constant and
I = a^4 / 6 its polar moment (Saint-Venant; Timoshenko and Goodier, art. 109). At a = L / 4 warping
lowers it by less than 1 %. Nothing is lost. Tolerances: frequency 3 %, energy after ten periods .9,
restored, with 27 particles per cell (with 8: .83; APIC: .5).
"""

import numpy as np
import pytest

from tests.support.oscillation import keeps, period
from tests.support.simulate import advance, begin, by_id
from tests.support.validation_record import held

E, NU, RHO, L, A = 1e5, 0.3, 1000.0, 0.32, 0.08
SHEAR = E / 2 / (1 + NU)
PERIOD = 2 * L / np.sqrt(6 * 0.1406 * SHEAR / RHO)  # [s]
MIDDLE = (0.08, 0.08, 0.2)
SCENE = """
[domain]
size = [0.16, 0.16, 0.4]
cell = {dx!r}
gravity = [0, 0, 0]
[time]
end = 100
[accuracy]
precision = "double"
{accuracy}
[material.rubber]
kind = "elastic"
density = 1000
youngs_modulus = 1e5
poisson_ratio = 0.3
[[object]]
name = "bar"
material = "rubber"
particles_per_cell = {particles}
shape = {{ box = [[0.04, 0.04, 0.04], [0.12, 0.12, 0.36]] }}
"""


def twist(x):
    """Velocity [m/s] of the mode, .01 m/s at the edges of the ends, at x (n, 3)."""
    r = x - MIDDLE
    rate = -0.01 / A * np.sin(np.pi * r[:, 2] / L)
    return np.stack([-rate * r[:, 1], rate * r[:, 0], np.zeros(len(x))], 1)


def twisting(folder, accuracy="", particles=27):
    """(period [s], share of the amplitude that a period leaves) of a bar 32 cells long."""
    dx = L / 32
    text = SCENE.format(dx=dx, accuracy=accuracy, particles=particles)
    simulation, _ = begin(folder, text, velocity=twist)
    mode = twist(by_id(simulation, "x")[0])
    times, found = [], []
    for k in range(248):
        if k:
            advance(simulation, k * PERIOD / 24)
        (v,) = by_id(simulation, "v")
        times.append(simulation.time)
        found.append((mode * v).sum() / (mode**2).sum())
    return period(times, found), keeps(times, found)


@pytest.mark.slow
def test_a_twist_lasts(tmp_path):
    """Ten periods; with APIC beside."""
    say = {"source": "Saint-Venant", "note": "32 x 8 x 8 cells, 27 particles per cell"}
    lasts, left = twisting(tmp_path)
    held("torsion of a bar: frequency", 1 / lasts, 1 / PERIOD, 0.03, unit="Hz", **say)
    say |= {"kind": "above", "unit": "of the energy after 10 periods"}
    held("torsion of a bar: energy", left**20, 1.0, 0.9, **say)
    apic = twisting(tmp_path, 'transfer = "apic"')[1] ** 20
    held("torsion of a bar: energy with APIC", apic, 1.0, 0.9, **say, expected=False)

"""Axial vibration of a bar fixed at one end: order of accuracy in space and time, walls included.

Theory: the first mode of a bar of length L, fixed at x = 0 and free at x = L, is sin(pi x / 2 L)
with frequency f = c / (4 L), c = sqrt(E / rho) for Poisson's ratio 0. The fixed end is a wall that
mirrors; a plain clamp at the wall's nodes is first order and fails. Tolerances: order >= 1.8
between 8, 16 and 32 cells; error below 1e-3 at 32 and at 64 cells.
"""

import numpy as np
import pytest

from tests.support import oscillation
from tests.support.simulate import begin, by_id
from tests.support.validation_record import held

E, RHO, L = 1e5, 1000.0, 1.0
EXACT = np.sqrt(E / RHO) / (4 * L)  # [Hz]
MODE = "f = c / (4 L), c = sqrt(E / rho)"
BAR = """
[accuracy]
precision = "double"
[domain]
size = [SIZE, WIDTH, WIDTH]
cell = CELL
gravity = [0, 0, 0]
boundary = { default = "slip", west = "stick" }
[time]
end = 100
cfl = 0.2
[material.rod]
kind = "elastic"
density = 1000
youngs_modulus = 1e5
poisson_ratio = 0.0
[[object]]
name = "bar"
material = "rod"
shape = { box = [[0, 0, 0], [1, WIDTH, WIDTH]] }
"""


def frequency(folder, cells):
    """Measured frequency [Hz] of the first mode."""
    return frequency_and_step(folder, cells)[0]


def frequency_and_step(folder, cells, keys=""):
    """The same from the zero crossings of the mode's velocity over three periods, and the step [s].

    keys: further keys of [accuracy].
    """
    dx = L / cells
    text = BAR.replace("SIZE", repr(1.25)).replace("WIDTH", repr(4 * dx)).replace("CELL", repr(dx))
    text = text.replace("[domain]", keys + "[domain]")
    amplitude = 1e-4 * np.sqrt(E / RHO)

    def mode(x):
        v = np.zeros_like(x)
        v[:, 0] = amplitude * np.sin(0.5 * np.pi * x[:, 0] / L)
        return v

    simulation, made = begin(folder, text, velocity=mode)
    shape = np.sin(0.5 * np.pi * made.x[:, 0] / L)
    times, values = [0.0], [amplitude * (shape**2).sum()]
    period = 4 * L / np.sqrt(E / RHO)
    dt = simulation.bound()
    while simulation.time < 3.2 * period:
        simulation.advance(dt)
        (v,) = by_id(simulation, "v")
        times.append(simulation.time)
        values.append((v[:, 0] * shape).sum())
    # symplectic Euler staggers v half a step: a constant shift that differences of crossings do not
    # see
    return 1 / oscillation.period(times, values), dt


def test_frequency_converges_with_second_order(tmp_path):
    cells = (8, 16, 32)
    errors = np.array([abs(frequency(tmp_path, n) / EXACT - 1) for n in cells])
    orders = np.log2(errors[:-1] / errors[1:])
    line = errors[0] * (8 / np.array(cells)) ** 2
    curves = {"error": (cells, errors), "theory: second order": (cells, line)}
    axes = ("cells", "relative error of the frequency")
    say = {"source": MODE, "note": "8, 16, 32 cells", "curves": curves, "axes": axes}
    held("axial bar: order", float(orders.min()), 2.0, 1.8, kind="above", **say)
    held("axial bar: error at 32 cells", errors[-1], 0.0, 1e-3, kind="below", source=MODE)


@pytest.mark.slow
def test_frequency_at_64_cells(tmp_path):
    found = frequency(tmp_path, 64)
    held("axial bar: frequency at 64 cells", found, EXACT, 1e-3, unit="Hz", source=MODE)

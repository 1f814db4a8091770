"""Drag of a fluid in the pores of a sand, against closed forms.

Theory: c = n^2 rho_w g / k [kg/(m3 s)], n porosity, k hydraulic conductivity, g = 9.80665 m/s2.
Relaxation of uniform velocities without gravity, solved implicitly: dv_n = dv_0 (1 + dt/T)^-n, 1/T
= c (1 / rhobar_s + 1 / rhobar_w) with partial densities rhobar_s = (1 - n) rho_s, rhobar_w = n
rho_w. Tolerance 1e-3; momentum 1e-14. The strength per volume does not depend on the cell: half
of it changes the rate by less than 5 %. The printed form lacks dt: at half the step it doubles.

Settling of loose sand in still water, a column filled evenly: v_s = -(1 - n)(rho_s / rho_w - 1) k,
slip v_w - v_s = -v_s / n. Tolerance 2 %.
"""

import numpy as np
import pytest

from tests.support.simulate import advance, begin, by_id, totals
from tests.support.validation_record import held

G = 9.80665
N, RHO_S, RHO_W = 0.4, 2650.0, 1000.0
SCENE = """
[accuracy]
pressure = "explicit"
precision = "double"
[domain]
size = {size}
cell = {cell!r}
boundary.default = "slip"
gravity = [0, 0, {gravity!r}]
gravity_ramp_time = {ramp!r}
[time]
end = 10
[material.water]
kind = "fluid"
tait_coefficient = {k!r}
[material.grains]
kind = "sand"
density = 2650
porosity = 0.4
youngs_modulus = {E!r}
[[object]]
name = "pores"
material = "water"
shape = {{ box = {box} }}
volume_fraction = 0.4
velocity = {velocity}
[[object]]
name = "sand"
material = "grains"
shape = {{ box = {box} }}
[[coupling]]
between = ["water", "grains"]
kind = "{kind}"
hydraulic_conductivity = {conductivity!r}
"""


def relaxation(folder, cell, conductivity, kind="drag", steps=40, dt=2e-4):
    """Slip [m/s] after each step of a block whose water moves at 0.1 m/s, and the drift of momentum
    over its sum of magnitudes."""
    side = 0.16
    text = SCENE.format(
        size=[0.32] * 3, cell=cell, gravity=0.0, ramp=0.0, k=1e3, E=1.0, kind=kind,
        box=[[0.08] * 3, [0.08 + side] * 3], velocity=[0.1, 0, 0],
        conductivity=conductivity,
    )  # fmt: skip
    simulation, made = begin(folder, text)
    water = made.object == 0
    inside = (np.abs(made.x - 0.16) < side / 2 - 2.5 * cell).all(1)  # away from the block's faces
    before = totals(simulation)["momentum"][0]
    slips = [0.1]
    for _ in range(steps):
        simulation.advance(dt)
        (v,) = by_id(simulation, "v")
        slips.append(v[water & inside, 0].mean() - v[~water & inside, 0].mean())
    return np.array(slips), abs(totals(simulation)["momentum"][0] - before) / before


def rate(slips, dt=2e-4):
    """1/T [1/s] of the implicit decay."""
    ratio = (slips[1:6] / slips[:5]).mean()
    return (1.0 / ratio - 1.0) / dt


def theory(conductivity):
    c = N**2 * RHO_W * G / conductivity
    return c * (1.0 / ((1 - N) * RHO_S) + 1.0 / (N * RHO_W))


def test_relaxation(tmp_path):
    conductivity = 1e-2
    slips, drift = relaxation(tmp_path, 0.01, conductivity)
    n = np.arange(len(slips))
    exact = 0.1 * (1.0 + 2e-4 * theory(conductivity)) ** -n
    here = n <= 5  # later the block's faces, which move apart, are felt inside
    worst = float(np.abs(slips - exact)[here].max() / 0.1)
    curves = {"theory": (n[here], exact[here]), "solver": (n[here], slips[here])}
    held("drag relaxation: slip", worst, 0.0, 1e-3, kind="absolute", source="closed form",
         note="over the first slip", curves=curves, axes=("steps", "slip [m/s]"))  # fmt: skip
    held("drag relaxation: momentum", drift, 0.0, 1e-14, kind="absolute", source="exact")


def test_drag_does_not_depend_on_the_cell(tmp_path):
    coarse, fine = (rate(relaxation(tmp_path, cell, 1e-2, steps=6)[0]) for cell in (0.02, 0.01))
    held("drag at half the cell", fine, coarse, 0.05, unit="1/s", source="the same at 2 cm")


def test_the_printed_drag_depends_on_the_step(tmp_path):
    """It lacks dt: the slip loses the same share in a step of any length."""
    coarse, fine = (
        rate(relaxation(tmp_path, 0.01, 1e3, "drag-versagauss", steps=6, dt=dt)[0], dt)
        for dt in (2e-4, 1e-4)
    )
    again = rate(relaxation(tmp_path, 0.01, 1e-2, steps=6, dt=1e-4)[0], 1e-4)
    held("drag at half the step", again, theory(1e-2), 0.05, unit="1/s", source="closed form")
    held("printed drag at half the step", fine, coarse, 0.05, unit="1/s",
         source="the same at twice the step", expected=False)  # fmt: skip


@pytest.mark.parametrize(
    "conductivity", [1e-3, pytest.param(1e-4, marks=pytest.mark.slow),
                     pytest.param(1e-2, marks=pytest.mark.slow)]
)  # fmt: skip
def test_settling(conductivity, tmp_path):
    """Means over whole periods of the column's ringing, which the ramp leaves weak."""
    height = 0.4
    text = SCENE.format(
        size=[0.04, 0.04, height], cell=0.01, gravity=-G, ramp=0.2, k=1e5, E=1.0, kind="drag",
        box=[[0, 0, 0], [0.04, 0.04, height]], velocity=[0, 0, 0],
        conductivity=conductivity,
    )  # fmt: skip
    simulation, made = begin(tmp_path, text)
    water = made.object == 0
    advance(simulation, 0.2)
    density = (1 - N) * RHO_S + N * RHO_W
    period = 4 * height / np.sqrt(7e5 / N / density)
    times, fall, slip = [], [], []
    while simulation.time < 0.2 + 3 * period:
        simulation.advance(simulation.bound())
        x, v = by_id(simulation, "x", "v")
        middle = np.abs(x[:, 2] - height / 2) < 0.06
        times.append(simulation.time)
        fall.append(v[middle & ~water, 2].mean())
        slip.append(v[middle & water, 2].mean() - fall[-1])
    exact = -(1 - N) * (RHO_S / RHO_W - 1) * conductivity
    mean = float(np.mean(slip))
    held(f"settling at k = {conductivity:g} m/s: slip", mean, -exact / N, 0.02, unit="m/s",
         source="Darcy's law")  # fmt: skip
    # the ringing moves sand and water together: what is left is the flux of volume
    own = float(np.mean(np.array(fall) - (np.array(fall) + N * np.array(slip))))
    held(f"settling at k = {conductivity:g} m/s: sand against the mixture", own, exact, 0.02,
         unit="m/s", source="Darcy's law")  # fmt: skip

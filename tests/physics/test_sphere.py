"""A sphere in ideal water: it coasts without drag, and sinks and rises against its added mass.

Theory: a body that is set off in ideal liquid at rest shares its momentum with the added mass C V
of the liquid and then keeps its speed (d'Alembert): v / v0 = s / (s + C), s its density over the
liquid's; let go, it is accelerated by (s - 1) g / (s + C). In the middle of a spherical shell of
radius b, C = (b^3 + 2 a^3) / (b^3 - a^3) / 2 (Lamb, Hydrodynamics, art. 93); of the box, b is that
of a sphere of its volume. The liquid is compressible (c = 4.5 m/s), so that sound goes to and fro
in the box: what is held is a mean. Motion is restored: with APIC water keeps a boundary layer.
Tolerances: speed 5 % over a radius; way of the first half radius 12 %. Missed, as a strict xfail:
a light sphere rises with 14 % less (6 cells in radius: 17 %). With 6 cells the other two are 5 %
off, with APIC a third and more.
"""

import numpy as np
import pytest

from tests.support.simulate import begin, by_id
from tests.support.validation_record import held

DX, CELLS, G = 0.01, 40, 9.81  # edge of the box in cells
L = CELLS * DX
SCENE = """
[domain]
size = [{L}, {L}, {L}]
cell = {dx}
gravity = [0, 0, {g}]
[time]
end = 10
[accuracy]
transfer = "apic-corrected"
precision = "single"
[material.water]
kind = "fluid"
tait_coefficient = 2e4
[material.rubber]
kind = "elastic"
density = {density}
youngs_modulus = {stiff}
poisson_ratio = 0.4
[[object]]
name = "ball"
material = "rubber"
shape = {{ sphere = {{ center = [{m}, {m}, {m}], radius = {R} }} }}
[[object]]
name = "water"
material = "water"
{pressure}
[object.shape]
difference = [
  {{ box = [[0, 0, 0], [{L}, {L}, {L}]] }},
  {{ sphere = {{ center = [{m}, {m}, {m}], radius = {R} }} }},
]
"""


def added_mass(cells):
    """Of a sphere of so many cells in radius, over its volume of liquid."""
    b3, a3 = CELLS**3 * 3 / 4 / np.pi, cells**3
    return (b3 + 2 * a3) / (b3 - a3) / 2


def ball(folder, cells, ratio, g=0.0, speed=0.0, until=1.0):
    """(times [s], way of the ball [its radii], its speed [m/s]) until a way."""
    R = cells * DX
    text = SCENE.format(
        L=L, dx=DX, g=-g, density=1000 * ratio, stiff=1e5 * max(ratio, 0.1), m=L / 2, R=R,
        pressure='initial_pressure = "hydrostatic"' if g else "",
    )  # fmt: skip

    def start(x):
        inside = ((x - L / 2) ** 2).sum(1) < R**2
        return np.outer(inside, [speed, 0, 0])

    simulation, _ = begin(folder, text, velocity=start)
    axis, rows, first = (2 if g else 0), [], None
    while not rows or abs(rows[-1][1]) < until:
        simulation.advance(simulation.bound())
        if simulation.step % 5 == 0:
            x, v, vol, thing = by_id(simulation, "x", "v", "vol0", "object")
            m = vol[thing == 0, None] / vol[thing == 0].sum()
            place = float((m * x[thing == 0]).sum(0)[axis])
            first = place if first is None else first
            now = float((m * v[thing == 0]).sum(0)[axis])
            rows.append((simulation.time, (place - first) / R, now))
        assert simulation.time < 2.0, "it does not get there"
    return np.array(rows).T


@pytest.mark.slow
def test_it_coasts(tmp_path):
    """Three times as dense as water, 8 cells in radius."""
    exact = 3 / (3 + added_mass(8))
    note = "3 times as dense as water, 8 cells in radius, box of 40 cells, over a radius"
    say = {"unit": "of its start", "source": "Lamb, art. 93; d'Alembert", "note": note}
    _, way, v = ball(tmp_path, 8, 3.0, speed=0.3)
    mean = float(v[way > 0.1].mean() / 0.3)
    held("coasting sphere: speed", mean, exact, 0.05, **say)


@pytest.mark.slow
@pytest.mark.parametrize(
    "ratio",
    [
        3.0,
        pytest.param(0.1, marks=pytest.mark.xfail(strict=True, reason="a light one is 14 % slow")),
    ],
)
def test_it_is_let_go(tmp_path, ratio):
    """To sink or rise."""
    times, way, _ = ball(tmp_path, 8, ratio, g=G, until=0.5)
    exact = (ratio - 1) * G / (ratio + added_mass(8))
    found = -2 * way[-1] * 8 * DX / times[-1] ** 2
    note = f"{ratio:g} times as dense as water, 8 cells in radius, over half a radius"
    held(f"sphere released, density {ratio:g}: acceleration", found, exact, 0.12, unit="m/s2",
         source="Lamb, art. 93", note=note, deviation=True)  # fmt: skip

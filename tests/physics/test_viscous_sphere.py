"""A sphere that slips sinks in a viscous liquid.

Theory: a sphere of radius a without shear stress on its surface feels the drag 4 pi eta a U in an
unbounded liquid (Hadamard and Rybczynski for a bubble; Lamb, Hydrodynamics, art. 337). In a box
with slip walls its images slow it down: U = F / (4 pi eta a) (1 - K a / L) (Happel and Brenner, Low
Reynolds number hydrodynamics, section 7), K from the sum over the periodic lattice of images
(Hasimoto 1959). Images in side walls push the same way, those in the floor and the roof the other.
Tolerance: 8 %, mean
over 0.4 s, in which the spheres sink by one and by two and a half cells.
"""

import numpy as np
import pytest

from tests.support.simulate import begin, by_id
from tests.support.validation_record import held

DX, CELLS, VISCOSITY, G = 0.01, 28, 100.0, 9.8  # [m], edge of the box, [Pa s], [m/s2]
DENSITIES = 2000.0, 1000.0  # [kg/m3] of the sphere and of the liquid
SCENE = """
[domain]
size = [{L}, {L}, {L}]
cell = {dx}
gravity = [0, 0, -{g}]
boundary = "slip"
[time]
end = 10
[accuracy]
precision = "single"
[material.honey]
kind = "fluid"
tait_coefficient = 2e4
viscosity = {eta}
[material.rubber]
kind = "elastic"
density = 2000
youngs_modulus = 1e5
poisson_ratio = 0.4
friction = 0
[[coupling]]
between = ["honey", "rubber"]
kind = "contact"
friction = 0
[[object]]
name = "ball"
material = "rubber"
shape = {{ sphere = {{ center = [{m}, {m}, {m}], radius = {R} }} }}
[[object]]
name = "honey"
material = "honey"
initial_pressure = "hydrostatic"
[object.shape]
difference = [
  {{ box = [[0, 0, 0], [{L}, {L}, {L}]] }},
  {{ sphere = {{ center = [{m}, {m}, {m}], radius = {R} }} }},
]
"""


def image_factor() -> float:
    """K of a box with slip walls: how much images slow a point force in its middle, L = 1."""
    width, waves = 0.05, 60
    sides = 2 * np.pi * np.arange(-waves, waves + 1)
    upright = np.pi * (2 * np.arange(-2 * waves, 2 * waves) + 1)
    x, y, z = np.meshgrid(sides, sides, upright, indexing="ij", sparse=True)
    square = x * x + y * y + z * z
    lattice = ((1 - z * z / square) / square * np.exp(-0.5 * width**2 * square)).sum()
    alone = np.sqrt(np.pi / 2) / (3 * np.pi**2 * width)
    return 4 * np.pi * (alone - lattice)


def terminal_speed(radius: int) -> float:
    """Speed of a sphere of so many cells in radius [m/s]."""
    a = radius * DX
    alone = (DENSITIES[0] - DENSITIES[1]) * G * a**2 / (3 * VISCOSITY)
    return alone * (1 - image_factor() * radius / CELLS)


def test_images_of_a_periodic_lattice_are_those_of_hasimoto():
    """The same sum for a lattice without changes of sign: 1 - 2.8373 a / L for no slip."""
    width, waves = 0.05, 60
    k = 2 * np.pi * np.arange(-waves, waves + 1)
    x, y, z = np.meshgrid(k, k, k, indexing="ij", sparse=True)
    square = x * x + y * y + z * z
    square[waves, waves, waves] = np.inf
    lattice = ((1 - z * z / square) / square * np.exp(-0.5 * width**2 * square)).sum()
    alone = np.sqrt(np.pi / 2) / (3 * np.pi**2 * width)
    assert abs(6 * np.pi * (alone - lattice) - 2.8373) < 2e-2


def sinking_speed(simulation) -> float:
    """Speed of the ball of a simulation from 0.15 s on [m/s], after viscosity has spread."""
    rows = []
    while simulation.time < 0.55:
        simulation.advance(simulation.bound())
        if simulation.step % 10 == 0:
            x, vol, thing = by_id(simulation, "x", "vol0", "object")
            ball = thing == 0
            rows.append((simulation.time, vol[ball] @ x[ball, 2] / vol[ball].sum()))
    t, z = np.array(rows).T
    return float(-np.polyfit(t[t > 0.15], z[t > 0.15], 1)[0])


@pytest.mark.slow
@pytest.mark.parametrize("radius", [3, 6])
def test_a_sphere_that_slips_sinks_as_fast_as_theory_says(tmp_path, radius):
    L = CELLS * DX
    text = SCENE.format(L=L, dx=DX, g=G, eta=VISCOSITY, m=L / 2, R=radius * DX)
    simulation, _ = begin(tmp_path, text)
    held(
        f"sphere that slips sinks in honey, {radius} cells in radius: speed",
        sinking_speed(simulation), terminal_speed(radius), 0.08, unit="m/s",
        source="Hadamard and Rybczynski; Hasimoto 1959",
        note=f"box of {CELLS} cells; Reynolds number below 0.1",
    )  # fmt: skip

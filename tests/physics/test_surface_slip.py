"""Viscous liquids that stick to colliders, or slip on them by Navier's law.

A liquid fills the gap between a plate at rest and one that turns, within a jacket without friction:
v = omega r (z + b) / (h + 2 b) exactly, without inertia, b the slip length. The torque is
pi eta omega R^4 / (2 (h + 2 b)). Tolerances: 1 % of the shear rate in the middle wherever the
plates lie among the nodes; 2 % of the torque, since a fortieth of a cell of the radius is 1 % of
it; 6 % with slip lengths. Between two cylinders, of which the inner one turns, the torque is
4 pi eta omega L a^2 b^2 / (b^2 - a^2): 5 %. A rigid sphere that sinks feels Stokes' drag 6 pi eta a
U with the images of the box, as in test_viscous_sphere.py: 10 %.
"""

import numpy as np
import pytest

import vgmpi
from tests.physics.test_cylinder_couette import SCENE as CYLINDERS
from tests.physics.test_cylinder_couette import mean_torques
from tests.physics.test_viscous_sphere import CELLS, DENSITIES, VISCOSITY, G, image_factor
from tests.physics.test_viscous_sphere import SCENE as SPHERE
from tests.support.simulate import advance, begin, by_id
from tests.support.validation_record import held

ETA, OMEGA, R, MIDDLE, DX = 50.0, 2.0, 0.1, 0.12, 0.01  # [Pa s], [rad/s], [m]
SCENE = """
[domain]
size = [0.24, 0.24, 0.2]
cell = 0.01
gravity = [0, 0, -1]
[time]
end = {end}
[accuracy]
precision = "single"
[material.honey]
kind = "fluid"
tait_coefficient = 2e4
viscosity = 50
[[object]]
name = "honey"
material = "honey"
shape = {{ cylinder = {{ endpoints = [[0.12, 0.12, {low}], [0.12, 0.12, {high}]], radius = 0.1 }} }}
[[object]]
name = "floor"
role = "scenery"
collider = true
{slip}
shape = {{ box = [[-0.1, -0.1, -0.1], [0.4, 0.4, {low}]] }}
[[object]]
name = "lid"
role = "scenery"
collider = true
{slip}
shape = {{ box = [[-0.1, -0.1, {high}], [0.4, 0.4, 0.3]] }}
motion = {{ pivot = [0.12, 0.12, 0], angular_velocity = 2 }}
[[object]]
name = "jacket"
role = "scenery"
collider = true
shape = {{ difference = [
  {{ box = [[-0.1, -0.1, -0.1], [0.4, 0.4, 0.4]] }},
  {{ cylinder = {{ endpoints = [[0.12, 0.12, -0.2], [0.12, 0.12, 0.5]], radius = 0.1 }} }},
] }}
[[probe]]
name = "low"
sampling_rate = 100
collider = "floor"
[[probe]]
name = "high"
sampling_rate = 100
collider = "lid"
"""


def plates(low: float, high: float, slip: str, end: float = 0.4) -> str:
    return SCENE.format(low=low, high=high, slip=slip, end=end)


@pytest.mark.parametrize(
    "low, high",
    [
        (0.043, 0.14),
        pytest.param(0.04, 0.14, marks=pytest.mark.slow),
        pytest.param(0.045, 0.145, marks=pytest.mark.slow),
    ],
)
def test_shear_between_plates_is_exact_wherever_they_lie(tmp_path, low, high):
    simulation, _ = begin(tmp_path, plates(low, high, "slip_length = 0"))
    advance(simulation, 0.3)
    x, v = by_id(simulation, "x", "v")
    r = np.hypot(x[:, 0] - MIDDLE, x[:, 1] - MIDDLE)
    inner = (r > 2 * DX) & (r < 7 * DX)
    turn = (x[:, 0] - MIDDLE) * v[:, 1] - (x[:, 1] - MIDDLE) * v[:, 0]
    spin, h = turn[inner] / r[inner] ** 2 / OMEGA, (x[inner, 2] - low) / (high - low)
    slope, start = np.polyfit(h, spin, 1)
    case = f"liquid between two plates, the lower at {low / DX:g} cells"
    held(f"{case}: shear rate", float(slope), 1.0, 0.01, source="Couette")
    held(f"{case}: turning at the lower plate", float(start), 0.0, 0.01, kind="absolute",
         source="no slip")  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("cells, tolerance", [(0, 0.02), (1, 0.06), (4, 0.06)])
def test_torque_on_plates_follows_the_slip_length(tmp_path, cells, tolerance):
    low, high, length = 0.043, 0.14, cells * DX
    run = vgmpi.run(
        vgmpi.load(tmp_path / "plates.toml", text=plates(low, high, f"slip_length = {length}"))
    )
    torque = mean_torques(run, "low", "high", begin=0.3)
    theory = np.pi * ETA * OMEGA * R**4 / 2 / (high - low + 2 * length)
    held(
        f"liquid between two plates, slip length of {cells} cells: torque",
        0.5 * (torque["low"] - torque["high"]) / theory, 1.0, tolerance, source="Navier 1823",
    )  # fmt: skip


@pytest.mark.slow
def test_the_torques_of_two_cylinders_are_those_of_theory_and_balance(tmp_path):
    text = CYLINDERS.replace("friction = 100", "slip_length = 0")
    run = vgmpi.run(vgmpi.load(tmp_path / "couette.toml", text=text))
    torque = mean_torques(run, "inner", "outer", begin=0.3)
    theory = 4 * np.pi * ETA * 3.0 * 0.04 * (0.2 * 0.08) ** 2 / (0.2**2 - 0.08**2)
    held(
        "two cylinders, liquid that sticks: torque on the inner one", -torque["inner"] / theory,
        1.0, 0.05, source="Couette 1890", note="8 and 20 cells in radius",
    )  # fmt: skip
    held(
        "two cylinders, liquid that sticks: torque on the outer over that on the inner one",
        -torque["outer"] / torque["inner"], 1.0, 0.03, source="angular momentum",
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("radius", [3, 4])
def test_a_rigid_sphere_that_liquid_sticks_to_sinks_by_stokes(tmp_path, radius):
    L, a = CELLS * DX, radius * DX
    text = SPHERE.format(L=L, dx=DX, g=G, eta=VISCOSITY, m=L / 2, R=a)
    rigid = 'material = "rubber"\nrigid = true\nslip_length = 0\n'
    simulation, _ = begin(tmp_path, text.replace('material = "rubber"\n', rigid))
    rows = []
    while simulation.time < 0.5:
        simulation.advance(simulation.bound())
        rows.append((simulation.time, simulation.features["rigid_bodies"].bodies.x[0, 2]))
    t, z = np.array(rows).T
    speed = -np.polyfit(t[t > 0.15], z[t > 0.15], 1)[0]
    alone = 2 * (DENSITIES[0] - DENSITIES[1]) * G * a**2 / (9 * VISCOSITY)
    held(
        f"rigid sphere sinks in honey that sticks to it, {radius} cells in radius: speed",
        float(speed), alone * (1 - 1.5 * image_factor() * radius / CELLS), 0.1, unit="m/s",
        source="Stokes 1851; Hasimoto 1959", note=f"box of {CELLS} cells", expected=False,
        deviation=True,
    )  # fmt: skip

"""Viscous liquids that stick to deformable solids, or slip on them by Navier's law.

Couette: a liquid fills the gap between a slab at rest, a body of a solid, and a plate that turns,
within a jacket without friction: v = omega r (z + b) / (h + b) exactly, without inertia, b the slip
length on the slab. The velocity must vanish within 0.1 cells of the slab's surface wherever it lies
among the nodes; with a slip length of a cell, the torque may be 6 % off, as on colliders. Stokes: a
sphere of rubber that the liquid sticks to feels the drag 6 pi eta a U with the images of the box:
15 %, of which a rigid sphere of that size has 13 (test_surface_slip.py). A ball in a drop of honey
without gravity keeps momentum and angular momentum to rounding.
"""

import numpy as np
import pytest

import vgmpi
from tests.physics.test_cylinder_couette import mean_torques
from tests.physics.test_surface_slip import DX, ETA, MIDDLE, OMEGA, SCENE, R
from tests.physics.test_viscous_sphere import (
    CELLS,
    DENSITIES,
    VISCOSITY,
    G,
    image_factor,
    sinking_speed,
)  # fmt: skip
from tests.physics.test_viscous_sphere import SCENE as SPHERE
from tests.support.simulate import advance, begin, by_id
from tests.support.validation_record import held

HIGH = 0.14  # [m] of the plate that turns
RUBBER = """
[material.rubber]
kind = "elastic"
youngs_modulus = 1e5
poisson_ratio = 0.3
friction = 0
"""
SLAB = """[[object]]
name = "slab"
material = "rubber"
slip_length = {slip}
motion = {{ pivot = [0.12, 0.12, 0], angular_velocity = 0 }}
shape = {{ cylinder = {{ endpoints = [[0.12, 0.12, {base}], [0.12, 0.12, {low}]], radius = 0.1 }} }}
"""
DROP = """
[domain]
size = [0.24, 0.24, 0.24]
cell = 0.01
gravity = [0, 0, 0]
boundary = "open"
[time]
end = 1
[accuracy]
precision = "double"
[material.honey]
kind = "fluid"
tait_coefficient = 2e4
viscosity = 10
[material.rubber]
kind = "elastic"
density = 2000
youngs_modulus = 1e5
[[object]]
name = "ball"
material = "rubber"
slip_length = SLIP
shape = { sphere = { center = [0.12, 0.12, 0.12], radius = 0.03 } }
velocity = [0.2, 0, 0]
angular_velocity = [0, 0, 20]
[[object]]
name = "drop"
material = "honey"
[object.shape]
difference = [
  { sphere = { center = [0.12, 0.12, 0.12], radius = 0.06 } },
  { sphere = { center = [0.12, 0.12, 0.12], radius = 0.03 } },
]
"""

JELLY = """
[domain]
size = [0.6, 0.6, 0.45]
cell = 0.015
boundary = {{ default = "open", bottom = "stick" }}
[time]
end = 0.8
[material]
honey = {{ preset = "honey", kind = "fluid", max_speed = 3, max_compression = 0.04 }}
jelly = {{ kind = "elastic", density = 1050, youngs_modulus = 2e4 }}
[[object]]
name = "jelly"
material = "jelly"
shape = {{ box = [[0.18, 0.18, 0], [0.42, 0.42, 0.15]] }}
{slip}
[[inlet]]
name = "honey"
material = "honey"
disc = {{ center = [0.3, 0.3, 0.4], radius = 0.035 }}
speed = 0.9
"""


def gap_above_slab(low: float, slip: float) -> str:
    """Return the scene of plates with a slab of rubber in place of the lower one."""
    text = SCENE.format(low=low, high=HIGH, slip="slip_length = 0", end=0.4)
    floor, lid = (text.index(f'[[object]]\nname = "{name}"') for name in ("floor", "lid"))
    slab = SLAB.format(slip=slip, base=low - 0.03, low=low)
    text = text[:floor] + slab + text[lid : text.index("[[probe]]")]
    return text.replace("[[object]]", RUBBER + "[[object]]", 1)


@pytest.mark.parametrize(
    "low, slip, tolerance",
    [
        (0.043, 0.0, 0.1),
        pytest.param(0.04, 0.0, 0.1, marks=pytest.mark.slow),
        pytest.param(0.0445, 0.0, 0.1, marks=pytest.mark.slow),
        pytest.param(0.0475, 0.0, 0.1, marks=pytest.mark.slow),
        pytest.param(0.0475, 0.01, 0.4, marks=pytest.mark.slow),
    ],
)
def test_the_liquid_rests_at_the_surface_of_a_slab(tmp_path, low, slip, tolerance):
    simulation, _ = begin(tmp_path, gap_above_slab(low, slip))
    advance(simulation, 0.3)
    x, v = by_id(simulation, "x", "v")
    r, height = np.hypot(x[:, 0] - MIDDLE, x[:, 1] - MIDDLE), x[:, 2] - low
    inner = (r > 2 * DX) & (r < 7 * DX) & (height > 2 * DX) & (height < HIGH - low - 2 * DX)
    turn = (x[:, 0] - MIDDLE) * v[:, 1] - (x[:, 1] - MIDDLE) * v[:, 0]
    slope, start = np.polyfit(height[inner] / DX, turn[inner] / r[inner] ** 2 / OMEGA, 1)
    case = f"liquid on a slab of rubber at {low / DX:g} cells, slip length {slip / DX:g} cells"
    held(f"{case}: height at which it rests", float(-start / slope), -slip / DX, tolerance,
         unit="cells", kind="absolute", source="Couette; Navier 1823")  # fmt: skip
    shear = float(slope) * (HIGH - low + slip) / DX
    held(f"{case}: shear rate", shear, 1.0, 0.06 if slip else 0.01, source="Couette; Navier 1823")


@pytest.mark.slow
def test_the_torque_on_a_slab_is_that_on_the_plate(tmp_path):
    probes = "".join(
        f'[[probe]]\nname = "{name}"\nsampling_rate = 100\ncollider = "{name}"\n'
        for name in ("slab", "lid")
    )
    low = 0.043
    text = gap_above_slab(low, 0.0) + probes
    run = vgmpi.run(vgmpi.load(tmp_path / "plates.toml", text=text))
    torque = mean_torques(run, "slab", "lid", begin=0.3)
    theory = np.pi * ETA * OMEGA * R**4 / 2 / (HIGH - low)
    for name, sign in (("slab", 1.0), ("lid", -1.0)):
        held(f"liquid between a plate and a slab of rubber: torque on the {name}",
             sign * torque[name] / theory, 1.0, 0.02, source="Couette")  # fmt: skip


@pytest.mark.slow
def test_a_sphere_of_rubber_that_liquid_sticks_to_sinks_by_stokes(tmp_path):
    L, a = CELLS * DX, 3 * DX
    text = SPHERE.format(L=L, dx=DX, g=G, eta=VISCOSITY, m=L / 2, R=a)
    simulation, _ = begin(tmp_path, text.replace('name = "ball"', 'name = "ball"\nslip_length = 0'))
    alone = 2 * (DENSITIES[0] - DENSITIES[1]) * G * a**2 / (9 * VISCOSITY)
    theory = alone * (1 - 1.5 * image_factor() * a / L)
    held(
        "sphere of rubber, 3 cells in radius, sinks in honey that sticks to it: speed",
        sinking_speed(simulation), theory, 0.15, unit="m/s",
        source="Stokes 1851; Hasimoto 1959",
    )  # fmt: skip


@pytest.mark.parametrize("slip", [0, 0.005])
def test_a_ball_in_honey_hands_on_momentum_and_loses_none(tmp_path, slip):
    simulation, _ = begin(tmp_path, DROP.replace("SLIP", str(slip)))

    def motion():
        x, v, C, vol, thing = by_id(simulation, "x", "v", "C", "vol0", "object")
        mass = vol * np.where(thing == 0, 2000.0, 1000.0)
        C = C.reshape(-1, 3, 3)
        own = 0.25 * DX**2 * np.stack([C[:, k - 1, k - 2] - C[:, k - 2, k - 1] for k in range(3)])
        spin = mass @ (np.cross(x - MIDDLE, v) + own.T)
        of_ball = mass[thing == 0] @ np.cross(x - MIDDLE, v)[thing == 0]
        return mass @ v, spin, of_ball, mass[thing == 0] @ v[thing == 0]

    before = motion()
    for _ in range(100):
        simulation.advance(simulation.bound())
    after = motion()
    scale = np.abs(before[0]).max(), np.abs(before[1]).max()
    assert np.abs(after[0] - before[0]).max() < 1e-12 * scale[0]
    assert np.abs(after[1] - before[1]).max() < 1e-11 * scale[1]
    assert after[2][2] < 0.8 * before[2][2]  # the honey takes part of the spin
    assert after[3][0] < 0.9 * before[3][0]


@pytest.mark.slow
@pytest.mark.parametrize("slip, largest", [("", 1.1), ("slip_length = 0", 1.45)])
def test_the_skin_of_a_jelly_under_a_jet_of_honey_is_not_torn(tmp_path, slip, largest):
    simulation, _ = begin(tmp_path, JELLY.format(slip=slip))
    advance(simulation, 0.8)
    F, thing = by_id(simulation, "F", "object")
    stretch = np.linalg.svd(F[thing == 0].reshape(-1, 3, 3), compute_uv=False).max()
    print(f"{slip or 'free slip'}: largest stretch {stretch:.2f}")
    assert stretch < largest

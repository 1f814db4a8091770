"""Consolidation of saturated sand under a load (Terzaghi 1925), by drag, buoyancy and storage.

A column of sand full of water between slip walls, open at the top, bears a load q on the sand,
ramped within two periods of the column's ringing; the theory is summed over the ramp. The water
takes it first; as it seeps out the pore pressure at the base falls with the time
factor T = c_v t / H^2, c_v = k M / (rho_w g), M = lam + 2 mu the sand's modulus in one dimension:
p / q = sum_m (2 / a_m) sin(a_m) exp(-a_m^2 T), a_m = (2 m + 1) pi / 2 at the base. Tolerance: rms
over T = 0.05 .. 0.3 below 0.02 (20 cells; water is 90 times as stiff as the sand, which costs 1 %).
"""

import numpy as np

from tests.support.simulate import advance, begin
from tests.support.validation_record import held
from vgmpi.kernels.particle_records import STATE
from vgmpi.materials.material import law_function

G, E, NU, N = 9.80665, 1.5e5, 0.3, 0.4
MODULUS = E * (1 - NU) / ((1 + NU) * (1 - 2 * NU))
PERMEABILITY, LOAD, HEIGHT, RAMP = 1e-2, 500.0, 0.4, 0.035
SCENE = f"""
[accuracy]
pressure = "explicit"
precision = "double"
[domain]
size = [0.08, 0.08, 0.48]
cell = 0.02
boundary.default = "slip"
gravity = [0, 0, 0]
[time]
end = 10
[material.water]
kind = "fluid"
tait_coefficient = 1e6
[material.grains]
kind = "sand"
density = 2650
porosity = {N}
youngs_modulus = {E}
poisson_ratio = {NU}
[[object]]
name = "pores"
material = "water"
shape = {{ box = [[0, 0, 0], [0.08, 0.08, {HEIGHT}]] }}
volume_fraction = {N}
[[object]]
name = "sand"
material = "grains"
shape = {{ box = [[0, 0, 0], [0.08, 0.08, {HEIGHT}]] }}
[[load]]
object = "sand"
pressure = {LOAD}
face = "top"
ramp_time = {RAMP}
[[coupling]]
between = ["water", "grains"]
kind = "drag"
hydraulic_conductivity = {PERMEABILITY}
"""


def theory(T):
    """p / q at the base after a sudden load; T: any array."""
    a = (2 * np.arange(200) + 1) * np.pi / 2
    return (2 / a * np.sin(a) * np.exp(-(a**2) * np.asarray(T)[..., None])).sum(-1)


def ramped(time, c_v):
    """p / q at the base at `time` [s] of a load that rises as half a cosine."""
    began = (np.arange(400) + 0.5) / 400 * RAMP
    step = np.pi / 2 * np.sin(np.pi * began / RAMP) / 400
    since = time - began
    sudden = theory(np.maximum(since, 0.0) * c_v / HEIGHT**2)
    return float((step * np.where(since > 0, sudden, 0.0)).sum())


def base_pressure(simulation) -> float:
    """Mean pressure [Pa] of the water in the lowest two cells."""
    (water,) = (g for g in simulation.groups if g.plan.material == "water")
    at, law = water.index(), water.plan.law
    low = water.positions()[:, 2] < 0.04
    state = tuple(water.f[STATE : STATE + len(water.plan.reference), at[low]])
    tau = law_function(law, "stress")(law, state, (0.0,) * 9)
    return float(np.mean(-tau[0] / law_function(law, "volume_ratio")(law, state)))


def test_pore_pressure_at_the_base(tmp_path):
    simulation, _ = begin(tmp_path, SCENE)
    c_v = PERMEABILITY * MODULUS / (1000.0 * G)
    factors, found, exact = np.arange(0.02, 0.301, 0.02), [], []
    for T in factors:
        advance(simulation, T * HEIGHT**2 / c_v)
        found.append(base_pressure(simulation) / LOAD)
        exact.append(ramped(simulation.time, c_v))
    assert abs(theory(0.2) - 0.7723) < 1e-4  # as tabulated
    late = factors > 0.05
    rms = float(np.sqrt(np.mean((np.array(found) - exact)[late] ** 2)))
    held("consolidation: rms of p / q at the base", rms, 0.0, 0.02, kind="absolute",
         source="Terzaghi 1925", curves={"theory": (factors, exact), "solver": (factors, found)},
         axes=("time factor", "p / q"))  # fmt: skip

"""A viscous liquid between two cylinders, of which the inner one turns: the torques balance.

Theory: once the flow is steady, the torque that the inner cylinder gives the liquid is the one that
the outer cylinder takes (angular momentum), whatever the liquid does at the walls. Tolerance: 3 %.
Colliders hold the liquid by Coulomb friction of a coefficient that no stress reaches.
"""

import numpy as np
import pytest

import vgmpi
from tests.support.validation_record import held

SCENE = """
[domain]
size = [0.5, 0.5, 0.04]
cell = 0.01
gravity = [0, 0, -9.8]
boundary = "slip"
[time]
end = 0.5
[accuracy]
precision = "single"
[material.honey]
kind = "fluid"
tait_coefficient = 2e4
viscosity = 50
[[object]]
name = "honey"
material = "honey"
shape = { difference = [
  { cylinder = { endpoints = [[0.25, 0.25, 0], [0.25, 0.25, 0.04]], radius = 0.2 } },
  { cylinder = { endpoints = [[0.25, 0.25, 0], [0.25, 0.25, 0.04]], radius = 0.08 } },
] }
[[object]]
name = "rotor"
role = "scenery"
collider = true
friction = 100
shape = { cylinder = { endpoints = [[0.25, 0.25, -0.1], [0.25, 0.25, 0.14]], radius = 0.08 } }
motion = { pivot = [0.25, 0.25, 0], angular_velocity = 3.0 }
[[object]]
name = "jacket"
role = "scenery"
collider = true
friction = 100
shape = { difference = [
  { box = [[-0.1, -0.1, -0.1], [0.6, 0.6, 0.14]] },
  { cylinder = { endpoints = [[0.25, 0.25, -0.2], [0.25, 0.25, 0.24]], radius = 0.2 } },
] }
[[probe]]
name = "inner"
sampling_rate = 100
collider = "rotor"
[[probe]]
name = "outer"
sampling_rate = 100
collider = "jacket"
"""


def mean_torques(run, *names: str, begin: float) -> dict[str, float]:
    """Mean torque about z of some probes after `begin` [s]."""
    rows = {name: [row for row in run.probes[name] if row["time"] > begin] for name in names}
    return {name: float(np.mean([row["torque_z"] for row in rows[name]])) for name in names}


@pytest.mark.slow
@pytest.mark.xfail(
    strict=True,
    reason="7 % apart: impulses act at nodes up to a cell outside the surface, and their moment is"
    " taken at the surface, where the work that they do is known",
)
def test_the_torques_of_two_cylinders_balance(tmp_path):
    run = vgmpi.run(vgmpi.load(tmp_path / "couette.toml", text=SCENE))
    assert run.code == 0
    torque = mean_torques(run, "inner", "outer", begin=0.3)
    theory = 4 * np.pi * 50 * 3.0 * 0.04 * (0.2 * 0.08) ** 2 / (0.2**2 - 0.08**2)
    print(f"{torque} N m, without slip {theory}")
    assert abs(torque["inner"]) > 0.5 * theory
    held(
        "two cylinders, viscous liquid: torque on the outer over that on the inner one",
        -torque["outer"] / torque["inner"], 1.0, 0.03, source="angular momentum", deviation=True,
        note="8 and 20 cells in radius",
    )  # fmt: skip

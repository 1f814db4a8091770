"""Closed systems keep momentum and angular momentum: exact properties of APIC with the MLS force
and of the contact.

Theory: the transfers conserve linear momentum (Jiang 2015, prop. 1) and, APIC, angular momentum
(prop. 2); internal forces sum to zero; contact impulses are equal and opposite. What is left is
rounding. Tolerances: |sum p - p0| <= 1e-12 sum m |v| after 1,000 steps; |dL| <= 1e-12 |L|; energy
loss of a spinning body < 1 %.
"""

import numpy as np
import pytest

from tests.simulate import advance, begin, by_id, mass_speed, totals

FREE = """
[domain]
size = [0.48, 0.48, 0.48]
cell = 0.02
gravity = [0, 0, 0]
[time]
end = 1
[material.water]
kind = "fluid"
bulk_modulus = 2e4
[material.rubber]
kind = "elastic"
density = 600
youngs_modulus = 5e4
"""

BLOB = """
[[object]]
name = "blob"
material = "water"
shape = { sphere = { center = [0, 0, 0], radius = 0.07 } }
position = [0.17, 0.24, 0.17]
velocity = [1, 0.1, 0]
[[object]]
name = "ball"
material = "rubber"
shape = { sphere = { center = [0, 0, 0], radius = 0.06 } }
position = [0.31, 0.24, 0.17]
velocity = [-1, 0, 0.2]
[[object]]
name = "cube"
material = "rubber"
shape = { box = [[-0.05, -0.05, -0.05], [0.05, 0.05, 0.05]] }
position = [0.24, 0.24, 0.305]
velocity = [0, 0, -0.5]
"""


def test_momentum_of_a_closed_system(tmp_path):
    """Water, a ball and a cube collide in the air, far from the walls: three phases in contact."""
    simulation, made = begin(tmp_path, FREE + BLOB)
    before = totals(simulation)
    for _ in range(1000):
        simulation.advance(0.15 * simulation.bound())
    after = totals(simulation)
    (x,) = by_id(simulation, "x")
    assert x.min() > 2 * 0.02 and x.max() < 0.48 - 2 * 0.02, "they met a wall"
    drift = np.abs(after["momentum"] - before["momentum"]).max() / mass_speed(simulation, made)
    print(f"closed system: momentum drift {drift:.1e} of sum m |v| after 1,000 steps")
    assert drift <= 1e-12
    assert after["mass"] == pytest.approx(before["mass"], rel=1e-14)
    assert after["kinetic"] < 0.95 * before["kinetic"], "they did not collide"


def test_a_spinning_body_keeps_its_angular_momentum(tmp_path):
    text = (
        FREE
        + """
    [[object]]
    name = "cube"
    material = "rubber"
    shape = { box = [[-0.06, -0.06, -0.03], [0.06, 0.06, 0.03]] }
    position = [0.24, 0.24, 0.2]
    spin = [0, 0, 12]
    """
    )
    simulation, _ = begin(tmp_path, text)
    advance(simulation, 0.002)  # the affine part has formed
    before = totals(simulation)
    advance(simulation, 0.002 + 2 * np.pi / 12)
    after = totals(simulation)
    assert abs(before["angular"][2]) > 1e-3
    drift = np.abs(after["angular"] - before["angular"]).max() / abs(before["angular"][2])
    loss = 1 - after["energy"] / before["energy"]
    print(f"spinning body: angular momentum drift {drift:.1e}, energy loss {loss:.1e} in a turn")
    assert drift <= 1e-12
    assert after["energy"] > 0.99 * before["energy"]

"""Rigid bodies of revolution that spin in water without friction keep their spin.

Theory: an ideal liquid has no stress along a surface, and nothing presses along the way in which a
round body turns (Lamb, Hydrodynamics, art. 21). All that brakes is what the method adds: normals
that are not those of the body. The scene is that of the rubber wheel of test_wheel.py. A wheel in a
slice of 4 cells has its faces in the slip walls.
"""

import numpy as np
import pytest

from tests.physics.test_wheel import DX, RIM, SCENE
from tests.support.simulate import advance, begin
from tests.support.validation_record import held


def spin_left(folder, body, radius, wide, high, turns):
    """Share of its spin that a body of some cells in radius has after some turns."""
    rate = RIM / (radius * DX)
    text = SCENE.format(long=round(wide * DX, 9), turns=rate, wheel=body, around="water")
    text = text.replace("angular_velocity", "rigid = true\nangular_velocity")
    simulation, _ = begin(folder, text.replace("0.04", repr(round(high * DX, 9))))
    bodies = simulation.features["rigid_bodies"].bodies
    start = bodies.spin[0, 2]
    advance(simulation, turns * 2 * np.pi / rate)
    return float(bodies.spin[0, 2] / start)


@pytest.mark.parametrize(
    "radius, wide, turns", [(6, 20, 0.1), pytest.param(8, 26, 3.0, marks=pytest.mark.slow)]
)
def test_a_ball_keeps_its_spin(tmp_path, radius, wide, turns):
    """With normals of the linear distance a ball of 6 cells lost 2 % in an eighth of a turn."""
    m = wide * DX / 2
    ball = f"sphere = {{ center = [{m}, {m}, {m}], radius = {radius * DX} }}"
    left = spin_left(tmp_path, ball, radius, wide, wide, turns)
    held(f"rigid ball of {radius} cells that spins in water: spin left after {turns:g} turns", left,
         1.0, 0.005, unit="of the initial spin", source="no torque without friction")  # fmt: skip


@pytest.mark.slow
def test_a_wheel_between_walls(tmp_path):
    """Its faces lie in the slip walls: it kept 0.991 in half a turn where nodes next to a wall took
    the normal of the nearest part of the surface, which may be such a face.
    """
    m = 24 * DX
    wheel = f"cylinder = {{ endpoints = [[{m}, {m}, 0], [{m}, {m}, 0.04]], radius = {12 * DX} }}"
    left = spin_left(tmp_path, wheel, 12, 48, 4, 3.0)
    held("rigid wheel of 12 cells in a slice of water: spin left after 3 turns", left, 1.0, 0.005,
         unit="of the initial spin", source="no torque without friction")  # fmt: skip

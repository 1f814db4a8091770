"""Scenes of rigid bodies alone: gravity and speeds set the step, since there are no particles.

References: free fall, a parabola, Newton's law of restitution, elastic impact, and the steady
precession of a gyroscope.
"""

import numpy as np
import pytest

from tests.support.simulate import advance, begin
from tests.support.small_scenes import scene
from tests.support.validation_record import held
from vgmpi.runtime.config.schema import SceneError
from vgmpi.solver.diagnostics.conservation import conservation_rows

G, DX, RADIUS = 9.81, 0.02, 0.06
SCENE = """
[domain]
size = [1.2, 0.4, 1.2]
cell = 0.02
gravity = [0, 0, {gravity}]
[time]
end = 1
frames = 5
{time}
[material.oak]
kind = "elastic"
density = 700
youngs_modulus = "1 GPa"
friction = 0
{objects}
"""


def ball(name, center, more=""):
    """Table of a rigid ball."""
    return (
        f'[[object]]\nname = "{name}"\nmaterial = "oak"\nrigid = true\n{more}\n'
        f"shape = {{ sphere = {{ center = {list(center)}, radius = {RADIUS} }} }}\n"
    )


def started(folder, objects, gravity=-G, time=""):
    """(simulation, its free bodies) of rigid bodies in a box."""
    text = SCENE.format(gravity=gravity, time=time, objects=objects)
    simulation, _ = begin(folder, text)
    return simulation, simulation.features["rigid_bodies"].bodies


def test_a_projectile(tmp_path):
    """Its velocity is exact; its height lags by half the fall of a step."""
    simulation, bodies = started(tmp_path, ball("shot", (0.2, 0.2, 0.3), "velocity = [1.5, 0, 3]"))
    x0, longest = bodies.x[0].copy(), 0.0
    while simulation.time < 0.5:
        before = simulation.time
        advance(simulation, before + 0.01)
        longest = max(longest, simulation.bound())
    t = simulation.time
    way = np.array([1.5 * t, 0.0, 3.0 * t - 0.5 * G * t**2])
    np.testing.assert_allclose(bodies.v[0], [1.5, 0, 3 - G * t, 0, 0, 0], rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose((bodies.x[0] - x0)[:2], way[:2], rtol=1e-12, atol=1e-12)
    error = (bodies.x[0] - x0)[2] - way[2]
    assert error < 0.0
    held("rigid body alone, thrown: height after 0.5 s", float(bodies.x[0, 2] - x0[2]), way[2],
         0.5 * G * t * longest, kind="absolute", unit="m", source="3 t - g t^2 / 2")  # fmt: skip


def test_a_shorter_step_falls_more_exactly(tmp_path):
    errors = []
    for dt in (1e-3, 5e-4):
        simulation, bodies = started(tmp_path, ball("shot", (0.6, 0.2, 1.1)), time=f"dt = {dt}")
        for _ in range(round(0.4 / dt)):
            simulation.advance(dt)
        errors.append(bodies.x[0, 2] - 1.1 + 0.5 * G * 0.4**2)
    np.testing.assert_allclose(errors, [-0.5 * G * 0.4 * dt for dt in (1e-3, 5e-4)], rtol=1e-9)


def test_it_bounces_and_comes_to_rest(tmp_path):
    """Off the floor at half its speed, and at last a ball lies on it."""
    simulation, bodies = started(tmp_path, ball("toy", (0.6, 0.2, 0.6), "restitution = 0.5"))
    fastest = 0.0
    while bodies.v[0, 2] <= 0.0:
        fastest = -bodies.v[0, 2]
        advance(simulation, simulation.time + 1e-4)
    held("rigid body alone: speed after a bounce over before", bodies.v[0, 2] / fastest, 0.5, 0.01,
         source="Newton's restitution")  # fmt: skip
    assert abs(fastest - np.sqrt(2 * G * (0.6 - RADIUS))) < 0.01 * fastest
    advance(simulation, 3.0)
    assert abs(bodies.x[0, 2] - RADIUS) < 0.05 * DX
    assert np.abs(bodies.v[0, :3]).max() < 2.0 * G * simulation.bound()  # that of a step's fall


def test_two_balls_exchange_their_velocities(tmp_path):
    """An elastic impact of equal masses without gravity; the sum of momentum stays."""
    objects = ball("cue", (0.3, 0.2, 0.6), "restitution = 1\nvelocity = [2, 0, 0]")
    objects += ball("eight", (0.6, 0.2, 0.6), "restitution = 1")
    simulation, bodies = started(tmp_path, objects, gravity=0)
    momentum = bodies.momentum.sum(0)
    advance(simulation, 0.3)
    np.testing.assert_allclose(bodies.v[:, 0], [0, 2], atol=2e-3)
    np.testing.assert_allclose(bodies.momentum.sum(0), momentum, rtol=1e-12, atol=1e-13)


def test_it_meets_a_collider(tmp_path):
    """A ball that is dropped on a table lies on the table."""
    table = (
        '[[object]]\nname = "table"\nrole = "scenery"\ncollider = true\n'
        "shape = { box = [[0.4, 0, 0.2], [0.8, 0.4, 0.3]] }\n"
    )
    simulation, bodies = started(tmp_path, ball("toy", (0.6, 0.2, 0.5)) + table)
    advance(simulation, 1.5)
    assert abs(bodies.x[0, 2] - (0.3 + RADIUS)) < 0.1 * DX


def test_a_gyroscope(tmp_path):
    """A disc that spins about a horizontal axle precesses at m g l / (I3 w) about its pivot."""
    spin, pivot = 200.0, [0.4, 0.2, 0.6]
    ends = "[[0.54, 0.2, 0.6], [0.6, 0.2, 0.6]]"
    body = '[[object]]\nname = "disc"\nmaterial = "oak"\nrigid = true\n'
    body += f"shape = {{ cylinder = {{ endpoints = {ends}, radius = 0.1 }} }}\n"
    joint = f'[[joint]]\nkind = "ball"\nbetween = ["disc"]\nat = {pivot}\n'
    _, bodies = started(tmp_path, body)
    arm, axial = float(bodies.x[0, 0] - pivot[0]), float(bodies.inertia[0, 0, 0])
    rate = float(bodies.mass[0]) * G * arm / (axial * spin)
    more = f"angular_velocity = [{spin}, 0, {rate}]\nvelocity = [0, {rate * arm}, 0]\n"
    simulation, bodies = started(tmp_path, body + more + joint, time="dt = 2e-4")
    for _ in range(1500):
        simulation.advance(2e-4)
    x = bodies.x[0] - pivot
    held("rigid body alone: precession of a gyroscope", float(np.arctan2(x[1], x[0])), 0.3 * rate,
         0.002, unit="rad", source="m g l / (I3 w)")  # fmt: skip
    assert abs(x[2]) < 0.01 * arm


def test_the_conservation_log(tmp_path):
    """It has one row, of no particles, with the sums over the bodies."""
    simulation, bodies = started(tmp_path, ball("toy", (0.6, 0.2, 0.6), "velocity = [1, 0, 0]"))
    (row,) = conservation_rows(simulation)
    assert row["particles"] == 0
    assert row["rigid_momentum_x"] == pytest.approx(float(bodies.mass[0]))


@pytest.mark.parametrize("gravity", [-G, 0])
def test_the_step(tmp_path, gravity):
    """It follows from gravity across a cell, or from the frames, and from the motion of bodies."""
    simulation, bodies = started(tmp_path, ball("toy", (0.6, 0.2, 0.6)), gravity)
    expected = 0.55 * np.sqrt(DX / (2 * G)) if gravity else 0.25
    assert simulation.bound() == pytest.approx(0.1 * expected)
    bodies.momentum[:] = bodies.mass * [[100.0, 0.0, 0.0]]
    bodies.set_velocities()
    assert simulation.bound() * 100.0 <= 0.3 * DX


def test_a_step_that_is_too_long(tmp_path):
    """It is refused with its line."""
    text = SCENE.format(gravity=-G, time="dt = 0.1", objects=ball("toy", (0.6, 0.2, 0.6)))
    with pytest.raises(SceneError, match=r"time.dt: 0.1 s is above the stable step of gravity"):
        begin(tmp_path, text)
    assert not scene(tmp_path, text).has_particles

"""Liquids that stick to free rigid bodies, with an implicit pressure.

The numbers from outside are Stokes' drag of a sphere with the images of the box (Hasimoto 1959), as
in test_viscous_sphere.py, and the sums of momenta and angular momenta. A drop of honey around a
ball a hundred times as light, so viscous that a step takes all their slip away, stays whole.
"""

import numpy as np
import pytest

from tests.physics import test_free_bodies, test_solid_slip
from tests.physics.test_viscous_sphere import CELLS, DENSITIES, DX, SCENE, G, image_factor
from tests.support.simulate import begin, by_id
from vgmpi.features.rigid_bodies.coupling import RigidBodies

IMPLICIT = '[accuracy]\npressure = "implicit"\n'


def test_a_sphere_sinks_by_stokes(tmp_path):
    """A radius of three cells; with an explicit pressure it has 0.74 of this speed."""
    viscosity, a = 25.0, 3 * DX
    text = SCENE.format(L=CELLS * DX, dx=DX, g=G, eta=viscosity, m=CELLS * DX / 2, R=a)
    rigid = 'material = "rubber"\nrigid = true\nslip_length = 0\n'
    text = text.replace('material = "rubber"\n', rigid).replace("[accuracy]\n", IMPLICIT)
    text = text[: text.index("[[coupling]]")] + text[text.index("[[object]]") :]
    text = text.replace("tait_coefficient = 2e4", "max_speed = 1")
    simulation, _ = begin(tmp_path, text)
    bodies, rows = simulation.features["rigid_bodies"].bodies, []
    while simulation.time < 0.35:
        simulation.advance(simulation.bound())
        rows.append((simulation.time, bodies.x[0, 2]))
    t, z = np.array(rows).T
    speed = -np.polyfit(t[t > 0.15], z[t > 0.15], 1)[0]
    alone = 2 * (DENSITIES[0] - DENSITIES[1]) * G * a**2 / (9 * viscosity)
    assert speed / (alone * (1 - 1.5 * image_factor() * 3 / CELLS)) == pytest.approx(1, abs=0.1)


def test_momentum_of_a_drop_that_hits_a_block_and_sticks(tmp_path, monkeypatch):
    """It is that before; what sticks exchanges no angular momentum with the outside either."""
    errors, moments = [], []
    apply_adhesion = RigidBodies.apply_adhesion

    def watch(self, nodes, *arguments):
        before = sums_of(self, nodes)
        apply_adhesion(self, nodes, *arguments)
        change = sums_of(self, nodes) - before
        errors.append(np.abs(change).max())
        moments.append(np.abs(before).max())

    monkeypatch.setattr(RigidBodies, "apply_adhesion", watch)
    text = test_free_bodies.SPLASH.format(kind="fluid", more="viscosity = 5\nmax_speed = 2")
    text = text.replace('pressure = "explicit"\n', "")
    text = text.replace("rigid = true", "rigid = true\nslip_length = 0")
    text = text.replace("[accuracy]\n", IMPLICIT)
    simulation, _ = begin(tmp_path, text)
    bodies = simulation.features["rigid_bodies"].bodies
    start, before = test_free_bodies.totals(simulation)[0], bodies.momentum.copy()
    while simulation.time < 0.07:
        simulation.advance(simulation.bound())
    end, scale = test_free_bodies.totals(simulation)[0], np.abs(start).max()
    assert np.abs(bodies.momentum - before).max() > 0.1 * scale
    assert np.abs(end - start).max() < 1e-10 * scale
    assert max(errors) < 1e-10 * max(moments)


def sums_of(coupling, nodes):
    """Momentum and angular momentum of the nodes inside the domain and of the bodies."""
    blocks = np.repeat(nodes.tables.coordinates, np.diff(nodes.tables.first), axis=0)
    v = nodes.velocities.reshape(-1, 64, 4)[: len(blocks)].astype(float)
    place = np.stack(np.unravel_index(np.arange(64), (4, 4, 4)), 1)
    x = (4 * blocks[:, None] - 1 + place) * coupling.plan.dx
    momentum = v[..., 3:] * v[..., :3]
    bodies = coupling.bodies
    angular = np.cross(x, momentum).sum((0, 1))
    angular += (bodies.spin + np.cross(bodies.x, bodies.momentum)).sum(0)
    return np.append(momentum.sum((0, 1)) + bodies.momentum.sum(0), angular)


@pytest.mark.parametrize("density, viscosity", [(20, 1000), (1400, 100)])
def test_a_ball_moves_along_with_the_honey_around_it(tmp_path, density, viscosity):
    """In empty space: it ends with the momentum over the mass of all, and is never faster."""
    text = test_solid_slip.DROP.replace("SLIP", "0\nrigid = true")
    text = text.replace("tait_coefficient = 2e4", "max_speed = 1")
    text = text.replace("[accuracy]\n", IMPLICIT)
    text = text.replace("density = 2000", f"density = {density}")
    text = text.replace("viscosity = 10", f"viscosity = {viscosity}")
    simulation, made = begin(tmp_path, text)
    bodies = simulation.features["rigid_bodies"].bodies
    start = test_free_bodies.totals(simulation)[0]
    mass = bodies.mass[0] + 1000 * made.vol0.sum()
    speeds = []
    while simulation.time < 0.02:
        simulation.advance(simulation.bound())
        speeds.append(bodies.v[0, 0])
    assert np.abs(test_free_bodies.totals(simulation)[0] - start).max() < 1e-10 * start.max()
    assert speeds[-1] == pytest.approx(start[0] / mass, rel=0.05)
    assert np.abs(speeds).max() < 0.2  # that at the start
    assert np.abs(by_id(simulation, "v")[0]).max() < 0.3

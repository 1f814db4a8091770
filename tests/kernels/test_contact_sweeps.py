"""Impulses at the points of rigid bodies: a ball that falls on a plane with friction."""

import numpy as np
import pytest

from vgmpi.features.rigid_bodies.body_contact import contact_points
from vgmpi.features.rigid_bodies.contact_sweeps import solve_contacts

MASS, RADIUS, FRICTION, FALL = 1.3, 0.1, 0.5, 1.0


def after_impact(slide, normal=(0.0, 0.0, 1.0)):
    """Velocity and spin of a solid ball after it has met a plane: slid along, and turned."""
    n = np.array(normal) / np.linalg.norm(normal)
    along = np.cross(n, [0.0, 1.0, 0.0])
    along /= np.linalg.norm(along)
    points = contact_points(1)
    points.body[0], points.other[0], points.normal[0], points.friction[0] = 0, -1, n, FRICTION
    x, v = RADIUS * n[None], np.zeros((1, 6))
    v[0, :3] = slide * along - FALL * n
    inertia = 0.4 * MASS * RADIUS**2 * np.eye(3)[None]
    solve_contacts(
        1, points, 0, contact_points(0), 1e-3, x, v, np.array([MASS]), inertia, np.zeros(1), 1e-3,
    )  # fmt: skip
    assert abs(v[0, :3] @ n) < 1e-12
    return v[0, :3] @ along, v[0, 3:] @ np.cross(n, along)


@pytest.mark.parametrize("normal", [(0, 0, 1), (1, 0, 2), (1, -2, 0.5)])
@pytest.mark.parametrize("slide", [0.01, 0.3, 1.7])
def test_a_ball_that_sticks_rolls(normal, slide):
    """Below 3.5 friction x fall the ball rolls at once, with 5/7 of its speed."""
    v, spin = after_impact(slide, normal)
    assert v == pytest.approx(5 / 7 * slide, rel=1e-8)
    assert spin == pytest.approx(v / RADIUS, rel=1e-8)


@pytest.mark.parametrize("normal", [(0, 0, 1), (1, -2, 0.5)])
def test_a_ball_that_slides_loses_friction_times_its_impulse(normal):
    v, spin = after_impact(3.0, normal)
    assert v == pytest.approx(3.0 - FRICTION * FALL, rel=1e-12)
    assert spin == pytest.approx(FRICTION * FALL / (0.4 * RADIUS), rel=1e-12)

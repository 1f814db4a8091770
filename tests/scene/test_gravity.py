"""Gravity by keyframes: it turns at an even pace, and its mean over any steps adds up."""

import numpy as np
import pytest
from scipy.integrate import quad_vec

from vgmpi.scene.gravity import gravity_at, mean_gravity

G = 9.8
KEYS = ((0.0, (0.0, 0.0, -G)), (0.5, (0.0, 0.0, -G)), (1.5, (G, 0.0, 0.0)), (2.0, (0.0, 0.0, 0.0)))


def test_it_turns_like_a_container():
    """A quarter of a turn in a second, of the same strength all the way."""
    for share in np.linspace(0, 1, 9):
        angle = share * np.pi / 2
        want = G * np.array([np.sin(angle), 0, -np.cos(angle)])
        assert np.allclose(gravity_at(KEYS, 0.5 + share), want, atol=1e-12)


def test_it_stays_before_and_after():
    assert tuple(gravity_at(KEYS, 0.0)) == tuple(gravity_at(KEYS, 0.3)) == (0, 0, -G)
    assert tuple(gravity_at(KEYS, 2.0)) == tuple(gravity_at(KEYS, 9.0)) == (0, 0, 0)


def test_it_fades_on_a_straight_line():
    assert np.allclose(gravity_at(KEYS, 1.75), (G / 2, 0, 0), atol=1e-12)
    through = ((0.0, (0.0, 0.0, -G)), (1.0, (0.0, 0.0, G)))  # opposite: no way to turn is named
    assert np.allclose(gravity_at(through, 0.25), (0, 0, -G / 2), atol=1e-12)


def test_the_mean_is_the_integral():
    ends = np.array([0.0, 0.31, 0.9, 0.9004, 1.6, 2.5])
    parts = [(b - a) * mean_gravity(KEYS, a, b) for a, b in zip(ends, ends[1:], strict=False)]
    want = quad_vec(lambda t: gravity_at(KEYS, t), 0, 2.5, points=[0.5, 1.5, 2.0], epsabs=1e-13)[0]
    assert np.sum(parts, 0) == pytest.approx(want, abs=1e-11)
    assert mean_gravity(KEYS, 0, 2.5) * 2.5 == pytest.approx(want, abs=1e-11)
    assert tuple(mean_gravity(KEYS, 0.3, 0.3)) == (0, 0, -G)

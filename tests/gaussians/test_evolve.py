"""Shapes and rotations of Gaussians that ride on particles."""

import numpy as np
import pytest
from scipy.linalg import polar

from vgmpi.gaussians import shape_evolution
from vgmpi.gaussians.cloud import pack_symmetric, unpack_symmetric


def random(n=200, spread=0.3, seed=0):
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(n, 3, 3)) * 0.01
    F = np.eye(3) + spread * rng.normal(size=(n, 3, 3))
    return pack_symmetric(root @ root.transpose(0, 2, 1)), F


def stretched(values, seed=0):
    """A deformation with the given principal stretches."""
    u, v = np.linalg.qr(np.random.default_rng(seed).normal(size=(2, 3, 3)))[0]
    return (u * values @ v)[None]


def test_solids_are_F_cov0_F_transposed():
    cov0, F = random(spread=0.1)
    want = F @ unpack_symmetric(cov0) @ F.transpose(0, 2, 1)
    np.testing.assert_allclose(
        unpack_symmetric(shape_evolution.deformed_covariance(cov0, F)), want, atol=1e-17
    )
    np.testing.assert_allclose(
        unpack_symmetric(shape_evolution.deformed_covariance(cov0, F.reshape(-1, 9))),
        want,
        atol=1e-17,
    )


@pytest.mark.parametrize("values", [(0.21, 0.3, 3.9), (3.9, 3.8, 3.7), (0.21, 0.22, 0.21)])
def test_the_clamp_touches_nothing_within_the_range_of_stretches(values):
    cov0, _ = random(1)
    F = stretched(values)
    want = F @ unpack_symmetric(cov0) @ F.transpose(0, 2, 1)
    np.testing.assert_allclose(
        unpack_symmetric(shape_evolution.deformed_covariance(cov0, F)), want, rtol=1e-9, atol=1e-18
    )


def test_torn_and_flat_particles_keep_within_bounds():
    cov0 = pack_symmetric(0.01**2 * np.eye(3)[None])
    got = unpack_symmetric(shape_evolution.deformed_covariance(cov0, stretched((100.0, 1.0, 1e-3))))
    np.testing.assert_allclose(np.sqrt(np.linalg.eigvalsh(got[0])), [0.002, 0.01, 0.04], rtol=1e-9)
    got = unpack_symmetric(shape_evolution.deformed_covariance(cov0, np.zeros((1, 9))))
    np.testing.assert_allclose(got[0], 0.002**2 * np.eye(3), rtol=1e-9)
    broken = shape_evolution.deformed_covariance(cov0, np.full((1, 9), np.nan))
    np.testing.assert_allclose(broken, cov0, rtol=1e-9)


def test_fluids_are_balls_of_the_volume_of_their_particle():
    vol0, J = np.array([1e-6, 8e-6]), np.array([1.0, 0.7])
    cov = shape_evolution.volume_sphere_covariance(vol0, J)
    radius = np.sqrt(cov[:, 0])
    np.testing.assert_allclose(4 / 3 * np.pi * radius**3, vol0 * J, rtol=1e-12)
    np.testing.assert_array_equal(cov[:, 0], cov[:, 3])
    np.testing.assert_array_equal(cov[:, 0], cov[:, 5])
    assert not cov[:, (1, 2, 4)].any()


def test_fluid_volumes_are_drawn_between_three_tenths_and_three():
    vol0 = np.full(6, 1e-6)
    got = shape_evolution.fluid_variance(vol0, np.array([0.01, 0.3, 1.0, 3.0, 50.0, np.inf]))
    ratio = (got / got[2]) ** 1.5
    np.testing.assert_allclose(ratio, [0.3, 0.3, 1, 3, 3, 3], rtol=1e-12)


def test_rotation_is_the_polar_factor():
    _, F = random()
    F = F[np.linalg.det(F) > 0.05]
    want = np.stack([polar(f)[0] for f in F])
    np.testing.assert_allclose(shape_evolution.rotation(F), want, atol=1e-12)
    np.testing.assert_allclose(
        shape_evolution.rotation(F.reshape(-1, 9).astype("f4")), want, atol=1e-5
    )


@pytest.mark.parametrize("values", [(1e3, 1.0, 1e-3), (1e-4, 1e-4, 1e-4), (3.0, 1.0, 1e-9)])
def test_rotation_of_extreme_stretches(values):
    F = stretched(values)
    F *= np.sign(np.linalg.det(F))
    np.testing.assert_allclose(shape_evolution.rotation(F)[0], polar(F[0])[0], atol=1e-5)


def test_rotation_is_proper_for_inverted_flat_and_broken_particles():
    F = np.stack(
        [np.diag([1.0, 1, -0.1]), np.zeros((3, 3)), np.full((3, 3), np.nan), -np.eye(3), np.eye(3)]
    )
    R = shape_evolution.rotation(F)
    np.testing.assert_allclose(np.linalg.det(R), 1, atol=1e-12)
    np.testing.assert_allclose(R @ R.transpose(0, 2, 1), np.tile(np.eye(3), (5, 1, 1)), atol=1e-12)
    np.testing.assert_allclose(R[0], np.eye(3), atol=1e-12)  # the sign goes to the least stretch
    assert len(shape_evolution.rotation(np.empty((0, 9)))) == 0

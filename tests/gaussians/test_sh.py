"""Spherical harmonics against Legendre functions, and their rotation against its meaning."""

import numpy as np
import pytest

from tests.support import dense_rasterizer
from vgmpi.gaussians import spherical_harmonics


def rotations(n, seed=0):
    q = np.linalg.qr(np.random.default_rng(seed).normal(size=(n, 3, 3)))[0]
    return q * np.linalg.det(q)[:, None, None]


def random(n, k, seed=0):
    rng = np.random.default_rng(seed)
    return rng.normal(size=(n, k, 3)), rng.normal(size=(n, 3))


def test_the_basis_is_that_of_legendre_functions():
    _, d = random(200, 1)
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    np.testing.assert_allclose(
        spherical_harmonics.basis(d, 16), dense_rasterizer.harmonics(d, 16), atol=1e-13
    )


def test_the_first_functions_are_minus_y_z_minus_x():
    """The signs of the files: with others a capture shows its colors from the wrong sides."""
    got = spherical_harmonics.basis(np.eye(3), 4)[:, 1:] / spherical_harmonics.C1
    np.testing.assert_allclose(got, [[0, 0, -1], [-1, 0, 0], [0, 1, 0]], atol=1e-15)


@pytest.mark.parametrize("k", spherical_harmonics.COEFFICIENTS)
def test_evaluate_is_the_clamped_sum_and_needs_no_unit_directions(k):
    c, d = random(100, k)
    want = dense_rasterizer.colors(c, d)
    np.testing.assert_allclose(spherical_harmonics.evaluate(c, d), want, atol=1e-12)
    np.testing.assert_allclose(spherical_harmonics.evaluate(c, 7 * d), want, atol=1e-12)
    assert (want == 0).any()  # the clamp was at work


def test_a_zero_direction_gives_the_constant_part():
    c, _ = random(5, 16)
    want = np.maximum(spherical_harmonics.rgb_from_dc(c[:, 0]), 0)
    np.testing.assert_allclose(spherical_harmonics.evaluate(c, np.zeros((5, 3))), want, atol=1e-14)


@pytest.mark.parametrize("k", spherical_harmonics.COEFFICIENTS)
def test_a_turned_object_shows_what_it_showed_towards_the_turned_back_direction(k):
    c, d = random(60, k, 1)
    R = rotations(60)
    np.testing.assert_allclose(
        spherical_harmonics.evaluate(spherical_harmonics.rotate(c, R[0]), d),
        spherical_harmonics.evaluate(c, d @ R[0]),
        atol=1e-12,
    )
    back = np.einsum("nij,ni->nj", R, d)
    np.testing.assert_allclose(
        spherical_harmonics.evaluate(spherical_harmonics.rotate(c, R), d),
        spherical_harmonics.evaluate(c, back),
        atol=1e-12,
    )


def test_rotation_keeps_type_and_length_of_each_degree():
    c = random(20, 16)[0].astype(np.float32)
    turned = spherical_harmonics.rotate(c, rotations(1)[0])
    assert turned.dtype == np.float32
    for a, b in ((0, 1), (1, 4), (4, 9), (9, 16)):
        np.testing.assert_allclose((turned[:, a:b] ** 2).sum(1), (c[:, a:b] ** 2).sum(1), rtol=1e-5)


def test_color_and_constant_coefficient_are_inverse():
    rgb = np.random.default_rng(0).random((9, 3))
    np.testing.assert_allclose(
        spherical_harmonics.rgb_from_dc(spherical_harmonics.dc_from_rgb(rgb)), rgb, atol=1e-15
    )
    np.testing.assert_allclose(
        spherical_harmonics.evaluate(spherical_harmonics.dc_from_rgb(rgb)[:, None], rgb),
        rgb,
        atol=1e-15,
    )


def test_only_whole_degrees_are_allowed():
    with pytest.raises(ValueError, match="1, 4, 9 or 16"):
        spherical_harmonics.basis(np.eye(3), 5)

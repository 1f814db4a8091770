"""Clouds: covariances, quaternions, and what a similarity transform does to them."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from vgmpi.gaussians import spherical_harmonics
from vgmpi.gaussians.cloud import (
    GaussianCloud,
    pack_symmetric,
    quaternion,
    rotation_matrices,
    unpack_symmetric,
)


def cloud(n=30, k=16, seed=0):
    rng = np.random.default_rng(seed)
    quat = rng.normal(size=(n, 4))
    return GaussianCloud(
        rng.normal(size=(n, 3)),
        quat / np.linalg.norm(quat, axis=1, keepdims=True),
        rng.uniform(0.01, 1, (n, 3)),
        rng.random(n),
        rng.normal(size=(n, k, 3)),
    )


def test_covariances_have_the_scales_along_the_turned_axes():
    c = cloud()
    axes = Rotation.from_quat(c.quat[:, [1, 2, 3, 0]]).as_matrix()
    np.testing.assert_allclose(rotation_matrices(c.quat), axes, atol=1e-14)
    for matrix, axis, scale in zip(unpack_symmetric(c.cov()), axes, c.scale):
        np.testing.assert_allclose(matrix @ axis, axis * scale**2, atol=1e-14)


def test_upper_is_xx_xy_xz_yy_yz_zz():
    m = np.array([[[1.0, 2, 3], [2, 4, 5], [3, 5, 6]]])
    np.testing.assert_array_equal(pack_symmetric(m), [[1, 2, 3, 4, 5, 6]])
    np.testing.assert_array_equal(unpack_symmetric(pack_symmetric(m)), m)


def test_quaternions_of_matrices_also_at_half_turns():
    half = [np.diag(d) for d in ([1.0, -1, -1], [-1.0, 1, -1], [-1.0, -1, 1])]
    for R in [*Rotation.random(50, random_state=0).as_matrix(), np.eye(3), *half]:
        q = quaternion(R)
        assert np.linalg.norm(q) == pytest.approx(1)
        np.testing.assert_allclose(rotation_matrices(q[None])[0], R, atol=1e-12)


def test_a_transform_moves_turns_and_scales_everything():
    c = cloud()
    R = Rotation.random(random_state=1).as_matrix()
    t = c.transformed(R, 2.5, (1.0, -2.0, 3.0))
    np.testing.assert_allclose(t.x, 2.5 * c.x @ R.T + [1, -2, 3], atol=1e-14)
    np.testing.assert_allclose(
        unpack_symmetric(t.cov()), 2.5**2 * R @ unpack_symmetric(c.cov()) @ R.T, atol=1e-13
    )
    d = np.random.default_rng(3).normal(size=(len(c), 3))
    np.testing.assert_allclose(
        spherical_harmonics.evaluate(t.sh, d @ R.T),
        spherical_harmonics.evaluate(c.sh, d),
        atol=1e-5,
    )
    np.testing.assert_array_equal(t.opacity, c.opacity)


def test_mirrors_and_stretches_are_no_rotations():
    for bad in (np.diag([1.0, 1, -1]), 2 * np.eye(3), np.full((3, 3), np.nan)):
        with pytest.raises(ValueError, match="rotation"):
            cloud().transformed(bad)


def test_select_takes_rows_in_order():
    c = cloud()
    part = c.select(np.array([4, 2]))
    assert len(part) == 2
    np.testing.assert_array_equal(part.x, c.x[[4, 2]])
    np.testing.assert_array_equal(part.sh, c.sh[[4, 2]])


def test_wrong_shapes_are_named():
    c = cloud()
    with pytest.raises(ValueError, match="Cloud.quat"):
        GaussianCloud(c.x, c.quat[:, :3], c.scale, c.opacity, c.sh)
    with pytest.raises(ValueError, match="Cloud.sh"):
        GaussianCloud(c.x, c.quat, c.scale, c.opacity, c.sh[:, :5])


def test_rgb_is_the_color_without_its_view_dependence():
    c = cloud(5)
    c.sh[:, 0] = spherical_harmonics.dc_from_rgb([[0.1, 0.5, 0.9]] * 4 + [[-1, 2, 0.5]])
    np.testing.assert_allclose(c.rgb[:4], [[0.1, 0.5, 0.9]] * 4, atol=1e-6)
    np.testing.assert_allclose(c.rgb[4], [0, 1, 0.5], atol=1e-6)

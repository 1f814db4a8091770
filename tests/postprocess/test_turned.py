"""A turned body seen from a turned camera, and a larger one from further away: the same pictures.

Theory: rasterisation sees positions, covariances and directions relative to the camera alone.
Tolerance 2e-3 of the range 0..1, at any pixel.
"""

from types import SimpleNamespace

import numpy as np
import pytest

from vgmpi.gaussians.camera import look_at
from vgmpi.gaussians.cloud import GaussianCloud, quaternion
from vgmpi.postprocess.frames.appearance import Appearance
from vgmpi.postprocess.raster import rasterize

MIDDLE = np.array([0.4, 0.5, 0.6])
EYE = np.array([1.1, -1.6, 1.3])
TOLERANCE = 2e-3


def cloud(n=600):
    """An opaque ball of flat Gaussians whose colors change with the view, in metres."""
    rng = np.random.default_rng(3)
    x = rng.normal(size=(n, 3))
    x = MIDDLE + 0.35 * x / np.linalg.norm(x, axis=1, keepdims=True) * rng.uniform(0.6, 1, (n, 1))
    quat = rng.normal(size=(n, 4))
    coefficients = 0.25 * rng.normal(size=(n, 16, 3))
    return GaussianCloud(
        x,
        quat / np.linalg.norm(quat, axis=1, keepdims=True),
        rng.uniform(0.005, 0.06, (n, 3)),
        rng.uniform(0.1, 0.95, n),
        coefficients.astype("f4"),
    )


def turn(seed):
    q = np.random.default_rng(seed).normal(size=4)
    w, *v = q / np.linalg.norm(q)
    k = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    return np.eye(3) + 2 * w * k + 2 * k @ k


def run_of(body):
    """The cloud as a solid body of a run."""
    rest = SimpleNamespace(
        object=np.zeros(len(body), int),
        vol0=np.full(len(body), 1e-6),
        cov0=body.cov().astype("f4"),
        opacity=body.opacity.astype("f4"),
        sh=body.sh,
    )
    return SimpleNamespace(gaussians=rest, objects=[{"name": "body", "family": "solid"}])


def picture(body, x, F, eye, target, up, near=0.2):
    """Through the look of a frame: positions x, deformation F (3, 3) of all."""
    camera = look_at(eye, target, up, 40, 160, 120, near)
    frame = {
        "id": np.arange(len(body)),
        "positions": x.astype("f4"),
        "F": np.tile(F.ravel(), (len(body), 1)).astype("f4"),
    }
    return rasterize.render(Appearance(run_of(body)).splats(frame, camera.eye), camera)[0]


def at_rest(body, eye=EYE, near=0.2):
    return picture(body, body.x, np.eye(3), eye, MIDDLE, (0, 0, 1), near)


@pytest.mark.parametrize("seed", range(4))
def test_a_rotated_body_from_a_rotated_camera(seed):
    """Reached 1.6e-6."""
    body, R = cloud(), turn(seed)
    want = at_rest(body)
    shift = np.array([0.3, -0.2, 0.5])

    def moved(p):
        return R @ p + shift

    x = body.x @ R.T + shift
    up = R @ [0, 0, 1]
    through_frame = picture(body, x, R, moved(EYE), moved(MIDDLE), up)
    placed = body.transformed(R, 1.0, shift)
    as_placed = picture(placed, placed.x, np.eye(3), moved(EYE), moved(MIDDLE), up)
    np.testing.assert_allclose(through_frame, want, rtol=0, atol=TOLERANCE)
    np.testing.assert_allclose(as_placed, want, rtol=0, atol=TOLERANCE)
    unturned = picture(body, body.x, np.eye(3), moved(EYE), moved(MIDDLE), up)
    assert abs(unturned - want).max() > 0.2


@pytest.mark.parametrize("scale", [0.5, 2.0, 3.0])
def test_a_larger_body_is_a_nearer_camera(scale):
    """Scaled about a point by s and seen from s times as far: the same; which is the body unscaled
    seen by a camera s times as near as the one that sees the scaled body. Reached
    1.4e-6."""
    body = cloud()
    want = at_rest(body)
    x = MIDDLE + scale * (body.x - MIDDLE)
    eye = MIDDLE + scale * (EYE - MIDDLE)
    through_frame = picture(body, x, scale * np.eye(3), eye, MIDDLE, (0, 0, 1), 0.2 * scale)
    placed = body.transformed(np.eye(3), scale, (1 - scale) * MIDDLE)
    as_placed = picture(placed, placed.x, np.eye(3), eye, MIDDLE, (0, 0, 1), 0.2 * scale)
    np.testing.assert_allclose(through_frame, want, rtol=0, atol=TOLERANCE)
    np.testing.assert_allclose(as_placed, want, rtol=0, atol=TOLERANCE)
    assert abs(at_rest(body, eye, 0.2 * scale) - want).max() > 0.2


def test_the_picture_depends_on_the_harmonics_and_on_the_shapes():
    """So that the comparisons above would see either left behind."""
    body, R = cloud(), turn(0)
    want = at_rest(body)
    plain = GaussianCloud(body.x, body.quat, body.scale, body.opacity, body.sh[:, :1])
    assert abs(at_rest(plain) - want).max() > 0.1
    q = quaternion(R)
    other = GaussianCloud(body.x, np.tile(q, (len(body), 1)), body.scale, body.opacity, body.sh)
    assert abs(at_rest(other) - want).max() > 0.1

"""Normals of solids in the studio against those of their surfaces, their creases, their shadows."""

import numpy as np
import pytest
from scipy import ndimage
from scipy.spatial import cKDTree

from tests.support import solid_runs
from vgmpi.gaussians.cloud import GaussianCloud, rotation_matrices
from vgmpi.postprocess.studio import body_normals

MESH = """
[[object]]
name = "thing"
mesh = "thing.obj"
{role}
position = [0.2, 0.2, 0.1]
"""
BODY, SCENERY = 'material = "clay"', 'role = "scenery"'
CLEAR = solid_runs.CAMERA + 'background = "none"\n'
OFF = "[appearance]\nbaked_shading = 0\n"


def ball(radius=0.1, groove=0.0, rings=96):
    """A ball with a groove around its equator."""
    angle = np.linspace(0, np.pi, rings + 1)
    r = radius * (1.0 - groove * np.exp(-((np.cos(angle) / 0.12) ** 2)))
    return solid_runs.surface_of_revolution(
        np.maximum(r * np.sin(angle), 1e-7), -r * np.cos(angle), 192
    )


def cup(radius=0.08, height=0.16, wall=0.006):
    """A jug whose wall is as thick as the particles are apart."""
    inner = radius - wall
    return solid_runs.surface_of_revolution(
        np.array([1e-7, radius, radius, inner, inner, 1e-7]),
        np.array([0, 0, height, height, wall, wall]),
    )


def angles(n, true):
    """Angles between unit vectors [degrees]."""
    return np.degrees(np.arccos(np.clip((n * true).sum(axis=1), -1, 1)))


def seen(folder, objects, deformation=None):
    """Points of the thing in the middle and normals there, as the studio paints them."""
    run = solid_runs.write(folder, objects, deformation)
    points, n = solid_runs.painted(solid_runs.painter(run, folder))
    close = np.linalg.norm(points - solid_runs.MIDDLE, axis=1) < 0.18
    return points[close], n[close]


SIDES = pytest.mark.parametrize("light", ["", OFF], ids=["painted light", "none"])
ROLES = pytest.mark.parametrize("role", [BODY, SCENERY], ids=["body", "scenery"])


@ROLES
@SIDES
def test_a_mesh_of_a_ball(tmp_path, role, light):
    solid_runs.write_obj(tmp_path / "thing.obj", *ball())
    points, n = seen(tmp_path, MESH.format(role=role) + light)
    off = angles(n, (points - [0.2, 0.2, 0.2]) / 0.1)
    assert len(off) > 5000
    assert off.mean() < 1.5 and np.percentile(off, 99) < 6


@ROLES
@SIDES
def test_a_mesh_with_a_groove(tmp_path, role, light):
    """Where it is concave, and the nearest other surface is close."""
    vertices, triangles = ball(groove=0.35)
    solid_runs.write_obj(tmp_path / "thing.obj", vertices, triangles)
    points, n = seen(tmp_path, MESH.format(role=role) + light)
    corner = vertices[triangles] + [0.2, 0.2, 0.2]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1), 1e-30)[:, None]
    nearest = cKDTree(corner.mean(axis=1)).query(points)[1]
    off = angles(n, normal[nearest])
    assert off.mean() < 3.5 and (off > 90).mean() < 0.01


@ROLES
@SIDES
def test_a_thin_cup(tmp_path, role, light):
    """Both sides of a wall that holds no particle."""
    solid_runs.write_obj(tmp_path / "thing.obj", *cup())
    points, n = seen(tmp_path, MESH.format(role=role) + light)
    axis = points[:, :2] - 0.2
    r = np.linalg.norm(axis, axis=1)
    side = (points[:, 2] > 0.12) & (points[:, 2] < 0.245)
    outside, inside = side & (r > 0.0785), side & (r < 0.0755)
    for where, sign in ((outside, 1), (inside, -1)):
        true = np.zeros((where.sum(), 3))
        true[:, :2] = sign * axis[where] / r[where, None]
        off = angles(n[where], true)
        assert where.sum() > 1000
        assert off.mean() < 1.5 and np.percentile(off, 99) < 20


def test_a_mesh_that_is_sheared(tmp_path):
    F = np.array([[1.3, 0.5, 0.0], [0.0, 0.7, 0.3], [-0.2, 0.0, 1.1]])
    solid_runs.write_obj(tmp_path / "thing.obj", *ball())
    points, n = seen(tmp_path, MESH.format(role=BODY), F)
    true = (points - [0.2, 0.2, 0.2]) @ np.linalg.inv(F).T @ np.linalg.inv(F)
    off = angles(n, true / np.linalg.norm(true, axis=1, keepdims=True))
    assert off.mean() < 2.5 and np.percentile(off, 99) < 5


def blob(rings=96):
    """A ball of bumps with deep creases between them."""
    vertices, triangles = ball(1.0, 0.0, rings)
    unit = vertices / np.linalg.norm(vertices, axis=1, keepdims=True)
    around = np.arctan2(unit[:, 1], unit[:, 0])
    r = 1.0 + 0.18 * np.abs(np.sin(5 * around)) * (1 - unit[:, 2] ** 2)
    r += 0.12 * np.abs(np.sin(6 * unit[:, 2]))
    return 0.08 * unit * r[:, None], triangles


@ROLES
def test_creases_are_not_black(tmp_path, role):
    """No pixel of a creased body is much darker than those around it."""
    solid_runs.write_obj(tmp_path / "thing.obj", *blob())
    run = solid_runs.write(tmp_path, MESH.format(role=role))
    view = solid_runs.painter(run, tmp_path, CLEAR).views_of(0, 0.0)[0]
    opaque = ndimage.binary_erosion(view.picture[..., 3] > 250, iterations=3)
    light = view.picture[..., :3].astype(float).mean(axis=2)
    mean = ndimage.uniform_filter(np.where(opaque, light, 0.0), 25)
    mean /= np.maximum(ndimage.uniform_filter(opaque.astype(float), 25), 1e-9)
    ratio = light[opaque] / mean[opaque]
    assert opaque.sum() > 5000
    assert ratio.min() > 0.35 and (ratio < 0.5).mean() < 0.002


@ROLES
@pytest.mark.parametrize("source", ["mesh", "shape"])
def test_ground_below_a_box_is_dark(tmp_path, role, source):
    solid_runs.write_obj(tmp_path / "thing.obj", *solid_runs.cube(0.16))
    text = MESH.format(role=role).replace("0.2, 0.1]", "0.2, 0.0]")
    if source == "shape":
        box = "shape = { box = [[0.12, 0.12, 0], [0.28, 0.28, 0.16]] }"
        text = f'[[object]]\nname = "thing"\n{box}\n{role}\n'
    renderer = solid_runs.painter(solid_runs.write(tmp_path, text), tmp_path)
    plane = renderer.studio.moment(renderer.look.frame(0), 0).plane
    at = plane.lower[0] + (np.arange(plane.light.shape[1]) + 0.5) * plane.texel
    below = np.abs(at - 0.2) < 0.07
    light = plane.light[np.ix_(below, below)].mean(axis=2)
    assert light.max() < 0.05 * plane.light.mean(axis=2).max()


def test_axes_along_which_gaussians_are_thin():
    """Of flat ones of any orientation, also unequally wide; round and long ones are not flat."""
    rng = np.random.default_rng(3)
    quat = rng.normal(size=(300, 4))
    quat /= np.linalg.norm(quat, axis=1, keepdims=True)
    scale = np.array([[2.0, 1.0, 0.2], [1.0, 1.0, 0.1], [1.0, 1.0, 1.0]])[np.arange(300) % 3] * 1e-3
    scale[297] = [5e-3, 1e-3, 0.9e-3]
    cloud = GaussianCloud(
        np.zeros((300, 3)), quat, scale, np.ones(300), np.zeros((300, 1, 3), "f4")
    )
    axis, is_flat = body_normals.thin_axes(cloud.cov().astype("f4"))
    expected = np.arange(300) % 3 < 2
    expected[297] = False
    np.testing.assert_array_equal(is_flat, expected)
    third = rotation_matrices(quat)[:, :, 2]
    assert angles(np.abs((axis * third).sum(axis=1))[is_flat, None], np.ones((199, 1))).max() < 0.1


def test_a_normal_seen_from_behind_faces_the_eye():
    x, eye = np.array([[0.0, 0, 0], [0, 0, 0]]), np.array([0.0, 0, 2])
    normal, out = np.array([[0.6, 0, 0.8], [0.6, 0, -0.8]]), np.empty((2, 3))
    body_normals.face_eye(x, normal, eye, out)
    np.testing.assert_array_equal(out[0], normal[0])
    np.testing.assert_allclose(out[1], -body_normals.SEEN_FROM_BEHIND * normal[1])

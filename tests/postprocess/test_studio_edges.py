"""Shapes and edges of solids in the studio: smooth faces, and edges that are sharp to a pixel."""

import numpy as np
import pytest

from tests.postprocess.test_studio_normals import BODY, CLEAR, MESH, ROLES, angles, seen
from tests.support import solid_runs
from vgmpi.postprocess.studio import surface_edges

SHAPES = {
    "sphere": "{ sphere = { center = [0.2, 0.2, 0.2], radius = 0.1 } }",
    "box": "{ box = [[0.12, 0.12, 0.12], [0.28, 0.28, 0.28]] }",
    "cylinder": "{ cylinder = { endpoints = [[0.2, 0.2, 0.12], [0.2, 0.2, 0.28]], radius = 0.08 }}",
    "shell": "{ difference = [{ sphere = { center = [0.2, 0.2, 0.2], radius = 0.1 } },"
    " { box = [[0.2, 0, 0.2], [0.4, 0.2, 0.4]] }] }",
}


def thing(shape, role):
    return f'[[object]]\nname = "thing"\nshape = {shape}\n{role}\n'


def normals_at(name, points):
    """Return the normals of a shape at points close to its surface."""
    p = points - 0.2
    if name == "box":
        return np.where(np.abs(p) == np.abs(p).max(axis=1, keepdims=True), np.sign(p), 0.0)
    if name == "cylinder":
        side = 0.08 - np.linalg.norm(p[:, :2], axis=1) < 0.08 - np.abs(p[:, 2])
        return np.where(side[:, None], p * [1, 1, 0], [0, 0, 1.0])
    if name == "shell":
        walls = np.stack([p[:, 0], -p[:, 1], p[:, 2]], axis=1)
        cut = (walls > -0.004).all(axis=1) & (np.linalg.norm(p, axis=1) < 0.096)
        wall = np.where(walls == walls.min(axis=1, keepdims=True), [1.0, -1, 1], 0.0)
        return np.where(cut[:, None], wall, p)
    return p


@ROLES
@pytest.mark.parametrize("name", SHAPES)
def test_normals_of_a_shape(tmp_path, role, name):
    points, n = seen(tmp_path, thing(SHAPES[name], role))
    true = normals_at(name, points)
    off = angles(n, true / np.linalg.norm(true, axis=1, keepdims=True))
    assert len(off) > 20000
    assert off.mean() < 4 and np.percentile(off, 95) < 3.5


def test_a_shape_that_is_sheared(tmp_path):
    F = np.array([[1.3, 0.5, 0.0], [0.0, 0.7, 0.3], [-0.2, 0.0, 1.1]])
    points, n = seen(tmp_path, thing(SHAPES["sphere"], BODY), F)
    true = (points - 0.2) @ np.linalg.inv(F).T @ np.linalg.inv(F)
    off = angles(n, true / np.linalg.norm(true, axis=1, keepdims=True))
    assert off.mean() < 1 and np.percentile(off, 99) < 2


@ROLES
@pytest.mark.parametrize("source", ["mesh", "shape"])
def test_silhouette_of_a_box(tmp_path, role, source):
    """Its width from 10 to 90 % of opacity, and where half of it lies."""
    solid_runs.write_obj(tmp_path / "thing.obj", *solid_runs.cube(0.16))
    text = thing(SHAPES["box"], role)
    if source == "mesh":
        text = MESH.format(role=role).replace("0.2, 0.1]", "0.2, 0.12]")
    renderer = solid_runs.painter(solid_runs.write(tmp_path, text), tmp_path, CLEAR)
    alpha = renderer.views_of(0, 0.0)[0].picture[..., 3] / 255.0
    camera = renderer.camera(0.0)
    edge = np.column_stack([np.full(40, 0.28), np.full(40, 0.12), np.linspace(0.15, 0.25, 40)])
    p = edge @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    columns = camera.fx * p[:, 0] / p[:, 2] + camera.cx
    rows = (camera.fy * p[:, 1] / p[:, 2] + camera.cy).astype(int)
    widths, errors = [], []
    for row, column in zip(rows, columns):
        first = int(column) - 12
        line = alpha[row, first : first + 24]
        at = [np.interp(-level, -line, np.arange(24)) for level in (0.9, 0.5, 0.1)]
        widths.append(at[2] - at[0])
        errors.append(first + at[1] + 0.5 - column)
    assert np.mean(widths) < 1.5 and abs(np.mean(errors)) < 0.6


def test_a_disc_is_cut_at_the_other_face():
    """Two faces at right angles, of unit discs that stand 1 m apart: the cut ends at the edge."""
    k = np.arange(6) + 0.5
    u, v = (a.ravel() for a in np.meshgrid(-k, np.arange(-6, 7.0)))
    x = np.concatenate([np.column_stack([u, v, 0 * u]), np.column_stack([0 * u, v, u])])
    normal = np.repeat([[0.0, 0, 1], [1.0, 0, 0]], len(u), axis=0)
    cov = np.repeat([[1.0, 0, 0, 1, 0, 0.01], [0.01, 0, 0, 1, 0, 1]], len(u), axis=0)
    shift, cut = surface_edges.cut_at_edges(x, normal, cov)
    top = (np.arange(len(x)) < len(u)) & (np.abs(x[:, 1]) < 3)
    close, far = top & (x[:, 0] == -0.5), top & (x[:, 0] < -surface_edges.WIDTH)
    ends = (x + shift)[close, 0] + surface_edges.WIDTH * np.sqrt(cut[close, 0])
    np.testing.assert_allclose(ends, 0.0, atol=1e-12)
    np.testing.assert_allclose(cut[close][:, (3, 5)], [[1.0, 0.01]] * close.sum())
    np.testing.assert_array_equal(cut[far], cov[far])
    assert not shift[far].any() and not shift[top][:, 1:].any()

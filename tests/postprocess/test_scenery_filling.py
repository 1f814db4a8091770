"""Filling of closed scenery: what a skin encloses, and what stays empty."""

import numpy as np

from vgmpi.postprocess.frames import scenery_filling

GAP = 0.05  # [m] spacing of a skin
NOBODY = np.zeros((0, 3))


def skin(lid=True):
    """Return points on the faces of a cube of 1 m, with or without its upper face."""
    k = (np.arange(20) + 0.5) * GAP
    u, v = (a.ravel() for a in np.meshgrid(k, k))
    faces = []
    for axis in range(3):
        for side in (0.0, 1.0):
            points = np.full((len(u), 3), side)
            points[:, (axis + 1) % 3], points[:, (axis + 2) % 3] = u, v
            faces += [points] if lid or axis < 2 or side == 0.0 else []
    return np.concatenate(faces)


def outward(x):
    """Return the normals of the cube's faces at points on them."""
    away = x - 0.5
    return np.where(np.abs(away) == 0.5, np.sign(away), 0.0)


def enclosed(x, others=NOBODY):
    """Return the points that fill a skin, and the volume of each."""
    points, nearest, volume = scenery_filling.enclosed_points(x, outward(x), GAP, 0.03, others)
    assert len(points) == len(nearest)
    return points, volume


def test_a_closed_skin_is_filled():
    points, volume = enclosed(skin())
    depth = scenery_filling.DEPTH * GAP  # [m]
    assert (points > depth).all() and (points < 1 - depth).all()
    np.testing.assert_allclose(len(points) * volume, (1 - 2 * depth) ** 3, rtol=0.1)  # [m3]
    assert volume <= 0.03**3


def test_open_and_inhabited_space_stays_empty():
    assert not len(enclosed(skin(lid=False))[0])
    someone = np.array([[0.5, 0.5, 0.5]])
    assert not len(enclosed(skin(), someone)[0])
    outside = np.array([[0.5, 0.5, 1.5], [-9.0, 0.5, 0.5]])
    assert len(enclosed(skin(), outside)[0])


def test_the_filling_moves_with_its_skin():
    x = np.concatenate([skin(), skin() + [3.0, 0, 0]])
    rows = [np.arange(len(x) // 2), np.arange(len(x) // 2, len(x))]
    filling = scenery_filling.fill_scenery(
        x,
        np.tile(outward(skin()), (2, 1)),
        rows,
        np.full(len(x), GAP),
        [rows[1][:0], rows[1]],
        0.1,
        NOBODY,
    )
    assert set(filling.pose) == {-1, 1}
    assert (np.linalg.norm(x[filling.parent] - filling.x, axis=1) < 0.6).all()
    turned = np.array([[0.0, -1, 0, 0], [1, 0, 0, 5], [0, 0, 1, 0], [0, 0, 0, 1]])
    moved = filling.positions([np.eye(4), turned])
    np.testing.assert_array_equal(moved[filling.pose < 0], filling.x[filling.pose < 0])
    expected = filling.x[filling.pose == 1] @ turned[:3, :3].T + turned[:3, 3]
    np.testing.assert_allclose(moved[filling.pose == 1], expected)

"""The studio's surface of a liquid: rho = 1/2 of lattices that are stretched, at walls, and of
little.

Geometry: a lattice of spacing s fills boxes of edge s around its particles, so its true surface
lies s / 2 beyond the outermost ones; a slab that is stretched k times along x is k times as thin.
"""

import numpy as np
import pytest

from tests.support import studio_scenes
from vgmpi.postprocess.studio import density_field, lattice_deformation

S = 0.01
SLAB = (24, 16, 6)
FAR = (-1.0, -1.0, -1.0, 2.0, 2.0, 2.0)


def heights(found, xs, ys, low, high, steps=2000):
    """Highest and lowest z of rho = 1/2 (n,) within low .. high at places x, y; nan for none."""
    z = np.linspace(low, high, steps)
    x = np.stack(np.broadcast_arrays(xs[:, None], ys[:, None], z[None]), -1)
    rho = density_field.densities(found, x.reshape(-1, 3)).reshape(len(xs), steps)
    inside = rho > 0.5
    none = ~inside.any(axis=1)
    first, last = inside.argmax(axis=1), steps - 1 - inside[:, ::-1].argmax(axis=1)
    rows = np.arange(len(xs))

    def crossing(a, b):  # between samples a and b, linearly
        fa, fb = rho[rows, a], rho[rows, b]
        t = np.clip((0.5 - fa) / np.where(fa == fb, 1.0, fb - fa), 0, 1)
        return np.where(none, np.nan, z[a] + t * (z[b] - z[a]))

    top = crossing(last, np.minimum(last + 1, steps - 1))
    return top, crossing(first, np.maximum(first - 1, 0))


def middle(x, y, margin):
    """A fine raster of places inside of a rectangle."""
    u, v = (np.arange(a + margin, b - margin, 0.23 * S) for a, b in (x, y))
    return (a.ravel() for a in np.meshgrid(u, v))


@pytest.mark.parametrize("times", [1, 2, 3])
def test_a_stretched_slab_has_no_ripple_and_no_holes(times):
    """Against half of the rows of particles, which round kernels would show."""
    x0 = studio_scenes.grid_points(SLAB, S)
    x = x0 * [times, 1, 1 / times]
    found, _ = studio_scenes.field_of(
        x, S, FAR, studio_scenes.OPEN, fine=3.0, stretch=studio_scenes.stretched(x0, x, S)
    )
    xs, ys = middle((0, 24 * S * times), (0, 16 * S), 4 * S)
    top, bottom = heights(found, xs, ys, -3 * S, 9 * S)
    assert np.isfinite(top).all()
    for surface in (top, bottom):
        assert surface.std() < 0.005 * S
    thick = (top - bottom).mean() * times / (6 * S)
    assert 1 / 1.1 < thick < 1.1


@pytest.mark.parametrize("fine", [2.0, 3.0])
def test_water_at_rest_is_level_up_to_its_walls(fine):
    """20 x 20 x 12 spacings in a box of that width: the level is 12 spacings, in corners as
    well."""
    box = (0, 0, 0, 20 * S, 20 * S, 30 * S)
    found, _ = studio_scenes.field_of(studio_scenes.grid_points((20, 20, 12), S), S, box, fine=fine)
    edge = 1e-4 * S
    for low, high in ((edge, 20 * S - edge), (5 * S, 15 * S)):
        at = np.linspace(low, high, 41)
        xs, ys = (a.ravel() for a in np.meshgrid(at, at))
        top, _ = heights(found, xs, ys, 9 * S, 15 * S)
        assert np.abs(top - 12 * S).max() < 0.05 * S
    # down to the floor it is full
    deep = np.array([[edge, edge, edge], [10 * S, edge, edge], [10 * S, 10 * S, edge]])
    assert (density_field.densities(found, deep) > 0.9).all()


def test_a_pool_ends_on_the_planes_of_its_walls():
    """Hits of a camera that looks along a side, within half a pixel of the wall's plane."""
    wide = 40 * S
    medium = studio_scenes.water(
        studio_scenes.grid_points((40, 40, 20), S), S, (0, 0, 0, wide, wide, 0.4)
    )
    camera = studio_scenes.look_at((-0.6, -0.9, 0.5), (0.2, 0.2, 0.1), (0, 0, 1), 30, 160, 160)
    stage = studio_scenes.stage_of(medium, camera)
    hits, normals = studio_scenes.find(stage)
    view = stage.buffers
    _, p = studio_scenes.wall_at(view, 0, 0.0)
    rays = (p - view.eye) / np.linalg.norm(p - view.eye, axis=-1, keepdims=True)
    on = np.isfinite(hits)
    at = view.eye + np.abs(hits)[..., None] * rays * np.sign(rays @ view.pose[2, :3])[..., None]
    pixel = 1.5 / view.lens[0]
    sides = {0: (normals[..., 0] < -0.99), 1: (normals[..., 1] < -0.99)}
    for axis, faces in sides.items():
        faces &= on
        assert faces.sum() > 500
        assert (hits[faces] < 0).mean() > 0.97  # said to be a wall
        assert np.abs(at[faces][:, axis]).max() < 0.5 * pixel
    # the picture of the pool ends where the edges of its box are seen
    inside = (at[..., :2] > -0.5 * pixel).all(-1) & (at[..., :2] < wide + 0.5 * pixel).all(-1)
    assert inside[on].all() and (at[on][:, 2] < 20.05 * S).all()
    outline = np.zeros(on.shape, bool)
    rows, columns = np.indices(on.shape)
    for axis in (0, 1):
        _, q = studio_scenes.wall_at(view, axis, 0.0)
        outline |= (
            (q[..., 1 - axis] > 0)
            & (q[..., 1 - axis] < wide)
            & ((q[..., 2] > 0) & (q[..., 2] < 20 * S))
        )
    assert not (outline & ~on).any()


@pytest.mark.parametrize("walls", [studio_scenes.WALLED, studio_scenes.OPEN])
def test_what_is_left_out_deep_inside_changes_nothing(monkeypatch, walls):
    box = (0, 0, 0, 40 * S, 40 * S, 40 * S)
    x = studio_scenes.grid_points((40, 40, 30), S)
    sparse, _ = studio_scenes.field_of(x, S, box, walls)
    assert (sparse.index == density_field.FULL).any()
    monkeypatch.setattr(density_field, "MARGIN", 1e3)
    whole, _ = studio_scenes.field_of(x, S, box, walls)
    assert not (whole.index == density_field.FULL).any()
    at = np.random.default_rng(2).uniform(-2 * S, 42 * S, (40000, 3))
    a, b = density_field.densities(sparse, at), density_field.densities(whole, at)
    assert ((a > 0.5) == (b > 0.5)).all()
    near = (b > 0.05) & (b < 0.9)
    assert near.sum() > 500
    np.testing.assert_allclose(a[near], b[near], atol=1e-5)


def test_nothing_and_one_particle():
    empty = density_field.empty_field()
    assert (
        density_field.densities(empty, np.random.default_rng(1).normal(size=(20, 3))) == 0
    ).all()
    stage = studio_scenes.stage_of(
        studio_scenes.water(np.full((1, 3), 0.5), S, FAR),
        studio_scenes.oblique(30, (0.5, 0.5, 0.5), size=40),
    )
    with_one = np.isfinite(studio_scenes.find(stage)[0])
    found = stage.medium.field
    # a kernel of its own: 315 / (64 pi R^3) of R = sqrt(11 (.68^2 + .3^2)) spacings, less than 1/2
    peak = 315 / (64 * np.pi * (11 * (0.68**2 + 0.3**2)) ** 1.5)
    assert density_field.densities(found, np.full((1, 3), 0.5))[0] == pytest.approx(peak, rel=0.02)
    assert not with_one.any()
    none = stage._replace(medium=stage.medium._replace(field=empty))
    assert not np.isfinite(studio_scenes.find(none)[0]).any()


def test_a_lattice_that_is_cut_obliquely_is_found_whole():
    """Corners off at 30 degrees, pushed off the lattice's origin: every neighbor, no other."""
    x0 = studio_scenes.grid_points((20, 20, 20), S, (0.013, -0.007, 0.0021))
    place = np.round((x0 - x0.min(axis=0)) / S).astype(int)
    kept = (x0 @ [0.5, 0.3, 0.8] < 0.14) & (x0 @ [0.7, -0.6, 0.1] < 0.06)
    x0, place = x0[kept], place[kept]
    links = lattice_deformation.link(x0, S)
    assert (links.row < 0).all()
    row = {tuple(p): k for k, p in enumerate(place)}
    for column in range(6):
        step = np.zeros(3, int)
        step[column // 2] = 1 - 2 * (column % 2)
        expected = [row.get(tuple(p + step), -1) for p in place]
        np.testing.assert_array_equal(links.axes[:, column], expected)


A = np.array([[1.6, 0.3, 0.0], [0.0, 0.9, -0.2], [0.1, 0.0, 0.7]])


def squares(stretch):
    """V V^T (n, 3, 3) of upper triangles of V (n, 6)."""
    full = stretch[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)
    return full @ full


@pytest.mark.parametrize("kind", ["capture", "lattice"])
def test_an_affine_motion_is_found_exactly(kind):
    """Of scattered points by least squares, of a lattice by its edges; not at their rims."""
    x0 = studio_scenes.grid_points((12, 12, 12), S)
    if kind == "capture":
        x0 = np.random.default_rng(4).uniform(0, 12 * S, x0.shape)
    links = lattice_deformation.link(x0, S)
    assert (links.row >= 0).all() == (kind == "capture")
    x = x0 @ A.T + [0.3, 0.2, 0.1]
    found = squares(studio_scenes.stretched(x0, x, S, limits=(0.1, 5.0)))
    tolerance = 1e-5 if kind == "capture" else 1e-9
    inner = (np.abs(x0 - 6 * S) < 4 * S).all(axis=1)
    assert inner.sum() > 100
    np.testing.assert_allclose(found[inner], np.tile(A @ A.T, (inner.sum(), 1, 1)), atol=tolerance)


def test_stretches_stay_within_their_limits_and_torn_lattices_are_at_rest():
    x0 = studio_scenes.grid_points((6, 6, 6), S)
    found = squares(studio_scenes.stretched(x0, x0 * [10.0, 1.0, 0.1], S))
    np.testing.assert_allclose(found, np.tile(np.diag([9.0, 1.0, 0.16]), (216, 1, 1)), atol=1e-9)
    torn = squares(studio_scenes.stretched(x0, x0 * [10.0, 1.0, 1.0], S, torn=5.0))
    np.testing.assert_allclose(torn, np.tile(np.eye(3), (216, 1, 1)), atol=1e-9)

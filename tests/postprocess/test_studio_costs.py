"""What a frame of the studio computes, in counts, and that leaving out the rest changes nothing."""

import numpy as np
import pytest

from tests.postprocess.test_studio_normals import BODY, CLEAR
from tests.support import solid_runs, studio_scenes
from vgmpi.postprocess.raster import rasterize, surface_canvas
from vgmpi.postprocess.raster.rasterize import ProjectableGaussians
from vgmpi.postprocess.studio import cone_occlusion, deferred_shading, surface_edges

BOX = '[[object]]\nname = "thing"\nshape = { box = [[0.12, 0.12, 0.12], [0.28, 0.28, 0.28]] }\n'


def test_opaque_bodies_are_blended_once(tmp_path, monkeypatch):
    renderer = solid_runs.painter(solid_runs.write(tmp_path, BOX + BODY), tmp_path, CLEAR)
    calls, blend = [], surface_canvas.blend_tiles
    monkeypatch.setattr(surface_canvas, "blend_tiles", lambda *a: (calls.append(1), blend(*a))[1])
    renderer.views_of(0, 0.0)
    assert len(calls) == 1


@pytest.mark.parametrize("of_one_material", [None, (0.0, 0, 0), (0, 0.2, 1)])
def test_one_pass_over_surfaces_is_several(of_one_material):
    """Color, normal, material and depth are those of a picture each."""
    rng = np.random.default_rng(4)
    x = rng.uniform(0.25, 0.4, (300, 3))
    cov = np.tile([1e-4, 0, 0, 1e-4, 0, 1e-4], (300, 1))
    color, normal, material = (rng.uniform(0, 1, (300, 3)) for _ in range(3))
    if of_one_material is not None:
        material[:] = of_one_material
    opacity = rng.uniform(0.1, 0.9, 300)
    camera = studio_scenes.oblique(50, (0.3, 0.3, 0.3), size=90)

    def splats(values):
        return ProjectableGaussians(x, cov, opacity, values)

    *found, through, median = surface_canvas.draw_surfaces(
        splats(color), camera, normal, material, 0.3, False, 1 / 255
    )
    assert (through == 1).mean() > 0.1 and (through < 0.5).mean() > 0.1
    options = {"lowpass": 0.3, "antialias": False, "alpha_min": 1 / 255, "depth": "median"}
    for got, values in zip(found, (color, normal, material)):
        want, left, depth = rasterize.render(splats(values), camera, (0, 0, 0), **options)
        np.testing.assert_allclose(got, want, atol=1e-6)
        np.testing.assert_allclose(through, left, atol=1e-6)
        np.testing.assert_array_equal(median, depth)


def box_of_discs(count=40):
    """Discs of standard deviation 0.7 spacings on the six faces of a cube of `count` spacings."""
    k = np.arange(count) + 0.5
    u, v = (a.ravel() for a in np.meshgrid(k, k))
    x, normal, cov = [], [], []
    for axis in range(3):
        for side in (0, 1):
            points = np.full((len(u), 3), float(side * count))
            points[:, (axis + 1) % 3], points[:, (axis + 2) % 3] = u, v
            n = np.zeros(3)
            n[axis] = 2 * side - 1
            x.append(points)
            normal.append(np.tile(n, (len(u), 1)))
            cov.append(np.tile([0.5 - 0.49 * n[0] ** 2, 0, 0, 0.5 - 0.49 * n[1] ** 2, 0,
                                0.5 - 0.49 * n[2] ** 2], (len(u), 1)))  # fmt: skip
    return tuple(np.concatenate(rows) for rows in (x, normal, cov))


def test_neighbors_are_searched_at_edges_only(monkeypatch):
    discs, searched, cut = box_of_discs(), [], surface_edges._cut
    monkeypatch.setattr(surface_edges, "_cut", lambda *a: (searched.append(len(a[2])), cut(*a))[1])
    few = surface_edges.cut_at_edges(*discs)
    monkeypatch.setattr(surface_edges, "TURN", 0.0)
    every = surface_edges.cut_at_edges(*discs)
    assert searched[1] == len(discs[0]) and 0 < searched[0] < 0.6 * searched[1]
    for a, b in zip(few, every):
        np.testing.assert_array_equal(a, b)
    assert (few[0] != 0).any()


def test_a_cone_ends_at_what_is_occupied():
    """Beyond the box all levels are empty; it is much smaller than the grid."""
    x = studio_scenes.grid_points((8, 8, 8), 0.01, (0.2, 0.3, 0.1))
    pyramid = studio_scenes.pyramid(x, 1e-6, cells=100)
    low, high = pyramid.occupied[:3], pyramid.occupied[3:]
    assert (high - low).max() < 0.6 * (pyramid.upper - pyramid.lower).min()
    rng = np.random.default_rng(1)
    points = rng.uniform(pyramid.lower, pyramid.upper, (4000, 3))
    outside = ((points < low) | (points > high)).any(axis=1)
    value = np.array(
        [[cone_occlusion.level_value(pyramid, q, *p) for q in range(5)] for p in points]
    )
    assert not value[outside].any() and value[~outside].any()
    light = [cone_occlusion.cone(pyramid, 0.24, 0.34, z, 0, 0, 1.0, 0.1, 0.01, 2.2)
             for z in (0.02, 0.6)]  # fmt: skip
    assert light[0] < 0.1 and light[1] == 1.0


def test_light_is_interpolated_where_it_is_even():
    """A floor in the shadow of a ball: the light is that of every pixel evaluated.

    A little sand in every other pixel keeps them from being interpolated.
    """
    rig = studio_scenes.dark_rig(key=0.8, horizon=0.5, zenith=0.6, bounce=0.4, width=0.07)
    x = studio_scenes.sphere(0.15, 0.0125, (0.5, 0.5, 0.3))
    shadows = studio_scenes.pyramid(x, 0.0125**3, cells=150)
    drop = studio_scenes.water(
        studio_scenes.grid_points((6, 6, 6), 0.01) + 5, 0.01, (5, 5, 5, 6, 6, 6)
    )
    camera = studio_scenes.oblique(40, (0.5, 0.5, 0.0), size=160)
    pictures = []
    for sand in (0.0, 0.03):
        stage = studio_scenes.stage_of(drop, camera, rig, shadows=shadows)
        view = stage.buffers
        view.depth[:] = studio_scenes.wall_at(view, 2, 0.0)[0]
        shape = (*view.depth.shape, 3)
        up = np.broadcast_to(np.float32([0.5, 0.5, 1.0]), shape).copy()
        white, kinds = np.ones(shape, np.float32), np.zeros(shape, np.float32)
        kinds[..., 0] = sand * (np.indices(shape[:2]).sum(axis=0) % 2)
        left = np.zeros(shape[:2], np.float32)
        deferred_shading.shade_opaque(stage, white, up, kinds, left, 1, False, 0.5)
        pictures.append(view.light.astype(float))
    smooth, exact = (picture[:, ::2][::2] for picture in pictures)  # pixels without sand
    assert exact.min() < 0.5 * exact.max()
    difference = np.abs(smooth - exact) / exact
    assert difference.any()  # interpolated
    assert difference.max() < 0.04 and difference.mean() < 0.003

"""Liquids with a surface: what they refract, mirror and take from light, against what optics says.

Theory: Snell, sin(a) = n sin(b); Fresnel's equations for light without polarisation; Beer and
Lambert, light falls by the color for each `clear` of way. A pool of particles in order, .6 x .6 m
and .2 m deep, spacing 1 cm, is seen from above.
"""

import numpy as np
import pytest

from tests.support.studio_scenes import pixel_of, surface_point
from vgmpi.gaussians.camera import look_at
from vgmpi.gaussians.cloud import pack_symmetric
from vgmpi.postprocess.raster import ground_plane, liquid_depth, liquid_shading, liquid_surface
from vgmpi.postprocess.raster.rasterize import ProjectableGaussians, render
from vgmpi.postprocess.raster.tile_blend import to_tiles

H, DEEP, INDEX = 0.01, 0.2, 1.333
OPTIONS = {"lowpass": 0.3, "antialias": False, "alpha_min": 1 / 255}
BLACK = liquid_shading.gradient((0, 0, 0), (0, 0, 0), (0, 0, 0))
WHITE = liquid_shading.gradient((1, 1, 1), (1, 1, 1), (1, 1, 1))
NONE = ProjectableGaussians(np.empty((0, 3)), np.empty((0, 6)), np.empty(0), np.empty((0, 3)))
UP = np.array([0.0, 0.0, 1.0])


def balls(x, sd, color, opacity=0.95):
    x = np.atleast_2d(np.asarray(x, dtype=np.float64))
    cov = np.tile(pack_symmetric(sd**2 * np.eye(3)[None]), (len(x), 1))
    return ProjectableGaussians(
        x, cov, np.full(len(x), opacity), np.tile(np.array(color, float), (len(x), 1))
    )


def pool(color=(0.3, 0.6, 0.9), opacity=0.0, jitter=0.0):
    """Particles of the pool, which ends at z = DEEP."""
    x = (np.indices((60, 60, 20)).reshape(3, -1).T + 0.5) * H
    x = x + np.random.default_rng(3).uniform(-jitter, jitter, x.shape) * H
    n = len(x)
    return liquid_surface.Liquid(
        x, np.full(n, H), np.tile(np.array(color, float), (n, 1)), np.full(n, opacity)
    )


def medium(clear=1e9, index=INDEX):
    return liquid_shading.LiquidMedium(index, clear, UP, 0.0, 0.05)


def oblique(angle, size=300, distance=1.5):
    """A camera that sees the middle of the pool's surface so many degrees from above."""
    a = np.radians(angle)
    middle = np.array([0.3, 0.3, DEEP])
    eye = middle + distance * np.array([0.0, -np.sin(a), np.cos(a)])
    return look_at(eye, middle, (0, 1, 0) if angle < 1 else (0, 0, 1), 30, size, size)


def drawn(splats, water, camera, background, sky, matter, under=None):
    shape = (camera.height, camera.width)
    ground = np.full(shape, np.inf, np.float32)
    if under is not None:
        ground = ground_plane.ground_depth(under, camera)
    background = np.broadcast_to(np.asarray(background, np.float32), (*shape, 3))
    return liquid_surface.render(splats, water, camera, background, ground, sky, matter, **OPTIONS)


@pytest.mark.parametrize("angle", [20, 40, 55])
def test_what_lies_below_is_shifted_as_snell_says(angle):
    camera = oblique(angle)
    mark = np.array([0.3, 0.35, 0.03])
    # a red spot on a floor of Gaussians
    rng = np.random.default_rng(1)
    sand = np.column_stack([rng.uniform(-0.3, 0.9, (40000, 2)), np.full(40000, 0.03)])
    splats = balls(sand, 0.006, (0, 0, 0), 0.99)
    splats.color[np.hypot(*(sand - mark)[:, :2].T) < 0.02, 0] = 1.0
    seen, alone = (
        centre(drawn(splats, pool(), camera, (0, 0, 0), BLACK, medium(index=index))[0])
        for index in (INDEX, 1.0)
    )
    apparent = pixel_of(camera, surface_point(camera.eye, mark, INDEX, DEEP))
    shift = apparent - pixel_of(camera, mark)
    assert np.hypot(*shift) > 5
    assert np.hypot(*(seen - alone - shift)) < 0.06 * np.hypot(*shift), (seen - alone, shift)


def centre(image):
    """Of what is red in a picture [pixels]."""
    rows, columns = np.indices(image.shape[:2])
    red = image[..., 0] * (image[..., 0] > 0.05)
    return np.array([(red * columns).sum(), (red * rows).sum()]) / red.sum() + 0.5


def test_without_refraction_nothing_is_shifted():
    camera, mark = oblique(40), np.array([0.3, 0.35, 0.03])
    image, *_ = drawn(
        balls(mark, 0.008, (1, 0, 0)), pool(), camera, (0, 0, 0), BLACK, medium(index=1)
    )
    alone, _ = render(balls(mark, 0.008, (1, 0, 0)), camera, (0, 0, 0))
    assert np.abs(image - alone).max() < 0.02


@pytest.mark.parametrize("angle", [0, 45, 70])
def test_as_much_is_mirrored_as_fresnel_says(angle):
    camera = oblique(angle)
    image, *_ = drawn(NONE, pool(), camera, (0, 0, 0), WHITE, medium())
    a = np.radians(angle)
    b = np.arcsin(np.sin(a) / INDEX)
    if angle == 0:
        share = ((INDEX - 1) / (INDEX + 1)) ** 2
    else:
        across = np.sin(a - b) ** 2 / np.sin(a + b) ** 2
        along = np.tan(a - b) ** 2 / np.tan(a + b) ** 2
        share = 0.5 * (across + along)
    middle = image[140:160, 140:160].mean()
    assert middle == pytest.approx(share, rel=0.05)


@pytest.mark.parametrize("color", [(0.3, 0.6, 0.9), (0.9, 0.2, 0.5)])
def test_light_is_weakened_by_the_color_on_its_way(color):
    camera = oblique(0)
    image, *_ = drawn(NONE, pool(color), camera, (1, 1, 1), BLACK, medium(clear=0.4))
    mirrored = ((INDEX - 1) / (INDEX + 1)) ** 2
    expected = (1 - mirrored) * np.array(color) ** (DEEP / 0.4)
    np.testing.assert_allclose(image[140:160, 140:160].mean(axis=(0, 1)), expected, rtol=0.05)


def test_what_is_opaque_gives_its_own_color_as_its_gaussians_do():
    """Gaussians of this opacity, as large as particles, splatted, and the liquid of them."""
    camera, water = oblique(0), pool((0.8, 0.4, 0.2), opacity=0.02)
    image, *_ = drawn(NONE, water, camera, (0, 0, 0), BLACK, medium(index=1))
    gaussians = balls(water.x, H * liquid_depth.RADIUS, (0.8, 0.4, 0.2), 0.02)
    alone, _ = render(gaussians, camera, (0, 0, 0), alpha_min=1e-4)
    ratio = image[140:160, 140:160].mean() / alone[140:160, 140:160].mean()
    assert ratio == pytest.approx(1.0, abs=0.05)


def test_the_front_of_a_flat_pool_is_flat_and_where_it_is():
    camera, water = oblique(30), pool(jitter=0.3)
    radius = liquid_depth.BALL * water.spacing
    depth = liquid_depth.liquid_depth(water.x, radius, H, camera)
    rows, columns = np.indices(depth.shape)
    u, v = (columns + 0.5 - camera.cx) / camera.fx, (rows + 0.5 - camera.cy) / camera.fy
    local = np.stack([u, v, np.ones_like(u)], -1) * depth[..., None]
    world = (local - camera.world_to_camera[:3, 3]) @ camera.world_to_camera[:3, :3]
    middle = world[120:180, 120:180, 2]
    assert middle.std() < 0.1 * H
    assert middle.mean() - liquid_depth.ABOVE * H == pytest.approx(DEEP, abs=0.2 * H)


def test_both_sides_of_a_front_make_the_whole():
    """Each Gaussian is drawn on the one side of the depth of a pixel or on the other."""
    rng = np.random.default_rng(2)
    x = rng.uniform(0, 0.6, (300, 3))
    splats = ProjectableGaussians(
        x, balls(x, 0.02, (0, 0, 0)).cov, rng.uniform(0.1, 0.6, 300), rng.uniform(0, 1, (300, 3))
    )
    camera = oblique(50, size=90)
    limit = rng.uniform(1.0, 2.0, (90, 90)).astype(np.float32)
    layers = liquid_surface.LayeredImage(splats, camera, 0.3, False, 1 / 255)
    dark = np.zeros((90, 90, 3), np.float32)
    whole, left = layers.picture(dark)
    near, passes = layers.picture(dark, limit, is_behind=False)
    far, left_far = layers.picture(dark, limit, is_behind=True)
    assert near.max() > 0.1 and far.max() > 0.1
    some = left > 2e-3  # of what nothing passes some Gaussians are left out
    assert some.mean() > 0.1
    np.testing.assert_allclose((near + passes[..., None] * far)[some], whole[some], atol=1e-3)
    np.testing.assert_allclose((passes * left_far)[some], left[some], atol=1e-5)
    assert to_tiles(limit).shape == (36, 256)


def test_what_stands_before_and_behind_the_front():
    camera, water = oblique(40), pool((0.5, 0.5, 0.5), opacity=0.2)
    before = balls((0.3, 0.2, 0.4), 0.02, (1, 0, 0))
    below = balls((0.3, 0.3, 0.05), 0.02, (1, 0, 0))
    clear, *_ = drawn(NONE, water, camera, (0, 0, 0), BLACK, medium())
    red = [drawn(s, water, camera, (0, 0, 0), BLACK, medium())[0] for s in (before, below)]
    seen = [np.abs(image - clear).max() for image in red]
    assert seen[0] > 0.4 and seen[1] < 0.05, seen


def test_drops_are_gaussians_and_pools_are_not():
    water = pool()
    lone = np.array([[0.3, 0.3, 0.5], [0.1, 0.1, 0.4]])
    more = liquid_surface.Liquid(lone, np.full(2, H), np.ones((2, 3)), np.full(2, 0.02))
    both = liquid_surface.Liquid(
        *(np.concatenate([getattr(w, f) for w in (water, more)]) for f in vars(water))
    )
    kept, spray = liquid_surface.split_spray(both, H)
    np.testing.assert_array_equal(spray.x, lone)
    assert len(kept.x) == len(water.x) and (spray.opacity >= liquid_surface.MIN_DROP_OPACITY).all()


def test_an_empty_liquid_is_no_liquid():
    camera = oblique(40, size=64)
    nothing = liquid_surface.Liquid(np.empty((0, 3)), np.empty(0), np.empty((0, 3)), np.empty(0))
    spot = balls((0.3, 0.3, 0.1), 0.05, (1, 0, 0))
    white, far = np.ones((64, 64, 3), np.float32), np.full((64, 64), np.inf, np.float32)
    image, left, depth = liquid_surface.render(
        spot, nothing, camera, white, far, WHITE, medium(), with_depth=True, **OPTIONS
    )
    alone, through, median = render(spot, camera, (1, 1, 1), depth="median")
    np.testing.assert_allclose(image, alone, atol=1e-6)
    np.testing.assert_allclose(left, through, atol=1e-6)
    np.testing.assert_array_equal(depth, median)

"""The floor and its shadow: where it is seen, what color it has, where and how dark the shadow."""

import numpy as np
import pytest

from vgmpi.gaussians.camera import look_at
from vgmpi.gaussians.cloud import pack_symmetric, unpack_symmetric
from vgmpi.postprocess.raster import rasterize
from vgmpi.postprocess.raster.ground_plane import GroundPlane, cast_shadow, composite_ground

LOW = look_at((0.0, -2.0, 1.0), (0, 0, 0), (0, 0, 1), 40, 90, 70)
TOP = look_at((0.0, 0.0, 4.0), (0, 0, 0), (0, 1, 0), 40, 101, 101)
EMPTY = rasterize.ProjectableGaussians(
    np.empty((0, 3)), np.empty((0, 6)), np.empty(0), np.empty((0, 3))
)


def ball(x, sd=0.05, opacity=0.9, n=1):
    cov = np.tile(pack_symmetric(sd**2 * np.eye(3)[None]), (n, 1))
    return rasterize.ProjectableGaussians(
        np.tile(np.array(x, float), (n, 1)), cov, np.full(n, opacity), np.ones((n, 3))
    )


def test_the_floor_is_seen_where_rays_meet_it_and_the_background_elsewhere():
    floor = GroundPlane(height=0.3, color=(0.2, 0.4, 0.6))
    seen = look_at((0.0, -2.0, 1.0), (0, 3.0, 1.2), (0, 0, 1), 60, 90, 70)
    out = composite_ground(floor, cast_shadow(EMPTY, floor), seen, (1, 0, 0))
    rotation = seen.world_to_camera[:3, :3]
    for row in (0, 20, 40, 69):
        for column in (0, 45, 89):
            local = [(column + 0.5 - seen.cx) / seen.fx, (row + 0.5 - seen.cy) / seen.fy, 1]
            downwards = (rotation.T @ local)[2] < 0
            np.testing.assert_allclose(out[row, column], floor.color if downwards else (1, 0, 0))
    assert (out[0] == (1, 0, 0)).all() and (out[-1] != (1, 0, 0)).any(axis=1).all()
    below = look_at((0.0, -2.0, 0.1), (0, 0, 0), (0, 0, 1), 40, 90, 70)
    assert (composite_ground(floor, cast_shadow(EMPTY, floor), below, (1, 0, 0)) == (1, 0, 0)).all()


def test_squares_have_their_side_and_fade_in_the_distance():
    floor = GroundPlane(color=(0, 0, 0), squares=((1, 1, 1), 0.5))
    out = composite_ground(floor, cast_shadow(EMPTY, floor), TOP)[..., 0]
    pixel = 4.0 / TOP.fx  # of the floor, seen from above
    x = (np.arange(101) + 0.5 - 50.5) * pixel
    row = int(50.5 - 0.1 / pixel)  # y = 0.1
    inside = np.abs((x / 0.5) % 1 - 0.5) < 0.4
    odd = np.floor(x / 0.5) % 2
    np.testing.assert_allclose(out[row][inside], odd[inside], atol=1e-6)
    far = look_at((0.0, -2.0, 1.0), (0, 100.0, 0.0), (0, 0, 1), 40, 90, 70)
    grey = composite_ground(floor, cast_shadow(EMPTY, floor), far)[..., 0]
    horizon = np.flatnonzero((grey != 1).all(axis=1))[0]
    np.testing.assert_allclose(grey[horizon + 1], 0.5)


def test_the_shadow_lies_where_the_light_throws_it():
    floor = GroundPlane(height=0.2, light=(0.5, -0.25, -1.0), softness=0.0)
    shadow = cast_shadow(ball((0.1, 0.3, 1.2)), floor)
    darkest = np.unravel_index(shadow.light.argmin(), shadow.light.shape)
    at = shadow.lower + (np.array(darkest)[::-1] + 0.5) * shadow.pixel
    np.testing.assert_allclose(at, [0.1 + 0.5, 0.3 - 0.25], atol=1.5 * shadow.pixel)
    assert shadow.light.min() == pytest.approx(1 - 0.9, abs=0.01)


def test_the_shadow_has_the_shape_of_the_gaussian_along_the_light():
    """A product over Gaussians of 1 - alpha, each flattened by the slanted projection."""
    rng = np.random.default_rng(0)
    root = rng.normal(size=(5, 3, 3)) * 0.05
    x = rng.uniform(-0.1, 0.1, (5, 3)) + [0, 0, 1]
    splats = rasterize.ProjectableGaussians(
        x, pack_symmetric(root @ root.transpose(0, 2, 1)), rng.uniform(0.2, 0.9, 5), np.ones((5, 3))
    )
    floor = GroundPlane(light=(0.4, 0.3, -1.0), softness=0.04)
    shadow = cast_shadow(splats, floor)
    onto = np.array([[1, 0, 0.4], [0, 1, 0.3]])
    middle = x @ onto.T
    flat = onto @ unpack_symmetric(splats.cov) @ onto.T
    wide = flat + ((0.04 * x[:, 2]) ** 2 + 0.3 * shadow.pixel**2)[:, None, None] * np.eye(2)
    amount = splats.opacity * np.sqrt(np.linalg.det(flat) / np.linalg.det(wide))
    rows, columns = rng.integers(0, shadow.light.shape, (300, 2)).T
    points = shadow.lower + (np.stack([columns, rows], axis=1) + 0.5) * shadow.pixel
    d = points[:, None] - middle
    s = 0.5 * np.einsum("pni,nij,pnj->pn", d, np.linalg.inv(wide), d)
    want = (1 - amount * np.exp(-s)).prod(axis=1)
    np.testing.assert_allclose(shadow.light[rows, columns], want, atol=5e-3)  # five times alpha_min
    assert want.min() < 0.7


def test_higher_things_throw_softer_shadows_of_the_same_amount():
    floor = GroundPlane(light=(0.0, 0.0, -1.0), softness=0.1)
    low, high = (cast_shadow(ball((0, 0, z), opacity=0.3), floor) for z in (0.5, 2.0))
    assert (1 - high.light).max() < 0.4 * (1 - low.light).max()
    amounts = [(1 - s.light).sum() * s.pixel**2 for s in (low, high)]
    assert amounts[0] == pytest.approx(0.3 * 2 * np.pi * 0.05**2, rel=0.03)
    assert amounts[1] == pytest.approx(amounts[0], rel=0.1)  # alpha_min cuts a little


def test_the_shadow_darkens_the_floor_as_much_as_asked():
    for strength in (0.0, 0.5, 1.0):
        floor = GroundPlane(
            color=(0.8, 0.6, 0.4), light=(0, 0, -1.0), shadow=strength, softness=0.0
        )
        out = composite_ground(
            floor, cast_shadow(ball((0, 0, 0.5), sd=0.3, opacity=0.99, n=3), floor), TOP
        )
        np.testing.assert_allclose(out[50, 50], (1 - strength) * np.array(floor.color), atol=2e-3)
        np.testing.assert_allclose(out[0, 0], floor.color, atol=2e-3)


def test_the_shadow_is_seen_where_it_lies():
    """From above x is to the right and y upwards: neither swapped nor turned."""
    floor = GroundPlane(color=(1, 1, 1), light=(0.6, -0.2, -1.0), softness=0.0, shadow=1.0)
    dark, faint = ball((0.1, 0.6, 0.5)), ball((-0.5, 0.7, 0.5), opacity=0.1)  # so the map is wide
    both = rasterize.join_gaussians([dark, faint])
    out = composite_ground(floor, cast_shadow(both, floor), TOP)[..., 0]
    row, column = np.unravel_index(out.argmin(), out.shape)
    pixel = 4.0 / TOP.fx
    np.testing.assert_allclose([(column - 50) * pixel, (50 - row) * pixel], [0.4, 0.5], atol=pixel)


def test_what_is_below_the_floor_throws_no_shadow_and_is_drawn_over_it():
    floor = GroundPlane(color=(0, 0, 1.0), light=(0, 0, -1.0))
    below = ball((0, 0, -0.3), sd=0.2)
    shadow = cast_shadow(below, floor)
    assert (shadow.light == 1).all()
    image, _ = rasterize.render(below, TOP, composite_ground(floor, shadow, TOP))
    assert image[50, 50, 0] > 0.8


def test_the_floor_shows_through_by_the_transmittance():
    floor = GroundPlane(color=(0.0, 1.0, 0.0), light=(1.0, 0, -1.0))
    splats = ball((0, 0, 1.0), opacity=0.6, sd=0.2)
    behind = composite_ground(floor, cast_shadow(splats, floor), LOW)
    image, left = rasterize.render(splats, LOW, behind)
    plain, _ = rasterize.render(splats, LOW, (0, 0, 0))
    np.testing.assert_allclose(image, plain + left[..., None] * behind, atol=1e-6)


def test_broken_gaussians_throw_no_shadow():
    good = ball((0, 0, 1.0))
    x = np.concatenate([good.x, [[np.nan, 0, 1], [0, 0, np.inf]]])
    bad = rasterize.ProjectableGaussians(
        x, good.cov[[0, 0, 0]], good.opacity[[0, 0, 0]], good.color[[0, 0, 0]]
    )
    np.testing.assert_array_equal(
        cast_shadow(bad, GroundPlane()).light, cast_shadow(good, GroundPlane()).light
    )


@pytest.mark.parametrize(
    "wrong",
    [{"light": (0, 0, 1.0)}, {"shadow": 1.5}, {"softness": -1.0}, {"squares": ((1, 1, 1), 0.0)}],
)
def test_wrong_floors_are_refused(wrong):
    with pytest.raises(ValueError, match="floor|allowed"):
        GroundPlane(**wrong)

"""The splatting kernel against the dense renderer, and each rule by itself."""

import numpy as np
import pytest

from tests.support import dense_rasterizer
from vgmpi.gaussians.camera import Camera, look_at
from vgmpi.gaussians.cloud import pack_symmetric, unpack_symmetric
from vgmpi.postprocess.raster import rasterize
from vgmpi.postprocess.raster.tile_blend import BATCH

MODES = {
    "classic": {"lowpass": 0.3, "antialias": False},
    "antialias": {"lowpass": 0.3, "antialias": True},
    "mip": {"lowpass": 0.1, "antialias": True},
}


def scene(n=400, seed=0, size=(0.005, 0.2), opacity=(0.01, 1.0)):
    """Splats of all shapes around the origin, some outside the picture and behind the camera."""
    rng = np.random.default_rng(seed)
    axes = np.linalg.qr(rng.normal(size=(n, 3, 3)))[0]
    scale = np.exp(rng.uniform(*np.log(size), (n, 3)))
    root = axes * scale[:, None, :]
    return rasterize.ProjectableGaussians(
        rng.normal(size=(n, 3)) * [1.0, 1.0, 1.5],
        pack_symmetric(root @ root.transpose(0, 2, 1)),
        rng.uniform(*opacity, n),
        rng.uniform(0, 1.2, (n, 3)),
    )


def camera(width=70, height=45, **changes):
    """Not square, not a multiple of the tiles, centre off the middle: nothing is symmetric."""
    seen = look_at((0.3, -3.0, 0.8), (0, 0, 0), (0, 0, 1), 50, width, height)
    values = dict(vars(seen), cx=0.4 * width, cy=0.55 * height, fy=1.1 * seen.fy) | changes
    return Camera(**values)


def both(splats, seen, background=(0.1, 0.2, 0.3), **options):
    fast, fast_t = rasterize.render(splats, seen, background, **options)
    slow, slow_t = dense_rasterizer.render(
        splats.x,
        unpack_symmetric(splats.cov),
        splats.opacity,
        splats.color,
        seen,
        background,
        **options,
    )
    return np.abs(fast - slow), np.abs(fast_t - slow_t)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("seed", range(3))
def test_agrees_with_the_dense_renderer(mode, seed):
    error, error_t = both(scene(seed=seed), camera(), **MODES[mode])
    assert error.mean() < 1e-6
    assert error.max() < 5e-3
    assert np.quantile(error, 0.999) < 1e-5  # only single pixels may lie on the edge of a rule
    assert error_t.max() < 5e-3


def test_subpixel_needles_and_faint_fluids_agree():
    tiny = scene(300, 5, size=(1e-5, 0.01))
    assert both(tiny, camera())[0].max() < 5e-3
    faint = scene(300, 6, size=(0.05, 0.1), opacity=(0.002, 0.02))
    for alpha_min in (1 / 255, 1e-4, 1e-5):
        error, _ = both(faint, camera(), alpha_min=alpha_min)
        assert error.mean() < 1e-6 and error.max() < 1.2 * alpha_min


def test_opaque_walls_stop_pixels_for_good():
    """Many opaque layers with faint ones between, which alone would still fit below the limit."""
    n = 60
    x = np.zeros((n, 3))
    x[:, 1] = np.linspace(0, 1, n)
    opacity = np.where(np.arange(n) % 2, 0.01, 0.97)
    color = np.random.default_rng(1).uniform(0, 1, (n, 3))
    cov = np.tile(pack_symmetric(0.3**2 * np.eye(3)[None]), (n, 1))
    error, error_t = both(
        rasterize.ProjectableGaussians(x, cov, opacity, color), camera(), background=(1, 1, 1)
    )
    assert error.max() < 2e-6
    assert error_t.max() < 1e-6
    _, left = rasterize.render(rasterize.ProjectableGaussians(x, cov, opacity, color), camera())
    assert left.min() >= 1e-4  # a pixel stops before it falls below


def one(x=(0, 0, 0), sd=0.2, opacity=0.5):
    return rasterize.ProjectableGaussians(
        np.array([x], dtype=float),
        pack_symmetric(sd**2 * np.eye(3)[None]),
        np.array([opacity]),
        np.array([[1.0, 0.5, 0.0]]),
    )


def test_an_opaque_gaussian_still_lets_a_hundredth_through():
    _, left = rasterize.render(one(opacity=1.0, sd=0.5), camera())
    assert left.min() == pytest.approx(0.01, rel=1e-4)


def test_a_pixel_centre_is_half_a_pixel_in():
    """A ball on the axis of a camera whose centre is a pixel centre lights that pixel most."""
    seen = camera(33, 33, cx=16.5, cy=16.5)
    _, left = rasterize.render(one(sd=0.02), seen)
    assert np.unravel_index(left.argmin(), left.shape) == (16, 16)
    np.testing.assert_allclose(left, left[:, ::-1], atol=1e-6)
    np.testing.assert_allclose(left, left[::-1], atol=0.01)


def test_what_lies_before_the_near_plane_is_not_drawn():
    eye = camera().eye
    towards = -eye / np.linalg.norm(eye)
    for depth, drawn in ((0.199, False), (0.201, True), (-1.0, False)):
        _, left = rasterize.render(
            one(eye + depth * towards, sd=0.001, opacity=1.0), camera(near_plane=0.2)
        )
        assert (left.min() < 0.9) == drawn


def test_alpha_min_cuts_where_it_says():
    seen = camera()
    for alpha_min in (1 / 255, 0.1):
        _, left = rasterize.render(one(opacity=0.5), seen, alpha_min=alpha_min)
        alpha = 1 - left[left < 1]
        assert alpha_min <= alpha.min() < 1.5 * alpha_min
    _, left = rasterize.render(one(opacity=0.003), seen)
    assert left.min() == 1


@pytest.mark.parametrize("alpha_min", [0.0, 1e-7, 0.9, float("nan")])
def test_alpha_min_out_of_range_is_refused(alpha_min):
    with pytest.raises(ValueError, match="alpha_min"):
        rasterize.render(one(), camera(), alpha_min=alpha_min)


def test_the_projection_is_limited_outside_the_picture_on_each_side_by_its_own_measure():
    """Large Gaussians just outside: with another limit their streaks differ by several percent."""
    seen = camera(64, 64, cx=12.0, cy=50.0)
    across = look_at((0.3, -3.0, 0.8), (0, 0, 0), (0, 0, 1), 50, 64, 64).world_to_camera[:2, :3]
    for sign in (-1, 1):
        for axis in across:
            splats = one(sign * 2.6 * axis - seen.eye * 0.3, sd=0.8, opacity=0.9)
            error, _ = both(splats, seen)
            assert error.max() < 5e-3 and error.mean() < 1e-6


def test_a_picture_as_background_and_no_gaussians():
    empty = rasterize.ProjectableGaussians(
        np.empty((0, 3)), np.empty((0, 6)), np.empty(0), np.empty((0, 3))
    )
    ground = np.random.default_rng(0).random((45, 70, 3))
    image, left = rasterize.render(empty, camera(), ground)
    np.testing.assert_allclose(image, ground, atol=1e-7)
    assert (left == 1).all()


def test_broken_gaussians_are_left_out():
    good = scene(50)
    want, _ = rasterize.render(good, camera())
    x, cov, opacity = good.x.copy(), good.cov.copy(), good.opacity.copy()
    x = np.concatenate([x, [[np.nan, 0, 0], [0, np.inf, 0], [0, 0, 0], [0, 0, 0], [1e200, 0, 0]]])
    more = np.tile(good.cov[:1], (5, 1))
    more[2] = np.nan
    more[3] = np.inf
    cov, opacity = np.concatenate([cov, more]), np.concatenate([opacity, np.full(5, 0.9)])
    color = np.concatenate([good.color, np.ones((5, 3))])
    got, _ = rasterize.render(rasterize.ProjectableGaussians(x, cov, opacity, color), camera())
    np.testing.assert_array_equal(got, want)


def test_the_order_of_the_rows_does_not_matter():
    splats = scene(300, 3)
    turned = rasterize.ProjectableGaussians(
        *(getattr(splats, f)[::-1] for f in ("x", "cov", "opacity", "color"))
    )
    np.testing.assert_array_equal(
        rasterize.render(splats, camera())[0], rasterize.render(turned, camera())[0]
    )


def test_nearer_gaussians_hide_farther_ones():
    """Also when their depths differ in the seventh digit only."""
    eye = camera().eye
    towards = -eye / np.linalg.norm(eye)
    for gap in (0.5, 3e-6):
        x = np.stack([eye + (2 + gap) * towards, eye + 2 * towards])
        splats = rasterize.ProjectableGaussians(
            x,
            np.tile(pack_symmetric(0.1**2 * np.eye(3)[None]), (2, 1)),
            np.array([0.99, 0.99]),
            np.array([[1.0, 0, 0], [0, 1.0, 0]]),
        )
        image, left = rasterize.render(splats, camera(), (0, 0, 0))
        at = np.unravel_index(left.argmin(), left.shape)
        assert image[at][1] > 0.9 and image[at][0] < 0.1


SIZES = [(70, 45), (45, 70), (16, 16), (17, 33), (1, 40), (96, 15)]
CENTRES = [(0.5, 0.5), (0.1, 0.9), (-0.4, 1.5)]


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("size", SIZES)
def test_any_size_and_any_centre(size, mode):
    """The centre also outside the picture: then the limits of the projection lie on one side."""
    for seed, (cx, cy) in enumerate(CENTRES):
        seen = camera(*size, cx=cx * size[0], cy=cy * size[1])
        error, error_t = both(scene(300, seed), seen, **MODES[mode])
        assert error.mean() < 1e-6 and error.max() < 5e-3
        assert error_t.max() < 5e-3


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("seed", range(4))
def test_any_scale_and_any_opacity(mode, seed):
    """1e-5 to 10 m and 1e-4 to 1, evenly in their logarithms, round the camera too."""
    splats = scene(300, 20 + seed, size=(1e-5, 10.0))
    opacity = np.exp(np.random.default_rng(seed).uniform(np.log(1e-4), 0, 300))
    splats = rasterize.ProjectableGaussians(3 * splats.x, splats.cov, opacity, splats.color)
    for alpha_min in (1 / 255, 1e-4):
        error, error_t = both(splats, camera(), alpha_min=alpha_min, **MODES[mode])
        assert error.mean() < 1e-6 and error.max() < 5e-3
        assert error_t.max() < 5e-3


def test_gaussians_behind_and_beside_the_camera():
    """Behind: nothing. Beside and touching the near plane: as the formulas have it."""
    seen = camera(near_plane=0.05)
    rotation = seen.world_to_camera[:3, :3]
    rng = np.random.default_rng(2)
    local = np.stack([rng.uniform(-4, 4, 400), rng.uniform(-4, 4, 400), rng.uniform(-2, 1, 400)], 1)
    splats = scene(400, 2, size=(0.01, 0.5))
    splats = rasterize.ProjectableGaussians(
        seen.eye + local @ rotation, splats.cov, splats.opacity, splats.color
    )
    error, error_t = both(splats, seen)
    assert error.mean() < 1e-6 and error.max() < 5e-3 and error_t.max() < 5e-3
    assert error_t.size and rasterize.render(splats, seen)[1].min() < 0.5  # and something is seen
    behind = rasterize.ProjectableGaussians(
        seen.eye - np.abs(local[:, 2:]) * rotation[2], splats.cov, splats.opacity, splats.color
    )
    assert (rasterize.render(behind, seen)[1] == 1).all()


@pytest.mark.parametrize("mode", MODES)
def test_a_needle_across_the_picture_keeps_its_digits(mode):
    """Its middle lies hundreds of pixels away: in single precision the ridge would wander."""
    along = np.array([[1.0, 0.0, 0.35]]) / np.linalg.norm([1.0, 0.0, 0.35])
    cov = 4.0**2 * along[:, :, None] * along[:, None] + 1e-4**2 * np.eye(3)
    for shift in (-3.0, 2.0, 6.0):
        needle = rasterize.ProjectableGaussians(
            shift * along, pack_symmetric(cov), np.array([0.9]), np.ones((1, 3))
        )
        error, _ = both(needle, camera(300, 200), (0, 0, 0), **MODES[mode])
        assert error.max() < 1e-4


def test_one_gaussian_in_every_mode():
    for mode in MODES.values():
        for opacity in (1e-4, 0.01, 1.0):
            error, error_t = both(one(opacity=opacity), camera(), alpha_min=1e-4, **mode)
            assert error.max() < 2e-6 and error_t.max() < 2e-6


def test_more_than_a_batch_of_gaussians_and_closed_tiles():
    """Walls that close tiles at different times, and gaps between them."""
    rng = np.random.default_rng(4)
    n = BATCH + 3000
    x = rng.uniform(-1, 1, (n, 3)) * [1.2, 0.5, 0.8]
    x[:, 0] -= 0.4 * (rng.random(n) < 0.5)
    cov = np.tile(pack_symmetric(0.02**2 * np.eye(3)[None]), (n, 1))
    splats = rasterize.ProjectableGaussians(
        x, cov, rng.uniform(0.1, 0.99, n), rng.uniform(0, 1, (n, 3))
    )
    error, error_t = both(splats, camera(40, 30))
    assert error.mean() < 1e-6 and error.max() < 5e-3 and error_t.max() < 5e-3


@pytest.mark.parametrize("kind", rasterize.DEPTHS)
@pytest.mark.parametrize("mode", MODES)
def test_depths_are_the_dense_renderers(kind, mode):
    splats, seen = scene(300, 7, size=(0.02, 0.4)), camera()
    image, left, got = rasterize.render(splats, seen, depth=kind, **MODES[mode])
    plain, plain_left = rasterize.render(splats, seen, **MODES[mode])
    np.testing.assert_array_equal(image, plain)  # the picture does not change for it
    np.testing.assert_array_equal(left, plain_left)
    want = dense_rasterizer.depths(
        splats.x, unpack_symmetric(splats.cov), splats.opacity, seen, **MODES[mode]
    )[kind]
    seen_by_both = np.isfinite(want) & np.isfinite(got)
    assert (np.isfinite(want) == np.isfinite(got)).mean() > 0.999
    assert 0.2 < seen_by_both.mean()
    error = np.abs(got[seen_by_both] / want[seen_by_both] - 1)
    assert np.quantile(error, 0.999) < 1e-5  # only single pixels may lie on the edge of a rule


def test_there_is_no_depth_where_there_is_nothing():
    _, left, expected = rasterize.render(one(sd=0.05), camera(), depth="expected")
    assert (np.isinf(expected) == (left == 1)).all() and np.isinf(expected).any()
    distance = np.linalg.norm(camera().eye)
    np.testing.assert_allclose(expected[left < 1], distance, rtol=0.02)
    _, _, median = rasterize.render(one(sd=0.05, opacity=0.4), camera(), depth="median")
    assert np.isinf(median).all()  # half of the light is never stopped


def test_supersampling_is_the_mean_of_a_finer_picture():
    splats, seen, ground = (
        scene(200, 8),
        camera(30, 20),
        np.random.default_rng(0).random((20, 30, 3)),
    )
    image, left, depth = rasterize.render(splats, seen, ground, supersample=3, depth="expected")
    fine = rasterize.supersampled_camera(seen, 3)
    np.testing.assert_allclose([fine.fx, fine.cx, fine.width], [3 * seen.fx, 3 * seen.cx, 90])
    thrice = np.kron(ground, np.ones((3, 3, 1)))
    want, want_left = dense_rasterizer.render(
        splats.x, unpack_symmetric(splats.cov), splats.opacity, splats.color, fine, thrice
    )
    np.testing.assert_allclose(image, want.reshape(20, 3, 30, 3, 3).mean(axis=(1, 3)), atol=2e-3)
    np.testing.assert_allclose(left, want_left.reshape(20, 3, 30, 3).mean(axis=(1, 3)), atol=2e-3)
    depths = dense_rasterizer.depths(splats.x, unpack_symmetric(splats.cov), splats.opacity, fine)[
        "expected"
    ]
    weight = 1 - want_left
    total = (np.where(weight > 0, depths, 0) * weight).reshape(20, 3, 30, 3).sum(axis=(1, 3))
    total /= np.maximum(weight.reshape(20, 3, 30, 3).sum(axis=(1, 3)), 1e-300)
    known = left < 0.99
    np.testing.assert_allclose(depth[known], total[known], rtol=1e-3)
    exact, _ = rasterize.render(splats, seen, thrice, supersample=3)  # a background as fine as that
    np.testing.assert_array_equal(exact, image)


@pytest.mark.parametrize("wrong", [{"depth": "mean"}, {"backend": "gpu"}, {"supersample": 0}])
def test_wrong_options_are_refused(wrong):
    with pytest.raises(ValueError, match="allowed"):
        rasterize.render(one(), camera(), **wrong)

"""The studio's light: shadows, ambient light, energy and tone, against geometry and formulas.

Theory: the share of the sky that walls leave of a hemisphere, weighted by the cosine, by counting
rays; the shadow of a ball of radius r under a light at elevation e is an ellipse of half axes r and
r / sin(e); a white body in an even sky of 1 shines with 1.
"""

import numpy as np
import pytest

from tests.support import studio_scenes
from vgmpi.postprocess.studio import deferred_shading, studio_ground, tile_light, tone_mapping

H, THICK = 0.0125, 0.1  # m: of walls in a box of 1 m


def block(low, high):
    """Particles that fill a box."""
    low = np.array(low)
    return studio_scenes.grid_points(np.round((high - low) / H).astype(int), H, low)


FLOOR = block((0, 0, 0), (1, 1, THICK))
WALLS = [block((0, 0, THICK), (THICK, 1, 1)), block((THICK, 0, THICK), (1, THICK, 1))]


def open_share(distance, walls, rays=200):
    """Cosine-weighted share of the sky at a point of the floor so far from each of the walls, which
    are as high as the box: by counting rays."""
    r = np.sqrt((np.arange(rays) + 0.5) / rays)
    angle = 2 * np.pi * (np.arange(4 * rays) + 0.5) / (4 * rays)
    r, angle = np.meshgrid(r, angle, indexing="ij")
    d = np.stack([r * np.cos(angle), r * np.sin(angle), np.sqrt(1 - r * r)], axis=-1)
    p = np.array([distance, distance if walls == 2 else 0.5 - THICK, 0.0])
    hidden = np.zeros(r.shape, bool)
    for a in range(walls):
        towards = d[..., a] < -1e-9
        t = np.where(towards, -p[a] / np.where(towards, d[..., a], 1.0), 0.0)
        beside = p[1 - a] + t * d[..., 1 - a]
        within = (beside > -THICK) & (beside < 1 - THICK) & (t * d[..., 2] < 1 - THICK)
        hidden |= towards & within
    return 1 - hidden.mean()


def lit(stage, p, n):
    """Ambient light and what is open at a point."""
    key, sky, work = np.empty(3), np.empty(3), np.empty(11)
    p, n = np.array(p, dtype=float), np.array(n, dtype=float)
    return tile_light.light_at(stage, p, n, 0.0, False, key, sky, work), sky, key


@pytest.fixture(scope="module")
def drop():
    """A medium far away from everything."""
    return studio_scenes.water(
        studio_scenes.grid_points((6, 6, 6), 0.01) + 5, 0.01, (5, 5, 5, 6, 6, 6)
    )


def even_stage(drop, x, volume, cells):
    """Things in a sky of 1 from everywhere."""
    rig = studio_scenes.dark_rig(horizon=1.0, zenith=1.0, bounce=1.0)
    shadows = studio_scenes.pyramid(x, volume, cells=cells, albedo=0.0)
    return studio_scenes.stage_of(
        drop, studio_scenes.oblique(45, (0.5, 0.5, 0.5)), rig, shadows=shadows
    )


@pytest.mark.parametrize("cells", [100, 150])
@pytest.mark.parametrize("walls", [1, 2])
def test_ambient_light_in_a_corner(drop, walls, cells):
    stage = even_stage(drop, np.concatenate([FLOOR, *WALLS[:walls]]), H**3, cells)
    for distance in (0.1, 0.15, 0.2, 0.3, 0.4, 0.55, 0.7):
        p = (THICK + distance, THICK + distance if walls == 2 else 0.5, THICK)
        free, sky, _ = lit(stage, p, (0, 0, 1))
        assert free == pytest.approx(open_share(distance, walls), rel=0.10), distance
        np.testing.assert_allclose(sky, free, rtol=1e-6)


def ball_picture(stage, middle, radius, kind, albedo=1.0, block=1):
    """Light of a ball, and where its picture is."""
    view = stage.buffers
    rows, columns = np.indices(view.depth.shape)
    u = (columns + 0.5 - view.lens[2]) / view.lens[0]
    v = (rows + 0.5 - view.lens[3]) / view.lens[1]
    rays = np.stack([u, v, np.ones_like(u)], -1) @ view.pose[:3, :3]
    to = np.array(middle) - view.eye
    A, B, C = (rays**2).sum(-1), rays @ to, to @ to - radius**2
    there = B * B > A * C
    t = (B - np.sqrt(np.where(there, B * B - A * C, 0.0))) / A
    normal = (view.eye + t[..., None] * rays - middle) / radius
    view.depth[there] = t[there]
    painted = np.where(there[..., None], 0.5 + 0.5 * normal, 0.0).astype(np.float32)
    white = np.where(there[..., None], np.float32(albedo), np.float32(0))
    white = np.ascontiguousarray(np.broadcast_to(white, painted.shape))
    kinds = np.ascontiguousarray(there[..., None] * np.array(kind, np.float32))
    left = 1.0 - there.astype(np.float32)
    deferred_shading.shade_opaque(stage, white, painted, kinds, left, block, False, 0.5)
    return view.light, there


KINDS = {"sand": (1, 0, 0), "snow": (0, 1, 0), "capture": (0, 0, 1)}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("cells", [60, 150])
def test_a_white_ball_in_an_even_sky_is_as_bright_as_the_sky(drop, kind, cells):
    middle = np.array([0.5, 0.5, 0.5])
    x = studio_scenes.sphere(0.2, H, middle)
    stage = even_stage(drop, x, H**3, cells)
    light, there = ball_picture(stage, middle, 0.2, KINDS[kind])
    assert there.sum() > 500
    np.testing.assert_allclose(light[there], 1.0, atol=0.02)


def test_nothing_is_brighter_than_its_light():
    """Any normal, color and shadow: at most the key, the sky where it is open; sand, snow,
    others."""
    rng = np.random.default_rng(5)
    rig = studio_scenes.dark_rig((0.5, 0.3, -0.8), key=(1.0, 0.9, 0.8), horizon=0.5, zenith=0.6)
    full, out = np.array([0.6, 0.5, 0.7]), np.empty(3)
    brightest = 0.0
    for k in range(4000):
        n, d = rng.normal(size=(2, 3))
        n, d = n / np.linalg.norm(n), d / np.linalg.norm(d)
        kind = np.zeros(3)
        kind[:2] = rng.dirichlet([1, 1, 1])[:2]
        comes, free = rng.uniform(0, 1, 2)
        if k % 4 == 0:  # what shines most
            n, comes, free = rig.toward, 1.0, 1.0
        albedo = rng.uniform(0, 1, 3) if k % 3 else np.ones(3)
        args = (albedo, kind, 0.0, 0.5, comes * rig.key, free * full, free, out)
        deferred_shading.surface_light(rig, d, n, *args)
        assert (out <= rig.key + full + 1e-9).all() and (out >= 0).all(), (n, kind, free)
        brightest = max(brightest, (out / (rig.key + full)).max())
    assert brightest > 0.95


@pytest.mark.parametrize("elevation", [60, 35])
def test_the_shadow_of_a_ball_is_an_ellipse(elevation):
    e, r, middle = np.radians(elevation), 0.12, np.array([0.25, 0.5, 0.25])
    rig = studio_scenes.dark_rig((np.cos(e), 0.0, -np.sin(e)), key=1.0, width=0.005)
    shadows = studio_scenes.pyramid(studio_scenes.sphere(r, 0.005, middle), 0.005**3, cells=150)
    plane = studio_scenes.plain(studio_ground.TILES, shadows, rig)
    dark = plane.light[..., 0] < 0.5 * np.sin(e)
    rows, columns = np.nonzero(dark)
    at = np.column_stack([columns, rows]) * plane.texel
    around = at.mean(axis=0) + plane.lower + 0.5 * plane.texel
    np.testing.assert_allclose(around, [0.25 + 0.25 / np.tan(e), 0.5], atol=0.01)
    np.testing.assert_allclose(2 * at.std(axis=0), [r / np.sin(e), r], rtol=0.1)
    assert plane.light[0, 0, 0] == pytest.approx(np.sin(e), rel=1e-6)


def published(c):
    """Khronos PBR Neutral as its authors wrote it, of a color (3,); display values."""
    start, desaturation = 0.8 - 0.04, 0.15
    x = c.min()
    c = c - (x - 6.25 * x * x if x < 0.08 else 0.04)
    peak = c.max()
    if peak >= start:
        d = 1.0 - start
        new = 1.0 - d * d / (peak + d - start)
        g = 1.0 - 1.0 / (desaturation * (peak - new) + 1.0)
        c = (1 - g) * c * new / peak + g * new
    c = np.clip(c, 0, 1)
    return np.where(c < 0.0031308, 12.92 * c, 1.055 * c ** (1 / 2.4) - 0.055)


def displayed(light, curve=1):
    light = np.asarray(light, dtype=float).reshape(1, -1, 3)
    out = np.empty_like(light)
    tone_mapping.show(light, curve, out)
    return out[0]


def test_the_tone_curve_is_the_published_one():
    rng = np.random.default_rng(1)
    light = np.concatenate([10 ** rng.uniform(-3, 1, (500, 3)), rng.uniform(0, 1, (500, 3))])
    expected = np.array([published(c) for c in light])
    np.testing.assert_allclose(displayed(light), expected, atol=1e-6)
    # middle gray loses the 4 % that a surface mirrors; white is 1 - .24^2 / (.96 + .24 - .76)
    for linear, after in ((0.18, 0.14), (0.04, 0.01), (1.0, 1 - 0.0576 / 0.44)):
        shown = tone_mapping.to_linear(displayed([linear] * 3))
        np.testing.assert_allclose(shown, after, atol=1e-6)


@pytest.mark.parametrize("curve", [0, 1])
def test_display_values_come_back_through_light(curve):
    """All colors, also saturated and bright ones."""
    steps = np.array([0, 0.002, 0.02, 0.1, 0.2, 0.5, 0.7, 0.85, 0.9, 0.95, 0.98, 0.99])
    colors = np.stack(np.meshgrid(steps, steps, steps), -1).reshape(-1, 3)
    back = displayed(tone_mapping.scene_linear(colors, bool(curve)), curve)
    np.testing.assert_allclose(back, colors, atol=0.5 / 255)
    white = displayed(tone_mapping.scene_linear(np.ones((1, 3)), bool(curve)), curve)
    np.testing.assert_allclose(white, 1.0, atol=1 / 255)

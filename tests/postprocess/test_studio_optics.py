"""The studio's liquids: what they refract, mirror and take from light, against what optics says.

Theory: Snell, sin(a) = n sin(b); Fresnel's equations for light without polarisation; Beer and
Lambert, light falls by exp(-sigma w) over a way w. A pool of particles in order, .6 x .6 m and .2 m
deep, spacing 1 cm, is seen from above; slabs of liquid are seen through their sides.
"""

import numpy as np
import pytest

from tests.support import studio_scenes
from tests.support.studio_scenes import INDEX, fresnel, inner, pixel_of, surface_point
from vgmpi.postprocess.studio import deferred_shading, liquid_radiance, studio_ground

H, DEEP = 0.01, 0.2
POOL = studio_scenes.grid_points((60, 60, 20), H)
BOX = (0.0, 0.0, 0.0, 0.6, 0.6, 0.4)
SURFACE = (0.3, 0.3, DEEP)
MIDDLE = slice(55, 65), slice(55, 65)


@pytest.fixture(scope="module")
def pool():
    """A medium that absorbs nothing."""
    return studio_scenes.water(POOL, H, BOX)


def clear(medium, absorbs=(0.0, 0.0, 0.0), index=INDEX):
    """The same liquid with another absorption [1/m] and index."""
    mean = np.array([*absorbs, *medium.mean[3:]])
    tint = medium.tint._replace(values=medium.tint.values.copy())
    tint.values[..., :3] = absorbs
    return medium._replace(mean=mean, tint=tint, index=index)


def centre(image):
    """Of the red spot in a picture [pixels], not of its mirror images in the pool's sides."""
    rows, columns = np.indices(image.shape[:2])
    top = np.unravel_index(image[..., 0].argmax(), image.shape[:2])
    near = np.hypot(rows - top[0], columns - top[1]) < 0.25 * len(image)
    red = image[..., 0] * near
    return np.array([(red * columns).sum(), (red * rows).sum()]) / red.sum() + 0.5


def spot(x, mark, radius=0.03):
    """Red light (..., 3) around a mark, seen on a plane's points x (..., 3)."""
    out = np.zeros(x.shape, np.float32)
    out[..., 0] = np.clip(1 - np.linalg.norm(x - mark, axis=-1) / radius, 0, 1)
    return out


@pytest.mark.parametrize("opaque", [False, True], ids=["ground", "body"])
@pytest.mark.parametrize("angle", [20, 40, 55])
def test_a_mark_is_shifted_as_snell_says(pool, angle, opaque):
    """Under the surface: on the ground, and on something opaque that the camera sees."""
    camera = studio_scenes.oblique(angle, SURFACE, size=240)
    mark = np.array([0.3, 0.35, 0.03 if opaque else 0.0])
    seen = {}
    for index in (INDEX, 1.0):
        stage = studio_scenes.stage_of(clear(pool, index=index), camera)
        if opaque:
            view = stage.buffers
            view.depth[:], at = studio_scenes.wall_at(view, 2, mark[2])
            view.light[:] = spot(at, mark)
            bed = studio_scenes.grid_points((60, 60, 3), H)
            stage = stage._replace(pyramid=studio_scenes.pyramid(bed, H**3, cells=60))
        else:
            plane = studio_scenes.plain(studio_ground.TILES, stage.pyramid, stage.rig)
            rows, columns = np.indices(plane.light.shape[:2])
            x, y = (plane.lower[a] + (n + 0.5) * plane.texel for a, n in enumerate((columns, rows)))
            plane.light[:] = spot(np.stack([x, y, 0.0 * x], -1), mark)
            stage = stage._replace(plane=plane)
        seen[index] = centre(studio_scenes.draw(stage, covered=opaque))
    apparent = pixel_of(camera, surface_point(camera.eye, mark, INDEX, DEEP))
    shift = apparent - pixel_of(camera, mark)
    assert np.hypot(*shift) > 5
    assert np.hypot(*(seen[INDEX] - seen[1.0] - shift)) < 0.03 * np.hypot(*shift), (seen, shift)


@pytest.mark.parametrize("angle", [0, 45, 70])
def test_as_much_is_mirrored_as_fresnel_says(pool, angle):
    rig = studio_scenes.dark_rig(mirror_horizon=1.0, mirror_zenith=1.0, mirror_ground=1.0)
    image = studio_scenes.draw(
        studio_scenes.stage_of(pool, studio_scenes.oblique(angle, SURFACE), rig)
    )
    assert image[MIDDLE].mean() == pytest.approx(fresnel(angle), rel=0.03)


@pytest.mark.parametrize("uniform", [True, False])
@pytest.mark.parametrize("absorbs", [(3.0, 1.3, 0.3), (0.3, 4.0, 1.7)])
def test_light_is_weakened_on_its_way(pool, absorbs, uniform):
    """From a white ground, seen 40 degrees from above; as one color, and from the grid of
    colors."""
    medium = clear(pool, absorbs)._replace(uniform=uniform)
    stage = studio_scenes.stage_of(medium, studio_scenes.oblique(40, SURFACE))
    plane = studio_scenes.plain(studio_ground.TILES, stage.pyramid, stage.rig)
    plane.light[:] = 1.0
    image = studio_scenes.draw(stage._replace(plane=plane))
    way = DEEP / np.cos(inner(40))
    expected = (1 - fresnel(40)) * np.exp(-np.array(absorbs) * way)
    np.testing.assert_allclose(image[MIDDLE].mean(axis=(0, 1)), expected, rtol=0.03)


def passes_up(stage, angle):
    """Share that leaves of a ray that goes up inside of the pool, so many degrees off upright."""
    a = np.radians(angle)
    q, t = np.array([0.3, 0.25, 0.12]), np.array([0.0, np.sin(a), np.cos(a)])
    depth, work, out = np.zeros(3), np.empty(72), np.empty(3)
    liquid_radiance._through(stage, q, t, 0.0, depth, work, out)
    return out[0]


def test_total_reflection_begins_at_its_angle(pool):
    """From inside: above asin(1 / n) light comes from the dark ground, else from the bright sky."""
    stage = studio_scenes.stage_of(pool, studio_scenes.oblique(0, SURFACE))
    plane = studio_scenes.plain(studio_ground.TILES, stage.pyramid, stage.rig, backdrop=(1, 1, 1))
    plane.light[:] = 0.0
    stage = stage._replace(plane=plane)
    critical = np.degrees(np.arcsin(1 / INDEX))
    for angle in (0, 20, 40, critical - 0.5):
        assert passes_up(stage, angle) > 0.5, angle
    for angle in (critical + 0.5, 55, 60):
        assert passes_up(stage, angle) == 0.0, angle


SLAB = studio_scenes.grid_points((60, 10, 40), H, (0.0, 0.2, 0.0))  # 0.1 m thick
FACE = np.array([0.3, 0.2, 0.2])


def through_slab(index, away, angle=40):
    """Where a mark `away` [m] behind the slab's middle is seen [pixels], and the camera."""
    a = np.radians(angle)
    walls = (0.0, 0.2, 0.0, 0.6, 0.3, 0.4)
    slab = studio_scenes.water(SLAB, H, walls, index=index)
    ray = np.array([np.sin(a), np.cos(a), 0.0])
    camera = studio_scenes.look_at(FACE - 6.0 * ray, FACE, (0, 0, 1), 3, 160, 160)
    mark = FACE + ray * (0.1 + away) / np.cos(a)
    wall = studio_scenes.grid_points((80, 5, 20), 0.02, (0.0, mark[1], 0.0))
    shadows = studio_scenes.pyramid(wall, 0.02**3, high=(2, 2, 1), cells=60)
    stage = studio_scenes.stage_of(slab, camera, shadows=shadows)
    view = stage.buffers
    view.depth[:], at = studio_scenes.wall_at(view, 1, mark[1])
    view.light[:] = spot(at, mark, 0.05)
    return centre(studio_scenes.draw(stage, covered=True)), camera, view.lens[0]


@pytest.mark.parametrize("away", [0.1, 0.5])
def test_a_slab_shifts_rays_and_leaves_them_parallel(away):
    """Seen through its wall and that behind: the shift does not grow with the distance behind."""
    (with_it, camera, focal), (without, *_) = (through_slab(n, away) for n in (INDEX, 1.0))
    a, b = np.radians(40), inner(40)
    lateral = 0.1 * np.sin(a - b) / np.cos(b)
    far = 6.0 + (0.1 + away) / np.cos(a)
    assert abs(with_it[1] - without[1]) < 0.1
    shift = abs(with_it[0] - without[0]) * far / focal
    assert shift == pytest.approx(lateral, rel=0.03)


def test_two_slabs_take_twice_and_mirror_at_four_surfaces():
    absorbs = np.array([2.0, 5.0, 0.5])
    camera = studio_scenes.look_at((0.3, -2, 0.2), FACE, (0, 0, 1), 3, 40, 40)
    two = np.concatenate([SLAB, SLAB + [0.0, 0.2, 0.0]])
    for x, count in ((SLAB, 1), (two, 2)):
        medium = studio_scenes.water(x, H, (0, 0, 0, 0.6, 1, 0.4), absorbs=absorbs)
        stage = studio_scenes.stage_of(medium, camera)
        plane = studio_scenes.plain(
            studio_ground.NONE, stage.pyramid, stage.rig, backdrop=(1, 1, 1)
        )
        image = studio_scenes.draw(stage._replace(plane=plane))[15:25, 15:25].mean(axis=(0, 1))
        expected = (1 - fresnel(0)) ** (2 * count) * np.exp(-absorbs * 0.1 * count)
        np.testing.assert_allclose(image, expected, rtol=0.03)


@pytest.mark.parametrize("elevation", [90, 45, 30])
def test_shadows_have_the_color_of_the_liquid(pool, elevation):
    """The key on the ground after its slanted way through the pool."""
    absorbs, e = np.array([3.0, 1.0, 0.2]), np.radians(elevation)
    rig = studio_scenes.dark_rig((np.cos(e), 0.0, -np.sin(e)), key=(0.9, 0.8, 0.7))
    stage = studio_scenes.stage_of(clear(pool, absorbs), studio_scenes.oblique(0, SURFACE), rig)
    stage = stage._replace(plane=studio_scenes.plain(studio_ground.TILES, stage.pyramid, rig))
    deferred_shading.tint_ground(stage)
    plane = stage.plane
    column, row = ((np.array([0.4, 0.3]) - plane.lower) / plane.texel).astype(int)
    expected = rig.key * np.sin(e) * np.exp(-absorbs * DEEP / np.sin(e))
    np.testing.assert_allclose(plane.light[row, column], expected, rtol=0.03)
    np.testing.assert_allclose(plane.light[0, 0], rig.key * np.sin(e), rtol=1e-5)


@pytest.mark.parametrize("scatters", [0.0, 6.0])
def test_beside_a_pool_half_of_the_key_is_missing(pool, scatters):
    """Light that would leave through a side is totally reflected there: the model takes a half of
    it, besides what is absorbed and what is scattered on its straight way."""
    absorbs, e = np.array([3.0, 1.0, 0.2]), np.radians(45)
    medium = clear(pool, absorbs)
    medium.mean[7] = scatters
    medium.tint.values[..., 7] = scatters
    rig = studio_scenes.dark_rig((np.cos(e), 0.0, -np.sin(e)), key=(0.9, 0.8, 0.7))
    stage = studio_scenes.stage_of(medium, studio_scenes.oblique(0, SURFACE), rig)
    stage = stage._replace(plane=studio_scenes.plain(studio_ground.TILES, stage.pyramid, rig))
    deferred_shading.tint_ground(stage)
    plane, gap = stage.plane, 0.03
    column, row = ((np.array([0.6 + gap, 0.3]) - plane.lower) / plane.texel).astype(int)
    gap = plane.lower[0] + (column + 0.5) * plane.texel - 0.6
    way = (DEEP - gap) / np.sin(e)
    expected = 0.5 * rig.key * np.sin(e) * np.exp(-(absorbs + scatters) * way)
    np.testing.assert_allclose(plane.light[row, column], expected, rtol=0.03)

"""Selecting, filling and weighing captures."""

import numpy as np
import pytest
from scipy import ndimage

from tests.support.small_scenes import scene
from vgmpi.gaussians.cloud import GaussianCloud
from vgmpi.gaussians.formats import ply
from vgmpi.gaussians.spherical_harmonics import dc_from_rgb
from vgmpi.preprocess.capture_selection import crop
from vgmpi.preprocess.meshes.surface_mesh import quaternion_to_normal
from vgmpi.preprocess.sampling import interior_fill
from vgmpi.preprocess.sampling.voxels import (
    Voxels,
    covered_voxels,
    fraction_by_neighbours,
    fraction_by_supersampling,
    volumes,
)
from vgmpi.preprocess.scene_builder import build_scene
from vgmpi.scene.captures import Select

MIDDLE = np.array([0.313, 0.271, 0.226])


def shell(radius=0.1, count=20_000, middle=MIDDLE):
    """Flat Gaussians on a sphere, red above and blue below."""
    k = np.arange(count) + 0.5
    z, angle = 1 - 2 * k / count, k * np.pi * (3 - np.sqrt(5))
    r = np.sqrt(1 - z * z)
    unit = np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)
    disc = 0.6 * np.sqrt(4 * np.pi * radius**2 / count)
    rgb = np.where(unit[:, 2:] > 0, (0.9, 0.1, 0.1), (0.1, 0.1, 0.9))
    return GaussianCloud(
        middle + radius * unit,
        quaternion_to_normal(unit),
        np.tile([disc, disc, 0.1 * disc], (len(unit), 1)),
        np.full(len(unit), 0.95),
        dc_from_rgb(rgb)[:, None, :].astype(np.float32),
    )


def ring(count=20_000, radius=0.065, tube=0.035, middle=MIDDLE):
    """Flat Gaussians spread evenly on a torus about the z axis."""
    area = 4 * np.pi**2 * radius * tube
    apart = np.sqrt(area / count)
    turns = 2 * np.pi * (np.arange(round(2 * np.pi * tube / apart)) + 0.5)
    angles = turns / len(turns)
    x, unit = [], []
    for angle in angles:
        r = radius + tube * np.cos(angle)
        around = 2 * np.pi * np.arange(round(2 * np.pi * r / apart))
        around /= len(around)
        out = np.stack([np.cos(around), np.sin(around), 0 * around], axis=1)
        unit.append(np.cos(angle) * out + [0, 0, np.sin(angle)])
        x.append(radius * out + tube * unit[-1])
    x, unit = np.concatenate(x), np.concatenate(unit)
    disc, n = 0.6 * apart, len(x)
    return GaussianCloud(
        middle + x,
        quaternion_to_normal(unit),
        np.tile([disc, disc, 0.1 * disc], (n, 1)),
        np.full(n, 0.95),
        np.zeros((n, 1, 3)),
    )


def in_ball(x):
    return np.linalg.norm(x - MIDDLE, axis=1) < 0.1


def in_ring(x):
    x = x - MIDDLE
    return np.hypot(np.hypot(x[:, 0], x[:, 1]) - 0.065, x[:, 2]) < 0.035


def cap(cloud, direction, share=0.08):
    """A ball's shell without the cap of a share of its surface, which looks along `direction`."""
    unit = (cloud.x - MIDDLE) / 0.1
    return cloud.select(unit @ np.divide(direction, np.linalg.norm(direction)) < 1 - 2 * share)


def agreement(cloud, whole, solid, h, mode=True):
    """Intersection over union of filled and true inner voxels of edge h [m].

    True are those whose middle is inside and through which no surface runs. solid: tells which
    points are inside; whole: the cloud without its holes.
    """
    inner = interior_fill.interior(cloud, h, mode).interior_points
    voxels = Voxels.enclosing(whole.x, h, margin=4)
    surface = covered_voxels(whole, voxels).ravel()
    surface[voxels.index(whole.x)] = True
    truth = solid(voxels.centers(np.ones(voxels.shape, bool))) & ~surface
    found = np.zeros(len(truth), bool)
    found[voxels.index(inner)] = True
    found &= ~surface
    iou = (found & truth).sum() / (found | truth).sum()
    print(f"{0.2 / h:.0f} voxels across, {truth.sum()} inside: IoU {iou:.4f}")
    return iou


ACROSS = [18, 24, 32, 36, 48]


@pytest.mark.parametrize("across", ACROSS)
@pytest.mark.parametrize("mode", [True, "closed"])
def test_closed_shells_are_filled(across, mode):
    assert agreement(shell(), shell(), in_ball, 0.2 / across, mode) >= 0.95
    assert agreement(ring(), ring(), in_ring, 0.2 / across, mode) >= 0.95


@pytest.mark.parametrize("across", ACROSS)
@pytest.mark.parametrize("direction", [(0, 0, 1), (1, 1, 1), (5, 2, 1)])
def test_a_leaking_shell_is_filled_by_sight(direction, across):
    """8 % of a ball's surface are missing; a flat lid over them leaves out 1.8 % of its volume."""
    leaking, h = cap(shell(), direction), 0.2 / across
    assert not interior_fill.interior(leaking, h, True).enclosed.any()
    assert agreement(leaking, shell(), in_ball, h, "closed") == 0.0
    assert agreement(leaking, shell(), in_ball, h) >= 0.95


@pytest.mark.parametrize("across", [24, 48])
@pytest.mark.parametrize("where, least", [("outer", 0.9), ("inner", 0.97), ("under", 0.97)])
def test_a_leaking_ring_is_filled_by_sight(where, least, across):
    """The hole in its middle is met all around too, and looks into the tube where that is open."""
    whole = ring()
    x = whole.x - MIDDLE
    out, up = np.hypot(x[:, 0], x[:, 1]) - 0.065, x[:, 2]
    turned, around = np.arctan2(up, out), np.arctan2(x[:, 1], x[:, 0])
    lacking = {
        "outer": (np.abs(turned - 1) < 0.8) & (np.abs(around) < 1),  # a patch of 10 %
        "inner": (np.abs(turned) > np.pi * 5 / 6) & (np.abs(around) < np.pi / 2),
        "under": np.abs(turned + np.pi / 2) < np.pi / 6,
    }[where]
    assert agreement(whole.select(~lacking), whole, in_ring, 0.2 / across) >= least


def test_openness_counts_directions():
    """What a hole lets in, less from below, and a wall that diagonal lines could slip through."""
    box = np.zeros((9, 9, 9), bool)
    box[1:8, 1:8, 1:8] = True
    box[2:7, 2:7, 2:7] = False
    assert interior_fill.visible_fraction(box)[4, 4, 4] == 0
    box[2:7, 2:7, 7] = False
    straight, half = 1 / 21, 1 / 21 + 4 * 4 / 105 + 4 * 9 / 280
    assert interior_fill.visible_fraction(box)[4, 4, 4] == pytest.approx(straight)
    assert interior_fill.visible_fraction(box)[4, 4, 6] == pytest.approx(half)
    assert interior_fill.visible_fraction(box, (0, 0, -1))[4, 4, 6] == pytest.approx(
        interior_fill.FROM_BELOW_WEIGHT * half
    )
    wall = np.zeros((9, 9, 9), bool)
    index = np.indices(wall.shape)
    wall[index.sum(0) == 12] = True  # diagonal lines from (1, 1, 1) pass sums 11 and 13
    seen = 3 * 4 / 105 + 9 / 280 + (1 - interior_fill.FROM_BELOW_WEIGHT) * half
    assert interior_fill.visible_fraction(wall)[1, 1, 1] == pytest.approx(1 - seen)


def test_hollow_stays_hollow():
    inner, enclosed, gaps = interior_fill.interior(shell(), 0.01, False)
    assert len(inner) == len(enclosed) == len(gaps) == 0


@pytest.mark.parametrize("leaks", [False, True])
def test_a_dent_is_not_filled(leaks):
    """A shaft is met all around as the inside is, but from its outer side."""
    solid = np.zeros((20, 20, 20), bool)
    solid[2:18, 2:18, 2:18] = True
    solid[8:12, 8:12, 8:18] = False  # from the top
    surface = solid & ~ndimage.binary_erosion(solid)
    if leaks:
        surface[4:8, 4:8, 2] = False
    h = 0.01
    x = Voxels(np.zeros(3, int), solid.shape, h).centers(surface)
    n = len(x)
    cloud = GaussianCloud(
        x,
        np.tile([1.0, 0, 0, 0], (n, 1)),
        np.full((n, 3), 0.3 * h),
        np.full(n, 0.9),
        np.zeros((n, 1, 3)),
    )
    inner, enclosed, _ = interior_fill.interior(cloud, h, True)
    assert enclosed.all() != leaks
    shaft = (np.abs(inner[:, :2] - 0.1) < 0.02).all(axis=1) & (inner[:, 2] > 0.08)
    assert len(inner) > 1000 and not shaft.any()


def test_coarse_captures_are_closed_by_the_extent_of_their_gaussians():
    coarse, h = shell(count=300), 0.01  # centres 2 cm apart, voxels of 1 cm
    voxels = Voxels.enclosing(coarse.x, h)
    by_centres = np.zeros(np.prod(voxels.shape), bool)
    by_centres[voxels.index(coarse.x)] = True
    surface = covered_voxels(coarse, voxels)
    assert surface.sum() > 2 * by_centres.sum()
    inner, enclosed, gaps = interior_fill.interior(coarse, h, "closed")
    assert enclosed.all()
    assert len(inner) > 2000 and len(gaps) > 300
    away = np.linalg.norm(gaps - MIDDLE, axis=1)
    assert away.min() > 0.075 and away.max() < 0.125
    taken = set(voxels.index(coarse.x)) & set(voxels.index(np.concatenate([inner, gaps])))
    assert not taken


CAPTURE_ON_THE_FLOOR = """
[domain]
size = [0.4, 0.4, 0.4]
cell = 0.02
[time]
end = 0.1
[material.rubber]
kind = "elastic"
density = 1000
youngs_modulus = 1e5
poisson_ratio = 0.3
[[object]]
name = "ball"
material = "rubber"
gaussians = "ball.ply"
origin = [0.2, 0.2, 0.101]
"""


def test_the_fill_of_a_coarse_capture_ends_at_the_walls(tmp_path):
    """The Gaussians lie in the domain, but they are so wide that their voxels reach through it."""
    ply.write(tmp_path / "ball.ply", shell(count=300, middle=np.zeros(3)))
    whole = interior_fill.interior(shell(count=300, middle=np.array([0.2, 0.2, 0.101])), 0.01, True)
    assert whole.gap_points[:, 2].min() < 0
    made = build_scene(scene(tmp_path, CAPTURE_ON_THE_FLOOR))
    assert len(made.x) > 300 + 0.8 * len(np.concatenate([whole.gap_points, whole.interior_points]))
    assert made.x[:, 2].min() >= 0


def test_faint_gaussians_are_no_surface():
    faint = shell()
    faint = GaussianCloud(faint.x, faint.quat, faint.scale, faint.opacity * 1e-4, faint.sh)
    assert len(interior_fill.interior(faint, 0.01, True).interior_points) == 0


def test_a_stray_gaussian_far_away_is_told():
    stray = shell()
    x = stray.x.copy()
    x[0] = (1e3, 1e3, 1e3)
    with pytest.raises(
        interior_fill.VoxelGridTooLargeError,
        match="remove outliers with select, or set fill = false",
    ):
        interior_fill.interior(
            GaussianCloud(x, stray.quat, stray.scale, stray.opacity, stray.sh), 0.01, True
        )


def test_filled_gaussians_take_the_color_of_the_nearest_surface():
    cloud = shell()
    inner = interior_fill.interior(cloud, 0.01, True).interior_points
    inside = interior_fill.filling(inner, cloud, 0.01, 0.8)
    top = inner[:, 2] > MIDDLE[2] + 0.015
    assert np.allclose(inside.rgb[top], (0.9, 0.1, 0.1), atol=1e-5)
    assert np.allclose(inside.rgb[inner[:, 2] < MIDDLE[2] - 0.015], (0.1, 0.1, 0.9), atol=1e-5)
    assert np.all(inside.opacity == 0.8)
    both = interior_fill.joined(cloud, inside)
    assert len(both) == len(cloud) + len(inner)
    assert np.array_equal(both.x[: len(cloud)], cloud.x)


@pytest.mark.parametrize("h, tolerance", [(0.02, 0.06), (0.01, 0.03), (0.005, 0.01)])
def test_volume_of_a_solid_is_that_of_its_form(h, tolerance):
    cloud = shell()
    inner, _, gaps = interior_fill.interior(cloud, h, True)
    outer = np.concatenate([cloud.x, gaps])
    voxels = Voxels.enclosing(outer, h)
    both = np.concatenate([outer, inner])
    found = volumes(voxels, both, fraction_by_neighbours(voxels, outer, inner))
    assert found.sum() == pytest.approx(4 / 3 * np.pi * 0.1**3, rel=tolerance)
    assert found.min() > 0 and len(found) == len(outer) + len(inner)
    assert np.allclose(found[len(outer) :], h**3)


def test_volume_of_a_hollow_body_is_that_of_its_voxels():
    cloud, h = shell(), 0.01
    voxels = Voxels.enclosing(cloud.x, h)
    found = volumes(voxels, cloud.x, np.ones(voxels.shape))
    occupied = np.unique(voxels.index(cloud.x))
    assert found.sum() == pytest.approx(len(occupied) * h**3, rel=1e-12)
    one = voxels.index(cloud.x) == occupied[5]
    assert np.allclose(found[one], h**3 / one.sum())


def test_share_by_neighbours_at_walls_corners_and_in_sheets():
    solid = np.zeros((9, 9, 9), bool)
    solid[2:7, 2:7, 2:7] = True
    inner = ndimage.binary_erosion(solid)
    voxels = Voxels(np.zeros(3, int), solid.shape, 0.01)
    shell = voxels.centers(solid & ~inner)
    share = fraction_by_neighbours(voxels, shell, voxels.centers(inner))
    assert share[4, 4, 4] == 1 and share[4, 4, 1] == 0
    assert share[4, 4, 2] == 9 / 18  # a wall
    assert share[2, 2, 2] == 1 / 20  # a corner sees one inner voxel and 19 outside
    sheet = np.zeros((9, 9, 9), bool)
    sheet[2:7, 2:7, 4] = True
    alone = fraction_by_neighbours(voxels, voxels.centers(sheet), np.empty((0, 3)))
    assert np.array_equal(alone, 0.5 * sheet)


def test_share_by_count_is_exact_for_what_it_counts():
    voxels = Voxels(np.array([1, 1, 1]), (2, 2, 2), 0.3)
    fine = np.array([[0.35, 0.35, 0.35], [0.45, 0.35, 0.35], [0.65, 0.8, 0.8], [9.0, 9.0, 9.0]])
    share = fraction_by_supersampling(voxels, [fine[:1], fine[1:]], 3)
    assert share[0, 0, 0] == 2 / 27 and share[1, 1, 1] == 1 / 27 and share.sum() == 3 / 27


def test_select():
    cloud = shell()
    opacity = np.where(np.arange(len(cloud)) % 2, 0.9, 0.05)
    x = cloud.x.copy()
    x[7] = MIDDLE + 0.5
    cloud = GaussianCloud(x, cloud.quat, cloud.scale, opacity, cloud.sh)
    assert crop(cloud, None) is cloud
    assert len(crop(cloud, Select(min_opacity=0.1))) == len(cloud) // 2
    half = crop(cloud, Select(box=[[-1, -1, MIDDLE[2]], [1, 1, 1]]))
    assert len(half) == pytest.approx(len(cloud) / 2, abs=3) and half.x[:, 2].min() >= MIDDLE[2]
    ball = crop(cloud, Select(sphere={"center": list(MIDDLE), "radius": "20 cm"}))
    assert len(ball) == len(cloud) - 1
    calm = crop(cloud, Select(outlier_sigma=4))
    assert len(calm) < len(cloud) and not (calm.x == x[7]).all(axis=1).any()
    assert len(calm) > 0.99 * len(cloud)

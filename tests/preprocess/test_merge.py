"""How the kept particles of a thinned body stand in for the others: on a ball of two colors."""

from dataclasses import replace

import numpy as np
import pytest

from tests.preprocess.test_interior_fill import MIDDLE, shell
from vgmpi.gaussians.cloud import GaussianCloud, quaternion_product
from vgmpi.preprocess.meshes.surface_mesh import quaternion_to_normal
from vgmpi.preprocess.pruning import image_similarity, prune
from vgmpi.preprocess.sampling import interior_fill

RADIUS = 0.1
SPACING = 0.01


@pytest.fixture(scope="module")
def ball():
    """(cloud, volume, skin) of 20,000 discs, red above, blue below, around lattice points."""
    surface = shell()
    over = quaternion_product(surface.quat, np.array([0.0, 1, 0, 0]))
    quat = np.where(np.arange(len(over))[:, None] % 2, over, surface.quat)  # half upside down
    surface = replace(surface, quat=quat, scale=surface.scale * 0.85 / 0.6)  # over spacing
    side = np.arange(-RADIUS, RADIUS, SPACING) + SPACING / 2
    inner = MIDDLE + np.stack(np.meshgrid(side, side, side), axis=-1).reshape(-1, 3)
    inner = inner[np.linalg.norm(inner - MIDDLE, axis=1) < RADIUS - SPACING]
    cloud = interior_fill.joined(surface, interior_fill.filling(inner, surface, SPACING, 1.0))
    return cloud, np.ones(len(cloud)), np.arange(len(cloud)) < len(surface)


def thinned(ball, scale=0.073):
    cloud, volume, skin = ball
    return prune.prune_versagauss(cloud, volume, skin, scale, False, False)


def height(x):
    """Of points (n, 3) above the edge of the colors, over the radius."""
    return np.abs(x[:, 2] - MIDDLE[2]) / RADIUS


def test_most_stay_where_colors_change(ball):
    cloud, _, skin = ball
    kept = thinned(ball).retained
    there = height(cloud.x) < 0.02
    part = [kept[skin & rows].mean() for rows in (there, ~there)]
    assert part[0] > 3 * part[1] and part[1] > 0.05
    assert kept[skin].sum() == pytest.approx(0.073 ** (2 / 3) * skin.sum(), abs=2)
    plain = replace(cloud, sh=np.zeros_like(cloud.sh))
    even = prune.importance(plain, skin)[skin]
    assert np.ptp(even) < 0.02 * even.mean()  # a ball bends the same everywhere


def test_detail_is_where_direction_changes_and_axes_have_no_sign(ball):
    """Two planes that meet at a right angle, every other disc upside down."""
    i, j = (a.ravel() for a in np.meshgrid(np.arange(60), np.arange(60)))
    flat = np.stack([i, j, np.zeros(3600)], axis=1) + 0.5
    upright, turned = np.array([1.0, 0, 0, 0]), np.array([np.sqrt(0.5), 0, np.sqrt(0.5), 0])
    over = np.array([0.0, 1, 0, 0])  # the same disc, its thin axis down
    quat = np.where((i % 2)[:, None], over, upright)
    scale = np.tile([0.8, 0.8, 0.08], (3600, 1))
    x = np.concatenate([flat, flat[:, [2, 1, 0]]])
    quat = np.concatenate([quat, np.tile(turned, (3600, 1))])
    both = GaussianCloud(x, quat, np.tile(scale, (2, 1)), np.ones(7200), np.zeros((7200, 1, 3)))
    found = prune.detail(both)
    away = np.maximum(x[:, 0], x[:, 2])  # from where they meet
    assert found[away < 1.5].min() > 10 * found[away > 5].max()


def test_a_surface_of_one_color_and_direction_has_no_detail():
    x = np.random.default_rng(0).random((500, 3)) * (1, 1, 0)
    quat = np.tile([0.5, 0.5, 0.5, 0.5], (500, 1))
    plain = GaussianCloud(x, quat, np.tile([1e-2, 1e-2, 1e-3], (500, 1)), np.ones(500),
                  np.full((500, 1, 3), 0.3))  # fmt: skip
    assert np.allclose(prune.detail(plain), 1, rtol=1e-9)
    assert len(prune.detail(plain.select([0]))) == 1


def test_the_outline_stays_where_it_is(ball):
    cloud, _, _ = ball
    views = image_similarity.cameras(cloud.x, 140)
    covered = [
        sum(float((through < 0.5).sum()) for _, through in image_similarity.render_views(c, views))
        for c in (cloud, thinned(ball).cloud)
    ]
    print(covered, covered[1] / covered[0] - 1)
    assert covered[1] == pytest.approx(covered[0], rel=0.004)


def test_the_surface_moves_out_by_a_part_of_what_it_grows(ball):
    cloud, _, skin = ball
    found = thinned(ball)
    before, on = cloud.select(found.retained & skin), skin[found.retained]
    after = found.cloud.select(on)
    away = np.linalg.norm(after.x - MIDDLE, axis=1) - RADIUS
    plain = height(after.x) > 0.1  # far from the edge all stand for about as many
    grown = (after.scale - before.scale)[plain, 0]
    assert np.median(away[plain] / grown) == pytest.approx(prune.OUTWARD_SHIFT, rel=0.2)
    assert np.percentile(away[plain], 1) > 0 and away.max() < grown.max()


def test_a_body_reaches_no_further_than_before(ball):
    """What lies against the edge of the domain stays within."""
    cloud, x = ball[0], thinned(ball).cloud.x
    assert np.all(x.min(axis=0) >= cloud.x.min(axis=0))
    assert np.all(x.max(axis=0) <= cloud.x.max(axis=0))


def test_discs_that_stand_upright_do_not_move_out(ball):
    """Their thin axes do not tell where outside is."""
    cloud, volume, skin = ball
    unit = cloud.x[skin] - MIDDLE
    side = np.cross(unit, [0.3, 0.5, 0.8])
    quat = cloud.quat.copy()
    quat[skin] = quaternion_to_normal(side / np.linalg.norm(side, axis=1, keepdims=True))
    found = prune.prune_versagauss(replace(cloud, quat=quat), volume, skin, 0.073, False, False)
    on = skin[found.retained]
    away = np.linalg.norm(found.cloud.x[on] - MIDDLE, axis=1) - RADIUS
    grown = (found.cloud.scale[on] - cloud.scale[found.retained & skin])[:, 0]
    alone = found.cloud.scale[on, 0] == cloud.scale[found.retained & skin, 0]
    assert (~alone).sum() > 1000 and np.median(away[~alone] / grown[~alone]) < 0.02


def test_a_hollow_body_has_no_outside():
    """Without particles inside, nothing tells which way to go: middles stay middles."""
    cloud = shell()
    found = prune.prune_versagauss(
        cloud, np.ones(len(cloud)), np.ones(len(cloud), bool), 0.5, False, False
    )
    assert np.linalg.norm(found.cloud.x - MIDDLE, axis=1).max() <= RADIUS * (1 + 1e-12)


def test_a_thin_cover_stays_as_thick_as_it_is(ball):
    """Discs of 0.5 of their spacing cover 1.5 times: what is left keeps that, it has no more."""
    cloud, volume, skin = ball
    layers = []
    for width in (0.5, 0.85, 1.2):
        scale = np.where(skin[:, None], cloud.scale * width / 0.85, cloud.scale)
        found = prune.prune_versagauss(
            replace(cloud, scale=scale), volume, skin, 0.073, False, False
        )
        after = found.cloud.select(skin[found.retained])
        area = 4 * np.pi * RADIUS**2
        layers.append(2 * np.pi * prune.visual_weight(after).sum() / area)
    assert layers[0] == pytest.approx(2 * np.pi * 0.95 * 0.5**2, rel=0.1)
    less = (0.073 ** (2 / 3)) ** (1 - 2 * prune.WIDTH_EXPONENT)  # where there is plenty
    for width, found in zip((0.85, 1.2), layers[1:]):
        assert found == pytest.approx(2 * np.pi * 0.95 * width**2 * less, rel=0.1)


def test_what_is_inside_stays_below_the_surface(ball):
    cloud, _, skin = ball
    found = thinned(ball)
    within = ~skin[found.retained]
    depth = RADIUS - np.linalg.norm(found.cloud.x[within] - MIDDLE, axis=1)
    width, before = found.cloud.scale[within, 0], cloud.scale[found.retained & ~skin, 0]
    assert np.all(width <= np.maximum(before, 1.01 * prune.INTERIOR_WIDTH_RATIO * depth) + 1e-12)
    assert np.all(width >= before) and width.max() > 2 * before.max()  # in the middle it is filled


def test_what_is_kept_whole_is_left_alone(ball):
    cloud, _, skin = ball
    every = np.ones(len(cloud), dtype=bool)
    same = prune.merged(cloud, np.ones(len(cloud)), np.arange(len(cloud)), every, skin)
    for name in ("x", "quat", "opacity", "sh"):
        assert np.allclose(getattr(same, name), getattr(cloud, name), rtol=1e-12)
    assert np.allclose(same.scale, cloud.scale, rtol=1e-12)


WITHOUT = {
    "detail": (prune, "_DETAIL_WEIGHT", 0.0),
    "the shift of the surface": (prune, "OUTWARD_SHIFT", 0.0),
    "hiding the inside": (prune, "INTERIOR_WIDTH_RATIO", np.inf),
    "more than the cube root": (prune, "WIDTH_EXPONENT", 1 / 3),
}


def test_a_sixth_of_a_surface_looks_the_same_and_every_part_counts(ball, monkeypatch):
    cloud, _, _ = ball
    views = image_similarity.cameras(cloud.x, 140)
    wanted = image_similarity.render_views(cloud, views)

    def decibels(without):
        found = image_similarity.image_psnr(
            wanted, image_similarity.render_views(thinned(ball).cloud, views)
        )
        print(f"without {without}: inside {found.inside:.1f} dB, whole {found.full:.1f} dB")
        return found.inside

    best = decibels("any loss")
    assert best > 42
    for what, (module, name, value) in WITHOUT.items():
        with monkeypatch.context() as patch:
            patch.setattr(module, name, value)
            assert decibels(what) < best - 0.5, what

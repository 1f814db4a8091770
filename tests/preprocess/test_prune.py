"""Pruning: shares, who is kept, what they take over, and how it looks."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.preprocess.test_interior_fill import MIDDLE, shell
from tests.support.small_scenes import scene
from vgmpi.gaussians.cloud import GaussianCloud
from vgmpi.gaussians.spherical_harmonics import dc_from_rgb
from vgmpi.preprocess.object_builder import build_object
from vgmpi.preprocess.pruning import image_similarity, prune
from vgmpi.runtime.config.schema import SceneError

SHARED = Path(__file__).resolve().parents[3] / "shared" / "data"
GUITAR = SHARED / "guitar.compressed.ply"

SCENE = """
allow_outside = true
[accuracy]
precision = "double"
[domain]
size = [0.64, 0.64, 0.64]
cell = 0.02
[time]
end = 1
[material.rubber]
kind = "elastic"
density = 400
youngs_modulus = 1e5
[[object]]
name = "duck"
material = "rubber"
SOURCE
position = [0.32, 0.32, 0.2]
"""


def duck_obj(rings=48):
    """Text of a mesh with colored points: a lumpy body, a head and a tail; 0.2 long."""
    lines, faces, first = [], [], 1
    parts = [((0, 0, 0.06), (0.1, 0.065, 0.06)), ((0.07, 0, 0.14), (0.045, 0.045, 0.045))]
    parts += [((0.13, 0, 0.135), (0.03, 0.02, 0.01)), ((-0.1, 0, 0.09), (0.03, 0.03, 0.015))]
    colors = [(0.95, 0.8, 0.1), (0.95, 0.75, 0.1), (0.9, 0.35, 0.1), (0.8, 0.6, 0.1)]
    for (center, radii), color in zip(parts, colors, strict=True):
        for i in range(rings + 1):
            for j in range(rings):
                a, b = np.pi * i / rings, 2 * np.pi * j / rings
                u = np.array([np.sin(a) * np.cos(b), np.sin(a) * np.sin(b), np.cos(a)])
                shade = np.clip(color + 0.12 * np.sin(9 * a) * np.cos(7 * b), 0, 1)
                words = [*(center + radii * u), *shade]
                lines.append("v " + " ".join(f"{v:.6f}" for v in words))
        for i in range(rings):
            for j in range(rings):
                k, n = first + i * rings, (j + 1) % rings
                faces.append(f"f {k + j} {k + rings + j} {k + rings + n} {k + n}")
        first += (rings + 1) * rings
    return "\n".join(lines + faces) + "\n"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("prune")
    (path / "duck.obj").write_text(duck_obj())
    return path


def made(folder, keys='mesh = "duck.obj"'):
    return build_object(scene(folder, SCENE.replace("SOURCE", keys)), 0)


@pytest.fixture(scope="module")
def duck(folder):
    return made(folder)


def by_chance(piece, share, skin, seed):
    """Both: each particle is kept by chance and drawn as large as prune does; the same, merged."""
    kept = np.random.default_rng(seed).random(len(share)) < share
    left = piece.cloud.select(kept)
    wider = replace(left, scale=left.scale * (share[kept] ** (-1 / 3))[:, None])
    heir = prune.merge_targets(piece.cloud.x, kept, skin)
    return wider, prune.merged(piece.cloud, share, heir, kept, skin)


def test_the_printed_ratios():
    assert prune.printed_keep_fractions(0.5) == (pytest.approx(0.5 ** (2 / 3)), 0.5)
    assert prune.printed_keep_fractions(0.6) == (pytest.approx(0.6 ** (1 / 3)), 0.6)
    assert prune.printed_keep_fractions(0.7)[0] == pytest.approx(0.7 ** (1 / 3))
    assert prune.printed_keep_fractions(0.71) == (1.0, 1.0)
    assert prune.printed_keep_fractions(0.3**3) == (pytest.approx(0.09), pytest.approx(0.027))


def test_shares_add_up_in_every_group():
    random = np.random.default_rng(1)
    group = random.integers(0, 5, 4000)
    count = np.bincount(group)
    wanted = np.array([0.3, 0.9, 1.0, 0.001, 0.6]) * count
    share = prune.keep_probabilities(wanted, group, random.lognormal(0, 1, 4000))
    assert np.allclose(np.bincount(group, share), wanted, rtol=1e-12)
    assert share.max() <= 1.0 and share.min() > 0 and (share[group == 2] == 1.0).all()
    heavy = prune.keep_probabilities(
        np.array([2.0]), np.zeros(4, int), np.array([1.0, 1.0, 1.0, 5.0])
    )
    assert np.allclose(heavy, [1 / 3, 1 / 3, 1 / 3, 1.0])  # none counts more than once


def test_every_third_of_the_curve_is_kept():
    x = shell().x
    skin = np.arange(len(x)) < 12_000
    kept = prune.stratified_mask(x, np.full(len(x), 1 / 3), skin)
    for rows in (skin, ~skin):
        along = np.flatnonzero(kept[rows][np.argsort(prune.morton(x)[rows], kind="stable")])
        assert np.all(np.abs(np.diff(along) - 3) <= 1)  # a third is rounded
        assert abs(kept[rows].sum() - rows.sum() / 3) < 1
    share = np.where(x[:, 2] > MIDDLE[2], 1.0, 0.25)
    kept = prune.stratified_mask(x, share, skin)
    assert kept[share == 1].all()
    assert kept[share < 1].sum() == pytest.approx((share < 1).sum() / 4, abs=2)


def test_morton_halves_the_cube_by_turns():
    corners = np.array([[i, j, k] for k in (0, 1) for j in (0, 1) for i in (0, 1)], float)
    assert np.array_equal(np.argsort(prune.morton(corners)), np.arange(8))
    x = np.random.default_rng(2).random((5000, 3))
    order = np.argsort(prune.morton(x))
    steps = np.linalg.norm(np.diff(x[order], axis=0), axis=1)
    assert np.median(steps) < 2 * 5000 ** (-1 / 3)  # neighbours on the curve are neighbours


@pytest.mark.parametrize(
    "keys",
    [
        'prune = "auto"',
        'prune = "versagauss"\nprune_scale = 0.4',
        'prune = "auto"\npassive_gaussians = true',
    ],
)
def test_mass_is_that_of_the_object(folder, duck, keys):
    thin = made(folder, f'mesh = "duck.obj"\n{keys}')
    total = duck.volume.sum()
    assert 100 < len(thin.cloud) < 0.7 * len(duck.cloud)
    assert abs(thin.volume.sum() / total - 1) < 1e-12
    assert thin.volume.min() > 0 and len(thin.volume) == len(thin.cloud)
    middle, before = (p.cloud.x.T @ p.volume / total for p in (thin, duck))
    assert np.abs(middle - before).max() < 0.02 * 0.2  # and where it was


def test_mass_after_filling_is_that_of_its_voxels(duck):
    """Densities times volumes: the particles share what is inside of each voxel."""
    ellipsoids = 4 / 3 * np.pi * np.array([0.1 * 0.065 * 0.06, 0.045**3])
    assert duck.volume.sum() == pytest.approx(ellipsoids.sum(), rel=0.1)
    assert abs(duck.volume.sum() / np.sort(duck.volume).sum() - 1) < 1e-12


def test_auto_leaves_eight_per_cell(folder, duck):
    thin = made(folder, 'mesh = "duck.obj"\nprune = "auto"\npassive_gaussians = true')
    cell, count = np.unique(np.floor(duck.cloud.x / 0.02).astype(int), axis=0, return_counts=True)
    left, after = np.unique(np.floor(thin.cloud.x / 0.02).astype(int), axis=0, return_counts=True)
    before = {tuple(c): n for c, n in zip(cell, count)}
    few = [n for c, n in zip(left, after) if before[tuple(c)] > 8 and n < 4]
    assert len(left) > 0.97 * len(cell) and len(few) < 0.03 * len(left)
    assert thin.volume.sum() == pytest.approx(duck.volume.sum(), rel=1e-12)
    assert len(thin.cloud) == pytest.approx(np.minimum(count, 8).sum(), rel=0.01)


def test_auto_stops_at_forty_decibels(folder, duck):
    thin = made(folder, 'mesh = "duck.obj"\nprune = "auto"')
    line = thin.summary
    assert f"{len(duck.cloud):,} -> {len(thin.cloud):,} particles" in line
    views = image_similarity.cameras(duck.cloud.x)
    wanted = image_similarity.render_views(duck.cloud, views)
    found = image_similarity.image_psnr(
        wanted, image_similarity.render_views(thin.cloud, views)
    ).inside
    assert f"{found:.1f} dB inside its outline" in line
    assert 40 <= found < 42  # and no more particles than that takes


def test_twice_the_same(folder):
    one, two = (made(folder, 'mesh = "duck.obj"\nprune = "auto"') for _ in range(2))
    assert np.array_equal(one.cloud.x, two.cloud.x) and np.array_equal(one.volume, two.volume)


def compare(piece, scale, pixels):
    """Decibels inside the outline of 12 views: pruned as the paper says; the same by chance."""
    skin = np.arange(len(piece.cloud)) < piece.surface_count
    views = image_similarity.cameras(piece.cloud.x, pixels)
    wanted = image_similarity.render_views(piece.cloud, views)

    def seen(cloud):
        return image_similarity.image_psnr(wanted, image_similarity.render_views(cloud, views))

    thin = prune.prune_versagauss(piece.cloud, piece.volume, skin, scale, False, False)
    surface, interior = prune.printed_keep_fractions(scale)
    share = np.where(skin, surface, interior)
    chance = [[seen(c).inside for c in by_chance(piece, share, skin, seed)] for seed in range(3)]
    alone, joined = np.max(chance, axis=0)
    own = seen(thin.cloud)
    print(
        f"s' = {scale}: {len(piece.cloud)} -> {len(thin.cloud)}, inside {own.inside:.2f} dB, "
        f"whole {own.full:.2f} dB, by chance {alone:.2f} dB, merged {joined:.2f} dB"
    )
    return own.inside, max(alone, joined)


@pytest.mark.parametrize("scale, least", [(0.6, 50), (0.5, 44), (0.4, 41.5)])
def test_pruning_looks_the_same_and_beats_chance(duck, scale, least):
    """41 dB with half of the particles."""
    own, chance = compare(duck, scale, 400)
    assert own >= least and own >= chance + 0.3


@pytest.mark.data
@pytest.mark.skipif(not GUITAR.exists(), reason="no shared data")
@pytest.mark.parametrize("scale, least", [(0.6, 40.5), (0.5, 31.5)])
def test_a_real_capture_beats_chance(folder, scale, least):
    """A capture of 0.3 mm fine Gaussians loses what it has too few of: more takes `passive`."""
    keys = f'gaussians = "{GUITAR}"\nup = "-y"\nheight = 0.15'
    own, chance = compare(made(folder, keys), scale, 400)
    assert own >= least and own >= chance + 0.3


def test_balls_are_compared_as_balls(duck):
    """Fluids are drawn by their volumes, whatever the covariances are."""
    skin = np.arange(len(duck.cloud)) < duck.surface_count
    found = prune.prune_versagauss(duck.cloud, duck.volume, skin, 0.5, False, True)
    flat = prune.prune_versagauss(duck.cloud, duck.volume, skin, 0.5, False, False)
    assert np.array_equal(found.retained, flat.retained) and found.summary != flat.summary


def test_pictures_and_decibels():
    n = 2000
    cloud = shell(count=n)
    views = image_similarity.cameras(cloud.x, 64)
    wanted = image_similarity.render_views(cloud, views)
    assert len(views) == 12 and all((t < 0.5).mean() > 0.15 for _, t in wanted)
    assert image_similarity.image_psnr(wanted, wanted).inside == np.inf
    paler = GaussianCloud(
        cloud.x, cloud.quat, cloud.scale, cloud.opacity, cloud.sh + dc_from_rgb(0.51)
    )
    found = image_similarity.image_psnr(wanted, image_similarity.render_views(paler, views))
    assert found.inside == pytest.approx(40, abs=0.3)  # 0.01 everywhere
    assert found.full > found.inside


@pytest.mark.parametrize(
    "keys, said",
    [
        ('shape = { sphere = { center = [0, 0, 0], radius = 0.1 } }\nprune = "auto"',
         "prune: is only for objects made of gaussians or a mesh"),
        ('mesh = "duck.obj"\nprune = "versagauss"', "prune: needs prune_scale"),
        ('mesh = "duck.obj"\nprune = "auto"\nprune_scale = 0.5', 'prune_scale: is only for'),
        ('mesh = "duck.obj"\npassive_gaussians = true',
         'passive_gaussians: needs prune = "auto" or "versagauss"'),
        ('mesh = "duck.obj"\nprune = "most"', "prune: must be one of off, auto, versagauss"),
        ('mesh = "duck.obj"\nprune = "versagauss"\nprune_scale = 1.5', "prune_scale: must be"),
    ],
)  # fmt: skip
def test_keys_that_do_not_go_together(folder, keys, said):
    with pytest.raises(SceneError) as caught:
        made(folder, keys)
    assert any(said in line for line in caught.value.lines), caught.value.lines


def test_passive_needs_a_solid_that_deforms(folder):
    text = SCENE.replace("SOURCE", 'mesh = "duck.obj"\nprune = "auto"\npassive_gaussians = true')
    elastic = 'kind = "elastic"\ndensity = 400\nyoungs_modulus = 1e5'
    metal = 'kind = "metal"\nyoungs_modulus = 1e6\nyield_stress = 1e3'
    for other in (
        text.replace(elastic, 'kind = "fluid"'),
        text.replace(elastic, metal).replace(
            "passive_gaussians = true", "passive_gaussians = true\ntrack_deformation = false"
        ),
    ):
        assert other != text
        with pytest.raises(SceneError, match="passive_gaussians: is only for solids that deform"):
            scene(folder, other)
    assert scene(folder, text.replace(elastic, metal)).object  # what yields carries F beside it

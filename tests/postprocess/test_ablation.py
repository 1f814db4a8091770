"""python -m tests.benchmarks.paper ablation: what each variant changes, and what is measured of
it."""

import imageio.v3 as iio
import numpy as np
import pytest

from tests.benchmarks.paper import __main__, ablation, contact_sheet, image_metrics
from tests.postprocess.test_look import EYE, fake, frame
from tests.support import drawn_runs
from vgmpi.io.run_reader import RunReader
from vgmpi.postprocess.frames import render_config
from vgmpi.postprocess.frames.appearance import Appearance

WATER, BAR = slice(0, drawn_runs.WATER), slice(drawn_runs.WATER, None)
TOML = """[camera]
kind = "fixed"
eye = [0.5, -1.4, 1.1]
target = [0.5, 0.5, 0.5]
[picture]
width = 96
height = 80
"""


def drawn(variant, turned=True):
    """Splats of a pool that carries F and of a bar that has turned, drawn as a variant."""
    run, rows = fake(scenery=False, k=4)
    run.objects[0]["tracks_deformation"] = True
    rows["sh"][:, 1:] = 0.3 * np.random.default_rng(0).normal(size=rows["sh"][:, 1:].shape)
    rows["cov0"][WATER] = drawn_runs.diagonal(4e-4, 1e-4, 2.5e-5, drawn_runs.WATER)
    f = frame(rows)
    f["F"][WATER] = np.diag([1.3, 1.0, 0.8]).ravel()
    if not turned:
        f["F"][BAR] = np.eye(3).ravel()
    chosen = ablation.variant_settings(render_config.Settings(), variant)
    return Appearance(run, chosen.look).splats(f, EYE)


CHANGED = {  # fields of Splats that a variant may change: of the water, of the bar
    "full method": ((), ()),
    "covariance fixed": (("cov",), ("cov",)),
    "harmonics fixed": ((), ("color",)),
    "opacity fixed": (("opacity",), ()),
    "normalised by radius": (("cov",), ()),
    # its colors turn with F, but this F turns nothing
    "normalised by deformation": (("cov",), ()),
}


@pytest.mark.parametrize("variant", ablation.VARIANTS)
def test_a_variant_changes_only_what_it_says(variant):
    full, other = drawn("full method"), drawn(variant)
    for of, names in zip((WATER, BAR), CHANGED[variant]):
        for name in ("x", "cov", "opacity", "color"):
            a, b = getattr(full, name)[of], getattr(other, name)[of]
            same = np.allclose(a, b, rtol=1e-5, atol=1e-6 * np.abs(a).max())
            assert same == (name not in names), name


def test_fixed_harmonics_change_nothing_where_nothing_turns():
    full, other = drawn("full method", turned=False), drawn("harmonics fixed", turned=False)
    np.testing.assert_array_equal(full.color, other.color)


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """What the command printed, its run and its render.toml."""
    folder = tmp_path_factory.mktemp("ablation")
    drawn_runs.write(folder / "out", opacity_scale=0.05)
    (folder / "render.toml").write_text(TOML)
    return folder


def flags(done, *more):
    return ["ablation", str(done / "out"), "--settings", str(done / "render.toml"), *more]


def test_a_sheet_and_a_table_come_out(done, capsys):
    assert __main__.main(flags(done, "-o", str(done / "a.png"))) == 0
    said = capsys.readouterr().out.splitlines()
    assert said[-1] == str(done / "a.png")
    text = (done / "out" / "ablation.md").read_text().splitlines()
    assert text == said[:-1]
    assert [line.split(" | ")[0].strip("| ") for line in text[2:]] == list(ablation.VARIANTS)
    rows = {line.split(" | ")[0].strip("| "): line.strip("| ").split(" | ") for line in text[2:]}
    assert rows["harmonics fixed"][1] == "the same picture"  # its colors are plain
    assert 5 < float(rows["covariance fixed"][1]) < 60
    picture = iio.imread(done / "a.png")
    tile = picture[:, : picture.shape[1] // 3]
    assert picture.shape[1] == 3 * (contact_sheet.WIDTH + contact_sheet.GAP)
    assert tile[: contact_sheet.LABEL].min() < 100  # there is a label
    first, second = picture[: len(picture) // 2], picture[len(picture) // 2 :]
    assert (first[contact_sheet.LABEL :] != second[contact_sheet.LABEL :]).any()


def test_thick_water_has_more_color(done):
    run = RunReader(done / "out")
    variants, where = ablation.study(run, render_config.load(done / "render.toml"), done, 2)
    by = {one.name: one.figures for one in variants}
    assert where.solid.sum() > 20 and where.granular_or_liquid.sum() > 200
    assert by["opacity fixed"].saturation > 1.2 * by["full method"].saturation
    assert by["opacity fixed"].saturated_fraction > by["full method"].saturated_fraction
    assert by["harmonics fixed"] == by["full method"]
    assert np.isinf(by["full method"].psnr)
    assert by["normalised by radius"].psnr < 40  # the captured Gaussians of the pool are tiny


def test_mistakes_are_one_line_each(done, capsys):
    assert __main__.main(["ablation", str(done / "no")]) == 2
    assert __main__.main(flags(done, "-o", "a.gif")) == 2
    assert __main__.main(flags(done, "--frame", "3")) == 2
    (done / "clear.toml").write_text('[picture]\nbackground = "none"\n')
    assert __main__.main(flags(done, "--settings", str(done / "clear.toml"))) == 2
    said = capsys.readouterr().err.splitlines()
    said = [line for line in said if not line.startswith("alpha_min")]
    assert [line.split(":")[0] for line in said][1:] == ["-o", "--frame", "picture.background"]
    assert len(said) == 4
    assert __main__.main([]) == 2 and __main__.main(["abl"]) == 2


def board(blur):
    """A solid of four tones on the left, an even fluid on the right, uint8 (60, 120, 3)."""
    from scipy import ndimage

    grey = np.full((60, 120), 160.0)
    grey[:30, :30], grey[30:, 30:60] = 40, 90
    grey[:, :60] = ndimage.gaussian_filter(grey, blur)[:, :60] if blur else grey[:, :60]
    return np.repeat(grey[:, :, None], 3, axis=2).astype(np.uint8)


def test_each_figure_sees_its_own_fault():
    left = np.zeros((60, 120), bool)
    left[:, :50] = True
    right = np.zeros((60, 120), bool)
    right[:, 70:] = True
    where = image_metrics.Regions(left, right)
    full = board(0)
    plain = image_metrics.measured(full, full, where)
    assert np.isinf(plain.psnr) and plain.grain == 0 and plain.saturation == 0
    # steps of 120 and of 70 grey levels, seen by the pixels on both sides as half of it each
    assert plain.edge == pytest.approx((60 + 60 + 35 + 35) / 4, rel=0.1)

    blurred = image_metrics.measured(board(3), full, where)
    assert blurred.edge < 0.4 * plain.edge and blurred.grain == 0

    noise = np.random.default_rng(1).normal(0, 10, size=(60, 120, 1)) * right[:, :, None]
    sandy = image_metrics.measured(np.clip(full + noise, 0, 255).astype(np.uint8), full, where)
    # the median of |a normal deviate| is 0.674 sigma; smoothing takes a little of it away
    assert sandy.grain == pytest.approx(6.74, rel=0.1) and sandy.edge == plain.edge
    assert sandy.streaks == pytest.approx(10, rel=0.1)
    assert sandy.psnr == pytest.approx(10 * np.log10(255**2 / (100 * right.mean())), abs=0.3)

    deep = full.copy()
    deep[right] = (32, 96, 160)
    deep = image_metrics.measured(deep, full, where)
    assert deep.saturation == pytest.approx(0.8) and deep.saturated_fraction == 1.0
    assert deep.grain < 1e-9

    nothing = image_metrics.Regions(np.zeros_like(left), np.zeros_like(left))
    assert np.isnan(image_metrics.measured(full, full, nothing).edge)
    assert np.isnan(image_metrics.measured(full, full, nothing).grain)


def test_regions_are_where_solids_and_fluids_are_seen(done):
    run, base = RunReader(done / "out"), render_config.load(done / "render.toml")
    _, where = ablation.study(run, base, done, 0)
    assert not (where.solid & where.granular_or_liquid).any()
    rows = np.flatnonzero(where.solid.any(axis=1))
    # the bar is over the pool
    assert rows.max() < np.flatnonzero(where.granular_or_liquid.any(axis=1)).mean()
    assert not where.granular_or_liquid[:5].any() and not where.solid[-5:].any()


def test_details_are_taken_where_the_variants_differ():
    first = np.zeros((100, 100, 3), np.uint8)
    second = first.copy()
    second[70:75, 20:25] = 9  # weak, but all there is of the second
    third = first.copy()
    third[10:14, 80:84] = 200
    everywhere = np.ones((100, 100), bool)
    upper = np.zeros((100, 100), bool)
    upper[:50] = True
    (row, column), (top, left) = contact_sheet.details(
        [first, second, second, third], image_metrics.Regions(upper, everywhere)
    )
    side = int(100 * contact_sheet.PART)
    assert row <= 70 and 75 <= row + side and column <= 20 and 25 <= column + side
    assert top <= 10 and 14 <= top + side and left <= 80 and 84 <= left + side
    assert contact_sheet.details([first, first], image_metrics.Regions(upper, upper)) == [
        (0, 0),
        (0, 0),
    ]

"""The study of pruning, on a tiny version of a scene: table and picture, and what they say."""

import sys

import numpy as np
import pytest

from tests.benchmarks.paper import __main__, portrait_metrics, table1_pruning
from tests.support import launch
from vgmpi.io.run_reader import RunReader
from vgmpi.postprocess.frames.appearance import Appearance

TINY = {
    "domain.size": '["40 cm", "32 cm", "40 cm"]',
    "domain.cell": "2 cm",
    **{f"object.{name}.particles_per_cell": "8" for name in ("duck", "left ball", "right ball")},
}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("study")
    words = ["pruning", "--scenes", "balls_duck", "--ranks", "1", "--pixels", "96", "-o", folder]
    for key, value in TINY.items():
        words += ["--set", f"{key}={value}"]
    done = launch.run([sys.executable, "-m", "tests.benchmarks.paper.__main__", *words])
    assert done.returncode == 0, done.stderr
    return folder, done.stdout


@pytest.mark.slow
def test_the_table_has_all_numbers_beside_the_papers(made):
    folder, said = made
    text = (folder / "table_one.md").read_text()
    assert text in said
    rows = [
        [cell.strip() for cell in line.split("|")[1:-1]]
        for line in text.splitlines()
        if line.startswith("| balls & duck in fluid | ")
    ]
    whole, pruned, riding = rows[:3]
    assert [row[1] for row in rows] == ["without", "with", "passive", "with", "passive"]
    assert [row[3] for row in rows[:3]] == ["368k", "191k", "-"]
    assert [row[5] for row in rows[:3]] == ["25.48", "8.78", "-"]
    assert int(whole[2].replace(",", "")) > int(pruned[2].replace(",", "")) > 10_000
    assert riding[2] == pruned[2]  # as many are simulated
    for row in rows[:3]:
        assert float(row[4]) > 0 and float(row[7]) > 0 and float(row[9]) >= 0
    assert riding[6] == riding[8] == "-"  # the paper has no such run
    for row, theirs in ((whole, 25.48), (pruned, 8.78)):
        assert row[6] == ("yes" if float(row[4]) <= theirs / 2 else "no")
    first, chance, first_whole, last, last_whole, paper = (float(c[:-3]) for c in rows[3][2:])
    assert paper == 45.79 and 20 < last <= first + 3 and first < first_whole < 80
    assert 20 < chance < first - 0.3 and last < last_whole
    again, none, _, later, *_, nor = rows[4][2:]
    assert none == nor == "-"
    assert float(again[:-3]) > first + 3 and float(later[:-3]) > last  # the look is kept


@pytest.mark.slow
def test_what_it_counts_is_in_the_files(made):
    folder, _ = made
    text = (folder / "table_one.md").read_text()
    for name in table1_pruning.VARIANTS:
        run = RunReader(folder / "balls_duck" / name)
        assert len(run) == 3 and np.allclose(run.times, [0, 0.04, 0.08])
        assert f"| {len(run.gaussians.object):,} |" in text
    kept = RunReader(folder / "balls_duck" / "without").gaussians.vol0.sum()
    assert run.gaussians.vol0.sum() == pytest.approx(kept, rel=1e-6)  # single precision


@pytest.mark.slow
def test_the_picture_shows_both_and_where_they_differ(made):
    from PIL import Image

    folder, _ = made
    picture = np.asarray(Image.open(folder / "balls_duck.png")).astype(float) / 255
    assert picture.shape == (96, 3 * 96, 3)
    whole, pruned, difference = np.split(picture, 3, axis=1)
    assert not np.array_equal(whole, pruned)
    shown = 1 - np.clip(10 * np.abs(whole - pruned), 0, 1)
    assert np.abs(shown - difference).max() < 0.09  # both are rounded to bytes


@pytest.mark.slow
def test_the_same_run_twice_is_alike_and_none_kept_is_not(made):
    """Decibels, outline and chance on a real frame."""
    look = Appearance(RunReader(made[0] / "balls_duck" / "with"))
    views = portrait_metrics.cameras(look.run, 64)
    assert len(views) == 12
    shown = portrait_metrics.render_portraits(look, 0, views, 1 / 255)
    assert portrait_metrics.psnr(shown.pictures, shown.pictures) == np.inf
    paler = [picture - 0.01 for picture in shown.pictures]
    assert portrait_metrics.psnr(shown.pictures, paler) == pytest.approx(40, abs=1e-3)
    rows = np.arange(len(shown.splats[0].x))
    everything = portrait_metrics.masks(shown.splats, rows, views, 1 / 255)
    assert all(0.02 < mask.mean() < 0.6 for mask in everything)
    all_kept = portrait_metrics.random_subset_images(
        shown.splats, [(rows, len(rows))], views, 1 / 255, 1
    )
    assert portrait_metrics.psnr(shown.pictures, all_kept) == np.inf
    half = portrait_metrics.random_subset_images(
        shown.splats, [(rows, len(rows) // 2)], views, 1 / 255, 1
    )
    assert 15 < portrait_metrics.psnr(shown.pictures, half, everything) < 45


@pytest.mark.parametrize("words", [[], ["nothing"], ["pruning", "--frames", "1"]])
def test_what_is_not_allowed_ends_in_a_line(words, capsys):
    assert __main__.main(words) == 2
    assert capsys.readouterr().err.strip()


def test_the_papers_numbers_are_whole():
    assert set(table1_pruning.PAPER_SCENES) == {"balls_duck", "faucet_ducks"}
    for known in table1_pruning.PAPER_SCENES.values():
        assert known.kernels[0] > known.kernels[1] and known.simulation[0] > known.simulation[1]

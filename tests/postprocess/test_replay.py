"""The page that replays a run: what it holds, and what a browser shows of it without a network."""

import io
import re
import sys

import imageio.v3 as iio
import numpy as np
import pytest

from tests.support import drawn_runs
from tests.support.headless_browser import browser_of, new_page
from vgmpi.io.run_reader import RunReader
from vgmpi.postprocess.commands import replay
from vgmpi.postprocess.frames.appearance import Appearance


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    return drawn_runs.write(tmp_path_factory.mktemp("run") / "out", frames=4)


@pytest.fixture(scope="module")
def html(tmp_path_factory):
    """The page of a run of 1 mm, with Gaussians of tens of micrometers."""
    pytest.importorskip("viser", reason='needs viser: pip install "vgmpi[replay]"')
    path = tmp_path_factory.mktemp("page") / "replay.html"
    out = drawn_runs.write(path.parent / "out", frames=4, cell=2e-4)
    assert replay.main([str(out), "-o", str(path), "--particles", "300", "--fps", "0.5"]) == 0
    return path


def test_the_same_gaussians_are_shown_at_every_frame(out):
    look = Appearance(RunReader(out))
    chosen = replay.GaussianSelection(look, 100)
    total = len(look.object) + len(look.scenery.x0)
    assert (chosen.all, chosen.count) == (total, 100)
    assert chosen.still.sum() + chosen.moving.sum() == 100
    rest = np.asarray(RunReader(out).gaussians.x0)[chosen.moving]
    for index in (0, 3):
        still, moving = chosen.splats_at(index, np.array([3.0, 0, 1]))
        assert len(still["centers"]) == chosen.still.sum()
        x = drawn_runs.frame_fields(drawn_runs.rest_state()[0], index, 4)["positions"][
            chosen.moving
        ]
        np.testing.assert_allclose(chosen.cell * moving["centers"], x, atol=1e-6)
        assert len(moving["centers"]) == len(rest)
        assert moving["opacities"].shape == (len(rest), 1)


def test_bodies_go_before_liquids_and_large_before_small(out):
    """What is left covers as much as all; of bodies nothing is lost while there are places."""
    look = Appearance(RunReader(out))
    liquid = int(look.fluid.sum())
    chosen = replay.GaussianSelection(look, 600)
    kept = chosen.moving & look.fluid
    assert chosen.still.all() and chosen.moving[~look.fluid].all() and kept.sum() < liquid
    area = look.cov0[:, (0, 3, 5)].sum(axis=1)
    assert chosen.growth[1][kept] @ area[kept] == pytest.approx(area[look.fluid].sum())
    assert (chosen.growth[1][~look.fluid] == 1).all() and (chosen.growth[0] == 1).all()
    look.cov0[look.fluid] *= np.where(np.arange(liquid) % 2, 100.0, 1.0)[:, None]
    kept = replay.GaussianSelection(look, 400).moving[look.fluid]
    assert kept[1::2].sum() > 5 * kept[::2].sum()


def test_few_places_are_shared(out):
    look = Appearance(RunReader(out))
    chosen = replay.GaussianSelection(look, 40)
    assert (chosen.moving & look.fluid).sum() == 10 and chosen.count == 40


def test_all_of_a_small_run_is_shown_as_it_is(out):
    look = Appearance(RunReader(out))
    chosen = replay.GaussianSelection(look, 10**6)
    assert chosen.count == chosen.all and all((g == 1).all() for g in chosen.growth)
    still, _ = chosen.splats_at(0, np.array([3.0, 0, 1]))
    cov = chosen.cell**2 * still["covariances"][0]
    np.testing.assert_allclose(cov, np.diag([9e-4, 9e-4, 1e-6]), rtol=1e-5)


def test_the_page_is_one_file(html):
    text = html.read_text()
    assert "300 of 4" in text or re.search(r"300 of [\d,]+ Gaussians", text)
    assert not re.search(r'<(script|link|img)[^>]+(src|href)="(https?:)?//', text)


def test_without_viser_one_line_says_what_to_install(out, tmp_path, monkeypatch, capfd):
    monkeypatch.setitem(sys.modules, "viser", None)
    assert replay.main([str(out), "-o", str(tmp_path / "r.html")]) == 2
    said = capfd.readouterr().err.strip()
    assert 'pip install "vgmpi[replay]"' in said and "\n" not in said
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "argv, says",
    [
        (["{none}"], "no such folder"),
        (["{out}", "-o", "r.mp4"], "ends in .html"),
        (["{out}", "--particles", "0"], "--particles"),
        (["{out}", "--fps", "nan"], "--fps"),
    ],
)
def test_mistakes_end_with_code_2_and_one_line(out, tmp_path, argv, says, capfd):
    places = {"none": tmp_path / "none", "out": out}
    assert replay.main([a.format(**places) for a in argv]) == 2
    said = capfd.readouterr().err.strip()
    assert says in said and "\n" not in said


@pytest.mark.browser
def test_a_browser_without_a_network_plays_it(html):
    """The red bar turns from across the view to along it; water and scenery are there."""
    api = pytest.importorskip("playwright.sync_api", reason="needs playwright")
    with api.sync_playwright() as play:
        browser = browser_of(play)
        page = new_page(browser, 480, 400)
        asked, errors = [], []
        page.on("request", lambda request: asked.append(request.url))
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.context.set_offline(True)
        page.goto(html.as_uri())
        page.get_by_text(re.compile("300 of")).wait_for()
        widths = []
        for _ in range(400):
            picture = iio.imread(io.BytesIO(page.screenshot()))[..., :3].astype(int)
            red = (picture[..., 0] > 120) & (picture[..., 1] < 80) & (picture[..., 2] < 80)
            if red.sum() > 20:
                blue = (picture[..., 2] > picture[..., 0] + 60).sum()
                widths.append(np.ptp(np.nonzero(red)[1]))
                if blue > 100 and max(widths) > 2 * min(widths):
                    break
            page.wait_for_timeout(300)
        browser.close()
    assert widths and max(widths) > 2 * min(widths), widths
    assert blue > 100
    assert not errors
    assert all(url.startswith(("file:", "blob:", "data:")) for url in asked), asked

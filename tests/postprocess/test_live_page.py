"""The live page in a browser, beside a run on two ranks that writes what it shows."""

import io
import re
import tomllib
from urllib.parse import urlsplit

import imageio.v3 as iio
import numpy as np
import pytest

from tests.support import drawn_runs
from tests.support.headless_browser import browser_of
from tests.support.launch import finish, on_ranks, start, until
from tests.support.live_pages import (
    ROW_BYTES,
    SCENE,
    LivePageProcess,
    Viewer,
    opened,
)
from vgmpi.io import checkpoint_manifest
from vgmpi.io.run_reader import RunReader
from vgmpi.postprocess.frames import render_config
from vgmpi.postprocess.frames.camera_paths import CameraPath
from vgmpi.postprocess.frames.frame_renderer import visible_extent

pytestmark = pytest.mark.browser
SCENE_PIXELS = 560  # of the window, left of the panel
FRAME = re.compile(r"newest frame (\d+)")


def picture(page):
    """What the page shows beside its panel."""
    return iio.imread(io.BytesIO(page.screenshot()))[:, :SCENE_PIXELS, :3].astype(int)


def reddish(page):
    shown = picture(page)
    return (shown[..., 0] > 120) & (shown[..., 1] < 90) & (shown[..., 2] < 90)


def newest(page):
    return int(FRAME.search(page.locator("#vgmpi-status").inner_text())[1])


def choose(page, label, name):
    page.get_by_label(label).click()
    page.get_by_role("option", name=name, exact=True).click()


def wait(page, there):
    until(lambda: page.wait_for_timeout(200) or there(), "the page")


@pytest.mark.mpi
def test_a_run_is_followed_and_stopped(tmp_path):
    """New frames change the picture, a field colors it, a curve is drawn; the button stops the run
    with a whole checkpoint, and the page goes on."""
    api = pytest.importorskip("playwright.sync_api", reason="needs playwright")
    (tmp_path / "scene.toml").write_text(SCENE)
    out = tmp_path / "out"
    run = start(on_ranks(2, "-m", "vgmpi", tmp_path / "scene.toml", "-o", out))
    until(lambda: (out / "frames/frame_00000.vtkhdf").exists() or run.poll() is not None, "frame")
    errors = []
    with LivePageProcess(out, "--port", 0) as live, api.sync_playwright() as play:
        browser = browser_of(play)
        page = opened(browser, live.address, errors)
        wait(page, lambda: reddish(page).sum() > 50)
        first, before = picture(page), newest(page)
        wait(page, lambda: newest(page) >= before + 5)
        wait(page, lambda: np.abs(picture(page) - first).max(axis=2).sum() > 1000)
        assert "running: process" in page.locator("#vgmpi-status").inner_text()
        choose(page, "color by", "velocity")
        page.get_by_text("velocity [m/s]").wait_for()
        wait(page, lambda: not reddish(page).any())
        page.get_by_text("Curves").click()
        page.wait_for_timeout(1000)
        choose(page, "curve", "ball: center")
        page.locator("canvas").nth(1).wait_for()
        other = Viewer(f"ws://127.0.0.1:{urlsplit(live.address).port}/")
        other.wait_for(1000 * ROW_BYTES, 0.0)
        other.link.socket.close()  # a second viewer comes and goes without a word
        assert run.poll() is None
        page.get_by_role("button", name="Stop the run").click()
        page.get_by_role("button", name="Let the run go on").click()
        page.wait_for_timeout(500)
        assert page.get_by_text("was asked to stop").count() == 0 and run.poll() is None
        page.get_by_role("button", name="Stop the run").click()
        page.get_by_role("button", name="Write a checkpoint and stop").click()
        page.get_by_text("was asked to stop with a checkpoint").wait_for()
        until(lambda: page.wait_for_timeout(100) or run.poll() is not None, "the run's end")
        wait(page, lambda: "no run writes here now" in page.locator("#vgmpi-status").inner_text())
        page.get_by_role("button", name="Stop the run").click()
        page.get_by_text("nothing to stop").wait_for()
        page.close()
        again = opened(browser, live.address, errors)  # it serves after the run's end
        wait(again, lambda: reddish(again).any() or len(np.unique(picture(again))) > 20)
        browser.close()
        assert live.process.poll() is None
    assert finish(run).returncode == 75
    (manifest,) = (out / "checkpoints").glob("*.json")
    checkpoint_manifest.check(manifest.with_suffix(".h5"))
    assert not errors


def test_frames_of_an_ended_run_are_chosen_and_played(tmp_path):
    """The red bar turns from across the view to along it as the slider goes from end to end."""
    api = pytest.importorskip("playwright.sync_api", reason="needs playwright")
    out, errors = drawn_runs.write(tmp_path / "out", frames=5), []
    with LivePageProcess(out, "--port", 0) as live, api.sync_playwright() as play:
        browser = browser_of(play)
        page = opened(browser, live.address, errors)
        wait(page, lambda: reddish(page).sum() > 20)

        def width():
            rows = np.nonzero(reddish(page))[1]
            return np.ptp(rows) if len(rows) else 0

        page.wait_for_timeout(2000)
        last = width()
        page.get_by_label("follow newest").uncheck()
        slider = page.get_by_role("slider").first
        slider.focus()
        slider.press("Home")
        wait(page, lambda: width() > 1.5 * last > 0)
        assert page.get_by_role("slider").first.get_attribute("aria-valuenow") == "0"
        assert not page.get_by_label("follow newest").is_checked()
        page.get_by_label("play", exact=True).check()
        wait(page, lambda: 0 < width() < 1.3 * last)
        page.get_by_label("play", exact=True).uncheck()
        browser.close()
    assert not errors


def test_a_view_is_saved_and_drawn(tmp_path):
    """The camera of a run of 1 mm is in meters, and shows its Gaussians of tens of micrometers."""
    api = pytest.importorskip("playwright.sync_api", reason="needs playwright")
    pytest.importorskip("tomlkit")
    out, errors = drawn_runs.write(tmp_path / "out", frames=2, cell=2e-4), []
    settings = tmp_path / "render.toml"
    settings.write_text("# mine\n[look]\npreset = 'paper'  # quick\n")
    with LivePageProcess(out, "--port", 0) as live, api.sync_playwright() as play:
        browser = browser_of(play)
        page = opened(browser, live.address, errors)
        wait(page, lambda: reddish(page).sum() > 20)
        page.get_by_role("button", name="Save this camera").click()
        page.get_by_text("camera saved in").wait_for()
        text = settings.read_text()
        assert text.startswith("# mine\n[look]\npreset = 'paper'  # quick\n")
        saved, chosen = tomllib.loads(text)["camera"], render_config.load(None)
        box = visible_extent(RunReader(out))
        first = CameraPath(chosen.views()[0], chosen.picture, lambda: box, tmp_path).camera_at(0, 0)
        assert saved["kind"] == "fixed"
        np.testing.assert_allclose(saved["eye"], first.eye, rtol=1e-4)
        np.testing.assert_allclose(saved["target"], np.mean(box, axis=0), rtol=1e-4)
        page.get_by_role("button", name="Draw this view").click()
        page.get_by_text("drawn view").wait_for()
        data = page.locator("img").last.get_attribute("src")
        assert data.startswith(("blob:", "data:image/"))
        browser.close()
    assert not errors

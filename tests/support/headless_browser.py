"""A headless Chromium that is here, for pages that tests and benchmarks open."""

import shutil

import pytest

from tests.support.launch import PATIENCE

CHROMIUM = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
# no graphics card is asked for
FLAGS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]


def find_chromium() -> str | None:
    """The program, None where there is none."""
    return next((p for p in map(shutil.which, CHROMIUM) if p), None)


def browser_of(play, flags=FLAGS):
    """A headless Chromium of playwright; the test is skipped where there is none."""
    program = find_chromium()
    if program is None:
        pytest.skip("no chromium here")
    return play.chromium.launch(executable_path=program, args=flags)


def new_page(browser, width, height):
    """A page of a browser whose waits end when patience is over."""
    page = browser.new_page(viewport={"width": width, "height": height})
    page.set_default_timeout(1000 * PATIENCE)
    return page

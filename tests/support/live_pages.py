"""A live page as a process of its own, a browser on it, and a run for it to follow."""

import re
import shutil
import sys
import threading

import pytest

from tests.support.launch import PATIENCE, start

CHROMIUM = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
# no graphics card is asked for
FLAGS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
SCENE = """
title = "A ball falls into water"
[domain]
size = ["24 cm", "16 cm", "16 cm"]
cell = "1 cm"
[time]
end = "4 s"
frames = 801
[output]
checkpoint_interval = 0
[material.rubber]
kind = "elastic"
density = 1000
youngs_modulus = "0.1 MPa"
[material.water]
kind = "fluid"
density = 1000
[[object]]
name = "ball"
material = "rubber"
shape = { sphere = { center = ["8 cm", "8 cm", "11 cm"], radius = "3 cm" } }
color = "#e02020"
[[object]]
name = "pool"
material = "water"
shape = { box = [[0, 0, 0], ["24 cm", "16 cm", "5 cm"]] }
color = "#2040e0"
[[probe]]
name = "ball"
object = "ball"
sampling_rate = 500
"""


class LivePageProcess:
    """`vgmpi live` as a process: its address, and its lines."""

    def __init__(self, *words):
        pytest.importorskip("viser", reason='needs viser: pip install "vgmpi[live]"')
        self.process = start([sys.executable, "-m", "vgmpi", "live", *words])
        line = self.process.stdout.readline()
        found = re.search(r"http://\S+", line)
        if found is None:
            pytest.fail(f"no address: {line}{self.process.stderr.read()}")
        self.address = found[0]

    def stop(self, number):
        """Send a signal and return exit code, stdout and stderr."""
        self.process.send_signal(number)
        out, err = self.process.communicate(timeout=PATIENCE)
        return self.process.returncode, out, err

    def __enter__(self):
        return self

    def __exit__(self, *_):
        if self.process.poll() is None:
            self.process.terminate()
            killer = threading.Timer(PATIENCE, self.process.kill)
            killer.start()
            self.process.communicate()
            killer.cancel()


def browser_of(play):
    """A headless Chromium of playwright; the test is skipped where there is none."""
    program = next((p for p in map(shutil.which, CHROMIUM) if p), None)
    if program is None:
        pytest.skip("no chromium here")
    return play.chromium.launch(executable_path=program, args=FLAGS)


def opened(browser, address, errors):
    """A page of a browser with the status of the run on it."""
    page = browser.new_page(viewport={"width": 900, "height": 700})
    page.set_default_timeout(1000 * PATIENCE)
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.goto(address)
    page.get_by_text(re.compile("of [\\d,]+ Gaussians")).wait_for()
    return page

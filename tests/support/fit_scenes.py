"""Small scenes that the tests of fits run, and how they are run."""

import sys
from pathlib import Path

from tests.support import launch
from vgmpi import api

BALL = """
title = "ball"
[domain]
size = [0.24, 0.24, 0.24]
cell = 0.02
boundary = "slip"
[time]
end = 0.06
frames = 7
[accuracy]
precision = "single"
[material.rubber]
kind = "elastic"
density = 1000
youngs_modulus = 2e4
[[object]]
name = "ball"
material = "rubber"
shape = { sphere = { center = [0.12, 0.12, 0.06], radius = 0.05 } }
velocity = [0, 0, -1.0]
[[probe]]
name = "ball"
object = "ball"
sampling_rate = 200
"""

FIT = """\
[[parameter]]
key = "material.rubber.youngs_modulus"
range = ["4 kPa", "400 kPa"]
initial = "200 kPa"
[target]
table = "reference/probe_ball.csv"
probe = "ball"
columns = ["center_z", "velocity_z"]
[method]
max_runs = 40
scan_points = 4
discretization_check = "none"
"""


def made(folder: Path, text: str, fit: str) -> tuple[Path, Path]:
    """The files of a scene and a fit in a folder."""
    scene, file = folder / "scene.toml", folder / "fit.toml"
    scene.write_text(text)
    file.write_text(fit)
    return scene, file


def reference(folder: Path, text: str, changes: dict | None = None, name="reference") -> Path:
    """A run of the same scene with something else, to be found again."""
    run = api.run(api.load(folder / "reference.toml", changes or {}, text), folder / name)
    assert run.code == 0
    return folder / name


SHORT = BALL.replace("end = 0.06", "end = 0.02").replace("frames = 7", "frames = 3")


def fitted_alone(folder: Path, fit: str) -> Path:
    """The folder with the short scene and a fit, and in alone/ what one process made of them."""
    scene, file = made(folder, SHORT, fit)
    reference(folder, SHORT)
    done = go(scene, file, folder / "alone")
    assert done.returncode == 0, done.stderr
    return folder


def command(scene: Path, fit: Path, out: Path, *flags) -> list:
    """The command of a fit."""
    return [sys.executable, "-m", "vgmpi.tools.fit", scene, fit, "-o", out, *flags]


def go(scene: Path, fit: Path, out: Path, *flags):
    """A fit in a process of its own."""
    return launch.run(command(scene, fit, out, *flags))

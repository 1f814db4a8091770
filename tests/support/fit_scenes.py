"""Small scenes that the tests of fits run, and how they are run."""

import csv
import sys
from pathlib import Path

from tests.support import launch
from vgmpi import api
from vgmpi.tools.fit import __main__ as fit

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


def write_fit(folder: Path, text: str, fit_text: str) -> tuple[Path, Path]:
    """The files of a scene and a fit in a folder."""
    scene, file = folder / "scene.toml", folder / "fit.toml"
    scene.write_text(text)
    file.write_text(fit_text)
    return scene, file


def reference(folder: Path, text: str, changes: dict | None = None, name="reference") -> Path:
    """A run of the same scene with something else, to be found again."""
    run = api.run(api.load(folder / "reference.toml", changes or {}, text), folder / name)
    assert run.code == 0
    return folder / name


SHORT = BALL.replace("end = 0.06", "end = 0.02").replace("frames = 7", "frames = 3")


def fitted_alone(folder: Path, fit_text: str) -> Path:
    """The folder with the short scene and a fit, and in alone/ what one process made of them."""
    scene, file = write_fit(folder, SHORT, fit_text)
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


def rows(out: Path, but=("seconds",)) -> list[dict]:
    """The runs that a fit tells of, without some columns."""
    with open(out / "fit.csv") as f:
        return [{k: v for k, v in row.items() if k not in but} for row in csv.DictReader(f)]


def bits(out: Path) -> list:
    """All that is told, but the time that it took."""
    names = ("fitted.toml", "report.md")
    return [rows(out), *((out / name).read_bytes() for name in names)]


def refused(capsys, folder: Path, text: str, out: str = "fit") -> tuple[Path, str]:
    """The file of a fit of the ball that is wrong, and the one line that the command says."""
    scene, file = write_fit(folder, BALL, text)
    capsys.readouterr()
    assert fit.main([str(scene), str(file), "-o", str(folder / out)]) == 2
    told = capsys.readouterr().err.strip().splitlines()
    assert len(told) == 1, told
    return file, told[0]

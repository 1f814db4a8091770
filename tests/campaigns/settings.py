"""Spoiled render.toml through the renderer: a small picture, or each mistake gets its line."""

import json
import re
from pathlib import Path

import numpy as np

from tests.campaigns import worker
from tests.campaigns.result import Result
from tests.campaigns.spoiled import Spoiler
from tests.postprocess import test_settings
from tests.support import drawn_runs

NAME = "settings"
COUNT = 1000
SMALL = 20

# what the files of runs/ do not say
PHOTOGRAPH = """
[[camera]]
name = "one"
kind = "keyframes"
keyframes = [
    { progress = 0, eye = [2, -2, 1] },
    { progress = 1, eye = [2, 2, 1], target = [0.5, 0.5, 0.5], fov = 30 },
]
[[camera]]
name = "two"
kind = "fixed"
eye = [2, 2, 2]
[picture]
width = 64
height = 48
background = "back.png"
supersample = 2
floor = { height = 0, color = "#aaaaaa", checker_size = 0.1, light = [0, 0, -1], shadow = 0.5 }
[look]
covariance = "fixed"
rotate_sh = false
opacity = "fixed"
"""
FROM_FILES = """
[[camera]]
name = "nerf"
kind = "transforms"
file = "transforms.json"
image = "b.png"
near = 0.1
[[camera]]
name = "col"
kind = "colmap"
folder = "sparse"
scale = 0.5
[picture]
background = "none"
[splatting]
mode = "antialias"
lowpass = 0.2
"""


def bases(folder: Path) -> list[str]:
    """Good ones, for the run tests.support.drawn_runs writes; the files they name go to
    `folder`."""
    import imageio.v3 as iio

    iio.imwrite(folder / "back.png", np.arange(60 * 80 * 3, dtype=np.uint8).reshape(60, 80, 3))
    pose = [[1, 0, 0, 0.5], [0, 0, -1, -2], [0, 1, 0, 0.5], [0, 0, 0, 1]]
    frames = [{"file_path": name, "transform_matrix": pose} for name in ("a.png", "b.png")]
    told = {"w": 64, "h": 48, "fl_x": 60, "frames": frames}
    (folder / "transforms.json").write_text(json.dumps(told))
    (folder / "sparse").mkdir(exist_ok=True)
    (folder / "sparse/cameras.txt").write_text("1 PINHOLE 64 48 60 60 32 24\n")
    (folder / "sparse/images.txt").write_text("1 0.70710678 0.70710678 0 0 0 0 2 1 a.png\n\n")
    found = [path.read_text() for path in sorted(worker.ROOT.glob("runs/*/render.toml"))]
    found = [re.sub(r"(?m)^#.*\n|^ *\w+ *= *[0-9.]+ *$", "", text) for text in found]
    # of a body that the run has
    found = [
        re.sub(r"brightness_jitter *= *\{.*\}", "brightness_jitter = { pool = 0.06 }", text)
        for text in found
    ]
    full = test_settings.FULL.replace('"milk"', '"pool"').replace("water = ", "pool = ")
    full = full.replace('"relax"', '"off"')  # the run does not tell its cells
    return [*found, full.replace('"my duck"', "bar").replace("last = 10", "last = 2"), PHOTOGRAPH,
            FROM_FILES]  # fmt: skip


def keys() -> list[str]:
    """Names of all keys there are."""
    from vgmpi.postprocess.frames import render_config

    tables = (render_config.Keyframe, render_config.CameraSettings, render_config.FloorSettings,
              render_config.PictureSettings, render_config.VideoSettings,
              render_config.FrameSettings,
              render_config.SplattingSettings, render_config.LookSettings,
              render_config.Settings)  # fmt: skip
    return sorted({name for table in tables for name in table.model_fields})


def campaign(count: int, seed: int, folder: Path) -> Result:
    """count: of settings. Those that fail stay in the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    run = drawn_runs.write(folder / "run")
    spoiler = Spoiler(bases(folder), keys())
    cases, paths = [], []
    for draw, path in spoiler.files(count, seed, folder):
        paths.append(path)
        flags = draw.choice((["--preview"], ["--preview"], ["--frame", "1"]))
        cases.append([drawn(run, path, folder, *flags)])
    # each way to draw is compiled
    warm = [drawn(run, path, folder, "--preview") for path in spoiler.good(folder)]
    return worker.judged(paths, cases, warm, _where, _named)


def _named(path: Path, command: list[str], code: int) -> str:
    return "refused" if code else "drawn"


def drawn(run: Path, path: Path, folder: Path, *flags: str) -> list[str]:
    """The command that draws a frame of a run."""
    return ["render", str(run), str(path), "-q", "-o", str(folder / "picture.png"), *flags]


def _where(path: Path, command: list[str]) -> re.Pattern:
    """How lines begin: what only shows with the run or a file names its key or the file."""
    return re.compile(
        rf"{re.escape(str(path))}:(?:\d+:)? .+|(?:camera|picture|look|frames)\b[\w.]*: .+"
        rf"|{re.escape(str(path.parent))}/.+: .+"
    )

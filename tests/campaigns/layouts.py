"""Spoiled layout.toml through `vgmpi photo`: a scene that passes the check, or its mistakes."""

import re
from pathlib import Path

import numpy as np
import pytest

from tests.campaigns import worker
from tests.campaigns.result import Result
from tests.campaigns.spoiled import Spoiler

NAME, COUNT, SMALL = "layouts", 600, 4

BASES = (
    """
[camera]
pitch = 20
[scene]
end = 0.5
frames = 3
[[object]]
name = "ball"
height = 0.1
box = [40, 50, 100, 110]
material = "rubber"
point_prompts = [[70, 80]]
""",
    """
[camera]
pitch = "15 deg"
fov = 50
[bodies]
method = "mask"
[[object]]
name = "ball"
height = "10 cm"
box = [40, 50, 100, 110]
reconstruction = "revolve"
material = "rubber"
""",
    """
[camera]
pitch = 35
fov = 30
height = "40 cm"
[scene]
end = "0.2 s"
cells = 32
shadows = "remove"
[[object]]
name = "cup"
mask = "disc.png"
reconstruction = "cup"
wall = 0.2
height = "10 cm"
support = "2 cm"
yaw = 10
[[object]]
name = "tea"
mask = "surface.png"
inside = "cup"
material = "water"
""",
    """
[camera]
pitch = 20
[masks]
method = "grabcut"
[depth]
method = "floor"
[[object]]
name = "box"
box = [40, 50, 100, 110]
reconstruction = "extrude"
thickness = 0.3
height = "10 cm"
support = "floor"
distance = "60 cm"
[[object]]
name = "lid"
mask = "lid.png"
text = "a red lid"
support = "box"
yaw = "5 deg"
""",
    """
[camera]
pitch = 20
[bodies]
folder = "bodies"
seed = 3
[[object]]
name = "duck"
mask = "disc.png"
body = "duck.obj"
up = "z"
height = "10 cm"
""",
)
MASKS = {"disc": (70, 80, 24, 24), "surface": (70, 68, 18, 7), "lid": (110, 40, 14, 9)}


def write_masks(folder: Path) -> None:
    """The files that the layouts name: ellipses of MASKS (x, y, and both radii), and a body."""
    from PIL import Image

    from tests.tools.test_photo_hostile import HEIGHT, WIDTH

    y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    for name, (a, b, width, height) in MASKS.items():
        mask = ((x - a) / width) ** 2 + ((y - b) / height) ** 2 < 1
        Image.fromarray(np.where(mask, 255, 0).astype(np.uint8)).save(folder / f"{name}.png")
    (folder / "duck.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    )


def campaign(count: int, seed: int, folder: Path) -> Result:
    """count: of layouts. Those that fail stay in the folder."""
    pytest.importorskip("cv2", reason="no OpenCV: pip install 'vgmpi[images]'")
    from tests.tools import test_photo_hostile

    folder.mkdir(parents=True, exist_ok=True)
    photo = folder / "photo.png"
    photo.write_bytes(test_photo_hostile.plain())
    write_masks(folder)
    keys = sorted({word for text in BASES for word in re.findall(r"(?m)^(\w+) =", text)})
    spoiler = Spoiler(
        list(BASES),
        [
            *keys,
            "mask",
            "position",
            "supported_by",
            "rotation",
            "views",
            "multi_view",
            "weights",
            "script",
        ],
    )
    cases, paths = [], []
    for _, path in spoiler.files(count, seed, folder):
        out = folder / f"out_{path.stem}"
        paths.append(path)
        cases.append(
            [
                ["photo", str(photo), str(path), "-o", str(out)],
                ["vgmpi", str(out / "scene.toml"), "--check"],
            ]
        )
    good = spoiler.good(folder)[0]
    warm = [["photo", str(photo), str(good), "-o", str(folder / "out_good")]]
    return worker.judged(paths, cases, warm, _where, _named)


def _named(path: Path, command: list[str], code: int) -> str:
    return (
        "passed" if code == 0 else f"refused by {'photo' if command[0] == 'photo' else '--check'}"
    )


def _where(path: Path, command: list[str]) -> re.Pattern:
    """How lines begin: with the layout's place or its name, or that of a file that it names."""
    return re.compile(rf"{re.escape(str(path))}(?::\d+)?: .+|{re.escape(str(path.parent))}/\S+: .+")

"""Spoiled layout.toml through `vgmpi photo`: a scene that passes the check, or its mistakes."""

import re
from pathlib import Path

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
)


def campaign(count: int, seed: int, folder: Path) -> Result:
    """count: of layouts. Those that fail stay in the folder."""
    pytest.importorskip("cv2", reason="no OpenCV: pip install 'vgmpi[images]'")
    from tests.apps import test_photo_hostile

    folder.mkdir(parents=True, exist_ok=True)
    photo = folder / "photo.png"
    photo.write_bytes(test_photo_hostile.plain())
    keys = sorted({word for text in BASES for word in re.findall(r"(?m)^(\w+) =", text)})
    spoiler = Spoiler(list(BASES), [*keys, "mask", "position", "supported_by", "rotation", "views"])
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

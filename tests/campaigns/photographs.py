"""Spoiled photographs and masks through `vgmpi photo`: a scene, or one line that names the file."""

import random
import re
from pathlib import Path

import pytest

from tests.campaigns import inputs, worker
from tests.campaigns.result import Result

NAME, COUNT, SMALL = "photographs", 600, 6

KINDS = (("photo", ".png"), ("photo", ".jpg"), ("mask", ".png"), ("find", ".png"))
LAYOUT = """[camera]
pitch = 20
[[object]]
name = "ball"
height = 0.1
"""


def campaign(count: int, seed: int, folder: Path) -> Result:
    """count: of pictures. Those that fail stay in the folder, with the layout that names them."""
    pytest.importorskip("cv2", reason="no OpenCV: pip install 'vgmpi[images]'")
    folder.mkdir(parents=True, exist_ok=True)
    all_ = good()
    cases, spoiled = [], []
    for k in range(-1, count):
        draw, kind = random.Random(f"{seed} {k}"), KINDS[max(k, 0) % len(KINDS)]
        path = folder / f"{k:04}" / f"picture{kind[1]}"
        path.parent.mkdir(exist_ok=True)
        data = draw.choice(all_[kind])
        path.write_bytes(inputs.spoil(data, kind, all_, draw) if k >= 0 else data)
        spoiled.append(path)
        cases.append(_commands(kind[0], path))
    return worker.judged(spoiled[1:], cases[1:], cases[0], _where, _named)


def good() -> inputs.Good:
    """Photographs of all kinds of pixels, and masks of the disc in them."""
    from PIL import Image

    from tests.tools import test_photo_hostile as drawn

    taken = {name: make() for name, make in drawn.TAKEN.items()}
    jpeg = [data for data in taken.values() if data.startswith(b"\xff\xd8")]
    other = [data for data in taken.values() if not data.startswith(b"\xff\xd8")]
    masks = [drawn.saved(Image.fromarray(drawn.disc())), drawn.clear()]
    return {
        ("photo", ".png"): other,
        ("photo", ".jpg"): jpeg,
        ("mask", ".png"): masks,
        ("find", ".png"): other,
    }


def _commands(use: str, path: Path) -> worker.Case:
    """What reads the picture; the layout that goes with it is written."""
    from tests.tools import test_photo_hostile as drawn

    layout, out, photo = path.with_name("layout.toml"), path.with_name("out"), path
    if use == "find":
        return [["photo", str(path), "--find", "-o", str(out)]]
    if use == "mask":
        photo = path.with_name("photo.png")
        photo.write_bytes(drawn.plain())
        layout.write_text(f'{LAYOUT}mask = "{path.name}"\n')
    else:
        layout.write_text(f"{LAYOUT}box = {drawn.BOX}\n")
    return [
        ["photo", str(photo), str(layout), "-o", str(out)],
        ["vgmpi", str(out / "scene.toml"), "--check"],
    ]


def _named(path: Path, command: list[str], code: int) -> str:
    return f"{path.suffix} {'refused' if code else 'read'}"


def _where(path: Path, command: list[str]) -> re.Pattern:
    """How lines begin: with the picture, or with the place in the layout beside it."""
    return re.compile(
        rf"{re.escape(str(path))}: .+|{re.escape(str(path.parent))}/layout\.toml:\d+: .+"
    )

"""scene.toml and render.toml of objects that have their places."""

import zlib
from typing import Any, NamedTuple

import numpy as np

from vgmpi.convert import written
from vgmpi.gaussians.cloud import Cloud
from vgmpi.images.view import View

BESIDE, ABOVE = 0.8, 0.3  # room around what is there, of its largest extent
GAP = 0.2  # cells between things and the floor: soft ones press some way into what they stand on
FRICTION = 0.4  # of the floor
_MARK = "# made by python -m vgmpi.images, sum "


class Thing(NamedTuple):
    """An object of the scene. cloud: about the middle of its base [m]; at: where that is, above the
    floor (3,) [m]; stuff: the name of its material, keys: what the scene says of it."""

    name: str
    cloud: Cloud
    at: np.ndarray
    stuff: str
    keys: dict[str, Any]


class Room(NamedTuple):
    """The domain: its lower corner above the floor (3,) [m], its cells along each edge and how long
    one is [m]."""

    low: np.ndarray
    counts: np.ndarray
    cell: float


def room(things: list[Thing], cells: int) -> Room:
    """A domain around all things, with the floor at its lower wall; cells: of its longest edge."""
    low = np.min([one.at + one.cloud.x.min(axis=0) for one in things], axis=0)
    high = np.max([one.at + one.cloud.x.max(axis=0) for one in things], axis=0)
    largest = max(float(np.ptp(one.cloud.x, axis=0).max()) for one in things)
    low[:2] -= BESIDE * largest
    high[:2] += BESIDE * largest
    low[2], high[2] = 0.0, high[2] + ABOVE * largest
    cell = float(f"{(high - low).max() / cells * 1.0005:.3g}")
    counts = np.ceil((high - low) / cell).astype(int)
    middle = (low + high)[:2] / 2
    low[:2] = middle - counts[:2] * cell / 2
    low[2] = -GAP * cell
    return Room(low, counts, cell)


def scene(things: list[Thing], space: Room, end: float, frames: int, title: str) -> str:
    """The text of scene.toml, its Gaussians in NAME.ply beside it."""
    stuff = {one.stuff: one.keys for one in things}
    top = {
        "title": title,
        "domain": {
            "size": [float(f"{n * space.cell:.12g}") for n in space.counts],
            "cell": space.cell,
            "boundary": {"default": "open", "floor": {"kind": "separate", "friction": FRICTION}},
        },
        "time": {"end": end, "frames": frames},
        "appearance": {"colour_transfer": "off"},
        "material": stuff,
        "object": [
            {
                "name": one.name,
                "material": one.stuff,
                "gaussians": f"{one.name}.ply",
                "position": [round(float(c), 9) for c in one.at - space.low],
            }
            for one in things
        ],
    }
    head = [
        "The scene of a photograph. What was guessed stands in layout.toml: change it there and",
        "start again; or change this file, which is then not replaced without --overwrite.",
    ]
    return sealed(written.text(top, head, []))


def render(view: View, eye: np.ndarray, background: str) -> str:
    """The text of render.toml: the photograph's camera. eye: in the domain (3,) [m]."""
    top = {
        "camera": {
            "kind": "fixed",
            "eye": [round(float(c), 9) for c in eye],
            "target": [round(float(c), 9) for c in eye + view.forward],
            "fov": view.fov,
            "near": near(eye),
        },
        "picture": {
            "width": view.width,
            "height": view.height,
            "background": background,
            "floor": {"kind": "photograph"},
        },
    }
    head = [
        "The photograph's camera; behind everything the photograph, its objects painted out. The",
        "light is in their colors, and the photograph holds their first shadows: no light is",
        "added, and the only shadows are those that come later.",
    ]
    return sealed(written.text(top, head, []))


def near(eye: np.ndarray) -> float:
    """The near plane [m]."""
    return float(f"{min(0.2, 0.05 * max(float(eye[2]), 1e-6)):.6g}")


def sealed(text: str) -> str:
    """A text with a first line that tells whether it was changed since."""
    return f"{_MARK}{zlib.crc32(text.encode()):08x}\n{text}"


def as_made(text: str) -> bool:
    """Whether a text is one of ours that nobody changed."""
    first, _, rest = text.partition("\n")
    return first.startswith(_MARK) and first == f"{_MARK}{zlib.crc32(rest.encode()):08x}"

"""Draw the photograph of this example: python runs/photo/make_photo.py [folder].

--sheet FILE: six frames of its run as one picture, for docs/how-to/photo-to-scene.md.
--examples FOLDER: the drawn photographs of vgmpi photo --demo, for vgmpi/tools/photo/examples.

A table before a wall, lit from the left: balls, cans and boxes, ray-traced in numpy. The same bytes
every time. `draw` also tells which pixels are whose, so that tests know the truth. photo.png and
its layout.toml go to runs/photo/made, where the example's commands look for them.
"""

import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # also without an installed vgmpi

from vgmpi.tools.photo.photo_camera import View

LIGHT = np.array([-0.45, -0.55, 0.70]) / np.linalg.norm([-0.45, -0.55, 0.70])
FINE = 2  # rays per pixel and axis
AMBIENT, SHADOW, NOISE = 0.45, 0.55, 2.5
WALL = 1.0  # m behind the eye's foot, where the wall stands


class Ball(NamedTuple):
    """middle (3,) and radius [m]."""

    middle: tuple
    radius: float
    color: tuple


class Can(NamedTuple):
    """An upright cylinder: the middle of its base (3,), radius and height [m]. inside: the color
    of its upper end."""

    base: tuple
    radius: float
    height: float
    color: tuple
    inside: tuple


class Box(NamedTuple):
    """Lower and upper corner (3,) [m]."""

    low: tuple
    high: tuple
    color: tuple


class Drawn(NamedTuple):
    """rgb: (height, width, 3) uint8. masks: what of each thing is seen, (height, width) bool."""

    rgb: np.ndarray
    masks: list[np.ndarray]


def draw(things: list, view: View, eye: float | np.ndarray, seed: int = 1) -> Drawn:
    """The photograph of things on a floor, by a camera `eye` [m] above it or at a place (3,).
    Without things: of the table and the wall alone."""
    rows, columns = np.meshgrid(
        *(np.arange(n * FINE) for n in (view.height, view.width)), indexing="ij"
    )
    at = (np.stack([columns, rows], -1) + 0.5) / FINE
    ray = view.rays(at).reshape(-1, 3)
    start = np.array([0.0, 0.0, eye]) if np.ndim(eye) == 0 else np.asarray(eye)
    color, which = _background(ray, start, things)
    best = np.full(len(ray), np.inf)
    for k, thing in enumerate(things):
        t, normal, paint = _hit(thing, start, ray)
        near = np.flatnonzero(t < best)
        best[near], which[near] = t[near], k
        others = [one for one in things if one is not thing]
        color[near] = _shaded(start, ray[near], t[near], normal[near], paint[near], others)
    shape = (view.height, FINE, view.width, FINE)
    mean = color.reshape(*shape, 3).mean(axis=(1, 3))
    share = [(which == k).reshape(shape).mean(axis=(1, 3)) for k in range(len(things))]
    noise = np.random.default_rng(seed).normal(0, NOISE / 255, mean.shape)
    rgb = np.clip(255 * (mean + noise) + 0.5, 0, 255).astype(np.uint8)
    return Drawn(rgb, [one > 0.5 for one in share])


def _shaded(start, ray, t, normal, paint, others) -> np.ndarray:
    """Colors (n, 3) of places where rays meet a thing, with the shadows of others."""
    place = start + t[:, None] * ray
    lit = AMBIENT + (1 - AMBIENT) * np.clip(normal @ LIGHT, 0, 1)
    half = LIGHT - ray / np.linalg.norm(ray, axis=1, keepdims=True)
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    shine = 0.25 * np.clip((normal * half).sum(axis=1), 0, 1) ** 30
    dark = _shadowed(place + 1e-4 * normal, others)
    lit = np.where(dark, np.minimum(lit, SHADOW), lit)
    return paint * lit[:, None] + np.where(dark, 0, shine)[:, None]


def _background(ray: np.ndarray, start: np.ndarray, things: list) -> tuple[np.ndarray, np.ndarray]:
    """Colors (n, 3) of table and wall, and -1 for nobody (n,)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        down = np.where(ray[:, 2] < 0, -start[2] / ray[:, 2], np.inf)
        wall = np.where(ray[:, 1] > 0, (WALL - start[1]) / ray[:, 1], np.inf)
    table = down < wall
    place = start + np.where(table, down, wall)[:, None] * ray
    board = np.floor(place[:, 1] / 0.045)
    grain = 0.5 + 0.5 * np.sin(place[:, 0] * 90 + 5 * np.sin(place[:, 0] * 17 + board * 2.1))
    tone = 0.82 + 0.06 * np.sin(board * 12.9) + 0.05 * grain
    tone *= np.where(np.abs(place[:, 1] / 0.045 - board - 0.5) > 0.47, 0.8, 1.0)
    wood = np.array([0.62, 0.47, 0.33]) * tone[:, None]
    dark = _shadowed(place + (0, 0, 1e-5), things)
    wood *= np.where(dark, SHADOW, 1.0)[:, None]
    up = np.clip(place[:, 2] / 0.5, -1, 1)[:, None]
    plaster = np.array([0.72, 0.76, 0.78]) - 0.08 * up + 0.012 * np.sin(place[:, :1] * 60)
    return np.where(table[:, None], wood, plaster), np.full(len(ray), -1)


def _shadowed(x: np.ndarray, things: list) -> np.ndarray:
    """Whether things stand between places (n, 3) and the light."""
    dark = np.zeros(len(x), dtype=bool)
    ray = np.broadcast_to(LIGHT, x.shape)
    for thing in things:
        t, _, _ = _hit(thing, x, ray)
        dark |= np.isfinite(t) & (t > 1e-4)
    return dark


def _hit(thing, start: np.ndarray, ray: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where rays meet a thing first: the factor of the ray (n,), infinite where they do not, the
    normal (n, 3) and the color (n, 3) there."""
    kind = {Ball: _ball, Can: _can, Box: _box}[type(thing)]
    with np.errstate(divide="ignore", invalid="ignore"):
        return kind(thing, np.broadcast_to(start, ray.shape), ray)


def _roots(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """The smaller positive solution of a t^2 + 2 b t + c = 0, or infinity."""
    root = b * b - a * c
    root = np.where(root >= 0, np.sqrt(np.maximum(root, 0)), np.nan)
    near, far = (-b - root) / a, (-b + root) / a
    t = np.where(near > 0, near, far)
    return np.where(t > 0, t, np.inf)  # NaN is not


def _ball(thing: Ball, start: np.ndarray, ray: np.ndarray):
    off = start - thing.middle
    t = _roots((ray**2).sum(1), (ray * off).sum(1), (off**2).sum(1) - thing.radius**2)
    normal = (off + np.where(np.isfinite(t), t, 0)[:, None] * ray) / thing.radius
    band = np.abs(normal[:, 2]) < 0.16
    paint = np.where(band[:, None], (0.95, 0.93, 0.88), thing.color)
    return t, normal, paint


def _can(thing: Can, start: np.ndarray, ray: np.ndarray):
    off = start - thing.base
    side = _roots(
        (ray[:, :2] ** 2).sum(1),
        (ray * off)[:, :2].sum(1),
        (off[:, :2] ** 2).sum(1) - thing.radius**2,
    )
    z = off[:, 2] + np.where(np.isfinite(side), side, 0) * ray[:, 2]
    side = np.where((z >= 0) & (z <= thing.height), side, np.inf)
    lid = (thing.height - off[:, 2]) / ray[:, 2]
    at = off + np.where(np.isfinite(lid), lid, 0)[:, None] * ray
    lid = np.where((lid > 0) & ((at[:, :2] ** 2).sum(1) <= thing.radius**2), lid, np.inf)
    top = lid < side
    t = np.where(top, lid, side)
    at = off + np.where(np.isfinite(t), t, 0)[:, None] * ray
    normal = np.where(top[:, None], (0, 0, 1), at * (1, 1, 0) / thing.radius)
    height = at[:, 2] / thing.height
    band = (height > 0.62) & (height < 0.74)
    paint = np.where(band[:, None], (0.93, 0.90, 0.82), thing.color)
    rim = (at[:, :2] ** 2).sum(1) > (0.86 * thing.radius) ** 2
    within = np.where(rim[:, None], thing.color, thing.inside)
    return t, normal, np.where(top[:, None], within, paint)


def _box(thing: Box, start: np.ndarray, ray: np.ndarray):
    first, second = ((np.asarray(c) - start) / ray for c in (thing.low, thing.high))
    near, far = np.minimum(first, second), np.maximum(first, second)
    enter = near.max(axis=1)
    t = np.where((enter <= far.min(axis=1)) & (enter > 0), enter, np.inf)
    axis = near.argmax(axis=1)
    normal = np.zeros(ray.shape)
    normal[np.arange(len(ray)), axis] = -np.sign(ray[np.arange(len(ray)), axis])
    at = start + np.where(np.isfinite(t), t, 0)[:, None] * ray
    size = np.asarray(thing.high) - thing.low
    place = (at - thing.low) / size
    frame = ((np.abs(place - 0.5) > 0.44) & (np.abs(normal) < 0.5)).any(axis=1)
    paint = np.where(frame[:, None], 0.75 * np.asarray(thing.color), thing.color)
    return t, normal, paint


MILK, GLASS = (0.93, 0.92, 0.88), (0.96, 0.95, 0.92)
TABLE = [
    Ball((0.005, 0.56, 0.215), 0.042, (0.86, 0.42, 0.10)),
    Can((0.0, 0.58, 0.0), 0.052, 0.11, GLASS, MILK),
    Box((0.125, 0.55, 0.0), (0.215, 0.61, 0.06), (0.70, 0.12, 0.20)),
    Ball((-0.17, 0.60, 0.045), 0.045, (0.16, 0.42, 0.66)),
]
PHOTO = View(720, 480, 40.0, 12.0), 0.26  # and the height of the eye [m]
# a ball above a stack of two boxes, and a glass that stands beside them
TOWER = [
    Ball((-0.02, 0.56, 0.235), 0.03, (0.20, 0.55, 0.30)),
    Box((-0.085, 0.53, 0.0), (0.045, 0.61, 0.05), (0.80, 0.60, 0.18)),
    Box((-0.06, 0.54, 0.05), (0.02, 0.60, 0.11), (0.70, 0.12, 0.20)),
    Can((0.13, 0.56, 0.0), 0.035, 0.09, (0.16, 0.34, 0.62), (0.25, 0.14, 0.08)),
]
# three balls, two of them in the air
BALLS = [
    Ball((-0.10, 0.58, 0.05), 0.05, (0.82, 0.22, 0.18)),
    Ball((-0.08, 0.58, 0.175), 0.04, (0.16, 0.42, 0.66)),
    Ball((0.10, 0.55, 0.21), 0.045, (0.86, 0.62, 0.12)),
    Box((0.04, 0.51, 0.0), (0.16, 0.59, 0.055), (0.55, 0.25, 0.50)),
]
EXAMPLES = {"milk": TABLE, "tower": TOWER, "balls": BALLS}
SHOWN = (0, 5, 8, 11, 15, 30)  # frames on the sheet
LAYOUT = """# What is in photo.png. The first start writes every guess here, the next one keeps it.
[camera]
fov = {view.fov}  # degrees; known here, since the photograph is drawn
pitch = {view.pitch}

[scene]
end = "0.6 s"
frames = 31
cells = 60

[[object]]
name = "orange"
box = {boxes[0]}
support = "17.3 cm"  # it is in the air: its lowest point is so high above the table

[[object]]
name = "glass of milk"
box = {boxes[1]}
reconstruction = "revolve"
height = "11 cm"  # the one length that is known
material = "milk"

[[object]]
name = "jelly"
box = {boxes[2]}
reconstruction = "extrude"
thickness = 0.67

[[object]]
name = "ball"
box = {boxes[3]}
"""


def box(mask: np.ndarray) -> list[int]:
    """As somebody draws it by hand: some pixels too large."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    return [int(v) for v in (columns[0] - 7, rows[0] - 6, columns[-1] + 8, rows[-1] + 7)]


def sheet(folder: Path, path: Path) -> None:
    """Six frames of the run in a folder, as one picture."""
    from PIL import Image

    from vgmpi.io.run_reader import RunReader
    from vgmpi.postprocess.frames import render_config
    from vgmpi.postprocess.frames.frame_renderer import FrameRenderer

    chosen = render_config.load(folder / "render.toml")
    painter = FrameRenderer(RunReader(folder / "out"), chosen, folder)
    frames = [painter.draw(k)[70:, 50:670] for k in SHOWN]
    rows = [np.concatenate(frames[k : k + 3], axis=1) for k in (0, 3)]
    made = Image.fromarray(np.concatenate(rows))
    made.resize((made.width * 2 // 3, made.height * 2 // 3)).save(path, quality=88)


def main() -> None:
    from PIL import Image

    folder = Path(__file__).parent / "made"
    if sys.argv[1:2] == ["--sheet"]:
        sheet(folder, Path(sys.argv[2]))
        return
    if sys.argv[1:2] == ["--examples"]:
        for name, things in EXAMPLES.items():
            drawn = draw(things, *PHOTO)
            Image.fromarray(drawn.rgb).save(Path(sys.argv[2]) / f"{name}.jpg", quality=88)
            print(name, [box(mask) for mask in drawn.masks])
        return
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else folder
    folder.mkdir(parents=True, exist_ok=True)
    view, eye = PHOTO
    drawn = draw(TABLE, view, eye)
    Image.fromarray(drawn.rgb).save(folder / "photo.png")
    boxes = [box(mask) for mask in drawn.masks]
    (folder / "layout.toml").write_text(LAYOUT.format(view=view, boxes=boxes))
    print(f"{folder}: photo.png and layout.toml")


if __name__ == "__main__":
    main()

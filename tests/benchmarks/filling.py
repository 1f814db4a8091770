"""Compare the choices of `fill` for captures: python -m tests.benchmarks.filling [picture]

Writes the picture of docs/how-to/prepare-captures.md: the figure of
tests/support/hollow_captures.py, as a camera sees it, and cut open.
"""

import itertools
import sys
import tempfile
from pathlib import Path

import numpy as np

from tests.support.hollow_captures import Body, body
from tests.support.small_scenes import scene
from vgmpi.gaussians.camera import Camera, look_at
from vgmpi.gaussians.cloud import GaussianCloud
from vgmpi.gaussians.formats import ply
from vgmpi.gaussians.spherical_harmonics import dc_from_rgb
from vgmpi.postprocess.raster.psnr import psnr
from vgmpi.preprocess.built_object import BuiltObject
from vgmpi.preprocess.object_builder import build_object
from vgmpi.preprocess.pruning import image_similarity
from vgmpi.scene.scene import Scene

PICTURE = Path(__file__).parents[2] / "docs" / "pictures" / "filling.jpg"
CHOICES = ("true", '"visible"', '"closed"', "false")
DIRECTIONS = [step for step in itertools.product((-1, 0, 1), repeat=3) if any(step)]
FOV = 40.0  # [degrees]
TALL, WIDE = 300, 220  # pixels of one picture in the docs
SCENE = """
allow_outside = true
[accuracy]
precision = "double"
[domain]
size = [0.6, 0.6, 0.6]
cell = CELL
[time]
end = 1
[material.clay]
kind = "elastic"
density = 400
youngs_modulus = 1e5
[[object]]
name = "body"
material = "clay"
gaussians = "FILE"
position = [0.3, 0.3, 0.1]
fill = CHOICE
"""
DRAWN, UNSEEN = (0.95, 0.5, 0.1), (0.55, 0.55, 0.55)  # colors of an inside cut open


def scene_of(file: Path, choice: str, cell: float, keys: str = "") -> Scene:
    """A scene with one capture; keys: more lines of its object."""
    text = SCENE.replace("FILE", str(file)).replace("CHOICE", choice).replace("CELL", str(cell))
    return scene(file.parent, text + keys)


def written(folder: Path, name: str) -> tuple[Body, Path]:
    """One of the bodies, and the file it lies in."""
    made, file = body(name), folder / f"{name}.ply"
    ply.write(file, made.cloud)
    return made, file


def around(x: np.ndarray, directions: list, pixels: int) -> list[Camera]:
    """A camera in each direction from points (n, 3) [m], which fill most of its picture."""
    low, high = x.min(axis=0), x.max(axis=0)
    middle, radius = (low + high) / 2, float(np.linalg.norm(high - low)) / 2
    away = 1.1 * radius / np.sin(np.radians(FOV / 2))
    eyes = [middle + away * np.asarray(d) / np.linalg.norm(d) for d in directions]
    return [look_at(eye, middle, (0, 0, 1), FOV, pixels, pixels) for eye in eyes]


def alike(
    with_it: GaussianCloud, without: GaussianCloud, directions: list, pixels: int = 160
) -> np.ndarray:
    """Decibels (n,) between the pictures of two clouds from each direction, inside the outline that
    either of them has."""
    views = around(without.x, directions, pixels)
    pairs = zip(
        image_similarity.render_views(with_it, views),
        image_similarity.render_views(without, views),
        strict=True,
    )
    found = []
    for (a, through), (b, past) in pairs:
        square = ((a.astype(float) - b) ** 2).mean(axis=2)
        found.append(psnr(square[(through < 0.5) | (past < 0.5)]))
    return np.array(found)


def cut(piece: BuiltObject, spacing: float) -> GaussianCloud:
    """The half of a body behind its middle, with what fills it as balls: in one color where it is
    drawn, in another where it has mass only."""
    inner = np.arange(len(piece.cloud)) >= piece.surface_count
    seen = inner & (piece.cloud.opacity > 0)
    sh = np.zeros_like(piece.cloud.sh)
    sh[:, 0] = np.where(seen[:, None], dc_from_rgb(np.array(DRAWN)), dc_from_rgb(np.array(UNSEEN)))
    marked = GaussianCloud(
        piece.cloud.x,
        piece.cloud.quat,
        np.where(inner[:, None], 0.3 * spacing, piece.cloud.scale),
        np.where(inner, 0.95, piece.cloud.opacity),
        np.where(inner[:, None, None], sh, piece.cloud.sh),
    )
    middle = (marked.x[:, 0].min() + marked.x[:, 0].max()) / 2
    return marked.select(marked.x[:, 0] < middle)


def picture(folder: Path) -> np.ndarray:
    """The picture of the docs, uint8: a column per choice."""
    from PIL import Image, ImageDraw, ImageFont

    _, file = written(folder, "figure")
    columns = []
    for choice in CHOICES:
        one = scene_of(file, choice, 0.01)
        piece = build_object(one, 0)
        low, high = piece.cloud.x.min(axis=0), piece.cloud.x.max(axis=0)
        target = (low + high) / 2
        view = look_at(target + (0.95, 0, 0), target, (0, 0, 1), 20, WIDE, TALL)
        label = Image.new("RGB", (WIDE, 26), "white")
        font = ImageFont.load_default(size=17)
        ImageDraw.Draw(label).text((WIDE / 2, 4), f"fill = {choice}", "black", font, anchor="ma")
        tiles = [np.asarray(label)]
        for cloud in (piece.cloud, cut(piece, 0.005)):
            drawn, through = image_similarity.render_views(cloud, [view])[0]
            tiles.append(np.round(255 * drawn).astype(np.uint8))
        columns.append(np.vstack(tiles))
    return np.hstack(columns)


def main(where: Path) -> None:
    from PIL import Image

    with tempfile.TemporaryDirectory() as folder:
        Image.fromarray(picture(Path(folder))).save(where, quality=88)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else PICTURE)

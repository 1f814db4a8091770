"""A photograph of a duck that stands on a table, and the duck as a generator would give it."""

import functools

import numpy as np
from PIL import Image

from tests.support import drawn_photograph
from vgmpi.gaussians import spherical_harmonics as harmonics
from vgmpi.gaussians.formats import ply
from vgmpi.postprocess.raster import rasterize
from vgmpi.preprocess.placement import UP, axis_rotation
from vgmpi.tools.photo.photo_camera import View

VIEW, EYE = View(480, 360, 36.0, 22.0), 0.30
PLACE, TALL = np.array([0.05, 0.62, 0.0]), 0.14
assets = drawn_photograph.load(drawn_photograph.ROOT / "runs" / "assets" / "make_assets.py")


@functools.cache
def duck():
    """Upright, looking along x, the middle of its base at 0 and 1 high."""
    made = assets.duck(20_000, 0.6)
    low, high = made.x.min(axis=0), made.x.max(axis=0)
    base = np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
    size = 1 / (high[2] - low[2])
    return made.transformed(np.eye(3), size, -size * base)


def turn(yaw):
    return axis_rotation((0.0, 0.0, 1.0), np.radians(yaw))


def placed_duck(yaw):
    """In its place, turned by `yaw` degrees."""
    turned = duck().transformed(turn(yaw))
    low, high = turned.x.min(axis=0), turned.x.max(axis=0)
    base = np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
    return turned.transformed(np.eye(3), TALL, PLACE - TALL * base)


@functools.cache
def table():
    return drawn_photograph.drawing.draw([], VIEW, EYE).rgb / 255.0


def photograph(yaw):
    """rgb (height, width, 3) uint8 and the true mask."""
    cloud, camera = placed_duck(yaw), VIEW.camera(np.array([0.0, 0.0, EYE]))
    color = harmonics.evaluate(cloud.sh, cloud.x - camera.eye)
    splats = rasterize.ProjectableGaussians(cloud.x, cloud.cov(), cloud.opacity, color)
    drawn, left = rasterize.render(splats, camera, table())
    return (255 * np.clip(drawn, 0, 1) + 0.5).astype(np.uint8), left < 0.5


def write_duck(path, up="-y", yaw=0.0):
    """The duck as a file whose axis `up` points up, in [-.5, .5]^3, turned by `yaw` in it."""
    cloud = duck().transformed(np.asarray(UP[up], dtype=float).T @ turn(yaw))
    low, high = cloud.x.min(axis=0), cloud.x.max(axis=0)
    size = 1 / (high - low).max()
    ply.write(path, cloud.transformed(np.eye(3), size, -size * (low + high) / 2))


def put(folder, yaw, head="", more=""):
    """photo.png and layout.toml; returns their paths."""
    rgb, mask = photograph(yaw)
    Image.fromarray(rgb).save(folder / "photo.png")
    text = f"[camera]\nfov = {VIEW.fov}\npitch = {VIEW.pitch}\nheight = {EYE}\n{head}\n"
    text += f'[[object]]\nname = "duck"\nbox = {drawn_photograph.bounding_box(mask)}\n{more}\n'
    (folder / "layout.toml").write_text(text)
    return folder / "photo.png", folder / "layout.toml"

"""A drawn photograph of three things whose places and sizes are known, and its layout."""

import functools
import importlib.util
import tomllib
from pathlib import Path

import numpy as np
from PIL import Image

from vgmpi.gaussians.formats import registry
from vgmpi.tools.photo import grabcut
from vgmpi.tools.photo.photo_camera import View

ROOT = Path(__file__).parents[2]


def load(path):
    """A script as a module."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


drawing = load(ROOT / "runs" / "photo" / "make_photo.py")
VIEW, EYE = View(640, 480, 38.0, 18.0), 0.28
NAMES = ("ball", "cup", "box")
THINGS = [
    drawing.Ball((-0.15, 0.54, 0.05), 0.05, (0.82, 0.22, 0.18)),
    drawing.Can((0.0, 0.60, 0.0), 0.04, 0.10, (0.16, 0.34, 0.62), (0.25, 0.14, 0.08)),
    drawing.Box((0.10, 0.53, 0.0), (0.20, 0.60, 0.07), (0.85, 0.65, 0.2)),
]
# lower and upper corners of their extents above the floor [m]
EXTENTS = np.array([
    [[-0.20, 0.49, 0.0], [-0.10, 0.59, 0.10]],
    [[-0.04, 0.56, 0.0], [0.04, 0.64, 0.10]],
    [[0.10, 0.53, 0.0], [0.20, 0.60, 0.07]],
])  # fmt: skip
FORMS = (
    'reconstruction = "inflate"',
    'reconstruction = "revolve"',
    'reconstruction = "extrude"\nthickness = 0.7',
)


@functools.cache
def three():
    """The photograph and the true masks."""
    return drawing.draw(THINGS, VIEW, EYE)


def bounding_box(mask, by=8):
    """A box as somebody draws it by hand: some pixels too large."""
    left, top, right, bottom = grabcut.box_of(mask)
    return [left - by, top - by, right + by, bottom + by]


def layout(heights=(None, "10 cm", None), more=("", "", ""), head=""):
    """The text of the three things' layout."""
    out = [head, f"[camera]\nfov = {VIEW.fov}\npitch = {VIEW.pitch}"]
    for name, mask, form, height, extra in zip(NAMES, three().masks, FORMS, heights, more):
        out += ["[[object]]", f'name = "{name}"', f"box = {bounding_box(mask)}", form, extra]
        if height:
            out.append(f'height = "{height}"')
    return "\n".join(out) + "\n"


def put(folder, text=None):
    """photo.png and layout.toml in a folder; returns their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    photo, where = folder / "photo.png", folder / "layout.toml"
    Image.fromarray(three().rgb).save(photo)
    where.write_text(layout() if text is None else text)
    return photo, where


def eye_of(out):
    """Where the camera of render.toml is [m]; above the floor, in the domain's coordinates."""
    return np.array(tomllib.loads((out / "render.toml").read_text())["camera"]["eye"])


def corners(out, name):
    """Lower and upper corner (2, 3) of an object about the eye, as scene.toml and render.toml have
    it [m]."""
    scene = tomllib.loads((out / "scene.toml").read_text())
    thing = next(one for one in scene["object"] if one["name"] == name)
    x = registry.read(out / thing["gaussians"]).x
    low, high = x.min(axis=0), x.max(axis=0)
    base = [(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]]
    return np.array([low, high]) - base + thing["position"] - eye_of(out)

"""Runs on disk of captures of several render models, and their float64 pictures."""

import numpy as np

from tests.support import dense_rasterizer
from tests.support.drawn_runs import on_paper, write_run
from tests.support.small_scenes import scene as load_scene
from vgmpi.gaussians.cloud import GaussianCloud, unpack_symmetric
from vgmpi.gaussians.formats import registry
from vgmpi.io.run_reader import RunReader
from vgmpi.postprocess.frames import render_config
from vgmpi.postprocess.frames.appearance import Appearance
from vgmpi.postprocess.frames.camera_paths import CameraPath
from vgmpi.postprocess.frames.frame_renderer import FrameRenderer, visible_extent

SCENE = """
[domain]
size = [1, 1, 1]
cell = 0.1
gravity = [0, 0, 0]
[time]
end = 0.04
frames = 2
[material.clay]
kind = "elastic"
density = 400
youngs_modulus = 1e5
[[object]]
name = "ball"
material = "clay"
gaussians = "ball.ply"
height = 0.4
position = [0.3, 0.5, 0.3]
BALL
[[object]]
name = "moon"
role = "scenery"
gaussians = "ball.ply"
height = 0.3
position = [0.75, 0.5, 0.35]
MOON
[[object]]
name = "box"
material = "clay"
shape = { box = [[0, 0, 0], [1, 1, 0.1]] }
"""
PICTURE = """
[camera]
kind = "fixed"
eye = [0.5, -2, 0.6]
target = [0.5, 0.5, 0.4]
[picture]
width = 90
height = 66
background = "#ffffff"
"""


def ball(n=500, seed=0):
    """Capture of a sphere: Gaussians far smaller than a pixel of a small picture."""
    rng = np.random.default_rng(seed)
    x, quat = rng.normal(size=(n, 3)), rng.normal(size=(n, 4))
    return GaussianCloud(
        x / np.linalg.norm(x, axis=1, keepdims=True),
        quat / np.linalg.norm(quat, axis=1, keepdims=True),
        np.exp(rng.uniform(np.log(0.01), np.log(0.05), (n, 3))),
        rng.uniform(0.3, 1.0, n),
        0.3 * rng.normal(size=(n, 4, 3)),
    )


def loaded(folder, ball="", moon=""):
    return load_scene(folder, SCENE.replace("BALL", ball).replace("MOON", moon))


KEYS = {
    "classic": ("", ""),
    "antialiased": ('render_model = "antialiased"',) * 2,
    "mixed": ('render_model = "antialiased"', 'render_model = "mip"'),
    "ball": ('render_model = "antialiased"', ""),
    "mip": ('render_model = "mip"',) * 2,
}


def write_runs(folder):
    """Write a run of each of KEYS into `folder`, and return their folders by name."""
    registry.write(folder / "ball.ply", ball())
    return {name: write_run(loaded(folder, *keys), folder / name) for name, keys in KEYS.items()}


def settings(tmp_path, text=""):
    path = tmp_path / "render.toml"
    path.write_text(on_paper(PICTURE + text))
    return render_config.load(path)


def picture(run, tmp_path, text=""):
    return FrameRenderer(RunReader(run), settings(tmp_path, text), tmp_path).pixels_of(0, 0.0)[0]


def dense_picture(run, tmp_path, lowpass):
    """Float64 picture of a run; lowpass: [pixels^2] of each object, 0 without compensation."""
    reader, chosen = RunReader(run), settings(tmp_path)
    box = lambda: visible_extent(reader)  # noqa: E731
    view = CameraPath(chosen.views()[0], chosen.picture, box, tmp_path).camera_at(0.0, 0.0)
    look = Appearance(reader)
    splats = look.splats(look.frame(0), view.eye)
    objects = np.concatenate([reader.gaussians.scenery.object, reader.gaussians.object])
    own = np.array(lowpass)[objects]
    return dense_rasterizer.render(
        splats.x, unpack_symmetric(splats.cov), splats.opacity, splats.color, view, (1, 1, 1),
        lowpass=np.where(own > 0, own, 0.3), antialias=own > 0,
    )  # fmt: skip

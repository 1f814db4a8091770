"""A dark cup, white inside, with tea: the run's first frame is the photograph, and what is hidden
is not seen."""

import sys
import tomllib

import numpy as np
import pytest
from PIL import Image
from scipy import ndimage

from tests.support.launch import run
from vgmpi.gaussians.formats import registry
from vgmpi.io.run_reader import RunReader
from vgmpi.postprocess.frames import render_config
from vgmpi.postprocess.frames.frame_renderer import FrameRenderer
from vgmpi.tools.photo import hollow_body, preview
from vgmpi.tools.photo.__main__ import main
from vgmpi.tools.photo.hollow_body import Cup
from vgmpi.tools.photo.mask_to_mesh import Profile
from vgmpi.tools.photo.photo_camera import View

pytest.importorskip("cv2", reason="no OpenCV: pip install 'vgmpi[images]'")
VIEW = View(320, 240, 20.0, 50.0)
RADIUS, BASE, RIM = 0.1, -1.25, -1.05  # about the eye, whose axis is at the depth 1
CUP = Cup(Profile(0.0, np.linspace(BASE, RIM, 200), np.linspace(0.06, RADIUS, 200)), 0.015)
DARK, WHITE, TEA = np.array((90, 12, 4)), np.array((240, 230, 215)), np.array((190, 110, 40))
LAYOUT = f"""[camera]
fov = {VIEW.fov}
pitch = {VIEW.pitch}
[scene]
cells = 40
[[object]]
name = "cup"
mask = "cup.png"
reconstruction = "cup"
wall = 0.15
height = "8 cm"
[[object]]
name = "tea"
mask = "tea.png"
inside = "cup"
"""


def drawn():
    """The photograph, and the masks of cup and tea, which is painted a little too large."""
    outer = np.logical_or.reduce([hollow_body._disc(CUP.profile, k, VIEW) for k in range(200)])
    cavity = CUP.cavity
    opening = hollow_body._disc(cavity, len(cavity.heights) - 1, VIEW)
    tea = hollow_body._disc(cavity, int(0.7 * len(cavity.heights)), VIEW) & opening
    rgb = np.full((VIEW.height, VIEW.width, 3), (150, 120, 90))
    for mask, color in (
        (outer, DARK), (hollow_body._disc(CUP.profile, 199, VIEW), WHITE), (tea, TEA),
    ):  # fmt: skip
        rgb = np.where(mask[..., None], color, rgb)
    soft = ndimage.gaussian_filter(rgb.astype(float), (0.7, 0.7, 0))
    return soft.round().astype(np.uint8), outer, ndimage.binary_dilation(tea, iterations=2)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The folder of the scene after its first step."""
    folder = tmp_path_factory.mktemp("tea")
    for name, picture in zip(("photo", "cup", "tea"), drawn()):
        Image.fromarray(picture).save(folder / f"{name}.png")
    (folder / "layout.toml").write_text(LAYOUT)
    out = folder / "out"
    assert main([str(folder / "photo.png"), str(folder / "layout.toml"), "-o", str(out)]) == 0
    short = ["--set", "time.end=1e-5", "--set", "time.frames=2", "-q"]
    ended = run([sys.executable, "-m", "vgmpi", out / "scene.toml", *short])
    assert ended.returncode == 0, ended.stdout + ended.stderr
    return out


def first_frame(out, **light):
    """The first frame 0..1. light: keys of [light] that are added."""
    chosen = render_config.load(out / "render.toml")
    if light:
        chosen = chosen.model_copy(update={"light": render_config.LightSettings(**light)})
    return FrameRenderer(RunReader(out / "out"), chosen, out).draw(0) / 255.0


def test_the_first_frame_of_the_run_is_the_photograph(made):
    """Before, the studio lit the tea once more, and what fills the wall shone through it."""
    rgb, cup, tea = drawn()
    masks = {
        "tea": tea,
        "inside the tea": ndimage.binary_erosion(tea, iterations=6),
        "dark wall": ndimage.binary_erosion(cup & (rgb.max(axis=-1) < 120), iterations=3),
    }
    image = first_frame(made)
    alike = {name: preview.psnr_in_mask(image, rgb, mask) for name, mask in masks.items()}
    print({name: round(float(value), 1) for name, value in alike.items()})
    assert alike["tea"] > 31 and alike["inside the tea"] > 45 and alike["dark wall"] > 48


def test_the_light_of_the_studio_does_not_change_a_liquid(made):
    tea = ndimage.binary_erosion(drawn()[2], iterations=4)
    usual, bright = (first_frame(made, captures=0.0, **keys) for keys in ({}, {"key": 5.0}))
    assert np.abs(usual - bright)[tea].max() < 1.5 / 255


def test_what_the_liquid_leaves_bare_and_its_sides_have_its_color(made):
    """Bodies in their places: the cup below the tea is wet, the tea's sides are not white."""
    scene = tomllib.loads((made / "scene.toml").read_text())
    chosen = render_config.load(made / "render.toml")
    camera = FrameRenderer(RunReader(made / "out"), chosen, made).camera(0.0)
    seen = ndimage.binary_erosion(drawn()[2], iterations=5)
    share = {}
    for entry in scene["object"]:
        cloud = registry.read(made / entry["gaussians"])
        pixels = camera.pixels(cloud.x + np.array(entry["position"]))[0].astype(int)
        inside = seen[pixels[:, 1], pixels[:, 0]] | (entry["name"] == "tea")
        share[entry["name"]] = (np.abs(cloud.rgb - TEA / 255).max(axis=1) < 0.15)[inside].mean()
    print({name: round(float(value), 3) for name, value in share.items()})
    assert min(share.values()) > 0.95


def test_what_fills_solids_is_not_drawn_and_what_fills_liquids_is(made):
    """Colors are fitted to the surface alone, through which a little of the filling would shine."""
    run_ = RunReader(made / "out")
    names = [entry["name"] for entry in run_.objects]
    opacity, owner = np.asarray(run_.gaussians.opacity), np.asarray(run_.gaussians.object)
    for name, is_drawn in (("cup", False), ("tea", True)):
        count = len(registry.read(made / f"{name}.ply"))
        filling = opacity[owner == names.index(name)][count:]
        assert len(filling) > 100 and (filling > 0).any() == is_drawn

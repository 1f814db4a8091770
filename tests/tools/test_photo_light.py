"""The light of a photograph from its shadows: against the light that drew them."""

import tomllib

import numpy as np
import pytest
from PIL import Image
from scipy import ndimage

from tests.support import drawn_photograph
from vgmpi.postprocess.frames.render_config import load
from vgmpi.postprocess.studio import light_rig
from vgmpi.tools.photo import scene_light
from vgmpi.tools.photo.__main__ import main
from vgmpi.tools.photo.photo_camera import View

VIEW = View(300, 200, 40.0, 20.0)
EYE = np.array([0.0, 0.0, 0.5])
MIDDLE, RADIUS = np.array([-0.05, 1.0, 0.2]), 0.08
TRAVEL = np.array([0.5, 0.2, -0.8]) / np.linalg.norm([0.5, 0.2, -0.8])
RANDOM = np.random.default_rng(3)


def degrees_between(a, b):
    cosine = np.dot(a, b) / np.linalg.norm(a) / np.linalg.norm(b)
    return np.degrees(np.arccos(np.clip(cosine, -1, 1)))


def ball_photograph(width, darkness=0.6):
    """A ball above a plain floor under a light of a half width, drawn by rays: photograph, the
    floor alone, the ball's mask, and points on the ball."""
    y, x = np.mgrid[0 : VIEW.height, 0 : VIEW.width] + 0.5
    ray = VIEW.rays(np.stack([x, y], axis=-1))
    place = EYE + ray * (-EYE[2] / np.minimum(ray[..., 2:], -1e-3))
    axes = np.linalg.svd(TRAVEL[None])[2][1:]
    disc = RANDOM.uniform(-1, 1, (90, 2))
    shaded = np.zeros(x.shape)
    disc = disc[np.hypot(*disc.T) < 1]
    for offset in disc:
        shaded += hits_ball(place, -(TRAVEL + width * offset @ axes))
    light = np.where(ray[..., 2] < 0, 1 - darkness * shaded / len(disc), 1.0)
    lit = np.full((*x.shape, 3), 200, np.uint8)
    rgb = (200 * light ** (1 / 2.2) + 0.5).astype(np.uint8)[..., None].repeat(3, axis=-1)
    normal = RANDOM.normal(size=(8000, 3))
    points = MIDDLE + RADIUS * normal / np.linalg.norm(normal, axis=1)[:, None]
    return rgb, lit, hits_ball(np.broadcast_to(EYE, ray.shape), ray), points


def hits_ball(start, ray):
    ray = ray / np.linalg.norm(ray, axis=-1, keepdims=True)
    to = MIDDLE - start
    along = (to * ray).sum(axis=-1)
    return (along > 0) & ((to**2).sum(axis=-1) - along**2 < RADIUS**2)


@pytest.mark.parametrize("width", [0.02, 0.1, 0.3])
def test_direction_width_and_darkness_are_the_true_ones(width):
    rgb, lit, mask, points = ball_photograph(width)
    light = scene_light.fit_light(points, VIEW.camera(EYE, 0.01), rgb, lit, [mask])
    print(light, f"{degrees_between(light.direction, TRAVEL):.1f} degrees")
    assert degrees_between(light.direction, TRAVEL) < 4
    assert 0.5 * width <= light.width <= 2 * width + 0.05
    assert light.darkness == pytest.approx(0.6, abs=0.16)


def test_without_shadows_there_is_no_light():
    _, lit, mask, points = ball_photograph(0.02)
    camera = VIEW.camera(EYE, 0.01)
    assert scene_light.fit_light(points, camera, lit, lit, [mask]) is None
    noise = np.clip(lit + RANDOM.normal(0, 60, lit.shape), 0, 255).astype(np.uint8)
    assert scene_light.fit_light(points, camera, noise, lit, [mask]) is None


def test_the_studio_darkens_the_floor_as_the_shadows():
    light = scene_light.ShadowLight((0.48, 0.0, -0.877), 0.05, 0.7, 1.0)
    keys = scene_light.render_keys(light)
    rig = light_rig.rig(**keys)
    key, sky = rig.key.mean() * rig.toward[2], 0.5 * (rig.horizon + rig.zenith).mean()
    assert key / (key + sky) == pytest.approx(0.7, abs=0.01)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Folders of a drawn photograph with shadows in the background, and with studio shadows."""
    pytest.importorskip("cv2", reason="no OpenCV: pip install 'vgmpi[images]'")
    folder = tmp_path_factory.mktemp("light")
    for word in ("keep", "remove"):
        text = drawn_photograph.layout() + f'[scene]\nshadows = "{word}"\n'
        photo, layout = drawn_photograph.put(folder / word, text)
        assert main([str(photo), str(layout), "-o", str(folder / word / "out")]) == 0
    return folder


@pytest.mark.parametrize("word", ["keep", "remove"])
def test_a_drawn_photograph_has_the_light_that_drew_it(made, word):
    table = tomllib.loads((made / word / "layout.toml").read_text())["light"]
    error = degrees_between(table["direction"], -drawn_photograph.drawing.LIGHT)
    print(f"{error:.1f} degrees, {table}")
    assert error < 5 and table["width"] <= 0.05
    settings = load(made / word / "out" / "render.toml")
    assert degrees_between(settings.light.direction, table["direction"]) < 0.1
    assert settings.captures == 0
    kind = settings.picture.floor.kind
    assert kind == ("photograph" if word == "keep" else None)


def test_shadows_leave_the_background_if_the_layout_asks_for_it(made):
    drawing, drawn = drawn_photograph.drawing, drawn_photograph.three()
    bare = drawing.draw([], drawn_photograph.VIEW, drawn_photograph.EYE).rgb.astype(float)
    outside = ~ndimage.binary_dilation(np.logical_or.reduce(drawn.masks), iterations=4)
    shadow = outside & ((bare - drawn.rgb).mean(-1) > 25)
    error = {}
    for word in ("keep", "remove"):
        out = made / word / "out"
        assert ("shadows:" in (out / "images.log").read_text()) == (word == "remove")
        background = np.asarray(Image.open(out / "background.png"), dtype=float)
        error[word] = np.abs(background - bare)[shadow].mean()
    print(error)
    assert error["remove"] < 0.4 * error["keep"]


def test_a_light_in_the_layout_is_taken(tmp_path):
    pytest.importorskip("cv2", reason="no OpenCV: pip install 'vgmpi[images]'")
    text = drawn_photograph.layout() + "[light]\ndirection = [0, 2, -2]\ndarkness = 0.3\n"
    photo, layout = drawn_photograph.put(tmp_path, text)
    assert main([str(photo), str(layout), "-o", str(tmp_path / "out")]) == 0
    light = load(tmp_path / "out" / "render.toml").light
    assert degrees_between(light.direction, (0, 1, -1)) < 0.1 and light.width == light_rig.WIDTH
    assert "width" not in tomllib.loads(layout.read_text())["light"]


@pytest.mark.parametrize("value", ["[0, 0, 1]", "[1, 0, 0]", "[0, 0]", '"down"', "[nan, 0, -1]"])
def test_a_light_that_does_not_come_from_above_is_one_line(tmp_path, value, capfd):
    text = drawn_photograph.layout() + f"[light]\ndirection = {value}\n"
    photo, layout = drawn_photograph.put(tmp_path, text)
    assert main([str(photo), str(layout), "-o", str(tmp_path / "out")]) == 2
    line = capfd.readouterr().err.strip()
    assert "light.direction" in line and "must" in line and "\n" not in line

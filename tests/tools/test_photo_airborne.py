"""A picture of depths tells which objects are in the air, and how high."""

import numpy as np
import pytest

from tests.support import drawn_photograph
from vgmpi.tools.photo import mask_to_mesh, object_placement
from vgmpi.tools.photo.__main__ import main
from vgmpi.tools.photo.learned_models import Models
from vgmpi.tools.photo.photo_camera import View

pytest.importorskip("cv2", reason="no OpenCV: pip install 'vgmpi[images]'")
drawing, VIEW, EYE = drawn_photograph.drawing, View(400, 300, 38.0, 18.0), drawn_photograph.EYE
BALLS = [
    drawing.Ball((-0.08, 0.55, 0.04), 0.04, (0.2, 0.4, 0.7)),  # on the floor
    drawing.Ball((0.08, 0.60, 0.13), 0.04, (0.8, 0.4, 0.1)),  # 9 cm above it
]


def depths():
    """True depths along the axis [m], (height, width), and the masks of the two balls."""
    at = np.indices((VIEW.width, VIEW.height)).T + 0.5
    ray = VIEW.rays(at).reshape(-1, 3)
    start = np.array([0.0, 0.0, EYE])
    with np.errstate(divide="ignore"):
        depth = np.where(ray[:, 2] < 0, -EYE / ray[:, 2], np.inf)
    depth = np.minimum(depth, 1.0 / ray[:, 1])
    masks = []
    for ball in BALLS:
        t, _, _ = drawing._hit(ball, start, ray)
        masks.append((t < depth).reshape(VIEW.height, VIEW.width))
        depth = np.minimum(depth, t)
    return depth.reshape(VIEW.height, VIEW.width), masks


def nearness(factor=37.0, offset=-4.0):
    """As a model tells it: 1 / depth up to a factor and an offset, with some noise."""
    depth, masks = depths()
    near = factor / depth + offset
    return near + np.random.default_rng(2).normal(0, 0.01 * np.ptp(near), near.shape), masks


def test_the_floor_tells_factor_and_offset():
    near, masks = nearness()
    fit = object_placement.fit_ground_depth(near, masks, VIEW)
    assert fit.factor == pytest.approx(37 / EYE, rel=0.02)
    assert fit.depth(37 / 0.6 - 4) == pytest.approx(0.6 / EYE, rel=0.02)


def test_what_is_in_the_air_is_told_with_its_height():
    near, masks = nearness()
    fit = object_placement.fit_ground_depth(near, masks, VIEW)
    found = []
    for mask in masks:
        points = mask_to_mesh.body(mask, VIEW, "inflate").points
        front = float(np.quantile(points @ VIEW.forward, 0.25))
        found.append(
            object_placement.height_above_ground(near, mask, float(points[:, 2].min()), front, fit)
        )
    assert found[0] is None
    height = found[1][0] * EYE
    print(f"its lowest point is {height:.4f} m above the floor (0.09)")
    assert height == pytest.approx(0.09, rel=0.1)


@pytest.mark.parametrize("what", ["no floor", "upside down"])
def test_what_tells_nothing(what):
    near, masks = nearness()
    if what == "no floor":
        masks = [np.ones_like(masks[0])]
    else:
        near = -near
    assert object_placement.fit_ground_depth(near, masks, VIEW) is None


def test_the_command_writes_it_as_a_guess(tmp_path, monkeypatch):
    drawn = drawing.draw(BALLS, VIEW, EYE)
    drawn_photograph.Image.fromarray(drawn.rgb).save(tmp_path / "photo.png")
    text = f"[camera]\nfov = {VIEW.fov}\npitch = {VIEW.pitch}\n"
    for name, mask, more in zip("ab", drawn.masks, ("height = 0.08", "")):
        text += (
            f'[[object]]\nname = "{name}"\nbox = {drawn_photograph.bounding_box(mask)}\n{more}\n'
        )
    (tmp_path / "layout.toml").write_text(text)

    class Depth:
        def nearness(self, rgb):
            assert rgb.shape == (VIEW.height, VIEW.width, 3)
            return nearness()[0]

    from vgmpi.tools.photo import learned_models, object_masks

    monkeypatch.setattr(learned_models, "load", lambda told: Models(object_masks.grabcut, Depth()))
    out = tmp_path / "out"
    assert main([str(tmp_path / "photo.png"), str(tmp_path / "layout.toml"), "-o", str(out)]) == 0
    corners = drawn_photograph.corners(out, "b") + drawn_photograph.eye_of(out)
    floor = drawn_photograph.corners(out, "a")[0, 2] + drawn_photograph.eye_of(out)[2]
    assert corners[0, 2] - floor == pytest.approx(0.09, rel=0.1)
    assert np.ptp(corners[:, 2]) == pytest.approx(0.08, rel=0.05)
    assert "as depths have it" in (tmp_path / "layout.toml").read_text()

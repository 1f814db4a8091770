"""The studio before a photograph that holds the light of its objects, and drops before a liquid."""

import imageio.v3 as iio
import numpy as np
import pytest

from tests.support import drawn_runs, studio_scenes
from vgmpi.io.run_reader import RunReader
from vgmpi.postprocess.frames import render_config
from vgmpi.postprocess.frames.frame_renderer import FrameRenderer
from vgmpi.postprocess.studio import (
    compositing,
    deferred_shading,
    light_rig,
    liquid_radiance,
    spray_drops,
    studio_ground,
    tone_mapping,
)
from vgmpi.postprocess.studio.studio_settings import optical_values

PHOTOGRAPH = {"background": "photo.png", "width": 64, "height": 48}
LIGHT = (0.6, 0.0, -1.0)
EYE = {"kind": "fixed", "eye": (0.5, -2.0, 1.0), "target": (0.5, 0.5, 0.3)}


def chosen(**picture):
    """Settings of a small picture before a photograph."""
    return render_config.Settings.model_validate(
        {"camera": EYE, "picture": {**PHOTOGRAPH, **picture}, "light": {"direction": LIGHT}}
    )


def test_only_shadows_that_have_come_since_are_left():
    plane = studio_scenes.plain(
        studio_ground.SHADOW, studio_scenes.pyramid(), studio_scenes.dark_rig(key=1.0), texels=8
    )
    light = np.full(plane.light.shape, 0.8, np.float32)
    before = plane._replace(light=light.copy(), far_light=np.ones(3))
    before.light[2, 2] = 0.4  # a shadow that goes, one that stays, one that comes
    before.light[2, 4] = 0.4
    after = before._replace(light=light.copy())
    after.light[2, 4] = 0.4
    after.light[4, 4] = 0.2
    left = studio_ground.new_shadows(after, before).light
    expected = np.ones_like(left)
    expected[4, 4] = 0.25
    np.testing.assert_allclose(left, expected, rtol=1e-6)


def test_the_first_frame_has_no_shadow_but_those_of_the_photograph(tmp_path):
    run = RunReader(drawn_runs.write(tmp_path / "out"))
    iio.imwrite(tmp_path / "photo.png", np.full((48, 64, 3), 160, np.uint8))
    kinds = ("none", "photograph", None)
    bare, held, shaded = (
        [
            FrameRenderer(run, chosen(floor={"kind": kind, "height": -0.2}), tmp_path)
            .draw(k)
            .astype(int)
            for k in (0, 2)
        ]
        for kind in kinds
    )
    seen = [(picture == 160).all(axis=-1) for picture in bare]  # the photograph alone
    assert np.abs(held[0] - bare[0])[seen[0]].max() <= 1
    assert (shaded[0] < bare[0] - 10)[seen[0]].any()  # the floor is in the picture
    assert (held[1] >= shaded[1] - 1)[seen[1]].all()


def test_captures_take_no_light_before_their_photograph():
    assert chosen(floor={"kind": "photograph"}).captures == 0
    assert chosen(floor={}).captures == render_config.Settings().captures == 0.5
    asked = {"picture": {**PHOTOGRAPH, "floor": {"kind": "photograph"}}, "light": {"captures": 0.3}}
    assert render_config.Settings.model_validate(asked).captures == 0.3


def values_of(captured, **picture):
    """Optical values of a white particle with foam."""
    settings = render_config.Settings.model_validate({"picture": picture})
    ones = np.ones(1)
    rig = light_rig.rig(LIGHT)
    (value,) = optical_values(
        np.full((1, 3), 0.6), np.array([captured]), ones, ones, 1.0, settings, rig
    )
    return value


def test_colors_of_liquids_contain_their_light_before_their_photograph_alone():
    before = {**PHOTOGRAPH, "floor": {"kind": "photograph"}}
    captured, plain = values_of(True, **before), values_of(False, **before)
    np.testing.assert_allclose(captured[3:7], (0.6, 0.6, 0.6, 0.0))
    np.testing.assert_allclose(plain[3:7], (0.6, 0.6, 0.6, 1.0))
    assert captured[8] == 1 and plain[8] == 0
    captured, plain = values_of(True), values_of(False)
    assert captured[8] == plain[8] == 0 and captured[6] == plain[6] == 1
    rig = light_rig.rig(LIGHT)
    usual = liquid_radiance.DIRECT * rig.key + liquid_radiance.AMBIENT * rig.horizon
    np.testing.assert_allclose(captured[3:6], 0.6 * (0.5 + 0.5 / usual))
    assert (plain[3:6] == 0.6).all()


@pytest.mark.parametrize("contained", [0.0, 1.0])
def test_a_liquid_whose_color_contains_its_light_takes_none(contained):
    """A turbid pool and a drop before it, under a key of two strengths."""
    s = 0.02
    medium = studio_scenes.water(studio_scenes.grid_points((20, 20, 10), s), s, (0, 0, 0, 0.4, 0.4,
    0.6))  # fmt: skip
    one = np.array([0.0, 0.0, 0.0, 0.5, 0.4, 0.3, 0.0, 5.0, contained])
    medium.tint.values[:] = one
    medium = medium._replace(mean=one)
    drawn = []
    for strength in (0.2, 1.0):
        rig = light_rig.rig(LIGHT, key=strength)
        view = studio_scenes.oblique(40, (0.2, 0.2, 0.2))
        stage = studio_scenes.stage_of(medium, view, rig)
        drawn.append(studio_scenes.draw(stage)[50:70, 50:70])
        p, d, n = np.array([0.2, 0.2, 0.3]), np.array([0.0, 0.0, -1.0]), np.array([0.6, 0.0, 0.8])
        out = np.empty(8)
        spray_drops.shade_drop(stage, p, d, n, np.zeros(3, np.float32), np.empty(72), out)
        drawn.append(out[:3])
    for dim, bright in (drawn[::2], drawn[1::2]):
        if contained:
            np.testing.assert_allclose(bright - dim, 0, atol=2e-3)
            np.testing.assert_allclose(np.broadcast_to(one[3:6], dim.shape), dim, atol=2e-3)
        else:
            assert (bright > 1.2 * dim).all()


@pytest.mark.parametrize("background", ["", 'background = "#ffffff"\n'])
def test_such_a_floor_needs_a_photograph(tmp_path, background):
    path = tmp_path / "render.toml"
    path.write_text(f'[picture]\n{background}floor = {{ kind = "photograph" }}\n')
    with pytest.raises(render_config.SettingsError, match="needs a picture as background"):
        render_config.load(path)


def test_a_drop_shows_the_liquid_behind_it():
    """Dark water over white ground: the drop is as dark as the water beside it."""
    s = 0.02
    medium = studio_scenes.water(studio_scenes.grid_points((20, 20, 10), s), s, (0, 0, 0, 0.4, 0.4,
    0.6),
                          absorbs=(3.0, 6.0, 9.0))  # fmt: skip
    rig = studio_scenes.dark_rig(key=1.0)
    plane = studio_scenes.plain(studio_ground.TILES, studio_scenes.pyramid(), rig)
    stage = studio_scenes.stage_of(medium, studio_scenes.oblique(0, (0.2, 0.2, 0.2)), rig, plane)
    view = stage.buffers
    deferred_shading.shade_background(stage, np.zeros((1, 1, 3), np.float32), 1)
    view.light[:] = view.background
    depth = np.full(view.depth.shape, np.inf, np.float32)
    normal = np.zeros((*depth.shape, 3), np.float32)
    middle, axis = np.array([[0.2, 0.2, 0.35]]), np.array([[0.0, 0.0, 1.0]])
    spray_drops.paint_drops(middle, axis, np.array([0.03]), np.array([0.03]), view, depth, normal)
    hits, normals = studio_scenes.find(stage)
    image, alpha = np.empty((*depth.shape, 3)), np.empty(depth.shape)
    far, keys = np.empty(depth.shape, np.float32), np.empty(depth.shape, np.float32)
    left = np.ones(depth.shape, np.float32)
    pixel = 1.0 / view.lens[0]
    drawn = image, alpha, far, keys
    compositing.compose(stage, left, depth, normal, hits, normals, pixel, 0, *drawn)
    image = tone_mapping.to_linear(image)
    inside = np.isfinite(depth)
    water = image[50:70, 20:30].mean(axis=(0, 1))
    assert inside.sum() > 100 and (water < 0.9 * image.max()).all()
    middle = image[58:62, 58:62].mean(axis=(0, 1))
    np.testing.assert_allclose(middle, water, rtol=0.1)

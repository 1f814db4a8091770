"""Captures are drawn as they were trained, object by object, from their file to the picture."""

import json
from dataclasses import replace

import h5py
import imageio.v3 as iio
import numpy as np
import pytest

from tests.postprocess.test_splat import camera, scene
from tests.support import captured_runs, dense_rasterizer
from tests.support.captured_runs import (
    PICTURE,
    SCENE,
    ball,
    dense_picture,
    loaded,
    picture,
    write_run,
)
from tests.support.drawn_runs import on_paper
from tests.support.picture_noise import psnr
from tests.support.small_scenes import scene as load_scene
from vgmpi.gaussians.camera import Camera
from vgmpi.gaussians.capture_conventions import render_model, with_render_model
from vgmpi.gaussians.cloud import unpack_symmetric
from vgmpi.gaussians.formats import registry
from vgmpi.io import file_layout, hdf5_validation, integrity
from vgmpi.io.run_reader import RunReader, inspect
from vgmpi.postprocess.commands import render
from vgmpi.postprocess.frames import render_config
from vgmpi.postprocess.frames.appearance import Appearance
from vgmpi.postprocess.frames.frame_renderer import FrameRenderer
from vgmpi.postprocess.raster import rasterize
from vgmpi.postprocess.raster.shadow_lighting import Light, shadow_visibility
from vgmpi.preprocess.pruning import image_similarity
from vgmpi.preprocess.scene_builder import build_scene
from vgmpi.runtime.config.schema import SceneError

# a Gaussian of 0.3 pixels: variance 0.09 pixels^2, and what a lowpass leaves of its opacity
PIXELS = 0.3
LEFT = {"classic": 1.0, "antialiased": 0.09 / 0.39, "mip": 0.09 / 0.19}
LOWPASS = {"classic": 0.0, "antialiased": 0.3, "mip": 0.1}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("runs")
    registry.write(path / "ball.ply", ball())
    return path


@pytest.fixture(scope="module")
def runs(folder):
    return captured_runs.write_runs(folder)


def one_gaussian(model, opacity=0.8):
    """A Gaussian of PIXELS in the middle of a pixel, and the camera that sees it."""
    seen = Camera(np.eye(4), 10.0, 10.0, 8.5, 8.5, 17, 17)
    variance = (PIXELS / 10.0 * 2.0) ** 2  # at a depth of 2 m
    cov = np.array([[variance, 0, 0, variance, 0, variance]])
    own = np.array([LOWPASS[model]])
    middle, alone = np.array([[0.0, 0.0, 2.0]]), np.array([opacity])
    return rasterize.ProjectableGaussians(middle, cov, alone, np.zeros((1, 3)), own), seen


@pytest.mark.parametrize("model", LEFT)
def test_a_gaussian_smaller_than_a_pixel_keeps_its_light(model):
    """What it hides in all is opacity 2 pi sigma^2 [pixels], as before the lowpass."""
    splats, seen = one_gaussian(model)
    through = rasterize.render(splats, seen, alpha_min=1e-5)[1]
    assert 1 - through[8, 8] == pytest.approx(0.8 * LEFT[model], rel=1e-6)
    variance = LOWPASS[model] or 0.3
    share = (1 - through).sum() / (0.8 * 2 * np.pi * PIXELS**2)
    steps = np.exp(-0.5 * np.arange(-8, 9) ** 2 / (PIXELS**2 + variance)).sum() ** 2
    want = LEFT[model] * steps / (2 * np.pi * PIXELS**2)  # sampled at the pixels' centers
    assert share == pytest.approx(want, rel=1e-3)
    if model != "mip":  # whose lowpass is too small to sample a Gaussian evenly
        assert share == pytest.approx({"classic": 0.39 / 0.09, "antialiased": 1.0}[model], rel=0.02)


@pytest.mark.parametrize("seed", range(3))
def test_a_mixed_picture_is_that_of_the_dense_renderer(seed):
    splats, seen = scene(seed=seed), camera()
    own = np.random.default_rng(seed).choice([0.0, 0.1, 0.3], len(splats.x))
    arrays = splats.x, unpack_symmetric(splats.cov), splats.opacity, splats.color
    want, left = dense_rasterizer.render(
        *arrays, seen, (1, 1, 1), lowpass=np.where(own > 0, own, 0.3), antialias=own > 0
    )
    mixed = replace(splats, compensated_lowpass=own)
    image, through = rasterize.render(mixed, seen)
    error = np.abs(image - want)
    assert error.mean() < 1e-6 and np.quantile(error, 0.999) < 1e-5
    assert np.abs(through - left).max() < 5e-3


def test_options_go_before_what_the_captures_say():
    splats, seen = scene(), camera()
    own = np.random.default_rng(0).choice([0.0, 0.1, 0.3], len(splats.x))
    mixed = replace(splats, compensated_lowpass=own)
    for options in ({"antialias": False}, {"antialias": True}, {"lowpass": 0.1, "antialias": True}):
        for got, want in zip(
            rasterize.render(mixed, seen, **options), rasterize.render(splats, seen, **options)
        ):
            np.testing.assert_array_equal(got, want)
    wide = replace(splats, compensated_lowpass=np.where(own > 0, 0.5, 0.0))
    got = rasterize.render(mixed, seen, lowpass=0.5)[0]
    np.testing.assert_array_equal(got, rasterize.render(wide, seen, lowpass=0.5)[0])


def test_a_classic_picture_is_the_same_with_and_without_flags():
    splats, seen = scene(), camera()
    flagged = replace(splats, compensated_lowpass=np.zeros(len(splats.x)))
    got, want = rasterize.render(flagged, seen), rasterize.render(splats, seen)
    np.testing.assert_array_equal(got[0], want[0])
    np.testing.assert_array_equal(got[1], want[1])


def test_joined_parts_keep_their_flags():
    a, b = scene(4, 1), scene(3, 2)
    assert rasterize.join_gaussians([a, b]).compensated_lowpass is None
    assert rasterize.join_gaussians([a]) is a
    flagged = replace(b, compensated_lowpass=np.full(3, 0.1))
    joined = rasterize.join_gaussians([a, flagged])
    np.testing.assert_array_equal(joined.compensated_lowpass, [0, 0, 0, 0, 0.1, 0.1, 0.1])
    np.testing.assert_array_equal(joined.x, np.concatenate([a.x, b.x]))


def test_a_capture_has_a_model():
    cloud = ball(10)
    assert render_model(cloud) == "classic"
    assert render_model(replace(cloud, is_antialiased=True)) == "mip"  # as Brush means it
    for model in LEFT:
        assert render_model(with_render_model(cloud, model)) == model
    assert with_render_model(cloud, "mip").lowpass == 0.1


# ---- from the file to the picture --------------------------------------------------------------


@pytest.mark.parametrize("name, lowpass", [
    ("classic", (0, 0, 0)), ("antialiased", (0.3, 0.3, 0)), ("mixed", (0.3, 0.1, 0)),
    ("ball", (0.3, 0, 0)), ("mip", (0.1, 0.1, 0)),
])  # fmt: skip
def test_each_object_is_drawn_as_it_was_trained(runs, tmp_path, name, lowpass):
    image, through, *_ = picture(runs[name], tmp_path)
    want, left = dense_picture(runs[name], tmp_path, lowpass)
    assert psnr(image, want) > 80 and psnr(through, left) > 80
    if name != "classic":  # the measure tells the models apart
        classic = dense_picture(runs[name], tmp_path, (0, 0, 0))[0]
        assert psnr(classic, want) < 30


@pytest.mark.parametrize("mode, like", [("classic", "classic"), ("capture", "mixed")])
def test_the_settings_may_draw_all_alike(runs, tmp_path, mode, like):
    got = picture(runs["mixed"], tmp_path, f'[splatting]\nmode = "{mode}"')
    want = picture(runs[like], tmp_path)
    np.testing.assert_array_equal(got[0], want[0])


def test_the_studio_draws_objects_by_their_models(runs, tmp_path):
    """Its picture of one model for all is that of the same mode; a mixed one is in between."""

    def studio(name, text=""):
        path = tmp_path / "render.toml"
        path.write_text(PICTURE.replace('background = "#ffffff"', "edge_samples = 1") + text)
        chosen = render_config.load(path)
        return FrameRenderer(RunReader(runs[name]), chosen, tmp_path).draw(0).astype(float)

    classic, both = studio("classic"), studio("antialiased")
    assert psnr(classic / 255, both / 255) < 40
    half = studio("ball")
    left, right = np.s_[:, :36], np.s_[:, 57:]
    assert np.abs(half[left] - both[left]).mean() < 0.2 * np.abs(half[left] - classic[left]).mean()
    assert (
        np.abs(half[right] - classic[right]).mean() < 0.2 * np.abs(half[right] - both[right]).mean()
    )
    alike = studio("antialiased", '[splatting]\nmode = "classic"')
    np.testing.assert_array_equal(alike, classic)


def test_a_file_that_says_it_needs_no_key(tmp_path, runs):
    """Crop, placement, filling and pruning keep what the file says; a key goes before it."""
    registry.write(tmp_path / "ball.ply", replace(ball(), is_antialiased=True))
    select = 'select = { min_opacity = 0.31 }\nprune = "versagauss"\nprune_scale = 0.3'
    entries = build_scene(loaded(tmp_path, select, 'render_model = "classic"')).objects
    assert [entry.get("render_model") for entry in entries] == ["mip", None, None]
    assert write_run(loaded(tmp_path), tmp_path / "out")
    told = RunReader(tmp_path / "out").objects
    assert [e.get("render_model") for e in told] == ["mip", "mip", None]
    image = picture(tmp_path / "out", tmp_path)[0]
    np.testing.assert_array_equal(image, picture(runs["mip"], tmp_path)[0])


def test_carried_gaussians_have_the_model_of_their_object(folder, tmp_path):
    thin = 'prune = "versagauss"\nprune_scale = 0.3\npassive_gaussians = true\n'
    out = write_run(loaded(folder, thin + 'render_model = "mip"'), tmp_path / "out")
    look = Appearance(RunReader(out))
    scenery, particles, carried = (p.compensated_lowpass for p in look.parts(look.frame(0)))
    assert (scenery == 0).all() and len(carried) > 0 and (carried == 0.1).all()
    np.testing.assert_array_equal(particles, np.where(look.object == 0, 0.1, 0.0))


def test_pruning_compares_pictures_as_they_will_be_drawn():
    cloud = ball()
    cloud = replace(cloud, x=cloud.x * 20)  # from afar
    views = image_similarity.cameras(cloud.x, 60)[:1]
    plain, own = (
        image_similarity.render_views(c, views)[0][1]
        for c in (cloud, replace(cloud, is_antialiased=True))
    )
    assert (1 - own).sum() < 0.5 * (1 - plain).sum()


def test_shadows_know_the_model_too():
    """Far smaller than a pixel of the shadow map, antialiased Gaussians hide next to nothing."""
    rng = np.random.default_rng(0)
    x = np.concatenate([rng.uniform(-1, 1, (4000, 3)) * [1, 1, 0.01], [[0.0, 0.0, -1.0]]])
    cov = np.tile(np.array([1, 0, 0, 1, 0, 1]) * 1e-8, (len(x), 1))
    splats = rasterize.ProjectableGaussians(x, cov, np.full(len(x), 0.99), np.zeros((len(x), 3)))
    light = Light(direction=(0.0, 0.0, -1.0), softness=0.3)
    lit = shadow_visibility(splats, light)[-1]
    flagged = replace(splats, compensated_lowpass=np.full(len(x), 0.3))
    assert shadow_visibility(flagged, light)[-1] == 1.0 > lit


def test_what_is_off_takes_no_bytes(runs, folder, tmp_path):
    """An entry of an object has the key only where it is not classic; the rest is the same."""
    said = write_run(loaded(folder, 'render_model = "classic"'), tmp_path / "said")
    texts = {}
    for name, path in (("never", runs["classic"]), ("said", said), ("on", runs["antialiased"])):
        with h5py.File(path / file_layout.GAUSSIANS) as f:
            texts[name] = f["objects"][()]
            names = set(f) | {f"scenery/{key}" for key in f["scenery"]}
            texts[name, "names"] = names
    assert texts["never"] == texts["said"] and b"render_model" not in texts["never"]
    assert texts["never", "names"] == texts["on", "names"]
    assert json.loads(texts["on"])[0]["render_model"] == "antialiased"


def test_inspect_names_the_model(runs):
    lines = inspect(runs["mixed"] / file_layout.GAUSSIANS).splitlines()
    found = [line for line in lines if line.startswith("object")]
    assert found[0].endswith(", render model antialiased")
    assert found[1].endswith(", render model mip") and "model" not in found[2]
    assert "model" not in inspect(runs["classic"] / file_layout.GAUSSIANS)


@pytest.mark.parametrize("value", ["fuzzy", ["mip"], None])
def test_an_unknown_model_in_a_file_is_refused(runs, value):
    reader = RunReader(runs["mixed"])
    reader.gaussians.objects[0]["render_model"] = value
    with pytest.raises(hdf5_validation.CorruptFileError, match="render model"):
        integrity.check_objects(reader.gaussians)


def test_a_scene_says_what_is_wrong(folder):
    with pytest.raises(SceneError, match=r"render_model: must be one of classic, antialiased, mip"):
        loaded(folder, 'render_model = "aa"')
    text = SCENE.replace("BALL", "").replace("MOON", "")
    with pytest.raises(SceneError, match="render_model: is only for objects made of gaussians"):
        load_scene(folder, text + 'render_model = "mip"\n')


def test_render_writes_the_same_picture(runs, tmp_path):
    """The command, from its files."""
    path = tmp_path / "render.toml"
    path.write_text(on_paper(PICTURE))
    argv = [str(runs["mixed"]), str(path), "--frame", "0", "-o", str(tmp_path / "a.png")]
    assert render.main(argv) == 0
    want = dense_picture(runs["mixed"], tmp_path, (0.3, 0.1, 0))[0]
    assert np.abs(iio.imread(tmp_path / "a.png") / 255 - np.clip(want, 0, 1)).max() < 0.01

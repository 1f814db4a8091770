"""A drawn photograph of three things becomes a scene without any weights: masks, places, sizes and
the first frame against the truth, and the scene runs."""

import sys
import time
import tomllib

import numpy as np
import pytest
from PIL import Image
from scipy import ndimage

from tests.support import drawn_photograph
from tests.support.launch import run
from vgmpi.io.run_reader import RunReader
from vgmpi.postprocess.frames import render_config
from vgmpi.postprocess.frames.frame_renderer import FrameRenderer
from vgmpi.tools.photo import grabcut, preview
from vgmpi.tools.photo.__main__ import main

cv2 = pytest.importorskip("cv2", reason="no OpenCV: pip install 'vgmpi[images]'")
SECONDS = 60.0  # of processor time


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The folder that the command makes, and its seconds of processor time."""
    folder = tmp_path_factory.mktemp("photo")
    photo, layout = drawn_photograph.put(folder)
    begun = time.process_time()
    assert main([str(photo), str(layout), "-o", str(folder / "out")]) == 0
    return folder, time.process_time() - begun


def test_masks_find_the_things(made):
    folder, _ = made
    found = [
        np.asarray(Image.open(folder / "out/masks" / f"{n}.png")) > 0
        for n in drawn_photograph.NAMES
    ]
    scores = [grabcut.iou(a, b) for a, b in zip(found, drawn_photograph.three().masks)]
    print("IoU", np.round(scores, 4))
    assert min(scores) >= 0.95


@pytest.mark.parametrize("k", range(3), ids=drawn_photograph.NAMES)
def test_places_and_sizes_are_the_true_ones(made, k):
    truth = drawn_photograph.EXTENTS[k] - (0, 0, drawn_photograph.EYE)
    found = drawn_photograph.corners(made[0] / "out", drawn_photograph.NAMES[k])
    size = np.ptp(found, axis=0) / np.ptp(truth, axis=0) - 1
    depth = found.mean(axis=0) @ drawn_photograph.VIEW.forward
    true_depth = truth.mean(axis=0) @ drawn_photograph.VIEW.forward
    off = np.linalg.norm(found.mean(axis=0) - truth.mean(axis=0)) / np.linalg.norm(truth.mean(0))
    print(f"size {size.round(4)}, depth {depth / true_depth - 1:.4f}, place {off:.4f}")
    assert np.abs(size).max() <= 0.03
    assert abs(depth / true_depth - 1) <= 0.05
    assert off <= 0.03


def test_it_takes_less_than_a_minute(made):
    print(f"{made[1]:.1f} s of processor time")
    assert made[1] < SECONDS


def test_the_scene_is_right_runs_and_begins_as_the_photograph(made):
    out = made[0] / "out"
    command = [sys.executable, "-m", "vgmpi", out / "scene.toml"]
    checked = run([*command, "--check"])
    assert checked.returncode == 0 and "0 errors" in checked.stdout, checked.stderr
    short = ["--set", "time.end=0.02", "--set", "time.frames=3", "-q"]
    ran = run([*command, *short])
    assert ran.returncode == 0, ran.stdout + ran.stderr
    painter = FrameRenderer(RunReader(out / "out"), render_config.load(out / "render.toml"), out)
    drawn = painter.draw(0) / 255.0
    truth = drawn_photograph.three()
    alike = [preview.psnr_in_mask(drawn, truth.rgb, mask) for mask in truth.masks]
    print("dB inside the masks", np.round(alike, 2))
    assert min(alike) >= 25
    outside = ~np.logical_or.reduce(truth.masks)
    assert preview.psnr_in_mask(drawn, truth.rgb, outside) >= 25


def test_what_is_written(made):
    out = made[0] / "out"
    for name in drawn_photograph.NAMES:
        crop = np.asarray(Image.open(out / "crops" / f"{name}.png"))
        mask = np.asarray(Image.open(out / "masks" / f"{name}.png")) > 0
        assert crop.shape[0] == crop.shape[1] and (crop[..., 3] > 0).sum() == mask.sum()
        assert crop.shape[0] == pytest.approx(1.2 * max(np.ptp(np.nonzero(mask), axis=1)), abs=4)
    lines = (out / "images.log").read_text().splitlines()
    for name in drawn_photograph.NAMES:
        said = [line for line in lines if line.startswith(f"'{name}'")]
        assert any("grabcut" in line for line in said) and any("away" in line for line in said)
        assert any("guessed" in line for line in said) and any("dB" in line for line in said)
    check = np.asarray(Image.open(out / "check.png"))
    assert check.shape == (480, 2 * 640 + 6, 3)
    assert not list(out.rglob("*.part"))


def test_the_background_has_no_objects(made):
    background = np.asarray(Image.open(made[0] / "out" / "background.png")).astype(float)
    truth = drawn_photograph.three()
    bare = drawn_photograph.drawing.draw([], drawn_photograph.VIEW, drawn_photograph.EYE).rgb
    gap = ndimage.binary_dilation(np.logical_or.reduce(truth.masks), iterations=3)
    other = cv2.inpaint(truth.rgb, gap.astype(np.uint8), 4, cv2.INPAINT_TELEA).astype(float)
    ours, theirs = (np.abs(one[gap] - bare[gap]).mean() for one in (background, other))
    print(f"behind the objects off by {ours:.1f} of 255, by OpenCV's inpainting {theirs:.1f}")
    assert ours < 0.75 * theirs
    for mask in truth.masks:
        before = np.abs(truth.rgb[mask].astype(float) - bare[mask]).mean()
        assert np.abs(background[mask] - bare[mask]).mean() < 0.5 * before
    outside = ~np.logical_or.reduce(truth.masks)
    assert np.abs(background[outside] - truth.rgb[outside]).mean() < 1


def test_a_second_run_keeps_what_was_guessed_and_what_was_changed(made, tmp_path):
    photo, layout = drawn_photograph.put(tmp_path, (made[0] / "layout.toml").read_text())
    text = layout.read_text()
    assert all(f"\n{key} = " in text for key in ("mask", "material", "support", "distance"))
    text = text.replace('material = "rubber"', 'material = "jelly" # by hand')
    text = text.replace('mask = "out/', f'mask = "{made[0].as_posix()}/out/')
    layout.write_text(text)
    assert main([str(photo), str(layout), "-o", str(tmp_path / "again")]) == 0
    assert layout.read_text() == text
    first, second = made[0] / "out", tmp_path / "again"
    for name in drawn_photograph.NAMES:
        before, after = (drawn_photograph.corners(out, name) for out in (first, second))
        assert np.allclose(before, after, atol=2e-4)
    scene = tomllib.loads((second / "scene.toml").read_text())
    assert scene["material"]["jelly"]["preset"] == "jelly" and "rubber" not in scene["material"]


def test_a_scene_that_was_changed_is_kept(made, capsys):
    out = made[0] / "out"
    text = (out / "scene.toml").read_text()
    command = [str(made[0] / "photo.png"), str(made[0] / "layout.toml"), "-o", str(out)]
    (out / "scene.toml").write_text(text.replace("end = 1.0", "end = 2.0"))
    assert main(command) == 2
    assert "scene.toml: is not as this command made it" in capsys.readouterr().err
    assert "end = 2.0" in (out / "scene.toml").read_text()
    assert main([*command, "--overwrite"]) == 0
    assert "end = 1.0" in (out / "scene.toml").read_text()

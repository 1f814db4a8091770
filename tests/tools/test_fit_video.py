"""Fits to a video: what was put in is found, a camera that is off is made up for, and the pictures
that are compared are those of the same moments."""

import csv
import shutil

import imageio_ffmpeg
import numpy as np
import pytest
from scipy import ndimage

from tests.benchmarks.recovery import aside, view
from tests.support.fit_scenes import BALL, FIT, reference, refused, write_fit
from vgmpi.io.run_reader import RunReader
from vgmpi.postprocess.commands import render
from vgmpi.postprocess.frames.image_io import to_bytes, write_png
from vgmpi.runtime import process_limits
from vgmpi.scene.loader import load
from vgmpi.tools.fit import __main__, video_target
from vgmpi.tools.fit import __main__ as fit
from vgmpi.tools.fit.__main__ import target_of
from vgmpi.tools.fit.fit_config import FitFile
from vgmpi.tools.fit.target_base import Pictures
from vgmpi.tools.fit.video_reader import pictures_in, scaled

KEY = "material.rubber.youngs_modulus"
CAMERA = ((0.12, -0.5, 0.15), (0.12, 0.12, 0.08), 20)
TARGET = FIT[FIT.index("[target]") : FIT.index("[method]")]


def text(keys):
    return FIT.replace(TARGET, f'[target]\nrender = "render.toml"\n{keys}\n')


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """With a reference run, and videos of it: a film, pictures, pictures of a camera that is off by
    a pixel down and to the left."""
    found = tmp_path_factory.mktemp("video")
    out = reference(found, BALL)
    (found / "render.toml").write_text(view(*CAMERA))
    eye, target, fov = CAMERA
    (found / "off.toml").write_text(view(eye, aside(eye, target, fov), fov))
    for name, to in (("render", "film.mp4"), ("render", "pictures"), ("off", "off")):
        called = [str(out), str(found / f"{name}.toml"), "-q", "-o", str(found / to)]
        assert render.main(called) == 0
    return found


def found_in(folder, keys, name, capsys=None):
    scene, file = write_fit(folder, BALL, text(keys))
    assert fit.main([str(scene), str(file), "-o", str(folder / name)]) == 0
    return load(folder / name / "fitted.toml").material["rubber"].youngs_modulus


@pytest.mark.parametrize("name", ["film.mp4", "pictures"])
def test_what_was_put_in_is_found(folder, name, capsys):
    out = f"of_{name}"
    assert found_in(folder, f'video = "{name}"', out) == pytest.approx(2e4, rel=0.01)
    times = ", 0.04 s apart, over 0.24 s" if name == "film.mp4" else ""
    assert capsys.readouterr().out.startswith(f"target {name}: 7 pictures{times}\n")
    with open(folder / out / "fit.csv") as f:
        rows = list(csv.DictReader(f))
    assert float(rows[0]["loss"]) > 1 and len(rows) <= 40
    best = min(rows, key=lambda row: float(row["loss"]))
    assert float(best["loss"]) < 0.2 and 0 < float(best["holdout_loss"]) < 0.3
    report = (folder / out / "report.md").read_text()
    assert "Held out: " in report and "Compared: 7 pictures of 128 x 96 pixels." in report


def halves(path):
    """Left and right of a video of two beside each other (frames, height, width, 3)."""
    frames = imageio_ffmpeg.read_frames(str(path))
    width, height = next(frames)["size"]
    assert (width, height) == (2 * 128 + 2, 96)
    shown = np.stack([np.frombuffer(f, np.uint8).reshape(height, width, 3) for f in frames])
    return shown[:, :, :128].astype(int), shown[:, :, 130:].astype(int)


def test_target_and_fit_are_shown_beside_each_other(folder, capsys):
    found_in(folder, 'video = "pictures"', "shown")
    asked = np.stack(list(pictures_in(folder / "pictures"))).astype(int)
    for half in halves(folder / "shown" / "beside.mp4"):
        assert len(half) == 7 and np.abs(half - asked).mean() < 2
    assert np.abs(asked[0] - asked[4]).mean() > 1  # it moves


def test_the_target_is_to_the_left(folder):
    reference(folder, BALL, {KEY: 2e5}, "stiff")
    target = made_target(folder, 'video = "pictures"')
    __main__.write_comparison(target, folder / "stiff", folder / "two.mp4")
    left, right = halves(folder / "two.mp4")
    asked = np.stack(list(pictures_in(folder / "pictures"))).astype(int)
    other = to_bytes(Pictures(folder / "render.toml").render_run(folder / "stiff", list(range(7))))
    assert np.abs(left - asked).mean() < 2 and np.abs(right - other).mean() < 2
    assert np.abs(right[4] - asked[4]).mean() > 2


def test_frames_of_another_run_are_shown_too_where_render_is_given(folder, capsys):
    scene, file = write_fit(
        folder, BALL, text('run = "reference"\n[method]\nmax_runs = 12\nscan_points = 4')
    )
    file.write_text(file.read_text().partition("[method]\nmax_runs = 40")[0])
    assert fit.main([str(scene), str(file), "-o", str(folder / "bodies")]) == 0
    assert (folder / "bodies" / "beside.mp4").stat().st_size > 1000
    file.write_text(file.read_text().replace('render = "render.toml"\n', ""))
    assert fit.main([str(scene), str(file), "-o", str(folder / "plain")]) == 0
    assert not (folder / "plain" / "beside.mp4").exists()


def test_a_camera_that_is_off_is_made_up_for(folder, capsys):
    """Its pictures lie .8 pixels to the left and .6 below: so far runs are moved."""
    own = found_in(folder, 'video = "off"\nmax_camera_shift = 3', "moved")
    assert own == pytest.approx(2e4, rel=0.01)
    (line,) = [s for s in (folder / "moved/report.md").read_text().splitlines() if "moved by" in s]
    right, down = (float(word) for word in line.split() if word[0] in "+-")
    assert right == pytest.approx(-0.8, abs=0.05) and down == pytest.approx(0.6, abs=0.05)
    assert found_in(folder, 'video = "off"', "still") != pytest.approx(2e4, rel=0.02)


def test_a_camera_is_off_by_no_more_than_it_may(folder, capsys):
    found_in(folder, 'video = "off"\nmax_camera_shift = 0.5', "little")
    report = (folder / "little" / "report.md").read_text()
    assert (
        "moved by -0.50 to the right and +0.50 down (as far as max_camera_shift lets it)" in report
    )


def made_target(folder, keys, scene=BALL):
    write_fit(folder, scene, text(keys))
    return target_of(FitFile(folder / "fit.toml", load(folder / "scene.toml")))


def test_pictures_of_the_same_moments_are_compared(folder):
    """A video that begins later and has pictures between the frames; loss 0 of the very run."""
    own = sorted((folder / "pictures").glob("*.png"))
    late = folder / "late"
    late.mkdir()
    for k in range(2, 7):  # frames of .02 .. .06 s, each with one between that shows nothing of it
        shutil.copy(own[k], late / f"{2 * k}.png".zfill(8))
        shutil.copy(own[0], late / f"{2 * k + 1}.png".zfill(8))
    target = made_target(folder, 'video = "late"\nframe_time = "5 ms"\ntime_offset = 0.02')
    assert target.frames == [2, 3, 4, 5, 6] and target.used.tolist() == [0, 2, 4, 6, 8]
    fitted, held = target.residual(folder / "reference", 2)
    assert all(np.sqrt(np.mean(off**2)) < 0.02 for off in (fitted, held))
    wrong = made_target(folder, 'video = "late"\nframe_time = "5 ms"\ntime_offset = 0.01')
    assert np.sqrt(np.mean(wrong.residual(folder / "reference", 2)[0] ** 2)) > 0.5


def test_some_frames_are_held_out(folder):
    target = made_target(folder, 'video = "pictures"\nholdout_every = 3')
    assert target.held_pictures.tolist() == [False, False, True, False, False, True, False]
    each = [12 * 16 * 3, 48 * 64 * 3, 96 * 128 * 3]  # as far apart as they are blurred
    for stage in range(3):
        off = target.residual(folder / "reference", stage)
        assert [len(x) for x in off] == [5 * each[stage], 2 * each[stage]]


def test_videos_are_scaled_to_what_is_compared(folder):
    target = made_target(folder, 'video = "film.mp4"\npixels = 64\nblur = [4, 1]')
    assert target.stages == 2 and len(target.values[1]) == 7 * 48 * 64 * 3
    assert len(target.values[0]) == 7 * 12 * 16 * 3
    # white noise that is blurred over so many pixels errs together on 4 pi as many squared
    assert target.correlated_counts == pytest.approx([4 * np.pi, 4 * np.pi])
    fitted, _ = target.residual(folder / "reference", 1)
    assert np.sqrt(np.mean(fitted**2)) < 0.2


@pytest.mark.parametrize("preset, studio", [(None, False), ("paper", False), ("studio", True)])
def test_a_fit_draws_gaussians_unless_it_is_told_otherwise(tmp_path, preset, studio):
    asked = view(*CAMERA).replace('[look]\npreset = "paper"\n', "")
    more = f'[look]\npreset = "{preset}"\n' if preset else ""
    (tmp_path / "render.toml").write_text(asked + more)
    assert Pictures(tmp_path / "render.toml").chosen.studio == studio


def test_a_run_is_drawn_as_the_renderer_draws_it(folder):
    own = Pictures(folder / "render.toml").render_run(folder / "reference", [0, 3])
    for picture, name in zip(own, ("frame_00000.png", "frame_00003.png")):
        (there,) = pictures_in_one(folder / "pictures" / name)
        assert (to_bytes(picture) == there).all()
    assert len(RunReader(folder / "reference")) == 7


def pictures_in_one(path):
    folder = path.parent / f"only_{path.stem}"
    folder.mkdir(exist_ok=True)
    shutil.copy(path, folder)
    return list(pictures_in(folder))


@pytest.mark.parametrize("by", [(1, 0), (0, -2), (0.3, -0.7), (-1.4, 2.2), (0.5, 0.5)])
def test_pictures_are_moved(by):
    """As splines of scipy move them; by whole pixels exactly."""
    noise = np.random.default_rng(0).normal(size=(2, 40, 50, 3))
    film = ndimage.gaussian_filter(noise, (0, 2, 2, 0)).astype(np.float32)
    other = ndimage.shift(film, (0, *by, 0), order=3, mode="nearest")
    inside = np.s_[:, 6:-6, 6:-6]
    moved = video_target.shifted(film, np.array(by, float))[inside]
    assert np.abs(moved - other[inside]).max() < 0.005 * np.abs(film).max()


def test_what_does_not_fit_is_refused(folder, monkeypatch, capsys):
    monkeypatch.setattr(process_limits, "available_memory", lambda swap=False: 3 << 20)
    _, told = refused(capsys, folder, text('video = "pictures"'), "large")
    assert "target.pixels: 40 runs of such pictures take 0.0487 GiB; 0.00293 GiB are free" in told


def test_pictures_of_all_kinds_are_read(tmp_path):
    grey = np.arange(96, dtype=np.uint8).reshape(8, 12)
    kinds = {"grey": grey[..., None].repeat(3, 2), "opaque": np.dstack([grey] * 3 + [grey * 0 + 9])}
    for k, picture in enumerate(kinds.values()):
        write_png(tmp_path / f"{k}.png", picture)
    found = list(pictures_in(tmp_path))
    assert all((picture == grey[..., None]).all() for picture in found) and len(found) == 2
    assert scaled(found[0], 6, 4).shape == (4, 6, 3)
    assert scaled(found[0], 6, 4)[0, 0, 0] == pytest.approx(grey[:2, :2].mean() / 255, abs=0.003)


def plain(folder):
    """A film in which nothing moves."""
    for k in range(3):
        write_png(folder / "plain_film" / f"{k}.png", np.full((96, 128, 3), 90, np.uint8))


VIDEO = 'video = "pictures"'
WRONG = {
    "no render": (VIDEO, "render = ", 5, "target: a video needs render"),
    "no such video": ('video = "film.mp"', "", 7, "target.video: no such file"),
    "an empty folder": ('video = "."', "", 7, "target.video: is a folder without .png"),
    "no film": ('video = "scene.toml"', "", 7, "target.video: no video that ffmpeg reads"),
    "of another shape": ('video = "wide"', "", 7, "target.video: is 128 x 64 pixels; render.toml"),
    "one picture": ('video = "one"', "", 7, "target.video: has 1 pictures"),
    "nothing moves": ('video = "plain_film"', "", 7, "target.video: shows nothing that changes"),
    "too long": ('video = "long"', "", 7, "target.video: has 8 pictures; of the scene 7 frames"),
    "blurred more and more": (f"{VIDEO}\nblur = [1, 2]", "", 8, "target.blur: must be one number"),
    "pixels of a stamp": (f"{VIDEO}\npixels = 8", "", 8, "target.pixels: must be greater than"),
    "a shift to the other side": (
        f"{VIDEO}\nmax_camera_shift = -1", "", 8, "target.max_camera_shift",
    ),
    "moments of no frame": (
        f"{VIDEO}\nframe_time = 0.003", "", 8, "target.frame_time: 1 pictures are of a moment",
    ),
    "frame_time in metres": (f'{VIDEO}\nframe_time = "3 m"', "", 8, "target.frame_time: "),
    "bins of a video": (
        f"{VIDEO}\ndensity_bins = [4]", "", 5, "target: a target of video has no density_bins",
    ),
    "a picture that is none": ('video = "broken"', "", 7, "target.video: 1.png: "),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_file_is_told_by_its_line(folder, capsys, name):
    keys, gone, line, said = WRONG[name]
    plain(folder)
    write_png(folder / "wide" / "0.png", np.zeros((64, 128, 3), np.uint8))
    for k, one in enumerate((*sorted((folder / "pictures").glob("*.png")), None)):
        (folder / "long").mkdir(exist_ok=True)
        shutil.copy(one or folder / "long" / "0.png", folder / "long" / f"{k}.png")
    for name in ("one", "broken"):
        (folder / name).mkdir(exist_ok=True)
        shutil.copy(folder / "long" / "0.png", folder / name)
    (folder / "broken" / "1.png").write_text("no picture")
    content = text(keys)
    if gone:
        content = content.replace('render = "render.toml"\n', "")
    file, told = refused(capsys, folder, content, "wrong")
    assert told.startswith(f"{file}:{line}: {said}"), told
    assert not (folder / "wrong").exists()


def test_a_render_toml_that_draws_nothing_is_told(folder, capsys):
    (folder / "none.toml").write_text(view(*CAMERA) + "[frames]\nfirst = 9\n")
    keys = f'{VIDEO}\nframe_time = "10 ms"'
    changed = text(keys).replace("render.toml", "none.toml")
    file, told = refused(capsys, folder, changed, "none")
    assert told == f"{file}:6: target.render: draws none of the scene's 7 frames; got 'none.toml'"


@pytest.mark.parametrize(
    "old, new, said",
    [
        ('kind = "fixed"', 'kind = "fixt"', "bad.toml:3: camera.kind: "),
        (f"target = {list(CAMERA[1])}\n", "", "bad.toml: camera: give eye and target"),
        ('background = "#808080"', 'background = "none"', "bad.toml: picture.background: 'none'"),
        ("[picture]", '[[camera]]\nname = "b"\n[picture]', "bad.toml"),
    ],
)
def test_a_wrong_render_toml_is_told(folder, capsys, old, new, said):
    content = view(*CAMERA)
    assert old in content
    (folder / "bad.toml").write_text(content.replace(old, new))
    _, told = refused(capsys, folder, text(VIDEO).replace("render.toml", "bad.toml"), "bad")
    assert said in told

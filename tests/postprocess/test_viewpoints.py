"""Cameras of render.toml over a video: paths through keyframes and through the cameras of files."""

import json
from pathlib import Path

import numpy as np
import pytest

from tests.postprocess.test_camerafiles import as_transforms, cameras
from vgmpi.postprocess.frames import render_config
from vgmpi.postprocess.frames.camera_paths import CameraPath

BOX = (np.zeros(3), np.ones(3))
KEYS = """[camera]
kind = "keyframes"
target = [0.5, 0.5, 0.5]
keyframes = [
  { progress = 0, eye = [3, 0, 1], fov = 30 },
  { progress = 0.4, eye = [2, 2, 1], fov = 50 },
  { progress = 0.6, eye = [2, 2, 1], target = [0, 0, 0], fov = 50 },
  { progress = 1, eye = [0, 3, 4] },
]
"""


def viewpoint(folder, text, longest=None):
    path = folder / "render.toml"
    path.write_text(text)
    chosen = render_config.load(path)
    return CameraPath(chosen.views()[0], chosen.picture, lambda: BOX, folder, longest)


def fov(camera):
    return 2 * np.degrees(np.arctan(0.5 * camera.height / camera.fy))


def test_a_path_goes_through_its_keys_and_is_smooth(tmp_path):
    view = viewpoint(tmp_path, KEYS)
    for part, eye, angle in [(0, (3, 0, 1), 30), (0.4, (2, 2, 1), 50), (1, (0, 3, 4), 40)]:
        camera = view.camera_at(part, 0.0)
        np.testing.assert_allclose(camera.eye, eye, atol=1e-9)
        assert fov(camera) == pytest.approx(angle)
    x, y, z, _ = view.camera_at(0, 0).world_to_camera @ [0.5, 0.5, 0.5, 1]
    assert z > 0 and abs(x) < 1e-9 and abs(y) < 1e-9
    x, y, z, _ = view.camera_at(0.6, 0).world_to_camera @ [0, 0, 0, 1]
    assert z > 0 and abs(x) < 1e-9 and abs(y) < 1e-9
    np.testing.assert_allclose(
        view.camera_at(0.5, 0).eye, (2, 2, 1), atol=1e-9
    )  # it was told to stay
    parts = np.linspace(0, 1, 2001)
    eyes = np.array([view.camera_at(p, 0).eye for p in parts])
    speed = np.diff(eyes, axis=0) / np.diff(parts)[:, None]
    assert np.abs(np.diff(speed, axis=0)).max() < 0.1  # straight lines would jump by 5 and more
    assert (eyes.min(axis=0) > -1e-9).all() and (eyes.max(axis=0) < 4 + 1e-9).all()


def test_a_path_by_the_time_of_the_run(tmp_path):
    text = '[camera]\nkind = "keyframes"\nkeyframes = [{time = 2, eye = [1, 0, 0]}, '
    view = viewpoint(tmp_path, text + "{time = 4, eye = [3, 0, 0]}]")
    for time, x in [(0, 1), (2, 1), (3, 2), (4, 3), (9, 3)]:
        np.testing.assert_allclose(view.camera_at(0.0, time).eye, (x, 0, 0), atol=1e-9)


def test_the_cameras_of_a_file_span_the_video(tmp_path):
    (tmp_path / "t.json").write_text(json.dumps(as_transforms(cameras(4))))
    view = viewpoint(tmp_path, '[camera]\nkind = "transforms"\nfile = "t.json"\nscale = 0.5')
    assert (view.width, view.height) == (64, 32)
    for k, known in enumerate(cameras(4)):
        camera = view.camera_at(k / 3, 0.0)
        np.testing.assert_allclose(camera.world_to_camera, known.world_to_camera, atol=1e-9)
        assert (camera.fx, camera.fy, camera.cx, camera.cy) == (45, 40, 30, 15)
        assert camera.near_plane <= 0.2
    a, b = (camera.eye for camera in cameras(4)[:2])
    between = view.camera_at(0.25 / 3, 0.0)
    np.testing.assert_allclose(between.eye, 0.75 * a + 0.25 * b, atol=1e-9)
    R = between.world_to_camera[:3, :3]
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)


def test_one_image_of_a_file(tmp_path):
    (tmp_path / "t.json").write_text(json.dumps(as_transforms(cameras(4))))
    text = '[camera]\nkind = "transforms"\nfile = "t.json"\nimage = '
    for name in ("images/2.png", "2.png"):
        view = viewpoint(tmp_path, text + f'"{name}"')
        np.testing.assert_allclose(view.camera_at(0.9, 0).eye, cameras(4)[2].eye, atol=1e-9)
    with pytest.raises(render_config.SettingsError, match="0 images 'x.png'"):
        viewpoint(tmp_path, text + '"x.png"')


def test_pictures_of_different_sizes_make_no_video(tmp_path):
    data = as_transforms(cameras())
    data["frames"][2]["w"] = 130
    (tmp_path / "t.json").write_text(json.dumps(data))
    with pytest.raises(render_config.SettingsError, match="128 x 64 and of 130 x 64"):
        viewpoint(tmp_path, '[camera]\nkind = "transforms"\nfile = "t.json"')


@pytest.mark.parametrize("kind", ["orbit", "file"])
def test_a_preview_is_the_same_view_in_fewer_pixels(tmp_path, kind):
    (tmp_path / "t.json").write_text(json.dumps(as_transforms(cameras())))
    text = {"orbit": "", "file": '[camera]\nkind = "transforms"\nfile = "t.json"'}[kind]
    whole, small = viewpoint(tmp_path, text), viewpoint(tmp_path, text, longest=50)
    assert max(small.width, small.height) == 50
    a, b = whole.camera_at(0.5, 0), small.camera_at(0.5, 0)
    np.testing.assert_allclose(b.world_to_camera, a.world_to_camera, atol=1e-12)
    np.testing.assert_allclose([b.fx / b.width, b.cx / b.width], [a.fx / a.width, a.cx / a.width])
    np.testing.assert_allclose(
        [b.fy / b.height, b.cy / b.height], [a.fy / a.height, a.cy / a.height]
    )


def test_eye_and_target_that_meet_on_the_way(tmp_path):
    text = '[camera]\nkind = "keyframes"\n'
    text += "keyframes = [{progress = 0, eye = [0, 0, 0], target = [1, 0, 0]}, "
    view = viewpoint(tmp_path, text + "{progress = 1, eye = [1, 0, 0], target = [0, 0, 0]}]")
    with pytest.raises(render_config.SettingsError, match="stands at its target"):
        view.camera_at(0.5, 0.0)


BAD = {
    "no keyframes": ("", "needs keyframes"),
    "one keyframe": ("keyframes = [{progress = 0, eye = [1, 2, 3]}]", "two or more"),
    "no eye": (
        "keyframes = [{progress = 0}, {progress = 1, eye = [1, 2, 3]}]",
        "camera.keyframes.0.eye: required key is missing: where the camera stands",
    ),
    "no progress": (
        "keyframes = [{eye = [1, 2, 3]}, {progress = 1, eye = [1, 2, 4]}]",
        "camera.keyframes.0: needs one of progress, time",
    ),
    "mixed": (
        "keyframes = [{progress = 0, eye = [1, 2, 3]}, {time = 1, eye = [1, 2, 4]}]",
        "all need time",
    ),
    "backwards": (
        "keyframes = [{progress = 0.5, eye = [1, 2, 3]}, {progress = 0.5, eye = [1, 2, 4]}]",
        "must grow",
    ),
    "beyond": (
        "keyframes = [{progress = 0, eye = [1, 2, 3]}, {progress = 2, eye = [1, 2, 4]}]",
        "camera.keyframes.1.progress: must be less than or equal to 1; got 2",
    ),
    "a wide lens": (
        "keyframes = [{progress = 0, eye = [1, 2, 3], fov = 190}, {progress = 1, eye = [1, 2, 4]}]",
        "camera.keyframes.0.fov: must be less than or equal to 170; got 190",
    ),
    "an unknown word": (
        "keyframes = [{progress = 0, eye = [1, 2, 3], roll = 3}, SECOND]",
        "camera.keyframes.0.roll: unknown key",
    ),
    "a point of two numbers": (
        "keyframes = [{progress = 0, eye = [1, 2]}, SECOND]",
        "camera.keyframes.0.eye: must be three",
    ),
    "numbers": ("keyframes = [1, SECOND]", "camera.keyframes.0: must be a table of keys; got 1"),
    "at its target": (
        "keyframes = [{progress = 0, eye = [1, 2, 3], target = [1, 2, 3]}, SECOND]",
        "camera.keyframes.0: eye and target",
    ),
    "a file": (
        'file = "x"\nkeyframes = [{progress=0,eye=[1,2,3]}, {progress=1,eye=[1,2,4]}]',
        "has no file",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_wrong_keys_are_one_line(tmp_path, name):
    text, says = BAD[name]
    path = tmp_path / "render.toml"
    text = text.replace("SECOND", "{progress = 1, eye = [1, 2, 4]}")
    path.write_text(f'[camera]\nkind = "keyframes"\n{text}')
    with pytest.raises(render_config.SettingsError) as caught:
        render_config.load(path)
    assert len(caught.value.lines) == 1 and says in caught.value.lines[0]
    assert caught.value.lines[0].startswith(f"{path}:") and "\n" not in caught.value.lines[0]


SEVERAL = """[[camera]]
name = "a"

[[camera]]
name = "b"
{0}
"""


@pytest.mark.parametrize(
    "more, line, says",
    [
        ("fov = 300", 6, "camera.b.fov: must be less than 170; got 300"),
        ('eye = [1, 2, 3]\nkind = "orbit"', 4, "has no eye"),
        ("fovv = 3", 6, "did you mean 'fov'?"),
        ("[[camera]]\nfov = 30", 6, "need a name each"),
        ('[[camera]]\nname = "a"', 6, "no two the same"),
        ('[[camera]]\nname = "a/b"', 7, "camera.a/b.name: must match pattern"),
    ],
)
def test_mistakes_of_one_of_several_cameras(tmp_path, more, line, says):
    path = tmp_path / "render.toml"
    path.write_text(SEVERAL.format(more))
    with pytest.raises(render_config.SettingsError) as caught:
        render_config.load(path)
    assert len(caught.value.lines) == 1 and says in caught.value.lines[0]
    assert caught.value.lines[0].startswith(f"{path}:{line}: "), caught.value.lines


def test_several_cameras(tmp_path):
    path = Path(tmp_path / "render.toml")
    path.write_text(SEVERAL.format("revolutions = 1"))
    assert [one.name for one in render_config.load(path).views()] == ["a", "b"]
    assert [one.revolutions for one in render_config.load(path).views()] == [0, 1]
    with pytest.raises(render_config.SettingsError, match="cameras: unknown key"):
        path.write_text("cameras = []")
        render_config.load(path)

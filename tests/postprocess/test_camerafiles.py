"""Cameras from transforms.json and COLMAP models: what they see, and files that are wrong."""

import json
import struct

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from vgmpi.gaussians.camera import look_at
from vgmpi.postprocess.frames import camera_paths
from vgmpi.postprocess.frames.render_config import SettingsError

LENS = {"fl_x": 90.0, "fl_y": 80.0, "cx": 60.0, "cy": 30.0, "w": 128, "h": 64}


def cameras(count=3):
    """Known poses around the origin."""
    eyes = [(3 * np.cos(a), 3 * np.sin(a), 1 + a) for a in np.linspace(0, 2, count)]
    return [look_at(eye, (0, 0.2, 0.1), (0, 0, 1), 40, 128, 64) for eye in eyes]


def as_transforms(some):
    frames = []
    for k, camera in enumerate(some):
        to_world = np.linalg.inv(camera.world_to_camera) @ np.diag([1.0, -1, -1, 1])
        frames.append({"file_path": f"images/{k}.png", "transform_matrix": to_world.tolist()})
    return {**LENS, "frames": frames}


def write_colmap(folder, some, binary=False):
    folder.mkdir(exist_ok=True)
    poses = []
    for k, camera in enumerate(some):
        q = Rotation.from_matrix(camera.world_to_camera[:3, :3]).as_quat()[[3, 0, 1, 2]]
        poses.append((k + 1, q, camera.world_to_camera[:3, 3], f"photo {9 - k}.png"))
    if binary:
        data = struct.pack("<QiiQQ4d", 1, 7, 1, 128, 64, 90, 80, 60, 30)
        (folder / "cameras.bin").write_bytes(data)
        data = struct.pack("<Q", len(poses))
        for number, q, t, name in poses:
            data += struct.pack("<i7di", number, *q, *t, 7) + name.encode() + b"\0"
            data += struct.pack("<Qddq", 1, 1.0, 2.0, -1)
        (folder / "images.bin").write_bytes(data)
        return
    (folder / "cameras.txt").write_text("# a line\n7 PINHOLE 128 64 90 80 60 30\n")
    text = "# a line\n"
    for number, q, t, name in poses:
        numbers = " ".join(repr(float(v)) for v in [*q, *t])
        points = ["", "1.0 2.0 -1 3.0 4.0 5", "1 2 3 4 5 6 7 8 9 10 11 12"][number % 3]
        text += f"{number} {numbers} 7 {name}\n{points}\n"
    (folder / "images.txt").write_text(text)


def same(named, want):
    assert len(named) == len(want)
    for (_, camera), known in zip(named, want):
        np.testing.assert_allclose(camera.world_to_camera, known.world_to_camera, atol=1e-9)
        assert (camera.fx, camera.fy, camera.cx, camera.cy) == (90, 80, 60, 30)
        assert (camera.width, camera.height) == (128, 64)


def test_transforms_stand_where_they_stood(tmp_path):
    path = tmp_path / "transforms.json"
    path.write_text(json.dumps(as_transforms(cameras())))
    named = camera_paths.read_transforms(path)
    same(named, cameras())
    assert [name for name, _ in named] == [f"images/{k}.png" for k in range(3)]
    # the target is in front of the camera and on the vertical through the centre
    x, y, z, _ = named[1][1].world_to_camera @ [0, 0.2, 0.1, 1]
    assert z > 2 and abs(x) < 1e-9


def test_a_lens_of_a_frame_comes_first_and_angles_will_do(tmp_path):
    data = as_transforms(cameras())
    del data["fl_x"], data["fl_y"]
    data["camera_angle_x"] = np.pi / 2
    data["frames"][1]["fl_x"] = 33.0
    path = tmp_path / "t.json"
    path.write_text(json.dumps(data))
    first, second, _ = (camera for _, camera in camera_paths.read_transforms(path))
    assert first.fx == pytest.approx(64) and first.fy == pytest.approx(64)
    assert (second.fx, second.fy) == (33.0, 33.0)


@pytest.mark.parametrize("binary", [False, True])
def test_colmap_stands_where_it_stood(tmp_path, binary):
    write_colmap(tmp_path / "sparse", cameras(), binary)
    named = camera_paths.read_colmap(tmp_path / "sparse")
    assert [name for name, _ in named] == ["photo 7.png", "photo 8.png", "photo 9.png"]
    same(named, cameras()[::-1])


def test_colmap_without_lines_of_points(tmp_path):
    write_colmap(tmp_path, cameras())
    lines = (tmp_path / "images.txt").read_text().splitlines()
    (tmp_path / "images.txt").write_text("\n".join(lines[:1] + lines[1::2]))
    same(camera_paths.read_colmap(tmp_path), cameras()[::-1])


def changed(**changes):
    data = as_transforms(cameras())
    data["frames"][1].update(changes)
    return json.dumps(data)


SKEW = [[1, 0.1, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
BAD_JSON = {
    "no JSON": ("{", "not readable as JSON"),
    "deep": ("[" * 100000, "not readable as JSON"),
    "a list": ("[]", "no list of frames"),
    "no frames": ("{}", "no list of frames"),
    "an empty list": ('{"frames": []}', "no list of frames"),
    "a frame that is a number": ('{"frames": [3]}', "frame 0: not a table"),
    "no size": ('{"frames": [{}]}', "frame 0: w = None"),
    "a huge picture": (changed(w=10**9), "frame 1: w = 1000000000"),
    "a huge number": (changed(w=10**400), "frame 1: w = 1"),
    "half a pixel": (changed(w=100.5), "whole numbers"),
    "not a number": (changed(fl_x=float("nan")), "frame 1: fl_x = nan"),
    "a word": (changed(fl_y="long"), "frame 1: fl_y = 'long'"),
    "yes for a number": (changed(cx=True), "frame 1: cx = True"),
    "a fisheye": (changed(camera_model="OPENCV_FISHEYE"), "frame 1: camera_model"),
    "three rows": (changed(transform_matrix=SKEW[:3]), "four rows of four"),
    "ragged rows": (changed(transform_matrix=[[1], [1, 2]]), "four rows of four"),
    "words in a matrix": (changed(transform_matrix="abcd"), "four rows of four"),
    "an infinite position": (changed(transform_matrix=[[1e999] * 4] * 4), "four rows of four"),
    "a far position": (
        changed(transform_matrix=[[1, 0, 0, 1e30], *np.eye(4)[1:].tolist()]),
        "frame 1: the position",
    ),
    "skewed": (changed(transform_matrix=SKEW), "frame 1: the pose is no rotation"),
    "mirrored": (changed(transform_matrix=np.diag([-1.0, 1, 1, 1]).tolist()), "no rotation"),
    "zero": (changed(transform_matrix=np.zeros((4, 4)).tolist()), "no rotation"),
}


@pytest.mark.parametrize("name", BAD_JSON)
def test_wrong_transforms_are_one_line(tmp_path, name):
    text, says = BAD_JSON[name]
    path = tmp_path / "t.json"
    path.write_text(text)
    one_line(lambda: camera_paths.read_transforms(path), path, says)


def one_line(call, path, says):
    with pytest.raises(SettingsError) as caught:
        call()
    assert len(caught.value.lines) == 1 and "\n" not in caught.value.lines[0]
    assert caught.value.lines[0].startswith(str(path)) and says in caught.value.lines[0]


POSE = "1 1 0 0 0 0 0 0 7 a.png\n\n"
BAD_TEXT = {
    "a model of a fisheye": ("7 OPENCV 128 64 1 2 3 4 0 0 0 0", POSE, "cameras", "model OPENCV"),
    "too few parameters": ("7 PINHOLE 128 64 90 80 60", POSE, "cameras", "4 parameters, not 3"),
    "no focal length": ("7 SIMPLE_PINHOLE 128 64 0 3 3", POSE, "cameras", "focal lengths"),
    "not a number": ("7 SIMPLE_PINHOLE 128 64 nan 3 3", POSE, "cameras", "focal lengths"),
    "a huge picture": ("7 SIMPLE_PINHOLE 99999 64 9 3 3", POSE, "cameras", "99999 x 64"),
    "a word": ("seven PINHOLE 128 64 90 80 60 30", POSE, "cameras", "record 1"),
    "half a line": ("7 PINHOLE", POSE, "cameras", "4 parameters, not 0"),
    "only a number": ("7", POSE, "cameras", "ends too early"),
    "an unknown camera": (None, POSE.replace("7 a", "8 a"), "images", "no camera 8"),
    "a short line": (None, "1 1 0 0 0 0 0\n\n", "images", "ends too early"),
    "no rotation": (None, POSE.replace("1 1 0", "1 0 0"), "images", "length 0"),
    "a position of NaN": (None, "1 1 0 0 0 nan 0 0 7 a.png\n", "images", "position"),
    "no images": (None, "# none\n", "images", "no images"),
    "bytes that are no text": (None, b"\xff\xfe\x00", "images", "record 1"),
}


@pytest.mark.parametrize("name", BAD_TEXT)
def test_wrong_models_are_one_line(tmp_path, name):
    lens, poses, file, says = BAD_TEXT[name]
    (tmp_path / "cameras.txt").write_text(lens or "7 PINHOLE 128 64 90 80 60 30")
    poses = poses if isinstance(poses, bytes) else poses.encode()
    (tmp_path / "images.txt").write_bytes(poses)
    one_line(lambda: camera_paths.read_colmap(tmp_path), tmp_path / f"{file}.txt", says)


@pytest.mark.parametrize("file", ["cameras.bin", "images.bin"])
def test_binary_models_cut_anywhere_are_one_line(tmp_path, file):
    write_colmap(tmp_path, cameras(), binary=True)
    whole = (tmp_path / file).read_bytes()
    for length in range(0, len(whole), 7):
        (tmp_path / file).write_bytes(whole[:length])
        one_line(lambda: camera_paths.read_colmap(tmp_path), tmp_path / file, "")
    (tmp_path / file).write_bytes(struct.pack("<Q", 2**63) + whole[8:])  # a false count
    one_line(lambda: camera_paths.read_colmap(tmp_path), tmp_path / file, "")


def test_files_that_are_not_there(tmp_path):
    one_line(
        lambda: camera_paths.read_transforms(tmp_path / "t.json"), tmp_path / "t.json", "No such"
    )
    one_line(
        lambda: camera_paths.read_colmap(tmp_path / "x"), tmp_path / "x" / "cameras.txt", "No such"
    )
    one_line(lambda: camera_paths.read_transforms(tmp_path), tmp_path, f"{tmp_path}: is no regular")

"""How colliders move: where they are at a time, what their files say, and what is refused."""

from types import SimpleNamespace

import numpy as np
import pytest

from tests.scene.test_bad_scenes import broken, lines
from tests.support import drawn_runs
from tests.support.wrong_scenes import LAST
from vgmpi.gaussians.cloud import unpack_symmetric
from vgmpi.gaussians.spherical_harmonics import evaluate
from vgmpi.io.frames import Frames
from vgmpi.io.run_reader import RunError, RunReader
from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.postprocess.frames.appearance import Appearance
from vgmpi.preprocess.collider_sdf import with_motion
from vgmpi.preprocess.scene_builder import build_scene
from vgmpi.scene.loader import load
from vgmpi.scene.rigid_motion import Motion, Trajectories, Trajectory

KEYS = [
    {"time": "1 s", "translation": [1, 0, 0], "angle": "90 deg"},
    {"time": "3 s", "translation": [1, 0, 0], "angle": "90 deg"},
    {"time": "4 s", "translation": [0, 2, 0], "angle": "-30 deg"},
]


class One:
    """One of Courses."""

    def __init__(self, pivot=(0.0, 0.0, 0.0), **keys):
        self.all = Trajectories([Trajectory(Motion(**keys), pivot)])

    def pose_at(self, time):
        row = self.all.displacements(time)[0]
        return row[:3], row[3]

    def matrix(self, time):
        return self.all.matrices(time)[0]


def test_it_is_where_its_keyframes_say():
    for interpolation in ("cubic", "linear"):
        way = One(keyframes=KEYS, interpolation=interpolation)
        for key in KEYS:
            translation, angle = way.pose_at(float(key["time"].split()[0]))
            assert np.allclose(translation, key["translation"], atol=1e-12)
            assert np.degrees(angle) == pytest.approx(float(key["angle"].split()[0]))
        assert np.allclose(way.pose_at(9.0)[0], (0, 2, 0)) and np.allclose(way.pose_at(0.0)[0], 0)


def test_cubic_begins_and_ends_at_rest_and_stays_between_alike():
    way, h = One(keyframes=KEYS), 1e-5
    for time in (h, 4.0 - h):  # it moves by the square of the time from there
        near = 0.0 if time < 1 else 4.0
        assert np.abs(way.pose_at(time)[0] - way.pose_at(near)[0]).max() < 1e-8
    for time in np.linspace(1, 3, 7):
        assert np.allclose(way.pose_at(time)[0], (1, 0, 0), atol=1e-12)
    dense = np.array([way.pose_at(t)[0] for t in np.linspace(0, 4, 401)])
    assert dense.min() > -1e-12 and dense[:, 0].max() < 1 + 1e-12 and dense[:, 1].max() < 2 + 1e-12


def test_linear_has_an_even_pace():
    way = One(keyframes=KEYS, interpolation="linear")
    assert np.allclose(way.pose_at(0.25)[0], (0.25, 0, 0)) and np.allclose(
        way.pose_at(3.5)[0], (0.5, 1, 0)
    )


def test_velocity_and_angular_velocity_until_the_end_time():
    way = One(
        (1.0, 0.0, 0.0), velocity=[0, 0, 2], angular_velocity="1 rad/s", end_time="0.5 s", axis="z"
    )
    there = way.matrix(7.0) @ [2.0, 0.0, 0.0, 1.0]  # a point a metre from the axis
    assert np.allclose(there[:3], (1 + np.cos(0.5), np.sin(0.5), 1.0), atol=1e-12)
    assert way.all.fastest(0.0, 0.5, np.ones(1))[0] == pytest.approx(
        3.0
    )  # 2 m/s, and 1 rad/s at 1 m


def test_a_turn_bends_space_for_none():
    way = One((0.3, -0.2, 0.1), angular_velocity=3.0, velocity=[1, 2, 3], axis=[1, 1, 0])
    (rotation,) = way.all.poses(0.7)[0]
    assert np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-14)
    assert np.allclose((way.matrix(0.7) @ [0.3, -0.2, 0.1, 1])[:3], [1.0, 1.2, 2.2], atol=1e-14)


PADDLE = """
[[object]]
name = "paddle"
role = "scenery"
collider = true
shape = {{ box = [[0.1, 0.1, 0.15], [0.2, 0.2, 0.25]] }}
{}
"""
WAY = "motion = {{ {} }}"


@pytest.mark.parametrize(
    "keys, where, says",
    [
        (WAY.format(""), "motion", "has no motion: give keyframes, velocity or angular_velocity"),
        (
            WAY.format('keyframes = [{ time = "1 s" }, { time = "1 s" }]'),
            "motion.keyframes.1.time",
            "must be later than the keyframe before, 1 s; got 1 s",
        ),
        (WAY.format("keyframes = []"), "motion.keyframes", "has no keyframe"),
        (
            WAY.format('keyframes = [{ translation = [0, 0, "1 cm"] }]'),
            "motion.keyframes.0.time",
            "required key is missing: time of the keyframe; keyframes are in order of time",
        ),
        (
            WAY.format('keyframes = [{ time = "1 s" }], angular_velocity = 3'),
            "motion.angular_velocity",
            "keyframes and angular_velocity given at once: give keyframes, or velocity and"
            " angular_velocity",
        ),
        (
            WAY.format('angular_velocity = 3, interpolation = "linear"'),
            "motion.interpolation",
            "is for keyframes only",
        ),
        (
            WAY.format('keyframes = [{ time = "1 s" }], end_time = "2 s"'),
            "motion.end_time",
            "is for velocity and angular_velocity only",
        ),
        (WAY.format("velocity = [1, 2]"), "motion.velocity", "has too few values; got [1, 2]"),
        (
            WAY.format("angular_velocity = 3, axis = [0, 0, 0]"),
            "motion.axis",
            "must be 'x', '-x', 'y', '-y', 'z', '-z' or three numbers that are not all 0",
        ),
        ("friction = -1", "friction", "must be >= 0"),
    ],
)
def test_wrong_motions(tmp_path, keys, where, says):
    path, _ = broken(tmp_path, LAST, LAST + PADDLE.format(keys))
    found = lines(path)
    assert any(f"object.paddle.{where}: {says}" in line for line in found), found
    assert all(line.startswith(f"{path}:") for line in found)


@pytest.mark.parametrize("key", ["motion = { angular_velocity = 3 }", "friction = 0.1"])
def test_only_colliders_move(tmp_path, key):
    path, _ = broken(tmp_path, LAST, LAST + PADDLE.format(key).replace("collider = true", ""))
    only = {"motion": "is for bodies, and for", "friction": "is only for"}[key.split()[0]]
    said = f"object.paddle.{key.split()[0]}: {only} scenery with collider = true"
    assert any(line.endswith(said) for line in lines(path)), lines(path)


@pytest.mark.parametrize(
    "keys, where, says",
    [
        (
            WAY.format(
                'keyframes = [{ time = "1 s" }, { time = "2 s", translation = [0, 0, 0.18] }]'
            ),
            "motion.keyframes.1",
            "leads out of the domain: at 2 s all of it is at z = 0.33 .. 0.43 m; the domain is"
            " 0 .. 0.32 m",
        ),
        (WAY.format("velocity = [-0.21, 0, 0]"), "motion.velocity", "leads out of the domain"),
    ],
)
def test_a_motion_stays_in_the_domain(tmp_path, keys, where, says):
    path, _ = broken(tmp_path, LAST, LAST + PADDLE.format(keys))
    found = lines(path, make=lambda path, _: build_scene(load(path)))
    assert len(found) == 1 and f": object.paddle.{where}: {says}" in found[0], found


def test_a_fixed_step_is_short_enough_for_every_keyframe(tmp_path):
    """.18 m in 60 ms, three times the mean where it is fastest: 9 m/s at the most."""
    keys = 'keyframes = [{ time = "1 s" }, { time = "1060 ms", translation = [0, 0, 0.1] }]'
    text = LAST + PADDLE.format(WAY.format(keys))
    path, _ = broken(tmp_path, LAST, text)
    build_scene(load(path))
    found = lines(path, ["time.dt=4 ms"], make=lambda p, o: build_scene(load(p, o)))
    assert len(found) == 1 and "object.paddle.motion.keyframes.1: moves at up to 2." in found[0]
    assert "cells in a step of time.dt = 0.004 s: at most 0.3 are possible" in found[0]


def test_thin_colliders_are_warned_of(tmp_path, caplog):
    path, _ = broken(tmp_path, LAST, LAST + PADDLE.format(""))
    build_scene(load(path))
    assert "thick" not in caplog.text
    path.write_text(path.read_text().replace("[0.2, 0.2, 0.25]", "[0.2, 0.2, 0.18]"))
    build_scene(load(path))
    assert "collider 'paddle' is 1.5 cells thick" in caplog.text


def test_the_farthest_point_from_the_axis(tmp_path):
    path, _ = broken(tmp_path, LAST, LAST + PADDLE.format(WAY.format("angular_velocity = 1")))
    collider = build_scene(load(path)).colliders[0]
    assert collider.course.max_radius(*collider.ends()) == pytest.approx(np.hypot(0.05, 0.05))
    shifted = with_motion(collider, Motion(angular_velocity=1.0, pivot=(0.1, 0.1, 0.0)))
    assert shifted.course.max_radius(*shifted.ends()) == pytest.approx(np.hypot(0.1, 0.1))


def turned():
    """The floor of the small run turns by a quarter about the vertical through 0.5, 0.5."""
    return One((0.5, 0.5, 0.0), angular_velocity=np.pi / 2, velocity=[0, 0, 0.25]).matrix(1.0)


def test_the_renderer_sees_scenery_where_it_is():
    rows, objects, ground = drawn_runs.rest_state()
    ground["cov0"] = drawn_runs.diagonal(0.03**2, 0.01**2, 1e-6, len(ground["x0"]))
    ground["sh"] = drawn_runs.sh(drawn_runs.BROWN, len(ground["x0"]), 4)
    ground["sh"][:, 3, 0] = 0.3  # redder along x
    objects[2]["is_moving"] = True
    held = SimpleNamespace(**rows, scenery=SimpleNamespace(**ground))
    look = Appearance(SimpleNamespace(gaussians=held, objects=objects))
    fields = {"id": np.arange(len(rows["x0"])), **drawn_runs.frame_fields(rows, 0, 3)}
    with pytest.raises(RunError, match="does not say where each object is that moves"):
        look.splats(fields, drawn_runs.rotation(0)[0])
    pose, still = turned(), np.eye(4)
    eye = np.array([0.5, -2.0, 1.0])
    seen = [look.splats({**fields, "poses": np.array([each])}, eye) for each in (still, pose)]
    n = len(ground["x0"])
    x = ground["x0"] - [0.5, 0.5, 0]
    assert np.allclose(seen[0].x[:n], ground["x0"])
    want = np.stack([-x[:, 1] + 0.5, x[:, 0] + 0.5, x[:, 2] + 0.25], 1)
    assert np.allclose(seen[1].x[:n], want)
    assert np.allclose(
        unpack_symmetric(seen[1].cov[:n])[0], np.diag([0.01**2, 0.03**2, 1e-6]), atol=1e-9
    )
    # its own colors towards where the eye is in its frame
    back = (seen[1].x[:n] - eye) @ pose[:3, :3]
    back /= np.linalg.norm(back, axis=1)[:, None]
    assert np.allclose(seen[1].color[:n], evaluate(ground["sh"], back), atol=1e-5)
    assert np.abs(seen[1].color[:n] - seen[0].color[:n]).max() > 0.01


def test_frames_hold_poses_and_damage_is_named(tmp_path):
    x = np.zeros((3, 3), np.float32)
    Frames(tmp_path, SerialCommunicator(), 3).write(
        0, 0.0, 0, np.arange(3), {"positions": x}, np.array([turned()])
    )
    assert np.array_equal(RunReader(tmp_path).frame(0)["poses"], [turned()])
    path = tmp_path / "frames" / "frame_00000.vtkhdf"
    data = path.read_bytes()
    at = data.index(turned().tobytes())
    path.write_bytes(data[: at + 3] + bytes([data[at + 3] ^ 1]) + data[at + 4 :])
    with pytest.raises(RunError, match="poses is not what was written"):
        RunReader(tmp_path).frame(0)

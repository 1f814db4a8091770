"""Moving Gaussians by groups: what is written and read back is what the renderer draws."""

from dataclasses import asdict
from types import SimpleNamespace

import numpy as np
import pytest

from tests.postprocess.test_passive import AFFINE, RIDING, moved
from tests.preprocess.test_prune import SCENE, duck_obj
from tests.support import drawn_runs
from tests.support.small_scenes import scene
from vgmpi.gaussians import spherical_harmonics as harmonics
from vgmpi.gaussians.formats import motion_stream as layout
from vgmpi.gaussians.formats.motion_stream import (
    GroupState,
    MotionGroup,
    MotionReader,
    MotionWriter,
    RestGaussians,
)
from vgmpi.gaussians.formats.residual_coding import MAX_BIN, SEGMENT, CodedRows
from vgmpi.gaussians.formats.validation import GaussianFileError
from vgmpi.postprocess.export.export_moving import RunMotion
from vgmpi.postprocess.frames.appearance import Appearance
from vgmpi.preprocess.scene_builder import build_scene

ACCURACY = 1e-3  # [cells]


def look_of(gaussians, objects, frames):
    """Appearance of a run with these frames."""
    run = SimpleNamespace(gaussians=gaussians, objects=objects, frame=lambda k: frames[k])
    return Appearance(run)


def decoded(look, frames, cell):
    """Reader of the frames, and the Gaussians that the renderer draws in each."""
    motion = RunMotion(look, 0)
    writer = MotionWriter(motion.groups, motion.rest_gaussians, cell=cell, accuracy=ACCURACY)
    for number, frame in enumerate(frames):
        writer.add_frame(float(number), motion.states(frame), motion.poses(frame))
    return motion, MotionReader(writer.to_bytes())


def compare(look, motion, reader, number, frame, cell):
    """Compare a decoded frame with the renderer's parts, Gaussian by Gaussian."""
    parts = look.parts(frame)
    names = (["scenery"] if look.scenery is not None else []) + ["particles", "carried"]
    ids = {"particles": frame["id"], "scenery": None, "carried": None}
    drawn = {}
    for name, part in zip(names, parts):
        rows = ids[name] if name == "particles" else part.rider_rows
        rows = np.arange(len(part.x)) if rows is None else rows
        for k, row in enumerate(rows):
            drawn[name, int(row)] = (part.x[k], part.cov[k])
    keys = [(part, int(row)) for part, members in motion.members for row in members]
    got = reader.frame(number)
    assert [key in drawn for key in keys] == got.present.tolist()
    assert got.present.sum() == len(drawn)
    for k in np.flatnonzero(got.present):
        x, cov = drawn[keys[k]]
        assert np.abs(got.x[k] - x).max() <= 1.001 * ACCURACY * cell
        assert np.abs(got.cov[k] - cov).max() <= 0.08 * np.abs(cov).max() + 1e-12


def test_carried_and_removed_gaussians(tmp_path):
    """Half of the particles leave; those they carry leave with them, and come back."""
    (tmp_path / "duck.obj").write_text(duck_obj(24))
    prepared = build_scene(scene(tmp_path, SCENE.replace("SOURCE", RIDING)))
    rest = SimpleNamespace(
        x0=prepared.x,
        **{n: getattr(prepared, n) for n in ("vol0", "object", "cov0", "opacity", "sh")},
    )
    riders = asdict(prepared.passive)
    rest.passive = SimpleNamespace(x0=riders.pop("x"), **riders)
    whole = moved(prepared, np.eye(3), np.zeros(3))
    turned = moved(prepared, AFFINE, np.array([0.1, 0, 0.2]))
    half = {name: array[::2] for name, array in turned.items()}
    frames = [whole, turned, half, turned]
    look = look_of(rest, prepared.objects, frames)
    motion, reader = decoded(look, frames, look.spacing)
    assert {group.name for group in motion.groups} >= {group.name for group in reader.groups}
    assert any("carried" in group.name for group in motion.groups)
    for number in (3, 2, 0, 1):
        compare(look, motion, reader, number, frames[number], look.spacing)


def turning_floor():
    """The small run; its floor turns by a quarter, and its colors change."""
    rows, objects, ground = drawn_runs.rest_state(k=4)
    ground["sh"] = drawn_runs.sh(drawn_runs.BROWN, len(ground["x0"]), 4)
    ground["sh"][:, 3, 0] = 0.3
    ground["cov0"] = drawn_runs.diagonal(0.03**2, 0.01**2, 1e-6, len(ground["x0"]))
    objects[2]["is_moving"] = True
    frames = []
    for k in range(4):
        pose = np.eye(4)
        pose[:3, :3] = drawn_runs.rotation(np.pi / 6 * k)
        pose[:3, 3] = [0, 0.1 * k, 0.02 * k]
        fields = {"id": np.arange(len(rows["x0"])), **drawn_runs.frame_fields(rows, k, 4)}
        frames.append({**fields, "poses": np.array([pose])})
    gaussians = SimpleNamespace(**rows, scenery=SimpleNamespace(**ground))
    return look_of(gaussians, objects, frames), frames


def test_scenery_that_moves():
    look, frames = turning_floor()
    motion, reader = decoded(look, frames, look.spacing)
    assert motion.groups[0].motion == layout.POSED
    for number in (3, 0):
        compare(look, motion, reader, number, frames[number], look.spacing)
    got = reader.frame(3)
    n = motion.groups[0].count
    np.testing.assert_allclose(got.rotation[:n], np.tile(drawn_runs.rotation(np.pi / 2), (n, 1, 1)))


def test_colors_of_frames_are_stored():
    look, frames = turning_floor()
    changed = look.color.sh.copy()
    changed[:, 0] = harmonics.dc_from_rgb(np.array([0.2, 0.5, 0.7]))
    frames = [{**frame, "sh": changed} for frame in frames]
    look.colors.at_frame = lambda index, frame: changed
    look.colors.mode = "step"
    motion, reader = decoded(look, frames, look.spacing)
    free = sum(group.count for group in motion.groups if group.motion == layout.FREE)
    rgb = reader.frame(2).rgb[-free:]
    np.testing.assert_allclose(rgb, np.tile([0.2, 0.5, 0.7], (free, 1)), atol=1.01 / 100)


@pytest.mark.parametrize("rows", [1, SEGMENT - 1, SEGMENT, 3 * SEGMENT + 5])
def test_integers_come_back_exactly(rows):
    """Jumps, noise, motion and rest, at the ends of the range too."""
    rng = np.random.default_rng(rows)
    coder, decoder = CodedRows(rows, 3), CodedRows(rows, 3)
    bins = rng.integers(-MAX_BIN, MAX_BIN, (rows, 3)).astype(np.int32)
    for number in range(14):
        if number % 5 == 4:
            bins = rng.integers(-MAX_BIN, MAX_BIN, (rows, 3)).astype(np.int32)
        bins = np.clip(bins + rng.integers(-9, 9, (rows, 3)), -MAX_BIN, MAX_BIN).astype(np.int32)
        data = b"".join(coder.encode(bins, number % 6 == 0))
        got, position = decoder.decode(memoryview(data), 0, number % 6 == 0)
        assert position == len(data)
        np.testing.assert_array_equal(got, bins)


def test_smooth_motion_takes_few_bytes():
    """A uniform motion of particles costs less than a hundredth of its float32 numbers."""
    rng = np.random.default_rng(0)
    x = rng.uniform(0, 10, (20_000, 3))
    rest = RestGaussians(x, np.zeros((len(x), 6)), np.ones(len(x)), np.zeros((len(x), 1, 3)))
    group = MotionGroup("a", len(x), layout.FREE)
    writer = MotionWriter([group], rest, cell=1.0, accuracy=0.01)
    for k in range(12):
        state = GroupState(np.ones(len(x), bool), x + 0.02 * 15 * k)
        writer.add_frame(k, [state])
    assert max(entry["bytes"] for entry in writer.frames[2:]) < 0.01 * 12 * len(x)


def test_a_run_too_large_for_the_accuracy_is_refused():
    x = np.array([[0, 0, 0], [1e6, 0, 0]])
    rest = RestGaussians(x, np.zeros((2, 6)), np.ones(2), np.zeros((2, 1, 3)))
    with pytest.raises(GaussianFileError, match=r"lower the accuracy"):
        MotionWriter([MotionGroup("a", 2, layout.FREE)], rest, cell=1e-3, accuracy=1e-3)


def test_damaged_frames_are_named():
    x = np.random.default_rng(0).uniform(0, 1, (300, 3))
    rest = RestGaussians(x, np.zeros((300, 6)), np.ones(300), np.zeros((300, 1, 3)))
    writer = MotionWriter([MotionGroup("a", 300, layout.FREE)], rest, cell=0.1, accuracy=0.01)
    for k in range(3):
        writer.add_frame(k, [GroupState(np.ones(300, bool), x + 0.01 * k)])
    data = bytearray(writer.to_bytes())
    data[-writer.frames[-1]["bytes"] :] = b"\xff" * writer.frames[-1]["bytes"]
    reader = MotionReader(bytes(data))
    with pytest.raises(GaussianFileError, match="frame 2 is damaged"):
        reader.frame(2)
    assert len(reader.frame(1).x) == 300  # those before are readable
    with pytest.raises(IndexError):
        reader.frame(3)

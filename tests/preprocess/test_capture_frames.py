"""The frame of captures from a file to a body: volume and mass, the key `frame`, what is said."""

import logging

import numpy as np
import pytest

from tests.gaussians.test_spz import PACK, smallest_three
from tests.support import gaussian_files
from tests.support.small_scenes import scene
from vgmpi.gaussians.capture_conventions import to_ply_frame
from vgmpi.gaussians.cloud import GaussianCloud
from vgmpi.gaussians.formats import registry
from vgmpi.preprocess import inspect_file
from vgmpi.preprocess.meshes.surface_mesh import quaternion_to_normal
from vgmpi.preprocess.object_builder import build_object
from vgmpi.preprocess.placement import PlacementError
from vgmpi.runtime.config.schema import SceneError
from vgmpi.scene.loader import load

HEIGHT, RADIUS = 1.0, 0.5  # [file units]
SCENE = """
[domain]
size = [1, 1, 1]
cell = 0.04
[time]
end = 0.1
[material.clay]
kind = "elastic"
density = 1000
youngs_modulus = 1e5
[[object]]
name = "cone"
material = "clay"
gaussians = "FILE"
up = "-y"
height = 0.6
position = [0.5, 0.5, 0.1]
"""
VOLUME = np.pi / 3 * 0.3**2 * 0.6  # [m3] of the cone in the domain


def cone(count=6000):
    """A capture of a cone that stands on its base: right, down, forward; nothing is seen below."""
    i = np.arange(count) + 0.5
    share = np.sqrt(i / count)  # of the slant height from the tip, evenly over the surface
    angle = np.pi * (1 + np.sqrt(5)) * i
    radial = np.stack([np.cos(angle), np.zeros(count), np.sin(angle)], axis=1)
    x = RADIUS * share[:, None] * radial + np.outer(HEIGHT * (share - 1), [0, 1, 0])
    normal = HEIGHT * radial - RADIUS * np.array([0, 1, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    rng = np.random.default_rng(0)
    sh = rng.uniform(-0.1, 0.1, (count, 4, 3))
    size = np.full((count, 3), 1.0) * [0.012, 0.012, 0.001]
    return GaussianCloud(x, quaternion_to_normal(normal), size, np.full(count, 0.95), sh)


def built(folder, name, keys="", height=0.6, cell=0.04):
    """The body of a file in the folder."""
    text = SCENE.replace("FILE", name).replace("height = 0.6", f"height = {height}")
    text = text.replace("cell = 0.04", f"cell = {cell}")
    return build_object(scene(folder, text + keys), 0)


def converted(version):
    """The bytes of a .spz as converters write it: the numbers of the .ply, and no record."""
    c = cone()
    rows = zip(
        np.rint(4096 * c.x).astype(int).tolist(),
        np.rint(255 * c.opacity[:, None]).astype(int).tolist(),
        np.clip(np.rint(127.5 + 38.25 * c.sh[:, 0]), 0, 255).astype(int).tolist(),
        np.rint(16 * (np.log(c.scale) + 10)).astype(int).tolist(),
        [smallest_three(list(np.roll(q, -1))) for q in c.quat],
        np.rint(128 + 128 * c.sh[:, 1:].reshape(len(c), -1)).astype(int).tolist(),
        strict=True,
    )
    if version == 3:
        return gaussian_files.spz(list(rows), degree=1)
    return gaussian_files.spz4(list(rows), PACK, degree=1)


@pytest.mark.parametrize("version", [3, 4])
@pytest.mark.parametrize("writer", ["converter", "vgmpi"])
def test_a_cone_weighs_the_same_from_either_file(tmp_path, writer, version):
    registry.write(tmp_path / "cone.ply", cone())
    if writer == "vgmpi":
        registry.write(tmp_path / "cone.spz", cone(), version)
    else:
        (tmp_path / "cone.spz").write_bytes(converted(version))
    reference = built(tmp_path, "cone.ply", cell=0.02)
    volume = reference.volume.sum()
    assert abs(volume / VOLUME - 1) < 0.1  # half a voxel of skin
    middle = (reference.volume @ reference.cloud.x[:, 2]) / volume
    assert abs(middle - (0.1 + 0.6 / 4)) < 0.01  # it stands on its base
    body = built(tmp_path, "cone.spz", cell=0.02)
    assert abs(body.volume.sum() / volume - 1) < 0.01
    assert abs((body.volume @ body.cloud.x[:, 2]) / body.volume.sum() - middle) < 1e-3
    np.testing.assert_allclose(body.cloud.x[:6000], reference.cloud.x[:6000], atol=2e-4)
    on_its_tip = built(tmp_path, "cone.ply", 'frame = "RUB"', cell=0.02)
    assert on_its_tip.volume.sum() < 0.6 * volume  # what the test would see


@pytest.mark.parametrize("frame", ["RUB", "LUF", "RFU", "LUB"])
def test_the_key_frame_turns_a_capture(tmp_path, frame):
    """The file holds the numbers of another frame; LUB mirrors them."""
    registry.write(tmp_path / "cone.ply", cone())
    into = {"RUB": "RUB", "LUF": "LUF", "RFU": "RBD", "LUB": "LUB"}[frame]  # the inverse turn
    registry.write(tmp_path / "there.ply", to_ply_frame(cone(), into))
    reference = built(tmp_path, "cone.ply")
    body = built(tmp_path, "there.ply", f'frame = "{frame}"')
    np.testing.assert_allclose(body.cloud.x[:6000], reference.cloud.x[:6000], atol=1e-6)
    np.testing.assert_allclose(body.cloud.sh[:6000], reference.cloud.sh[:6000], atol=1e-5)
    cov, want = body.cloud.cov()[:6000], reference.cloud.cov()[:6000]
    np.testing.assert_allclose(cov, want, atol=1e-9)
    assert abs(body.volume.sum() / reference.volume.sum() - 1) < 1e-3


def test_select_is_in_the_axes_after_the_turn(tmp_path):
    registry.write(tmp_path / "cone.ply", cone())
    upper = "\nselect = { box = [[-1, -1, -1], [1, -0.5, 1]] }"  # the upper half: y points down
    reference = built(tmp_path, "cone.ply", upper)
    registry.write(tmp_path / "rub.ply", to_ply_frame(cone(), "RUB"))
    body = built(tmp_path, "rub.ply", f'frame = "RUB"{upper}')
    assert 100 < reference.surface_count and len(body.cloud) == len(reference.cloud)


def test_the_frame_is_said_before_a_body_is_built(tmp_path, caplog):
    """One line where there was something to decide; none for a plain .ply."""
    caplog.set_level(logging.INFO, "vgmpi")
    registry.write(tmp_path / "cone.ply", cone())
    registry.write(tmp_path / "cone.spz", cone())
    built(tmp_path, "cone.ply")
    assert "frame" not in caplog.text
    built(tmp_path, "cone.spz")
    assert "'cone': frame RDF: said by the file's record" in caplog.messages
    built(tmp_path, "cone.spz", 'frame = "RDF"')
    assert "'cone': frame RDF: named by the key frame" in caplog.messages
    caplog.clear()
    with pytest.raises(PlacementError, match="outside the domain"):  # where it helps most
        built(tmp_path, "cone.spz", 'frame = "RUB"\nrotation = { axis = "x", angle = "90 deg" }', 3)
    (said,) = caplog.messages
    assert said == (
        "'cone': frame RUB: named by the key frame, although the file says RDF, turned to RDF"
    )


@pytest.mark.parametrize(
    "line, message",
    [
        ('frame = "rub"', "object.cone.frame: must be three letters, the directions of x, y and z"),
        ("frame = 5", "object.cone.frame: must be three letters"),
    ],
)
def test_wrong_frames_are_refused_with_the_line(tmp_path, line, message):
    registry.write(tmp_path / "cone.ply", cone(50))
    path = tmp_path / "scene.toml"
    path.write_text(SCENE.replace("FILE", "cone.ply") + line)
    with pytest.raises(SceneError) as caught:
        load(path)
    (said,) = caught.value.lines
    assert said.startswith(f"{path}:18: {message}")


@pytest.mark.parametrize(
    "source", ['mesh = "a.obj"', "shape = { sphere = { center = [0, 0, 0], radius = 1 } }"]
)
def test_the_key_is_for_captures_only(tmp_path, source):
    path = tmp_path / "scene.toml"
    path.write_text(SCENE.replace('gaussians = "FILE"', source) + 'frame = "RUB"')
    with pytest.raises(SceneError) as caught:
        load(path)
    said = [line for line in caught.value.lines if "frame" in line]
    assert len(said) == 1 and "is only for objects made of gaussians, not of a" in said[0]


def test_inspect_tells_format_frame_and_doubts(tmp_path):
    registry.write(tmp_path / "cone.spz", cone(50), 4)
    lines = inspect_file.describe_file(tmp_path / "cone.spz").splitlines()
    assert lines[1] == "  format   .spz, version 4"
    assert lines[2] == "  axes     RDF: said by the file's record"
    assert lines[3] == "  training not antialiased is assumed: the file does not say"

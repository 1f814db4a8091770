"""Frames of captures: the turn of centers, shapes and colors to the frame of a .ply."""

import itertools

import numpy as np
import pytest

from tests.gaussians.test_ply import cloud
from vgmpi.gaussians import capture_conventions as frames
from vgmpi.gaussians.capture_conventions import capture_notes
from vgmpi.gaussians.cloud import rotation_matrices, unpack_symmetric
from vgmpi.gaussians.formats import ply, registry
from vgmpi.gaussians.spherical_harmonics import evaluate

ALL = [
    "".join(letters[k] for k in order)
    for letters in itertools.product("RL", "DU", "FB")
    for order in itertools.permutations(range(3))
]
STANDARD = ["LDB", "RDB", "LUB", "RUB", "LDF", "RDF", "LUF", "RUF"]


def seen_from(frame, vectors):
    """Vectors (n, 3) of right, down, forward in the axes of a frame."""
    parts = dict(zip("RDF", vectors.T)) | dict(zip("LUB", -vectors.T))
    return np.stack([parts[letter] for letter in frame], axis=1)


def test_there_are_48_frames():
    assert len(set(ALL)) == 48 and set(STANDARD) < set(ALL)


@pytest.mark.parametrize("frame", ALL)
def test_centers_and_shapes(frame):
    """Right-handed or not: distances of points of the space from each Gaussian are the same."""
    c = cloud(50, 4)
    turned = frames.to_ply_frame(c, frame)
    np.testing.assert_array_equal(seen_from(frame, turned.x), c.x)
    probes = np.random.default_rng(1).normal(size=(50, 3))
    inverse = np.linalg.inv(unpack_symmetric(c.cov()))
    inverse_turned = np.linalg.inv(unpack_symmetric(turned.cov()))
    probes_there = seen_from(frame, probes)
    want = np.einsum("ni,nij,nj->n", probes_there, inverse, probes_there)
    got = np.einsum("ni,nij,nj->n", probes, inverse_turned, probes)
    np.testing.assert_allclose(got, want, rtol=1e-9)
    assert (np.linalg.det(rotation_matrices(turned.quat)) > 0.999).all()
    np.testing.assert_array_equal(turned.scale, c.scale)


@pytest.mark.parametrize("k", [1, 4, 9, 16])
@pytest.mark.parametrize("frame", ALL)
def test_colors_seen_from_the_same_side_are_the_same(frame, k):
    c = cloud(200, k)
    turned = frames.to_ply_frame(c, frame)
    towards = np.random.default_rng(2).normal(size=(200, 3))
    want = evaluate(c.sh, seen_from(frame, towards))
    np.testing.assert_allclose(evaluate(turned.sh, towards), want, atol=2e-6)


@pytest.mark.parametrize("frame", STANDARD)
def test_signs_are_those_of_another_program(frame):
    """convertCoordinates and coordinateConverter of nianticlabs/spz, src/cc/splat-types.h."""
    c = cloud(50, 16)
    turned = frames.to_ply_frame(c, frame)
    x, y, z = (1 if a == b else -1 for a, b in zip(frame, "RDF"))
    np.testing.assert_array_equal(turned.x, c.x * [x, y, z])
    np.testing.assert_array_equal(turned.quat, c.quat * [1, y * z, x * z, x * y])
    signs = [y, z, x, x * y, y * z, 1, x * z, 1, y, x * y * z, y, z, x, z, x]
    want = c.sh[:, 1:] * np.array(signs)[:, None]
    np.testing.assert_allclose(turned.sh[:, 1:], want, atol=1e-6)
    np.testing.assert_array_equal(turned.sh[:, 0], c.sh[:, 0])


def test_rub_turned_twice_is_the_file_itself():
    c = cloud(50, 16)
    back = frames.to_ply_frame(frames.to_ply_frame(c, "RUB"), "RUB")
    np.testing.assert_array_equal(back.x, c.x)
    np.testing.assert_array_equal(back.quat, c.quat)
    np.testing.assert_allclose(back.sh, c.sh, atol=1e-6)


@pytest.mark.parametrize("name", ["", "RD", "RDFB", "rdf", "RRB", "RUD", "XYZ", "RD ", 5, None])
def test_what_is_no_frame_is_refused_in_one_line(name):
    with pytest.raises(ValueError, match=r'three letters.*such as "RDF" or "RUB"$'):
        frames.validate_frame(name)


def test_a_frame_for_any_format(tmp_path):
    c = cloud(20, 4)
    ply.write(tmp_path / "c.ply", c)
    plain = registry.read(tmp_path / "c.ply")
    for frame in ("RUB", "LUB", "FLU"):
        turned = registry.read(tmp_path / "c.ply", frame)
        np.testing.assert_array_equal(seen_from(frame, turned.x), plain.x)
        assert f"frame {frame}: named by the key frame, turned to RDF" in capture_notes(turned)
    with pytest.raises(ValueError, match="three letters"):
        registry.read(tmp_path / "c.ply", "RUX")

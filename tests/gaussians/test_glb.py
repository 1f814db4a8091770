"""A written .glb is what glTF 2.0 and KHR_gaussian_splatting ask for, and holds the cloud with x to
the left, y up and z forward: read here by the words of the specification."""

import json

import numpy as np
import pytest

from vgmpi.gaussians.cloud import GaussianCloud, unpack_symmetric
from vgmpi.gaussians.formats import gltf, registry
from vgmpi.gaussians.spherical_harmonics import evaluate

PREFIX = "KHR_gaussian_splatting:"
TO_GLTF = np.diag([-1.0, -1.0, 1.0])  # right, down, forward to left, up, forward
COUNTS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}
SIZES = {5126: "<f4", 5121: "u1"}


def cloud(n=37, terms=16):
    rng = np.random.default_rng(2)
    quat = rng.normal(size=(n, 4))
    quat /= np.linalg.norm(quat, axis=1)[:, None]
    sh = rng.normal(size=(n, terms, 3)).astype("f4") * 0.1
    return GaussianCloud(
        rng.normal(size=(n, 3)), quat, rng.uniform(0.01, 1, (n, 3)), rng.random(n), sh
    )


def parsed(path):
    """Header, and values of each attribute (n, c)."""
    raw = path.read_bytes()
    magic, version, total = raw[:4], *np.frombuffer(raw[4:12], "<u4")
    assert magic == b"glTF" and version == 2 and total == len(raw)
    chunks, at = {}, 12
    while at < total:
        length = int(np.frombuffer(raw[at : at + 4], "<u4")[0])
        assert length % 4 == 0
        chunks[raw[at + 4 : at + 8]] = raw[at + 8 : at + 8 + length]
        at += 8 + length
    assert list(chunks) == [b"JSON", b"BIN\0"] and at == total
    header = json.loads(chunks[b"JSON"])
    (primitive,) = header["meshes"][0]["primitives"]
    assert header["buffers"][0]["byteLength"] <= len(chunks[b"BIN\0"])
    values = {}
    for name, number in primitive["attributes"].items():
        accessor = header["accessors"][number]
        view = header["bufferViews"][accessor["bufferView"]]
        assert view["byteOffset"] % 4 == 0
        part = chunks[b"BIN\0"][view["byteOffset"] :][: view["byteLength"]]
        found = np.frombuffer(part, SIZES[accessor["componentType"]])
        values[name] = found.reshape(accessor["count"], COUNTS[accessor["type"]])
    return header, values


@pytest.mark.parametrize("terms", [1, 4, 9, 16])
def test_all_is_kept(tmp_path, terms):
    made, path = cloud(terms=terms), tmp_path / "a.glb"
    registry.write(path, made)
    header, values = parsed(path)
    assert header["extensionsUsed"] == [gltf.NAME]
    (primitive,) = header["meshes"][0]["primitives"]
    assert primitive["mode"] == 0
    assert primitive["extensions"][gltf.NAME]["kernel"] == "ellipse"
    position = header["accessors"][primitive["attributes"]["POSITION"]]
    np.testing.assert_array_equal(position["min"], values["POSITION"].min(axis=0))
    np.testing.assert_array_equal(position["max"], values["POSITION"].max(axis=0))
    np.testing.assert_array_equal(values["POSITION"], (made.x @ TO_GLTF).astype("f4"))
    np.testing.assert_array_equal(values[PREFIX + "SCALE"], made.scale.astype("f4"))
    np.testing.assert_array_equal(values[PREFIX + "OPACITY"][:, 0], made.opacity.astype("f4"))
    assert len([name for name in values if "SH_" in name]) == terms


def test_the_rotation_is_that_of_the_specification(tmp_path):
    made = cloud()
    registry.write(tmp_path / "a.glb", made)
    _, values = parsed(tmp_path / "a.glb")
    x, y, z, w = values[PREFIX + "ROTATION"].astype("f8").T
    turn = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    ).transpose(2, 0, 1)
    axes = turn * values[PREFIX + "SCALE"][:, None, :]
    covariance = axes @ axes.transpose(0, 2, 1)
    want = TO_GLTF @ unpack_symmetric(made.cov()) @ TO_GLTF
    np.testing.assert_allclose(covariance, want, rtol=1e-5, atol=1e-6)


def test_colors_are_those_of_the_specification(tmp_path):
    made, direction = cloud(terms=16), np.array([0.36, -0.48, 0.8])
    registry.write(tmp_path / "a.glb", made)
    _, values = parsed(tmp_path / "a.glb")
    x, y, z = direction
    terms = {
        "0_COEF_0": 0.2820947917738781,
        "1_COEF_0": -0.4886025119029199 * y,
        "1_COEF_1": 0.4886025119029199 * z,
        "1_COEF_2": -0.4886025119029199 * x,
        "2_COEF_0": 1.092548430592079 * x * y,
        "2_COEF_1": -1.092548430592079 * y * z,
        "2_COEF_2": 0.3153915652525200 * (2 * z * z - x * x - y * y),
        "2_COEF_3": -1.092548430592079 * x * z,
        "2_COEF_4": 0.5462742152960395 * (x * x - y * y),
        "3_COEF_0": -0.5900435899266435 * y * (3 * x * x - y * y),
        "3_COEF_1": 2.890611442640554 * x * y * z,
        "3_COEF_2": -0.4570457994644657 * y * (4 * z * z - x * x - y * y),
        "3_COEF_3": 0.3731763325901154 * z * (2 * z * z - 3 * x * x - 3 * y * y),
        "3_COEF_4": -0.4570457994644657 * x * (4 * z * z - x * x - y * y),
        "3_COEF_5": 1.445305721320277 * z * (x * x - y * y),
        "3_COEF_6": -0.5900435899266435 * x * (x * x - 3 * y * y),
    }
    color = 0.5 + sum(f * values[f"{PREFIX}SH_DEGREE_{name}"] for name, f in terms.items())
    ours = evaluate(made.sh, np.tile(TO_GLTF @ direction, (len(made), 1)))
    np.testing.assert_allclose(np.maximum(color, 0), ours, atol=1e-6)

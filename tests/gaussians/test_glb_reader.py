"""A .glb is read as its specification says, from bytes by hand: nodes, types of numbers, colors."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.gaussians.test_glb import cloud
from tests.support import splat_containers
from vgmpi.gaussians.capture_conventions import to_ply_frame
from vgmpi.gaussians.cloud import unpack_symmetric
from vgmpi.gaussians.formats import gltf, registry
from vgmpi.gaussians.spherical_harmonics import dc_from_rgb, evaluate

KHR = splat_containers.KHR
TO_PLY = np.diag([-1.0, -1.0, 1.0])  # left, up, forward to right, down, forward
AXIS = np.array([1.0, 2.0, -2.0]) / 3
TURN = Rotation.from_rotvec(1.1 * AXIS)


def read(path, header, binary):
    path.write_bytes(splat_containers.glb(header, binary))
    return registry.read(path)


def by_specification(columns, matrix=1.0, shift=(0, 0, 0)):
    """Centers and covariances in the axes of a .ply: matrix C C^T matrix^T of each Gaussian."""
    matrix = matrix * np.eye(3) if np.isscalar(matrix) else matrix
    x = columns["POSITION"][0].astype("f8") @ matrix.T + np.array(shift)
    turn = Rotation.from_quat(columns[f"{KHR}:ROTATION"][0].astype("f8")).as_matrix()
    root = TO_PLY @ matrix @ (turn * columns[f"{KHR}:SCALE"][0].astype("f8")[:, None, :])
    return x @ TO_PLY, root @ root.transpose(0, 2, 1)


def assert_shapes(got, x, cov):
    np.testing.assert_allclose(got.x, x, atol=1e-6)
    np.testing.assert_allclose(unpack_symmetric(got.cov()), cov, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("terms", [1, 4, 9, 16])
def test_what_the_writer_wrote_comes_back(tmp_path, terms):
    """Row by row, with float32 precision, in the axes of the .ply of the same cloud."""
    before = cloud(terms=terms)
    for suffix in (".glb", ".ply"):
        registry.write(tmp_path / f"a{suffix}", before)
    got, ply = registry.read(tmp_path / "a.glb"), registry.read(tmp_path / "a.ply")
    np.testing.assert_array_equal(got.x, ply.x)
    np.testing.assert_array_equal(got.sh, ply.sh)
    np.testing.assert_allclose(got.quat, ply.quat, atol=1e-15)
    np.testing.assert_allclose(got.scale, ply.scale, rtol=1e-6)
    np.testing.assert_allclose(got.opacity, ply.opacity, atol=1e-6)
    assert got.record.frame == "LUF" and "glTF" in got.record.frame_source
    assert got.record.comments == ("generator: vgmpi",) and not got.is_antialiased


def test_the_axes_are_left_up_forward(tmp_path):
    """What is up in glTF (+y) is up in the capture's .ply (-y), left (+x) is left (-x)."""
    columns = splat_containers.gltf_columns(n=3)
    columns["POSITION"] = (np.eye(3, dtype="f4"), False)
    got = read(tmp_path / "a.glb", *splat_containers.gltf_parts(columns))
    np.testing.assert_array_equal(got.x, [[-1, 0, 0], [0, -1, 0], [0, 0, 1]])
    assert_shapes(got, *by_specification(columns))


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_colors_seen_from_the_same_side_are_the_same(tmp_path, degree):
    columns = splat_containers.gltf_columns(degree=degree)
    got = read(tmp_path / "a.glb", *splat_containers.gltf_parts(columns))
    assert got.sh.shape[1] == (degree + 1) ** 2
    sh = np.stack([c[0] for name, c in columns.items() if "SH_" in name], axis=1)
    direction = np.tile(AXIS, (4, 1))
    np.testing.assert_allclose(
        evaluate(got.sh, direction @ TO_PLY), evaluate(sh, direction), atol=1e-6
    )


def trs(scale):
    return {
        "translation": [10.0, -20.0, 5.0],
        "rotation": TURN.as_quat().tolist(),
        "scale": scale,
    }


def as_matrix(node):
    matrix = np.eye(4)
    matrix[:3, :3] = TURN.as_matrix() * np.array(node["scale"])
    matrix[:3, 3] = node["translation"]
    return matrix


@pytest.mark.parametrize("form", ["parts", "matrix", "parent"])
@pytest.mark.parametrize("scale", [[2.0, 2.0, 2.0], [0.5, 1.0, 3.0]])
def test_nodes_move_turn_and_scale(tmp_path, form, scale):
    columns, node = splat_containers.gltf_columns(n=40, degree=3), trs(scale)
    matrix = as_matrix(node)
    if form == "matrix":
        node = {"matrix": matrix.T.ravel().tolist()}
    header, binary = splat_containers.gltf_parts(columns, node if form != "parent" else None)
    if form == "parent":
        header["nodes"] = [{"children": [1]} | node, {"children": [2]}, {"mesh": 0}]
    got = read(tmp_path / "a.glb", header, binary)
    assert_shapes(got, *by_specification(columns, matrix[:3, :3], matrix[:3, 3]))
    sh = np.stack([c[0] for name, c in columns.items() if "SH_" in name], axis=1)
    direction = np.tile(AXIS[[1, 0, 2]], (40, 1))
    seen = evaluate(got.sh, direction @ TURN.as_matrix().T @ TO_PLY)
    np.testing.assert_allclose(seen, evaluate(sh, direction), atol=1e-5)


def test_a_parent_moves_its_children_by_its_own_scale(tmp_path):
    columns = splat_containers.gltf_columns()
    header, binary = splat_containers.gltf_parts(columns)
    header["nodes"] = [
        {"translation": [1, 0, 0], "scale": [3, 3, 3], "children": [1]},
        {"translation": [0, 2, 0], "mesh": 0},
    ]
    got = read(tmp_path / "a.glb", header, binary)
    assert_shapes(got, *by_specification(columns, 3.0, [1, 6, 0]))


def test_all_primitives_of_all_nodes_of_the_scene(tmp_path):
    """In the order of nodes and primitives; lower degrees are padded, other meshes left out."""
    columns = splat_containers.gltf_columns(n=4, degree=1)
    header, binary = splat_containers.gltf_parts(columns)
    (points,) = header["meshes"][0]["primitives"]
    plain = json.loads(json.dumps(points))
    plain["attributes"] = {k: v for k, v in plain["attributes"].items() if "DEGREE_1" not in k}
    header["meshes"] = [
        {"primitives": [points, plain]},
        {"primitives": [{"attributes": {"POSITION": 0}}]},
        {"primitives": [points]},
    ]
    header["nodes"] = [
        {"mesh": 1, "children": [1]},
        {"mesh": 0, "translation": [1, 0, 0]},
        {"mesh": 0},
        {"mesh": 2},  # not in the scene
    ]
    header |= {"scenes": [{"nodes": [3]}, {"nodes": [2, 0]}], "scene": 1}
    got = read(tmp_path / "a.glb", header, binary)
    x = columns["POSITION"][0] @ TO_PLY
    np.testing.assert_allclose(
        got.x, np.concatenate([x, x, x - [1, 0, 0], x - [1, 0, 0]]), atol=1e-6
    )
    higher = got.sh[:, 1:].reshape(4, 4, -1)
    assert higher[0].all() and not higher[1].any() and higher[2].all() and not higher[3].any()
    assert got.record.omissions == ("meshes without Gaussians are left out",)


def test_without_a_scene_all_nodes_count(tmp_path):
    columns = splat_containers.gltf_columns()
    header, binary = splat_containers.gltf_parts(columns)
    header["nodes"] = [{"mesh": 0}, {"children": [0], "translation": [0, 0, 7]}, {"mesh": 0}]
    del header["scenes"], header["scene"]
    got = read(tmp_path / "a.glb", header, binary)
    x = columns["POSITION"][0] @ TO_PLY
    np.testing.assert_allclose(got.x, np.concatenate([x + [0, 0, 7], x]), atol=1e-6)


def test_interleaved_attributes(tmp_path):
    columns = splat_containers.gltf_columns(n=50, degree=1)
    want = read(tmp_path / "a.glb", *splat_containers.gltf_parts(columns))
    got = read(tmp_path / "b.glb", *splat_containers.gltf_parts(columns, stride=100))
    for name in ("x", "quat", "scale", "opacity", "sh"):
        np.testing.assert_array_equal(getattr(got, name), getattr(want, name))


@pytest.mark.parametrize("code, top", [("i1", 127), ("i2", 32767)])
def test_whole_numbers(tmp_path, code, top):
    """Normalized, and sizes that are not: as the table of the extension allows."""
    columns, unsigned = splat_containers.gltf_columns(), code.replace("i", "u")
    quat = np.rint(columns[f"{KHR}:ROTATION"][0] * top).astype(code)
    quat[0] = [-top - 1, 0, 0, 0]  # decodes to -1 as -top does
    most = 2 * top + 1
    columns[f"{KHR}:ROTATION"] = (quat, True)
    columns[f"{KHR}:SCALE"] = (
        np.array([[1, 2, 3], [most] * 3, [9, 9, 0], [7, 1, 1]], unsigned),
        False,
    )
    columns[f"{KHR}:OPACITY"] = (np.array([[0], [1], [most], [most // 2]], unsigned), True)
    got = read(tmp_path / "a.glb", *splat_containers.gltf_parts(columns))
    np.testing.assert_allclose(np.sort(got.scale)[1], most)
    np.testing.assert_allclose(got.opacity, np.array([0, 1, most, most // 2]) / most)
    exact = dict(columns)
    exact[f"{KHR}:ROTATION"] = (np.maximum(quat / top, -1).astype("f4"), False)
    assert_shapes(got, *by_specification(exact))
    columns[f"{KHR}:SCALE"] = (columns[f"{KHR}:SCALE"][0], True)
    scaled = read(tmp_path / "b.glb", *splat_containers.gltf_parts(columns))
    np.testing.assert_allclose(scaled.scale, got.scale / most)


@pytest.mark.parametrize(
    "name, values",
    [
        ("OPACITY", np.zeros((4, 1), "u1")),
        ("ROTATION", np.ones((4, 4), "i2")),
        ("SH_DEGREE_0_COEF_0", np.zeros((4, 3), "u1")),
        ("SCALE", np.ones((4, 3), "i1")),
    ],
)
def test_numbers_that_the_extension_does_not_allow(tmp_path, name, values):
    columns = splat_containers.gltf_columns() | {f"{KHR}:{name}": (values, False)}
    with pytest.raises(registry.GaussianFileError, match=f"{name} as .*does not allow"):
        read(tmp_path / "a.glb", *splat_containers.gltf_parts(columns))


def test_linear_colors_become_srgb(tmp_path):
    """IEC 61966-2-1: 0.5 of linear light is 0.735357, 0.001 is 0.01292."""
    columns = splat_containers.gltf_columns()
    linear = np.tile(np.array([0.5, 0.001, -0.2]), (4, 1))
    columns[f"{KHR}:SH_DEGREE_0_COEF_0"] = (dc_from_rgb(linear).astype("f4"), False)
    space = {"colorSpace": "lin_rec709_display"}
    got = read(tmp_path / "a.glb", *splat_containers.gltf_parts(columns, extension=space))
    np.testing.assert_allclose(got.rgb, np.tile([0.735357, 0.01292, 0], (4, 1)), atol=1e-6)
    assert any("linear" in doubt for doubt in got.record.doubts)
    columns |= {k: v for k, v in splat_containers.gltf_columns(degree=1).items() if "DEGREE_1" in k}
    with pytest.raises(registry.GaussianFileError, match="only colors of degree 0"):
        read(tmp_path / "b.glb", *splat_containers.gltf_parts(columns, extension=space))


def test_degree_4_is_left_out_and_told(tmp_path):
    columns = splat_containers.gltf_columns(degree=4)
    got = read(tmp_path / "a.glb", *splat_containers.gltf_parts(columns))
    assert got.sh.shape == (4, 16, 3) and got.record.omissions == (
        "colors of degree 4 are left out, the highest is 3",
    )


@pytest.mark.parametrize(
    "extension, says",
    [
        ({"kernel": "customShape"}, "customShape"),
        ({"colorSpace": "bt2020"}, "bt2020"),
        ({"extensions": {"EXT_x": {}}}, "EXT_x"),
    ],
)
def test_what_is_not_known_is_doubted(tmp_path, extension, says):
    header, binary = splat_containers.gltf_parts(
        splat_containers.gltf_columns(), extension=extension
    )
    (doubt,) = read(tmp_path / "a.glb", header, binary).record.doubts
    assert says in doubt


def test_compressed_gaussians_are_named(tmp_path):
    name = f"{KHR}_compression_spz_2"
    extension = {"extensions": {name: {"bufferView": 0}}}
    header, binary = splat_containers.gltf_parts(
        splat_containers.gltf_columns(), extension=extension
    )
    with pytest.raises(registry.GaussianFileError, match=f"compressed by {name}: not supported"):
        read(tmp_path / "a.glb", header, binary)


def test_a_mesh_is_no_cloud(tmp_path):
    header, binary = splat_containers.gltf_parts(splat_containers.gltf_columns())
    del header["meshes"][0]["primitives"][0]["extensions"]
    with pytest.raises(registry.GaussianFileError, match="no Gaussians of KHR.* a mesh"):
        read(tmp_path / "a.glb", header, binary)


def test_a_gltf_with_its_buffer_beside_it(tmp_path):
    columns = splat_containers.gltf_columns(degree=1)
    header, binary = splat_containers.gltf_parts(columns)
    want = read(tmp_path / "a.glb", header, binary)
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "a b.bin").write_bytes(binary)
    header["buffers"][0]["uri"] = "parts/a%20b.bin"
    (tmp_path / "a.gltf").write_text(json.dumps(header))
    got = registry.read(tmp_path / "a.gltf")
    np.testing.assert_array_equal(got.x, want.x)
    np.testing.assert_array_equal(got.sh, want.sh)
    assert got.record.encoding == f".gltf, {KHR}"
    with pytest.raises(registry.GaussianFileError, match="only read"):
        registry.write(tmp_path / "b.gltf", got)


@pytest.mark.parametrize("uri", ["../secret.bin", "/etc/passwd", "%2e%2e/secret.bin", "parts"])
def test_a_gltf_opens_no_files_elsewhere(tmp_path, uri):
    (tmp_path / "secret.bin").write_bytes(bytes(1000))
    (tmp_path / "scene" / "parts").mkdir(parents=True)
    header, _ = splat_containers.gltf_parts(splat_containers.gltf_columns())
    header["buffers"][0]["uri"] = uri
    (tmp_path / "scene" / "a.gltf").write_text(json.dumps(header))
    with pytest.raises(registry.GaussianFileError, match="outside of its own folder|there is none"):
        registry.read(tmp_path / "scene" / "a.gltf")


def test_half_a_turn_on_reading_and_writing_leaves_every_bit():
    before = cloud()
    turned = to_ply_frame(to_ply_frame(before, gltf.FRAME), gltf.FRAME)
    np.testing.assert_array_equal(turned.x, before.x)
    np.testing.assert_array_equal(turned.quat, before.quat)
    np.testing.assert_array_equal(turned.sh, before.sh)

"""Bodies whose particles a file holds: .ply, .npz, .vtp."""

import zipfile

import numpy as np
import pytest

import vgmpi
from vgmpi.preprocess.scene_builder import build_scene

EDGE = 0.01  # [m]
X = EDGE * (np.stack(np.meshgrid(*3 * [np.arange(4)], indexing="ij"), -1).reshape(-1, 3) + 0.5)
RANDOM = np.random.default_rng(0)
V = RANDOM.normal(size=(64, 3)).round(3)
VOLUMES = RANDOM.uniform(0.5, 1, 64).astype(np.float32).astype(float) * 1e-6
COLORS = RANDOM.integers(0, 256, (64, 3))
SCENE = """
[accuracy]
precision = "double"
[domain]
size = [0.16, 0.16, 0.16]
cell = "2 cm"
gravity = [0, 0, 0]
[time]
end = "1 ms"
frames = 2
[material.rubber]
kind = "elastic"
youngs_modulus = "0.1 MPa"
density = 1000
[[object]]
name = "block"
material = "rubber"
origin = [0.05, 0.05, 0.05]
"""


def write_ply(path):
    names = ["x", "y", "z", "volume", "vx", "vy", "vz"]
    head = "ply\nformat ascii 1.0\nelement vertex 64\n"
    head += "".join(f"property double {name}\n" for name in names)
    head += "".join(f"property uchar {name}\n" for name in ("red", "green", "blue"))
    rows = np.column_stack([X, VOLUMES, V, COLORS])
    lines = [" ".join(f"{v!r}" for v in [*r[:7], *map(int, r[7:])]) for r in rows.tolist()]
    path.write_text(head + "end_header\n" + "\n".join(lines) + "\n")


def write_npz(path):
    np.savez_compressed(path, positions=X, volumes=VOLUMES, velocities=V, colors=COLORS / 255)


def write_vtp(path):
    pyvista = pytest.importorskip("pyvista")
    cloud = pyvista.PolyData(X)
    cloud["volume"], cloud["velocity"], cloud["colors"] = VOLUMES, V, COLORS.astype(np.uint8)
    cloud.save(path)


def load(folder, points):
    return vgmpi.load(folder / "scene.toml", text=f"{SCENE}points = {points}\n")


@pytest.mark.parametrize("suffix", [".ply", ".npz", ".vtp"])
def test_a_file_is_the_body_of_its_arrays(tmp_path, suffix):
    globals()[f"write_{suffix[1:]}"](tmp_path / f"block{suffix}")
    found = build_scene(load(tmp_path, f'"block{suffix}"'))
    scale = 1e-6 if suffix == ".vtp" else 1e-12  # pyvista may write numbers of four bytes
    np.testing.assert_allclose(found.x, X + 0.05, scale)
    np.testing.assert_allclose(found.vol0, VOLUMES, scale)
    np.testing.assert_allclose(found.v0, V, scale)
    np.testing.assert_allclose(0.5 + 0.28209479177387814 * found.sh[:, 0], COLORS / 255, 0, 1e-6)


def test_a_run_of_a_file_is_that_of_its_arrays(tmp_path):
    """Also where the particles are read from a folder that was prepared before."""
    write_npz(tmp_path / "block.npz")
    scenes = [load(tmp_path, '"block.npz"'), load(tmp_path, '{ file = "block.npz" }')]
    runs = [vgmpi.run(one, tmp_path / str(k)) for k, one in enumerate(scenes)]
    assert [run.code for run in runs] == [0, 0]
    assert (runs[0].array("positions") == runs[1].array("positions")).all()
    momentum = VOLUMES @ V / VOLUMES.sum()
    mean = VOLUMES @ runs[0].array("velocity") / VOLUMES.sum()
    np.testing.assert_allclose(mean, momentum, 0, 1e-9)


def test_positions_alone_and_a_spacing(tmp_path):
    np.savez(tmp_path / "block.npz", positions=X.astype(np.float32))
    assert build_scene(load(tmp_path, '"block.npz"')).vol0 == pytest.approx(EDGE**3, rel=1e-5)
    made = build_scene(load(tmp_path, '{ file = "block.npz", spacing = "8 mm" }'))
    assert made.vol0 == pytest.approx(0.008**3, rel=1e-12) and not made.v0.any()


def encrypted(path):
    write_npz(path)
    data = bytearray(path.read_bytes())
    data[6] |= 1
    data[data.index(b"PK\x01\x02") + 8] |= 1
    path.write_bytes(bytes(data))


def gray(path):
    pyvista = pytest.importorskip("pyvista")
    cloud = pyvista.PolyData(X)
    cloud["colors"] = VOLUMES
    cloud.save(path.with_suffix(".vtp"))


def npz(path, **arrays):
    np.savez(path, **arrays)


def truncated(path):
    write_npz(path)
    path.write_bytes(path.read_bytes()[:700])


def enormous(path):
    """A header that promises a trillion rows."""
    head = b"{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000, 3), }"
    head += b" " * (117 - len(head)) + b"\n"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("positions.npy", b"\x93NUMPY\x01\x00" + bytes([118, 0]) + head)


@pytest.mark.parametrize(
    "make, points, line",
    [
        (None, '"block.npz"', "there is no file"),
        (None, '"block.xyz"', "must end in .ply, .npz or .vtp; got 'block.xyz'"),
        (None, "{ }", "has no points: give file or positions"),
        (None, '"../block.npz"', "there is no file"),
        (truncated, '"block.npz"', "block.npz: File is not a zip file"),
        (encrypted, '"block.npz"', "is encrypted"),
        (gray, '"block.vtp"', "colors must have three or four numbers per point"),
        (enormous, '"block.npz"', "block.npz: positions is larger than its file explains"),
        (lambda p: npz(p, x=X), '"block.npz"', "block.npz: has an array 'x'; known: positions,"),
        (lambda p: npz(p, volumes=VOLUMES), '"block.npz"', "block.npz: has no positions"),
        (lambda p: npz(p, positions=np.array([{}])), '"block.npz"', "positions holds no numbers"),
        (lambda p: npz(p, positions=X[:, :2]), '"block.npz"', "positions must be a row of 3"),
        (lambda p: npz(p, positions=X, colors=V), '"block.npz"', "colors must be from 0 to 1"),
        (lambda p: npz(p, positions=X, volumes=VOLUMES[1:]), '"block.npz"',
         "volumes has 63 rows, positions has 64"),
        (write_npz, '{ file = "block.npz", spacing = 0.01 }', "has volumes, and spacing is"),
        (lambda p: p.with_suffix(".ply").write_text("ply\n"), '"block.ply"', "block.ply: "),
        (lambda p: p.with_suffix(".vtp").write_text("<VTKFile"), '"block.vtp"', "block.vtp: "),
    ],
)  # fmt: skip
def test_what_is_wrong_with_a_file_is_one_line(tmp_path, make, points, line):
    if make:
        make(tmp_path / "block.npz")
    with pytest.raises(vgmpi.SceneError) as caught:
        build_scene(load(tmp_path, points))
    (message,) = str(caught.value).splitlines()
    assert "scene.toml:19: object.block.points: " in message and line in message, message
    assert len(message) < 300

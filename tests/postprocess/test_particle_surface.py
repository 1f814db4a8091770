"""Surfaces of particles as meshes: closed, flat where a pool is flat, and of the right volume."""

import sys

import numpy as np
import pytest
import pyvista

import vgmpi
from tests.support import drawn_runs, launch
from tests.support.file_digests import files
from vgmpi.io.run_reader import RunReader
from vgmpi.postprocess.commands import export
from vgmpi.postprocess.export import particle_surface

pytest.importorskip("pysplashsurf", reason="needs pysplashsurf: pip install 'vgmpi[mesh]'")

H, CELL = 0.005, 0.01  # distance of particles, 8 per cell
POOL = np.array([0.16, 0.12, 0.08])
BOX = np.array([0.16, 0.12, 0.2])
SCENE = """
[domain]
size = [0.08, 0.08, 0.12]
cell = 0.01
[time]
end = 0.2
frames = 3
[accuracy]
pressure = "explicit"
[material.water]
kind = "fluid"
max_depth = 0.06
[[object]]
name = "pool"
material = "water"
color = "#2f7fd0"
initial_pressure = "hydrostatic"
shape = { box = [[0, 0, 0], [0.08, 0.08, 0.06]] }
[output]
fields = ["velocity", "J", "pressure"]
"""


def lattice(size, jitter=0.0):
    x = (np.indices(np.rint(np.array(size) / H).astype(int)).reshape(3, -1).T + 0.5) * H
    return x + H * np.random.default_rng(1).uniform(-jitter, jitter, x.shape)


def made(x, size=None, fields=None, **options):
    return particle_surface.reconstruct_surface(x, H, fields or {}, size, **options)


def assert_closed(triangles):
    """Each edge has two triangles, which pass it in opposite directions."""
    edges = np.concatenate([triangles[:, [k, (k + 1) % 3]] for k in range(3)])
    assert len(np.unique(edges, axis=0)) == len(edges) > 0
    assert set(map(tuple, edges)) == set(map(tuple, edges[:, ::-1]))


def volume(mesh):
    a, b, c = (mesh.vertices[mesh.triangles[:, k]] for k in range(3))
    return np.einsum("na,na->", a, np.cross(b, c)) / 6


def top_vertices(vertices, triangles):
    """The vertices of all triangles that look up and have an area."""
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    area = np.linalg.norm(normal, axis=1)
    return vertices[np.unique(triangles[(normal[:, 2] > 0.7 * area) & (area > 1e-3 * H * H)])]


def parts(mesh):
    data = pyvista.PolyData.from_regular_faces(mesh.vertices, mesh.triangles)
    return len(np.unique(data.connectivity().point_data["RegionId"]))


@pytest.mark.parametrize("jitter", [0.0, 0.3])
def test_a_pool_is_flat_and_closed(jitter):
    """To 0.1 cells, also at the walls, which cut it; its volume is exact to 0.3 %."""
    mesh = made(lattice(POOL, jitter), BOX)
    assert_closed(mesh.triangles)
    top = top_vertices(mesh.vertices, mesh.triangles)
    assert np.abs(top[:, 2] - POOL[2]).max() < 0.1 * CELL
    np.testing.assert_allclose(top.min(0)[:2], 0, atol=1e-3 * CELL)
    np.testing.assert_allclose(top.max(0)[:2], POOL[:2], atol=1e-3 * CELL)
    assert volume(mesh) == pytest.approx(POOL.prod(), rel=3e-3)
    assert parts(mesh) == 1


def test_the_surface_of_a_ball():
    x = lattice([0.2] * 3) - 0.1
    x = x[np.linalg.norm(x, axis=1) < 0.08]
    mesh = made(x)
    assert_closed(mesh.triangles)
    radius = np.linalg.norm(mesh.vertices, axis=1)
    true = np.cbrt(len(x) * H**3 * 3 / (4 * np.pi))
    assert np.abs(radius - true).max() < 0.25 * CELL
    assert volume(mesh) == pytest.approx(len(x) * H**3, rel=0.04)


def test_drops_and_sheets_stay():
    """A single particle, eight of them, and a layer of one: none vanishes."""
    for x, low, high in (
        (lattice([H] * 3), 0.5, 4.5),
        (lattice([2 * H] * 3), 0.8, 1.6),
        (lattice([12 * H, 12 * H, H]), 0.8, 2.0),
    ):
        mesh = made(x)
        assert_closed(mesh.triangles)
        assert low < volume(mesh) / (len(x) * H**3) < high


def test_gaps_and_mirror_images_leave_nothing():
    x = lattice(POOL)
    middle = np.abs(x - POOL / 2).max(1)
    assert parts(made(x[middle > 1.1 * H], BOX)) == 1  # a gap of eight particles
    assert parts(made(x[middle > 3.1 * H], BOX)) == 2  # a bubble of 216
    drop = lattice([2 * H] * 3) + [0.05, 0.05, 3.1 * H]  # its image in the floor is apart
    mesh = made(drop, BOX)
    assert parts(mesh) == 1 and mesh.vertices[:, 2].min() > H


def test_values_are_interpolated():
    """Two colors side by side, and a field that is linear."""
    x = lattice(POOL, 0.1)
    left = x[:, 0] < 0.08
    rgb = np.where(left[:, None], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0])
    mesh = made(x, BOX, {"RGB": rgb, "place": x[:, 1]})
    there, v = mesh.fields["RGB"], mesh.vertices
    np.testing.assert_allclose(
        there[v[:, 0] < 0.06], [[1, 0, 0]] * (v[:, 0] < 0.06).sum(), atol=1e-9
    )
    np.testing.assert_allclose(there[v[:, 0] > 0.1], [[0, 0, 1]] * (v[:, 0] > 0.1).sum(), atol=1e-9)
    assert mesh.fields["place"] == pytest.approx(v[:, 1], abs=0.5 * CELL)


def test_the_same_particles_give_the_same_bytes(run, tmp_path):
    """In another process, too."""
    command = [sys.executable, "-m", "vgmpi", "export", run, "--surface", "water", "-q"]
    for name in ("a", "b"):
        done = launch.run([*command, "--frames", "-1", "-o", tmp_path / name])
        assert done.returncode == 0, done.stderr
    one, two = files(tmp_path / "a"), files(tmp_path / "b")
    assert set(one) == {"frame_00002.vtp", "surface.pvd"} and one == two


def test_smoothing():
    rough, smooth = (made(lattice(POOL, 0.3), BOX, steps=n) for n in (0, 30))
    spread = [np.ptp(top_vertices(m.vertices, m.triangles)[:, 2]) for m in (rough, smooth)]
    assert spread[1] < 0.5 * spread[0]


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pool")
    scene = vgmpi.load(folder / "scene.toml", text=SCENE)
    assert vgmpi.run(scene, folder / "out").code == 0
    return folder / "out"


def test_the_surface_of_a_run_at_rest_in_paraviews_reader(run, tmp_path):
    """By the material's name: flat to 0.1 cells and closed, with colors, fields and times."""
    assert export.main([str(run), "--surface", "water", "-o", str(tmp_path), "-q"]) == 0
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == [*(f"frame_0000{k}.vtp" for k in range(3)), "surface.pvd"]
    reader = pyvista.get_reader(tmp_path / "surface.pvd")
    assert reader.time_values == pytest.approx([0, 0.1, 0.2])
    reader.set_active_time_value(reader.time_values[-1])
    mesh = reader.read()[0]
    triangles = mesh.faces.reshape(-1, 4)[:, 1:]
    assert_closed(triangles)
    vertices = mesh.points.astype(float)
    top = top_vertices(vertices, triangles)
    assert np.abs(top[:, 2] - 0.06).max() < 0.1 * CELL
    assert top.min(0)[:2] == pytest.approx(0, abs=1e-5) and top.max(0)[:2] == pytest.approx(0.08)
    assert mesh.volume == pytest.approx(0.08 * 0.08 * 0.06, rel=5e-3)
    assert set(mesh.point_data) == {"RGB", "velocity", "J", "pressure"}
    assert mesh.point_data["RGB"].dtype == np.uint8
    assert np.abs(mesh.point_data["RGB"].astype(int) - [0x2F, 0x7F, 0xD0]).max() <= 1
    # at the floor the mean of particles in depths of 5.25 and 5.75 cells
    deep = np.abs(vertices[:, 2]) < 1e-6
    assert mesh.point_data["pressure"][deep].mean() == pytest.approx(1000 * 9.8 * 0.0562, rel=0.03)


def test_points_are_those_of_the_frames(run):
    """For programs that read no VTKHDF: positions, integers and all fields, and a time series."""
    assert export.main([str(run), "--format", "vtp", "-q"]) == 0
    files = RunReader(run)
    for index in range(len(files)):
        frame, mesh = files.frame(index), pyvista.read(run / f"points/frame_{index:05d}.vtp")
        assert mesh.n_points == mesh.n_verts == len(frame["positions"])
        assert np.array_equal(mesh.verts.reshape(-1, 2)[:, 1], np.arange(mesh.n_points))
        assert np.array_equal(mesh.points, frame["positions"])
        assert set(mesh.point_data) == set(frame) - {"positions", "poses"}
        for name in mesh.point_data:
            assert mesh.point_data[name].dtype == frame[name].dtype
            assert np.array_equal(mesh.point_data[name], frame[name])
    series = pyvista.get_reader(run / "points" / "points.pvd")
    assert series.time_values == files.times.tolist()


def test_an_obj_has_colors_and_y_up(run, tmp_path):
    words = [str(run), "--surface", "pool", "--frames", "-1", "-q"]
    assert export.main([*words, "--format", "obj", "-o", str(tmp_path)]) == 0
    assert export.main([*words, "-o", str(tmp_path)]) == 0
    rows = [line.split() for line in (tmp_path / "frame_00002.obj").read_text().splitlines()]
    v = np.array([row[1:] for row in rows if row[0] == "v"], float)
    f = np.array([row[1:] for row in rows if row[0] == "f"], int) - 1
    mesh = pyvista.read(tmp_path / "frame_00002.vtp")
    assert np.array_equal(f, mesh.faces.reshape(-1, 4)[:, 1:])
    x = mesh.points
    np.testing.assert_allclose(v[:, :3], np.column_stack([x[:, 0], x[:, 2], -x[:, 1]]), atol=1e-6)
    np.testing.assert_allclose(255 * v[:, 3:], mesh.point_data["RGB"], atol=0.6)
    assert pyvista.read(tmp_path / "frame_00002.obj").n_cells == len(f)


@pytest.mark.parametrize("name, low, high", [("pool", -0.1, 0.7), ("bar", 0.7, 1.0)])
def test_colors_are_those_of_the_body(tmp_path, name, low, high):
    """A run with two bodies and scenery: only the particles of the chosen one count."""
    out = drawn_runs.write(tmp_path / "out", frames=1)
    assert export.main([str(out), "--surface", name, "-q"]) == 0
    mesh = pyvista.read(out / "surface" / "frame_00000.vtp")
    want = {"pool": drawn_runs.BLUE, "bar": drawn_runs.RED}[name]
    np.testing.assert_allclose(mesh.point_data["RGB"] / 255, [want] * mesh.n_points, atol=3e-3)
    assert low < mesh.bounds.z_min < mesh.bounds.z_max <= high


def test_a_frame_without_the_body_has_an_empty_mesh():
    mesh = made(np.zeros((0, 3)), BOX, {"RGB": np.zeros((0, 3))})
    assert len(mesh.vertices) == len(mesh.triangles) == len(mesh.fields["RGB"]) == 0


@pytest.mark.parametrize(
    "argv, says",
    [
        (["--surface", "wotor"], "did you mean 'water'?"),
        (["--surface", "ice"], "there are pool, water"),
        (["--format", "obj"], "name a body, --surface NAME"),
        (["--format", "vtp", "--up=-y"], "--up: is not for --format vtp without --surface"),
        (["--format", "vtp", "--no-scenery"], "--no-scenery: is not for --format vtp"),
        (["--surface", "pool", "--format", "ply"], "allowed with --surface: vtp, obj"),
        (["--surface", "pool", "--smoothing", "-1"], "allowed: 0 to 500 steps"),
        (["--surface", "pool", "--no-scenery"], "a surface has no scenery"),
        (["--surface", "pool", "-o", "{file}"], "File exists"),
    ],
)
def test_mistakes_end_with_code_2_and_one_line(run, tmp_path, capfd, argv, says):
    (tmp_path / "file").touch()
    argv = [word.format(file=tmp_path / "file") for word in argv]
    assert export.main([str(run), "-q", *argv]) == 2
    text = capfd.readouterr().err.strip()
    assert says in text and "\n" not in text


def test_without_the_package_a_line_says_so(run, tmp_path, capfd, monkeypatch):
    monkeypatch.setitem(sys.modules, "pysplashsurf", None)
    assert export.main([str(run), "--surface", "pool", "-q", "-o", str(tmp_path)]) == 2
    text = capfd.readouterr().err.strip()
    assert "not installed: pip install 'vgmpi[mesh]'" in text and "\n" not in text

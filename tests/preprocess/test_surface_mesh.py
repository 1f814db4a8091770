"""Meshes: reading, even sampling, inside and outside, also where the surface has holes."""

import numpy as np
import pytest
import pyvista
import scipy
from imageio.v3 import imwrite
from scipy.spatial import cKDTree

from tests.support.small_scenes import ROOM, scene
from vgmpi.gaussians.cloud import rotation_matrices
from vgmpi.preprocess import shape_sdf
from vgmpi.preprocess.meshes import point_in_mesh, surface_mesh
from vgmpi.preprocess.meshes.surface_mesh import MeshError
from vgmpi.preprocess.meshes.triangle_mesh import Mesh
from vgmpi.solver.initial_particles import preparation_hash


def ball(radius=0.1, middle=(0.31, 0.27, 0.22), rings=24):
    """A closed triangle mesh of a sphere, outward."""
    theta = np.linspace(0, np.pi, rings + 1)[1:-1]
    phi = np.arange(2 * rings) * np.pi / rings
    t, p = np.meshgrid(theta, phi, indexing="ij")
    grid = np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)], axis=-1)
    points = np.concatenate([grid.reshape(-1, 3), [[0, 0, 1], [0, 0, -1]]])
    n, north, south = 2 * rings, len(points) - 2, len(points) - 1
    faces = []
    for j in range(n):
        k = (j + 1) % n
        faces.append((north, j, k))
        for i in range(rings - 2):
            a, b, c, d = i * n + j, i * n + k, (i + 1) * n + j, (i + 1) * n + k
            faces += [(a, c, b), (b, c, d)]
        last = (rings - 2) * n
        faces.append((south, last + k, last + j))
    return Mesh(points * radius + np.array(middle), np.array(faces))


def cube(low, high):
    """Twelve triangles, outward, whose faces are aligned with the axes."""
    c = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [f for a, b, c_, d in quads for f in ((a, b, c_), (a, c_, d))]
    low, high = np.asarray(low), np.asarray(high)
    return Mesh(low + c * (high - low), np.array(faces))


def volume(m):
    a, b, c = m.corners().transpose(1, 0, 2)
    return np.abs((a * np.cross(b, c)).sum() / 6)


def lattice_inside(m, h):
    low, high = m.points.min(axis=0), m.points.max(axis=0)
    return shape_sdf.lattice(lambda x: point_in_mesh.inside(m, x, h), low, high, h)


def test_inside_of_a_ball():
    m, h = ball(), 0.005
    x = lattice_inside(m, h)
    assert len(x) * h**3 == pytest.approx(volume(m), rel=0.005)
    away = np.linalg.norm(x - [0.31, 0.27, 0.22], axis=1)
    assert away.max() < 0.1 + 1e-9


def test_faces_and_edges_through_lattice_points_and_lines():
    h = 0.01  # faces at 0.005 + k h run through points, diagonals through lines of points
    x = lattice_inside(cube([0.005, 0.015, 0.025], [0.105, 0.115, 0.065]), h)
    assert len(x) == 10 * 10 * 4


def test_cubes_that_overlap_count_once():
    a, b = cube([0, 0, 0], [0.1, 0.1, 0.1]), cube([0.05, 0.05, 0.05], [0.15, 0.15, 0.15])
    both = Mesh(
        np.concatenate([a.points, b.points]), np.concatenate([a.triangles, b.triangles + 8])
    )
    assert len(lattice_inside(both, 0.01)) == 1000 + 1000 - 125


def test_a_hole_in_the_surface_does_not_leak():
    m, h = ball(), 0.005
    middle = m.corners().mean(axis=1) - [0.31, 0.27, 0.22]
    hole = Mesh(m.points, m.triangles[middle[:, 2] < 0.085])  # the top cap is missing
    assert len(hole.triangles) < len(m.triangles)
    assert len(lattice_inside(hole, h)) == pytest.approx(len(lattice_inside(m, h)), rel=0.05)
    above = shape_sdf.lattice(
        lambda x: np.ones(len(x), bool), [0.28, 0.24, 0.33], [0.34, 0.3, 0.4], h
    )
    assert not point_in_mesh.inside(
        hole, above, h
    ).any()  # one axis sees only the floor below the hole


def test_samples_are_even_on_the_surface_and_face_outward():
    m, h = ball(), 0.01
    cloud = surface_mesh.sample(m, h, (0.2, 0.4, 0.6), 0.9, [1, 2])
    away = cloud.x - [0.31, 0.27, 0.22]
    size = np.linalg.norm(away, axis=1)
    assert size.max() < 0.1 + 1e-9 and size.min() > 0.099
    area = 4 * np.pi * 0.1**2
    gap = cKDTree(cloud.x).query(cloud.x, 2)[0][:, 1]
    ideal = np.sqrt(area / len(cloud))
    assert gap.min() > 0.6 * ideal and gap.max() < 1.6 * ideal
    # no holes: every point of the surface has a Gaussian within 1.1 of the mean distance
    probe = np.random.default_rng(1).normal(size=(5000, 3))
    probe = probe / np.linalg.norm(probe, axis=1)[:, None] * 0.0995 + [0.31, 0.27, 0.22]
    assert cKDTree(cloud.x).query(probe)[0].max() < 1.15 * ideal
    normal = rotation_matrices(cloud.quat)[:, :, 2]
    assert np.allclose(normal, surface_mesh.normals(cloud))
    assert ((normal * away).sum(axis=1) / size).min() > 0.98
    assert np.allclose(cloud.scale[:, 2], 0.1 * cloud.scale[:, 0])
    assert cloud.scale[0, 0] == pytest.approx(0.6 * ideal, rel=0.01)
    assert np.allclose(cloud.rgb, (0.2, 0.4, 0.6), atol=1e-6)


def test_the_same_key_gives_the_same_samples():
    m = ball()
    a, b, c = (
        surface_mesh.sample(m, 0.01, (1, 1, 1), 0.9, key) for key in ([1, 2], [1, 2], [1, 3])
    )
    assert np.array_equal(a.x, b.x) and not np.array_equal(a.x[:100], c.x[:100])


@pytest.mark.parametrize("few", [None, 10, 150])
def test_spread_is_what_one_by_one_gives(monkeypatch, few):
    """Also in parts, as where points crowd."""
    if few is not None:
        monkeypatch.setattr(surface_mesh, "_MIN_BATCH", few)
        monkeypatch.setattr(surface_mesh, "_PAIRS_PER_POINT", 0)
    x = np.random.default_rng(2).random((400, 3))
    kept = []
    for k in range(len(x)):
        if all(np.linalg.norm(x[k] - x[j]) > 0.15 for j in kept):
            kept.append(k)
    assert np.array_equal(surface_mesh.poisson_disc_subset(x, 0.15), kept)


def test_crowds_are_seen_before_their_pairs_are_made(monkeypatch):
    tree, sizes = scipy.spatial.cKDTree, []

    class Watched(tree):
        def query_pairs(self, *args, **kwargs):
            found = super().query_pairs(*args, **kwargs)
            sizes.append(len(found))
            return found

    monkeypatch.setattr(scipy.spatial, "cKDTree", Watched)
    x = np.random.default_rng(2).random((20_000, 3))
    x[::4] *= 0.01  # a quarter in a corner: 12 million pairs
    kept = surface_mesh.poisson_disc_subset(x, 0.02)
    assert max(sizes) < surface_mesh._MIN_BATCH**2 / 2 and len(sizes) > 1
    assert len(tree(x[kept]).query_pairs(0.02)) == 0
    away = tree(x[kept]).query(x)[0]
    assert away.max() <= 0.02


def test_crossings_in_parts_are_the_same(monkeypatch):
    m = ball(rings=8)
    every = lattice_inside(m, 0.01)
    monkeypatch.setattr(point_in_mesh, "_BATCH", 30)
    assert np.array_equal(lattice_inside(m, 0.01), every) and len(every)


@pytest.mark.parametrize("many", [0, point_in_mesh._MAX_CROSSINGS])
def test_crossings_below_are_those_that_are_counted_one_by_one(monkeypatch, many):
    """Also of lines without any, and of points that lie on one."""
    monkeypatch.setattr(point_in_mesh, "_MAX_CROSSINGS", many)
    random = np.random.default_rng(5)
    lines, columns = random.integers(0, 9, 40), random.integers(0, 12, 300)
    heights, signs = random.integers(0, 9, 40) / 8, random.choice([-1.0, 1.0], 40)
    points = np.stack([columns, columns, random.integers(-1, 10, 300) / 8], axis=1)
    want = [
        sum(s for line, z, s in zip(lines, heights, signs) if line == c and z <= p[2])
        for c, p in zip(columns, points)
    ]
    assert point_in_mesh._crossings_below(lines, heights, signs, columns, points).tolist() == want


def test_two_directions_that_agree_need_no_third():
    """Of a soup of triangles, where the directions often do not."""
    h, random = 0.02, np.random.default_rng(3)
    soup = Mesh(random.random((120, 3)) * 0.4, np.arange(120).reshape(40, 3))
    points = (np.stack(np.meshgrid(*[np.arange(20)] * 3), axis=-1).reshape(-1, 3) + 0.5) * h
    orders = [[(axis + 1) % 3, (axis + 2) % 3, axis] for axis in range(3)]
    ways = [point_in_mesh._winding(soup.corners()[:, :, o], points[:, o], h) != 0 for o in orders]
    want = np.sum(ways, axis=0) >= 2
    assert (point_in_mesh.inside(soup, points, h) == want).all()
    assert 500 < want.sum() < 7000 and 500 < np.sum(ways[0] != ways[1])


def test_vertex_colors_are_interpolated():
    m = cube([0, 0, 0], [0.1, 0.1, 0.1])
    rgb = (m.points / 0.1) * (0.8, 0.6, 0.0)
    cloud = surface_mesh.sample(Mesh(m.points, m.triangles, rgb), 0.01, (0, 0, 0), 0.9, [1])
    assert np.allclose(cloud.rgb, cloud.x / 0.1 * (0.8, 0.6, 0.0), atol=1e-5)


def test_normals_of_every_direction():
    n = np.random.default_rng(3).normal(size=(200, 3))
    n = np.concatenate([n / np.linalg.norm(n, axis=1)[:, None], np.eye(3), -np.eye(3)])
    assert np.allclose(
        rotation_matrices(surface_mesh.quaternion_to_normal(n))[:, :, 2], n, atol=1e-6
    )


def test_obj_with_polygons_negative_numbers_colors_and_textures(tmp_path):
    path = tmp_path / "square.obj"
    path.write_text(
        "# a square\nv 0 0 0 1 0 0\nv 1 0 0 0 1 0\nv 1 1 0 0 0 1\nv 0 1 0 1 1 1\n"
        "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nvt .5 .5\nvn 0 0 1\n"
        "f 1/1/1 2/2/1 3/3/1 4/5/1\nf -4 -3 -2\n"
    )
    m = surface_mesh.read(path)
    assert m.triangles.tolist() == [[0, 1, 2], [0, 2, 3], [0, 1, 2]]
    assert m.rgb.tolist() == [[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]]


@pytest.mark.parametrize("suffix", ["stl", "ply", "vtk", "vtu", "obj"])
def test_formats(tmp_path, suffix):
    import meshio

    m = cube([0, 0, 0], [1, 2, 3])
    path = tmp_path / f"cube.{suffix}"
    meshio.Mesh(m.points, [("triangle", m.triangles)]).write(path)
    found = surface_mesh.read(path)
    assert len(found.triangles) == 12 and volume(found) == pytest.approx(6)


@pytest.mark.parametrize(
    "name, text, says",
    [
        ("a.obj", "v 0 0 0\n", "holds no triangles"),
        ("a.obj", "v 0 0\nv 1 0\nf 1 2 1\n", "cannot be read"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 nan\nf 1 2 3\n", "not finite"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "triangles without points"),
        ("a.stl", "nothing", "cannot be read"),
        ("a.ply", "ply\n", "cannot be read"),
        ("a.ply", "ply\nformat ascii 1.0\nelement vertex 3\n", "its header has no end"),
        ("a.xyz", "1 2 3", "allowed are .obj, .stl"),
    ],
)
def test_bad_files_are_one_line(tmp_path, name, text, says, capsys):
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(MeshError) as caught:
        surface_mesh.read(path)
    assert says in str(caught.value) and str(path) in str(caught.value)
    assert "\n" not in str(caught.value)
    assert capsys.readouterr() == ("", "")


@pytest.mark.timeout(60)  # some readers wait for ever at the end of a cut file
@pytest.mark.parametrize("suffix", surface_mesh.FORMATS)
def test_cut_files_end_in_an_error_or_a_mesh(tmp_path, suffix):
    import meshio

    m = cube([0, 0, 0], [1, 2, 3])
    path = tmp_path / f"cube{suffix}"
    if suffix == ".vtp":
        pyvista.PolyData.from_regular_faces(m.points, m.triangles).save(path)
    else:
        kind = "gmsh" if suffix == ".msh" else None
        meshio.Mesh(m.points, [("triangle", m.triangles)]).write(path, file_format=kind)
    whole = path.read_bytes()
    refused = 0
    for size in range(0, len(whole), max(1, len(whole) // 8)):
        path.write_bytes(whole[:size])
        try:
            assert len(surface_mesh.read(path).triangles) <= 12
        except MeshError:
            refused += 1
    assert refused > 5


# a square of 2 x 2 with a picture of 2 x 2 pixels, and a triangle of a material without one
PAINTED = """mtllib square.mtl
v 0 0 0
v 2 0 0
v 2 2 0
v 0 2 0
v 5 0 0
v 6 0 0
v 5 1 0
vt 0 0
vt 1 0
vt 1 1
vt 0 1
usemtl tiles
f 1/1 2/2 3/3 4/-1
usemtl plain
f 5/1 6/2 7/3
usemtl tiles
f 5 6 7
"""
LIBRARY = "newmtl plain\nKd 1 0 0\nnewmtl tiles\nmap_Kd -s 1 1 1 pictures/tiles.png\n"
TILES = np.array(
    [[[255, 0, 0], [0, 255, 0]], [[0, 0, 255], [255, 255, 255]]], dtype=np.uint8
)  # the upper row first


def painted(folder, library=LIBRARY, picture=TILES):
    (folder / "pictures").mkdir(exist_ok=True)
    (folder / "square.obj").write_text(PAINTED)
    if library:
        (folder / "square.mtl").write_text(library)
    if picture is not None:
        imwrite(folder / "pictures" / "tiles.png", picture)
    return surface_mesh.read(folder / "square.obj")


def test_a_texture_colors_what_lies_under_it(tmp_path):
    found = painted(tmp_path)
    assert found.textures.which.tolist() == [0, 0, -1, -1]
    cloud = surface_mesh.sample(found, 0.02, (0.5, 0.5, 0.5), 0.9, [1])
    x, rgb = cloud.x, cloud.rgb
    # the middles of the pixels are at 1/4 and 3/4 of the square
    for where, color in (
        ((0.5, 1.5), (1, 0, 0)),
        ((1.5, 1.5), (0, 1, 0)),
        ((0.5, 0.5), (0, 0, 1)),
        ((1.5, 0.5), (1, 1, 1)),
        ((1.0, 1.0), (0.5, 0.5, 0.5)),
    ):
        near = np.linalg.norm(x[:, :2] - where, axis=1) < 0.02
        assert near.sum() > 5 and np.allclose(rgb[near].mean(axis=0), color, atol=0.04), where
    # without a picture: the material's color, or else the object's
    other = rgb[x[:, 0] > 4]
    counts = [np.isclose(other, c, atol=1e-6).all(1).sum() for c in ((1, 0, 0), (0.5,) * 3)]
    assert min(counts) > 1000 and sum(counts) == len(other)
    right = (x[:, 0] > 1.99) & (x[:, 0] < 2) & (np.abs(x[:, 1] - 1.5) < 0.1)
    assert np.allclose(rgb[right].mean(axis=0), (0.5, 0.5, 0), atol=0.05)  # it repeats


@pytest.mark.parametrize("kind", ["grey", "alpha", "16 bit"])
def test_kinds_of_pictures(tmp_path, kind):
    picture = {
        "grey": TILES[..., 0],
        "alpha": np.pad(TILES, ((0, 0), (0, 0), (0, 1)), constant_values=9),
        "16 bit": TILES[..., 0].astype(np.uint16) * 257,
    }[kind]
    [image] = painted(tmp_path, picture=picture).textures.images
    want = TILES / 255 if kind == "alpha" else np.repeat(TILES[..., :1], 3, axis=2) / 255
    assert np.allclose(image, want)


@pytest.mark.parametrize(
    "library, picture, said",
    [
        ("", TILES, "names 'square.mtl', which is not there"),
        (LIBRARY, None, "names 'pictures/tiles.png', which is not there"),
        (LIBRARY.replace("pictures", "../.."), TILES, "lies outside its folder"),
        (LIBRARY.replace("-s 1 1 1 pictures/tiles.png", "square.mtl"), TILES, "cannot be read"),
    ],
)
def test_a_mesh_without_its_pictures_is_plain(tmp_path, caplog, library, picture, said):
    found = painted(tmp_path, library, picture)
    assert found.textures is None and len(found.triangles) == 4
    assert said in caplog.text and len(caplog.records) == 1


def test_textures_that_make_no_sense(tmp_path):
    painted(tmp_path)
    for old, new in (("3/3 4/-1", "3/3 4/9"), ("vt 1 1", "vt 1 nan")):
        (tmp_path / "square.obj").write_text(PAINTED.replace(old, new))
        with pytest.raises(MeshError, match="texture coordinates"):
            surface_mesh.read(tmp_path / "square.obj")


def test_a_new_picture_is_a_new_preparation(tmp_path):
    painted(tmp_path)
    text = """
[[object]]
name = "tile"
material = "clay"
mesh = "square.obj"
width = 0.1
position = [0.2, 0.2, 0.2]
"""
    loaded = scene(tmp_path, ROOM + text)
    one = preparation_hash(loaded)
    assert preparation_hash(loaded) == one
    imwrite(tmp_path / "pictures" / "tiles.png", TILES[::-1])
    assert preparation_hash(loaded) != one


def test_what_a_library_says_of_a_file_is_a_line_for_people(tmp_path):
    path = tmp_path / "a.obj"
    path.write_text(f"v 0 0 {'9' * 5000}_\n")
    with pytest.raises(surface_mesh.MeshError) as caught:
        surface_mesh.read(path)
    assert "could not convert string to float: '999" in str(caught.value)
    assert len(str(caught.value)) < 300 + len(str(path))

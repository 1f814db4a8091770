"""Shells, holes and sides of meshes, and what a scene makes of them."""

import logging

import numpy as np
import pytest

from tests.preprocess.test_surface_mesh import ball, cube, volume
from tests.support.small_scenes import ROOM, scene
from vgmpi.preprocess import inspect_file
from vgmpi.preprocess.meshes.mesh_topology import analyze_mesh, oriented
from vgmpi.preprocess.meshes.triangle_mesh import Mesh
from vgmpi.preprocess.scene_builder import build_scene


def flipped(mesh):
    return Mesh(mesh.points, mesh.triangles[:, ::-1])


def joined(*meshes):
    first = np.cumsum([0, *(len(m.points) for m in meshes)])
    triangles = [m.triangles + k for m, k in zip(meshes, first)]
    return Mesh(np.concatenate([m.points for m in meshes]), np.concatenate(triangles))


def signed_volume(m):
    a, b, c = m.corners().transpose(1, 0, 2)
    return (a * np.cross(b, c)).sum() / 6


BIG, LATER = cube([0, 0, 0], [1, 1, 1]), cube([0.5, 0.2, 0.2], [1.5, 0.8, 0.8])
HOLE, ISLAND = cube([0.2] * 3, [0.8] * 3), cube([0.4] * 3, [0.6] * 3)


@pytest.mark.parametrize(
    "mesh, turned, want",
    [
        (BIG, 0, 1.0),
        (flipped(BIG), 1, 1.0),
        (joined(BIG, flipped(LATER)), 1, 1.36),  # 1 and 0.36; their union is 1.18
        (joined(BIG, flipped(HOLE)), 0, 1 - 0.216),  # a cavity stays one
        (joined(flipped(BIG), HOLE), 2, 1 - 0.216),
        (joined(BIG, flipped(HOLE), ISLAND), 0, 1 - 0.216 + 0.008),
        (joined(flipped(BIG), HOLE, flipped(ISLAND)), 3, 1 - 0.216 + 0.008),
        (joined(BIG, HOLE), 0, 1.216),  # facing outward: part of the solid
        (joined(BIG, cube([1, 0, 0], [2, 1, 1]), flipped(cube([3, 0, 0], [4, 1, 1]))), 1, 3.0),
    ],
)
def test_shells_face_outward_and_cavities_inward(mesh, turned, want):
    topology = analyze_mesh(mesh)
    assert topology.inside_out.sum() == turned and not topology.is_open
    assert topology.is_closed.all() and len(topology.is_closed) == len(mesh.triangles) // 12
    assert signed_volume(oriented(mesh, topology)) == pytest.approx(want)


def test_triangles_that_face_both_ways_are_turned():
    random = np.random.default_rng(4)
    mesh = ball(rings=12)
    swap = random.random(len(mesh.triangles)) < 0.3
    mixed = Mesh(mesh.points, np.where(swap[:, None], mesh.triangles[:, ::-1], mesh.triangles))
    topology = analyze_mesh(mixed)
    assert topology.is_mixed.tolist() == [True] and (topology.flips == swap).all()
    assert signed_volume(oriented(mixed, topology)) == pytest.approx(volume(mesh))


def test_points_at_one_place_are_one():
    """As in .stl files and at the seams of textures, also where rounding parts them."""
    mesh = ball()
    soup = mesh.points[mesh.triangles].reshape(-1, 3)
    soup = soup + 1e-9 * np.random.default_rng(1).normal(size=soup.shape)
    topology = analyze_mesh(Mesh(soup, np.arange(len(soup)).reshape(-1, 3)))
    assert not topology.is_open and len(topology.is_closed) == 1


def test_holes_of_a_box():
    open_box = Mesh(BIG.points, BIG.triangles[2:])
    topology = analyze_mesh(open_box)
    assert topology.boundary_edges == 4 and topology.hole_size.tolist() == [1.0]
    assert topology.hole_center.tolist() == [[0.0, 0.5, 0.5]]
    two = analyze_mesh(Mesh(BIG.points, np.delete(BIG.triangles, [0, 2], axis=0)))
    assert two.boundary_edges == 6 and two.hole_size.tolist() == [1.0, 1.0]


def test_walls_between_and_twisted_bands_are_left_alone():
    wall = Mesh(BIG.points, np.array([[0, 6, 1], [1, 6, 7]]))  # across the box, from edge to edge
    parted = Mesh(BIG.points, np.concatenate([BIG.triangles, wall.triangles]))
    topology = analyze_mesh(parted)
    assert topology.branching_edges >= 2 and not topology.flips.any()
    angle = np.linspace(0, 2 * np.pi, 41)
    band = np.array([[(1 + r * np.cos(t / 2)) * np.cos(t), (1 + r * np.cos(t / 2)) * np.sin(t),
                      r * np.sin(t / 2)] for t in angle for r in (-0.2, 0.2)])  # fmt: skip
    rows = [t for k in range(0, 80, 2) for t in ((k, k + 2, k + 1), (k + 1, k + 2, k + 3))]
    topology = analyze_mesh(Mesh(band, np.array(rows)))
    assert topology.is_open and len(topology.hole_size) == 1 and not topology.flips.any()


def test_lines_and_points_have_no_shell():
    topology = analyze_mesh(Mesh(BIG.points, np.array([[0, 0, 1], [2, 2, 2]])))
    assert not topology.is_open and not topology.flips.any() and len(topology.is_closed) == 0


def write(path, mesh):
    rows = [f"v {x} {y} {z}" for x, y, z in mesh.points]
    rows += [f"f {a} {b} {c}" for a, b, c in mesh.triangles + 1]
    path.write_text("\n".join(rows) + "\n")


def body_volume(folder, mesh, width):
    write(folder / "thing.obj", mesh)
    text = f"""
[[object]]
name = "thing"
material = "clay"
mesh = "thing.obj"
width = {width}
position = [0.2, 0.2, 0.05]
"""
    return build_scene(scene(folder, ROOM + text)).vol0.sum()


def test_the_volume_of_a_body_is_that_of_the_union(tmp_path, caplog):
    caplog.set_level(logging.INFO)
    scale = 0.3 / 1.5
    found = body_volume(tmp_path, joined(BIG, flipped(LATER)), 0.3)
    assert found == pytest.approx(1.18 * scale**3, rel=0.01)
    assert "'thing': 1 of its 2 shells is inside out: turned outward" in caplog.text
    hollow = body_volume(tmp_path, joined(BIG, flipped(HOLE)), 0.2)
    assert hollow == pytest.approx((1 - 0.216) * 0.2**3, rel=0.01)


def test_an_open_body_says_what_counts_as_its_inside(tmp_path, caplog):
    caplog.set_level(logging.INFO)
    found = body_volume(tmp_path, Mesh(BIG.points, BIG.triangles[2:]), 0.2)
    assert found == pytest.approx(0.2**3, rel=0.02)
    assert "its mesh is open: 4 boundary edges; one hole 0.2 m wide at (0.1, 0.2, 0.15) m; it" in (
        caplog.text
    )
    assert "counts as filled up to its holes" in caplog.text


def test_inspect_tells_shells_and_holes(tmp_path):
    write(tmp_path / "a.obj", joined(BIG, flipped(LATER)))
    text = inspect_file.describe_file(tmp_path / "a.obj")
    assert "surface  watertight\n  shells   2, 1 inside out\n" in text
    write(tmp_path / "a.obj", joined(BIG, Mesh(LATER.points, LATER.triangles[2:])))
    text = inspect_file.describe_file(tmp_path / "a.obj")
    assert "open: 4 boundary edges; one hole 0.6 wide at (0.5, 0.5, 0.5)\n" in text
    assert "shells   2, 1 of them open\n" in text

"""Open meshes as colliders: a wall of half a cell, whose two sides are kept apart."""

import functools
import logging

import numpy as np
import pytest

from tests.preprocess.test_mesh_topology import write
from tests.preprocess.test_surface_mesh import cube
from tests.support.simulate import advance, begin, by_id
from vgmpi.features.thin_walls.kernels import EDGE
from vgmpi.features.thin_walls.shells import thin_shell
from vgmpi.preprocess import sheet_collider
from vgmpi.preprocess.meshes.triangle_mesh import Mesh
from vgmpi.preprocess.sheet_collider import SheetCollider

DX = 0.02


def revolved(profile, n=24):
    """A sheet of revolution about z through (r, z); r = 0 is one point."""
    angle = 2 * np.pi * np.arange(n) / n
    points, rings, faces = [], [], []
    for r, z in profile:
        count = n if r > 0 else 1
        rings.append(len(points) + (np.arange(n) if r > 0 else np.zeros(n, dtype=int)))
        points += [(r * np.cos(a), r * np.sin(a), z) for a in angle[:count]]
    for p, q in zip(rings, rings[1:]):
        for i in range(n):
            j = (i + 1) % n
            faces += [(p[i], p[j], q[j]), (p[i], q[j], q[i])]
    proper = [f for f in faces if len(set(f)) == 3]
    return Mesh(np.array(points), np.array(proper))


BOWL = revolved([(0, 0), (0.1, 0), (0.1, 0.14)])
TUBE = revolved([(0.1, 0), (0.1, 0.2)])
HEMISPHERE = revolved([(0.12 * np.sin(s), 0.12 - 0.12 * np.cos(s))
                       for s in np.linspace(0, np.pi / 2, 9)])  # fmt: skip
BOX = cube([0, 0, 0], [0.2, 0.2, 0.2])
BOX = Mesh(BOX.points, BOX.triangles[:-2])  # its last face, z = 0.2, is missing
QUAD = Mesh(np.array([[0, 0, 0], [0.2, 0, 0], [0.2, 0.2, 0], [0, 0.2, 0.06]]),
            np.array([[0, 1, 2], [0, 2, 3]]))  # fmt: skip
SHEETS = {"bowl": BOWL, "tube": TUBE, "hemisphere": HEMISPHERE, "box": BOX, "quad": QUAD}


def collider_of(mesh):
    return SheetCollider.from_triangles("sheet", mesh.corners(), DX)


@functools.cache
def shell_of(name):
    """The shell of a sheet, stored whole."""
    return thin_shell(collider_of(SHEETS[name]), DX)


@pytest.mark.parametrize("cuts", [1, 40])
def test_distance_of_a_square(cuts):
    """Of large and of small triangles: that to a square, less half of half a cell."""
    u = np.linspace(0, 0.2, cuts + 1)
    points = np.array([(x, y, 0) for x in u for y in u])
    k = (np.arange(cuts)[:, None] * (cuts + 1) + np.arange(cuts)).ravel()
    faces = np.concatenate([np.stack([k, k + cuts + 1, k + 1], 1),
                            np.stack([k + 1, k + cuts + 1, k + cuts + 2], 1)])  # fmt: skip
    x = np.random.default_rng(2).uniform(-0.2, 0.4, (2000, 3)) * (1, 1, 0.5)
    beyond = np.maximum(np.maximum(-x, x - (0.2, 0.2, 0)), 0)
    exact = np.linalg.norm(beyond, axis=1)
    found = collider_of(Mesh(points, faces))
    error = np.abs(found.distance(x) - (exact - DX / 4))
    assert error[exact < 4 * DX].max() < 1e-12 and error.max() < 0.05 * DX
    foot = np.clip(x, 0, (0.2, 0.2, 0))
    close = (exact < 4 * DX) & (exact > 0.01 * DX)
    normal = (x - foot) / np.maximum(exact, 1e-9)[:, None]
    assert np.abs(found.normal(x[close]) - normal[close]).max() < 1e-6


@pytest.mark.parametrize("name", ["bowl", "box"])
def test_what_is_far_outside_the_domain_is_not_stored(name):
    """What is stored is the same."""
    collider, every = collider_of(SHEETS[name]), shell_of(name)
    middle = every.start + DX / 4 * np.array(every.front.shape)
    domain = middle - 0.03, middle + np.array([0.05, 0.04, 0.03])
    part = thin_shell(collider, DX, domain)
    first = np.rint((part.start - every.start) / (DX / 2)).astype(int)
    end = first + part.front.shape
    ends = domain[0] - 8 * DX, domain[1] + 8 * DX
    assert (part.start <= np.maximum(ends[0], every.start) + 1e-12).all()
    assert part.front.size < every.front.size
    inner = tuple(slice(a, b) for a, b in zip(first, end, strict=True))
    in_domain = (slice(16, -16),) * 3  # the margin of 8 cells sees beyond the cut
    for mine, theirs in zip(part[1:], every[1:], strict=True):
        np.testing.assert_array_equal(mine[in_domain], theirs[inner][in_domain])


def test_a_sheet_outside_the_domain_is_stored_whole():
    found = thin_shell(collider_of(QUAD), DX, (np.full(3, 9.0), np.full(3, 9.1)))
    assert found.front.shape == shell_of("quad").front.shape


@pytest.mark.parametrize("name", SHEETS)
def test_the_two_sides_are_told_apart_up_to_the_edge(name):
    """Points a cell off a face see one side all over the sheet and the other one behind it; what
    lies beyond the edge has no side."""
    mesh, shell = SHEETS[name], shell_of(name)
    collider = collider_of(mesh)
    random = np.random.default_rng(5)
    corner = mesh.corners()
    cross = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    area = np.linalg.norm(cross, axis=1)
    chosen = random.choice(len(corner), 3000, p=area / area.sum())
    weights = random.dirichlet((1, 1, 1), 3000)
    x = (weights[:, :, None] * corner[chosen]).sum(axis=1)
    normal = cross[chosen] / area[chosen, None]
    directed = np.concatenate([mesh.triangles[:, [k, (k + 1) % 3]] for k in range(3)])
    edge, count = np.unique(np.sort(directed, axis=1), axis=0, return_counts=True)
    rim = mesh.points[edge[count == 1]]
    along = np.linspace(0, 1, 60)[:, None, None]
    rim_points = (rim[:, 0] * (1 - along) + rim[:, 1] * along).reshape(-1, 3)
    from_rim = np.linalg.norm(x[:, None] - rim_points, axis=2).min(axis=1)

    def depths(points):
        """Return the distance from the middle of the wall, and the kind, at lattice points."""
        place = np.rint((points - shell.start) / (DX / 2)).astype(int)
        at = tuple(place.T)
        return 0.5 * (shell.front - shell.back)[at], shell.kinds[at]

    for far, least in ((1.5, 1.0), (0.75, 0.97)):  # cells from the edge, and the share that agrees
        away = from_rim > far * DX
        points = [(x + side * DX * normal)[away] for side in (1, -1)]
        # a lattice point next to one that is this close to another face may lie behind it
        points = [p[collider.distance(p) > 0.45 * DX] for p in points]
        (front, _), (back, _) = map(depths, points)
        sign = np.sign(np.median(front))
        assert (np.sign(front) == sign).mean() >= least
        assert (np.sign(back) == -sign).mean() >= least
    outward = rim_points - mesh.points.mean(axis=0)
    if name in ("tube", "bowl", "hemisphere", "box"):  # over the rim
        outward = np.where(rim_points[:, 2:] > 0.01, (0, 0, 1.0), (0, 0, -1.0))
    outward /= np.linalg.norm(outward, axis=1)[:, None]
    assert (depths(rim_points + 1.5 * DX * outward)[1] == EDGE).mean() > 0.9


def test_pieces_of_large_triangles_are_bounded(monkeypatch):
    monkeypatch.setattr(sheet_collider, "_MAX_PIECES", 1000)
    corner = np.array([[[0, 0, 0], [500.0, 0, 0], [0, 500.0, 0]]])
    found = SheetCollider.from_triangles("sheet", corner, DX)
    assert len(found._pieces[1]) < 2100
    assert found.distance(np.array([[100.0, 100, 3]])) == pytest.approx(3 - DX / 4)


ROOM = """
[domain]
size = [0.4, 0.4, 0.4]
cell = 0.02
[time]
end = 1
[material.water]
kind = "fluid"
max_speed = "2.5 m/s"
[[object]]
name = "bowl"
role = "scenery"
collider = true
thin = {thin}
mesh = "bowl.obj"
scale = 1
position = [0.2, 0.2, 0.06]
[[object]]
name = "drop"
material = "water"
shape = {{ cylinder = {{ endpoints = [[0.2, 0.2, {low}], [0.2, 0.2, {high}]], radius = 0.07 }} }}
"""


@pytest.mark.parametrize("thin, low, high", [("true", 0.14, 0.26), ("false", 0.22, 0.34)])
def test_an_open_bowl_holds_water_if_it_is_thin(tmp_path, caplog, thin, low, high):
    """Without it is a block, and both are said."""
    caplog.set_level(logging.INFO)
    write(tmp_path / "bowl.obj", BOWL)
    sim, _ = begin(tmp_path, ROOM.format(thin=thin, low=low, high=high))
    said = "'bowl': its mesh is open: 24 boundary edges; one hole 0.2 m wide at (0.2, 0.2, 0.2) m"
    meaning = "as a wall half a cell" if thin == "true" else "as a solid block up to its holes"
    assert f"{said}; it counts {meaning}" in caplog.text
    advance(sim, 0.4)
    (x,) = by_id(sim, "x")
    r, z = np.hypot(x[:, 0] - 0.2, x[:, 1] - 0.2), x[:, 2] - 0.06
    inside = (r < 0.1) & (z > 0) & (z < 0.14)
    below_rim = ~inside & (z < 0.13)
    if thin == "true":
        assert inside.sum() > 0.95 * len(x) and not below_rim.any()
    else:
        assert not inside.any() or z[inside].min() > 0.1

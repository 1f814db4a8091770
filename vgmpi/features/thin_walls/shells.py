"""Sides and thickness of a thin wall, found from its signed distance alone.

A point close to a face belongs to a wall if the ray from its foot into the solid leaves it within
MAX_THICKNESS_CELLS through a face that looks the other way. Neighbors whose normals agree are on
the same side, both ends of a ray on opposite sides. Other points close to the wall take the side
from which they can be reached through free space; those that both sides reach quickly lie beyond
the edge of the wall, such as over the rim of a cup.
"""

import itertools
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import scipy
import scipy.spatial
from scipy.sparse.csgraph import connected_components

from vgmpi.kernels.colliders.moving_colliders import SDF_SPACING_CELLS
from vgmpi.preprocess.placement import PlacementError
from vgmpi.preprocess.sheet_collider import SheetCollider

from .kernels import EDGE, NEAR_EDGE, SIDED, WALL_BAND_CELLS, ShellLattice

MAX_THICKNESS_CELLS = 3.0  # [cells] thickness up to which a wall has two sides
RAY_STEP_CELLS = 0.125  # [cells] length of a step along a ray through the wall
FACE_CELLS = 1.1  # [cells] distance from a face up to which points send rays
OPPOSITE = 0.6  # [-] cosine above which the face at the end of a ray is the opposite face
# [-] cosine above which the normals of neighbors are those of one side; in an inner corner of the
# wall, where normals meet, its negative
AGREEING = 0.5
SAME_NORMAL = 0.9  # [-] cosine above which a point has the normal of the face below it
EDGE_CELLS = 4.0  # [cells] way through free space within which an edge has both sides
BALL_CELLS = np.array([0.1, 0.2, 0.35, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 5.0])  # [cells] radii
BALL_TOLERANCE = 1e-3  # [-] of a radius
CLOSEST_FACES = 16  # balls among which the closest one is sought
CHUNK = 4096  # points whose distances are computed at a time, in the cache
BEHIND_CELLS = 2.5  # [cells] distance from the wall up to which the other side's distance is exact
OUTSIDE_CELLS = 8.0  # [cells] outside the domain, up to which the sides of a wall are known
# [cells] distance from a wall up to which points need normals: those from which points that have a
# side are reached, and the corners around them
NORMAL_CELLS = WALL_BAND_CELLS + EDGE_CELLS + 2.0
# [cells] distance from the thin parts of a wall up to which its points are kept: those that have a
# side are closer, and a particle that leaves them along a thick part finds points without one
REACH_CELLS = NORMAL_CELLS + EDGE_CELLS + 3.0
RESET_CELLS = 2.0  # [cells] distance from an edge within which particles may change sides
_AXES = tuple(np.eye(3, dtype=np.int64))


class _Faces(NamedTuple):
    """Lattice points next to faces of the wall."""

    place: np.ndarray  # (n, 3) on the lattice
    normal: np.ndarray  # (n, 3) outward normals
    foot: np.ndarray  # (n, 3) [m] closest point of the face
    opposite: np.ndarray  # (n, 3) places next to the opposite face


def with_shell(collider: Any, dx: float, size: tuple[float, float, float]) -> Any:
    """Return a collider that is a thin wall with its two sides.

    Args:
        collider: Collider.
        dx: Cell size [m].
        size: Edges of the domain [m].

    Raises:
        PlacementError: Its walls have no two sides.
    """
    try:
        is_at_rest = collider.course is None and collider.body is None
        domain = (np.zeros(3), np.array(size)) if is_at_rest else None
        shell = thin_shell(collider, dx, domain)
    except ValueError as error:
        raise PlacementError("thin", str(error)) from None
    if shell is None:
        message = "is not needed: nowhere are two faces up to three cells apart"
        raise PlacementError("thin", message)
    return replace(collider, detail=shell)


def thin_shell(
    collider, dx: float, domain: tuple[np.ndarray, np.ndarray] | None = None
) -> ShellLattice | None:
    """Return the sides of a collider's walls on a lattice around it; None if it has none.

    Args:
        collider: Object with distance(points) -> (m,) [m] and ends() -> corners, both at rest.
        dx: Cell size [m].
        domain: Lower and upper corner of the domain [m], shape (3,) each: nothing further outside
            is stored, as that of a collider at rest is never read. None: all of the collider.

    Raises:
        ValueError: The wall has no two sides.
    """
    h = SDF_SPACING_CELLS * dx
    low, high = collider.ends()
    start = low - WALL_BAND_CELLS * dx
    shape = np.ceil((high - low + 2 * WALL_BAND_CELLS * dx) / h).astype(np.int64) + 1
    first = np.zeros(3, np.int64)
    if domain is not None:
        margin = OUTSIDE_CELLS * dx
        lowest = np.maximum(np.floor((domain[0] - margin - start) / h).astype(np.int64), 0)
        last = np.minimum(np.ceil((domain[1] + margin - start) / h).astype(np.int64) + 1, shape)
        if (lowest < last).all():
            first, shape = lowest, last - lowest
    places = map(np.arange, first, first + shape)
    grid = start + h * np.stack(np.meshgrid(*places, indexing="ij"), -1)
    phi = _distances(collider, grid)
    faces = _faces(collider, grid, phi, dx)
    if not len(faces.place):
        return None
    region, corner = _crop_around(faces, phi.shape)
    grid, phi, first = grid[region], phi[region], first + corner
    faces = faces._replace(place=faces.place - corner, opposite=faces.opposite - corner)
    within = (phi > 0.0) & (phi <= NORMAL_CELLS * dx)
    normal = np.zeros(grid.shape)
    normal[within] = _normals(collider, grid[within], 0.02 * dx)
    side = _sides(faces, phi.shape)
    label = _spread_sides(faces, side, phi, normal, h)
    front, back = (
        _distance_from_side(collider, faces, side, s, label, grid, phi, dx) for s in (1, -1)
    )
    return ShellLattice(start + h * first, front, back, _kinds(label, phi, dx))


def _distance_from_side(
    collider, faces: _Faces, side, s: int, label, grid, phi, dx: float
) -> np.ndarray:  # fmt: skip
    """Return the signed distance [m] of lattice points from what is free on one side of the wall.

    It is positive outside the wall on that side, and negative in the wall and behind it. Balls that
    touch the faces from that side fill what is free; the closest ones give the distance.

    Args:
        collider: Collider.
        faces: Points next to faces.
        side: Side of each, shape (n,).
        s: The side, 1 or -1.
        label: Side of each lattice point, 0 inside the wall and beyond its edges.
        grid: Lattice points [m].
        phi: Their distances from the wall [m].
        dx: Cell size [m].
    """
    is_inner = phi < -MAX_THICKNESS_CELLS * dx  # within what is no thin wall
    out = np.where((label == s) | is_inner, phi, -(phi + MAX_THICKNESS_CELLS * dx))
    foot, normal = faces.foot[side == s], faces.normal[side == s]
    if not len(foot):  # this side is too far outside the domain
        return out
    radius = np.zeros(len(foot))
    for rho in BALL_CELLS * dx:
        touches = collider.distance(foot + rho * normal) >= (1.0 - BALL_TOLERANCE) * rho
        radius = np.where(touches, rho, radius)
    tree = scipy.spatial.cKDTree(foot)
    covered = np.argwhere((label != s) & (phi < BEHIND_CELLS * dx) & ~is_inner)
    x = grid[tuple(covered.T)]
    center = foot + radius[:, None] * normal
    closest = np.empty(len(x))
    for start in range(0, len(x), CHUNK):
        part = x[start : start + CHUNK]
        number = np.minimum(tree.query(part, k=CLOSEST_FACES)[1], len(foot) - 1)
        away = np.sqrt(((part[:, None] - center[number]) ** 2).sum(-1)) - radius[number]
        closest[start : start + CHUNK] = away.min(1)
    free = (label[tuple(covered.T)] == 0) & (phi[tuple(covered.T)] > 0.0)  # beyond an edge
    out[tuple(covered.T)] = -np.where(free, closest, np.maximum(closest, 0.0))
    return out


def _distances(collider, grid: np.ndarray) -> np.ndarray:
    """Return the signed distances [m] at points (nx, ny, nz, 3)."""
    rows = [collider.distance(layer.reshape(-1, 3)) for layer in grid]
    return np.stack(rows).reshape(grid.shape[:3])


def _normals(collider, points: np.ndarray, step: float) -> np.ndarray:
    """Return unit gradients of the distance at points (n, 3), by differences over 2 `step` [m].

    A collider of sheets knows its own, and takes long for a distance.
    """
    if isinstance(collider, SheetCollider):
        return collider.normal(points)
    out = np.empty_like(points)
    for axis in range(3):
        shift = np.zeros(3)
        shift[axis] = step
        out[:, axis] = collider.distance(points + shift) - collider.distance(points - shift)
    return out / np.maximum(np.sqrt((out**2).sum(axis=1)), 1e-300)[:, None]


def _crop_around(faces: _Faces, shape: tuple) -> tuple[tuple[slice, ...], np.ndarray]:
    """Return the part of a lattice of `shape` that has sides, and its first place, shape (3,)."""
    reach = int(np.ceil(REACH_CELLS / SDF_SPACING_CELLS))
    first = np.maximum(faces.place.min(0) - reach, 0)
    last = np.minimum(faces.place.max(0) + reach + 1, shape)
    return tuple(map(slice, first, last)), first


def _faces(collider, grid, phi: np.ndarray, dx: float) -> _Faces:
    """Return the lattice points next to faces of a wall, with what is opposite."""
    index = np.argwhere((phi > 0.0) & (phi <= FACE_CELLS * dx))
    x = grid[tuple(index.T)]
    n = _normals(collider, x, 0.02 * dx)
    foot = x - phi[tuple(index.T)][:, None] * n
    before, leave = np.zeros(len(index)), np.full(len(index), np.inf)
    inside = np.zeros(len(index), bool)
    for k in range(1, int(MAX_THICKNESS_CELLS / RAY_STEP_CELLS) + 2):
        travel = k * RAY_STEP_CELLS * dx
        phi_ray = collider.distance(foot - travel * n)
        left = np.isinf(leave) & (phi_ray > 0.0)
        fraction = before[left] / np.minimum(before[left] - phi_ray[left], -1e-300)
        leave[left] = travel - (1.0 - np.clip(fraction, 0.0, 1.0)) * RAY_STEP_CELLS * dx
        inside |= np.isinf(leave) & (phi_ray < 0.0)
        before = phi_ray
    thin = np.isfinite(leave) & (leave > 1e-6 * dx) & (leave <= MAX_THICKNESS_CELLS * dx)
    index, n, foot, leave = index[thin], n[thin], foot[thin], leave[thin]
    h = SDF_SPACING_CELLS * dx
    # a spacing beyond the opposite face: the closest lattice point is outside the wall, next to it
    beyond = foot - (leave + h)[:, None] * n
    m = _normals(collider, beyond, 0.02 * dx)
    facing = (n * m).sum(1) < -OPPOSITE
    opposite = np.rint((beyond - grid[0, 0, 0]) / h).astype(np.int64)
    return _Faces(index[facing], n[facing], foot[facing], opposite[facing])


def _sides(faces: _Faces, shape: tuple) -> np.ndarray:
    """Return the side of each point next to a face, 1 or -1, shape (n,).

    Raises:
        ValueError: The wall has no two sides.
    """
    n = len(faces.place)
    number = np.full(shape, -1)
    number[tuple(faces.place.T)] = np.arange(n)
    same_a, same_b = [], []
    for axis, step in itertools.product(_AXES, (1, 2)):  # two over the bisector of an inner corner
        other = np.minimum(faces.place + step * axis, np.array(shape) - 1)
        partner = number[tuple(other.T)]
        out, other_out = faces.normal, faces.normal[partner]
        cosine = (out * other_out).sum(1)
        is_concave = ((other_out - out) * axis).sum(1) < 0.0
        agrees = is_concave & (cosine > -AGREEING)
        if step == 1:
            agrees |= cosine > AGREEING
        agrees &= (partner >= 0) & (other != faces.place).any(1)
        same_a.append(np.flatnonzero(agrees))
        same_b.append(partner[agrees])
    inside = ((faces.opposite >= 0) & (faces.opposite < np.array(shape))).all(1)
    partner = np.where(inside, number[tuple(np.clip(faces.opposite, 0, np.array(shape) - 1).T)], -1)
    faced = partner >= 0
    faced &= (faces.normal * faces.normal[partner]).sum(1) < -OPPOSITE
    a, b = np.concatenate(same_a), np.concatenate(same_b)
    c, d = np.flatnonzero(faced), partner[faced]
    # every point twice, as one of either side: a pair on opposite sides links its two copies
    rows, columns = np.concatenate([a, a + n, c, c + n]), np.concatenate([b, b + n, d + n, d])
    links = scipy.sparse.coo_array((np.ones(len(rows)), (rows, columns)), (2 * n, 2 * n))
    part = connected_components(links, directed=False)[1]
    if (part[:n] == part[n:]).any():
        raise ValueError("has no two sides: a thin wall may not twist into itself")
    # the first point of each pair of parts is on the front side
    return np.where(part[:n] < part[n:], 1, -1)


def _spread_sides(faces: _Faces, side: np.ndarray, phi, normal, h: float):
    """Return the side of every lattice point, 0 in the wall and where both sides reach it, or none.

    Points that are not next to a face take the side of the point next to their foot, and else the
    side from which they are reached.
    """
    core = np.zeros(phi.shape, np.int8)
    core[tuple(faces.place.T)] = side
    looks = np.zeros((*phi.shape, 3))
    looks[tuple(faces.place.T)] = side[:, None] * faces.normal
    place = scipy.ndimage.distance_transform_edt(
        core == 0, return_distances=False, return_indices=True
    )
    band = np.argwhere((core == 0) & (phi > 0.0))
    n = normal[tuple(band.T)]
    foot = band - ((phi[tuple(band.T)] - 0.5 * h) / h)[:, None] * n
    foot = np.clip(np.rint(foot).astype(np.int64), 0, np.array(phi.shape) - 1)
    at_foot = place[:, foot[:, 0], foot[:, 1], foot[:, 2]].T
    close = ((at_foot - foot) ** 2).sum(1) <= 3.0
    foot_side = core[tuple(at_foot.T)] * close
    foot_side *= foot_side * (n * looks[tuple(at_foot.T)]).sum(1) > SAME_NORMAL
    label = core.copy()
    label[tuple(band.T)] = foot_side
    open_points = (label == 0) & (phi > 0.0)
    rounds = int(EDGE_CELLS / SDF_SPACING_CELLS)
    reached = [
        scipy.ndimage.binary_dilation(
            label == s, iterations=rounds, mask=open_points | (label == s)
        )
        for s in (1, -1)
    ]
    label[open_points & reached[0] & ~reached[1]] = 1
    label[open_points & reached[1] & ~reached[0]] = -1
    return label


def _kinds(label: np.ndarray, phi: np.ndarray, dx: float) -> np.ndarray:
    """Return the kind of every lattice point, see `ShellLattice`."""
    edge = (label == 0) & (phi > 0.0)
    kinds = np.where(edge, EDGE, SIDED).astype(np.int8)
    rounds = int(RESET_CELLS / SDF_SPACING_CELLS)
    kinds[
        scipy.ndimage.binary_dilation(edge & (phi < 2 * RESET_CELLS * dx), iterations=rounds)
        & ~edge
    ] = NEAR_EDGE
    kinds[phi > WALL_BAND_CELLS * dx] = 0
    return kinds

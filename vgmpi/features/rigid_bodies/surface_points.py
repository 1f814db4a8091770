"""Points on the surfaces of free rigid bodies, with their normals and curvatures, and overlaps.

A surface is known at some points only. By normal and curvature a point tells where near it the
surface faces a direction, so that a ball rolls as if it had all its points.
"""

from typing import NamedTuple

import numpy as np

from vgmpi.kernels.colliders.moving_colliders import SDF_SPACING_CELLS
from vgmpi.kernels.colliders.static_colliders import SDF_BAND_CELLS
from vgmpi.runtime.jit import array_function, device_function

from .free_bodies import inverse_times
from .plan import Overlap, RigidBodiesSummary, RigidBodySummary

SURFACE_SPACING_CELLS = 0.5  # [cells] of the points on the surfaces
SURFACE_BAND = 0.6  # [spacings] distance of lattice points that are moved to the surface
FLAT_RADIUS_CELLS = 100.0  # [cells] radius of curvature of what counts as flat
MAX_TRAVEL_CELLS = 0.5  # [cells] largest way to the point that faces the other surface
MIN_OVERLAP_CELLS = 0.25  # [cells] depth above which an overlap is told
ALIGNED = 0.9  # [-] cosine between the normals of two faces


class SurfacePoints(NamedTuple):
    """Points on the surfaces of all free bodies, at the start."""

    first: np.ndarray  # (m + 1,) first point of each body, and the number of points
    place: np.ndarray  # (n, 3) [m] from the body's center
    normal: np.ndarray  # (n, 3)
    curvature: np.ndarray  # (n, 3, 3) [1/m] change of the normal along the surface


@device_function
def dot(a, b):
    """Return the product of two vectors, shape (3,)."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@device_function
def quadratic_form(m, n):
    """Return n . m n."""
    total = 0.0
    for a in range(3):
        for b in range(3):
            total += n[a] * m[a, b] * n[b]
    return total


@array_function
def facing_point(surface, p, facing, dx, out):
    """Find the point near p at which the surface has the normal `facing`, as far as it is curved.

    Args:
        surface: SurfacePoints.
        p: Number of the point.
        facing: Normal in the body's axes, shape (3,).
        dx: Cell size [m].
        out: Point from the body's center (out), shape (3,) [m].

    Returns:
        False if it is too far away: another point is nearer to it.
    """
    s, n = surface.curvature[p], surface.normal[p]
    for c in range(3):
        out[c] = surface.place[p, c]
    bending = 0.0
    for a in range(3):
        bending += abs(s[a, 0]) + abs(s[a, 1]) + abs(s[a, 2])
    if bending < 1.0 / (FLAT_RADIUS_CELLS * dx) or dot(n, facing) < ALIGNED:  # a face, an edge
        return True
    square, right, travel = np.zeros((3, 3)), np.zeros(3), np.zeros(3)
    for a in range(3):
        square[a, a] = 1.0 / (FLAT_RADIUS_CELLS * dx) ** 2
        for b in range(3):
            right[a] += s[a, b] * (facing[b] - n[b])
            for c in range(3):
                square[a, b] += s[a, c] * s[c, b]
    inverse_times(square, right, travel)
    size = np.sqrt(travel[0] * travel[0] + travel[1] * travel[1] + travel[2] * travel[2])
    bend = 0.5 * quadratic_form(s, travel)
    for c in range(3):
        out[c] += travel[c] - bend * n[c]
    return size <= MAX_TRAVEL_CELLS * dx


@array_function
def turned_normal(surface, p, own, rotation, out):
    """Store the inward normal of a surface next to one of its points, in the domain's axes.

    Args:
        surface: SurfacePoints.
        p: Number of the point.
        own: Place next to the point, from the body's center, shape (3,) [m].
        rotation: Rotation of the body from the start, shape (3, 3).
        out: Normal (out), shape (3,).
    """
    n, size = np.zeros(3), 0.0
    for a in range(3):
        n[a] = surface.normal[p, a]
        for b in range(3):
            n[a] += surface.curvature[p, a, b] * (own[b] - surface.place[p, b])
        size += n[a] * n[a]
    size = np.sqrt(size)
    for a in range(3):
        out[a] = -dot(rotation[a], n) / size


def points_on_surface(collider, dx: float) -> tuple[np.ndarray, float]:
    """Return points on the surface of a body, shape (n, 3) [m], and its largest depth [m].

    There is about one point for each point of a lattice. The depth is that of the points of the
    lattice and of the middle of the body.

    Args:
        collider: Object with distance(points), normal(points) and ends().
        dx: Cell size [m].
    """
    spacing = SURFACE_SPACING_CELLS * dx
    low, high = collider.ends()
    shape = np.ceil((high - low) / spacing).astype(np.int64) + 3
    start = low - spacing
    layers, depth = [], -float(collider.distance(0.5 * (low + high)[None])[0])
    for layer in range(shape[0]):
        index = np.stack(np.meshgrid([layer], *map(np.arange, shape[1:]), indexing="ij"), -1)
        x = start + spacing * index.reshape(-1, 3)
        distance = collider.distance(x)
        depth = max(depth, -float(distance.min()))
        layers.append(x[np.abs(distance) < SURFACE_BAND * spacing])
    x = np.concatenate(layers)
    for _ in range(3):
        x = x - collider.distance(x)[:, None] * collider.normal(x)
    return x, depth


def surface_points(colliders: list, centers: np.ndarray, dx: float) -> SurfacePoints:
    """Return points on the surfaces of bodies, with their normals and curvatures.

    Args:
        colliders: Objects with distance(points), normal(points) and ends().
        centers: Their centers of mass, shape (m, 3) [m].
        dx: Cell size [m].
    """
    first, pieces, spacing = [0], [], SURFACE_SPACING_CELLS * dx
    for collider, center in zip(colliders, centers, strict=True):
        x, _ = points_on_surface(collider, dx)
        n, curvature, step = collider.normal(x), np.zeros((len(x), 3, 3)), 0.25 * spacing
        for a in range(3):
            shift = np.zeros(3)
            shift[a] = step
            change = (collider.normal(x + shift) - collider.normal(x - shift)) / (2.0 * step)
            curvature[:, :, a] = change - (change * n).sum(1)[:, None] * n
        curvature = 0.5 * (curvature + curvature.transpose(0, 2, 1))
        pieces.append((x - center, n, curvature))
        first.append(first[-1] + len(x))
    place, normal, curvature = (np.concatenate(part) for part in zip(*pieces, strict=True))
    return SurfacePoints(np.array(first), place, normal, curvature)


def measure_rigid_bodies(colliders: list, dx: float) -> RigidBodiesSummary:
    """Return the free rigid bodies among colliders, and their overlaps with each other and others.

    Args:
        colliders: Colliders at the start.
        dx: Cell size [m].
    """
    rows = [m for m, collider in enumerate(colliders) if collider.body is not None]
    ends = np.array([collider.ends() for collider in colliders])
    bodies: list[RigidBodySummary] = []
    overlaps: dict[tuple[int, int], float] = {}
    for m in rows:
        collider = colliders[m]
        surface, depth = points_on_surface(collider, dx)
        shape = np.ceil((np.ptp(ends[m], axis=0) / dx + 2 * SDF_BAND_CELLS + 2) / SDF_SPACING_CELLS)
        bodies.append(
            RigidBodySummary(
                collider.name,
                float(collider.body.mass),
                2.0 * depth,
                len(surface),
                8 * int(np.prod(shape + 1)),
            )  # fmt: skip
        )
        meets = (ends[:, 0] < ends[m, 1]).all(1) & (ends[:, 1] > ends[m, 0]).all(1)
        for other in map(int, np.flatnonzero(meets)):
            if other != m:
                inside = -float(colliders[other].distance(surface).min(initial=np.inf))
                pair = (m, other) if m < other else (other, m)
                overlaps[pair] = max(overlaps.get(pair, 0.0), inside)
    pairs = [
        Overlap(colliders[a].name, colliders[b].name, depth)
        for (a, b), depth in overlaps.items()
        if depth > MIN_OVERLAP_CELLS * dx
    ]
    return RigidBodiesSummary(tuple(bodies), tuple(sorted(pairs, key=lambda pair: -pair.depth)))

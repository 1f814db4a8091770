"""One object in the domain, as it was built, and what its particles have beside volume and place.

Particles without a Gaussian of their own get a round one; passive Gaussians ride on particles. The
surface descriptor of solids serves contact: normal, distance and curvature at each particle at rest
move with the particle (kernels/nodal_fields/surface_distance.py).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy

from vgmpi.gaussians.cloud import GaussianCloud
from vgmpi.gaussians.spherical_harmonics import dc_from_rgb
from vgmpi.kernels.nodal_fields.surface_distance import MAX_DEPTH_CELLS
from vgmpi.planning.particle_channels import CURVATURE_TO_FULL
from vgmpi.scene.scene import Scene

from .collider_sdf import Collider
from .placement import SimilarityTransform

_UNIT_BALL_RADIUS = (3 / (4 * np.pi)) ** (1 / 3)  # [-] radius of a ball of volume 1
CARRIERS = 4  # particles that carry a passive Gaussian; they span a tetrahedron
SHEET_SEARCH_CELLS = 0.6  # [cells] from the surface: particles that test whether a body is a sheet
# [cells] depth expected a cell below the surface, also at edges, and the fraction of the surface
# particles that may lack it.
SHEET_DEPTH_CELLS, SHEET_FRACTION = 0.6, 0.2
WALL_DISTANCE_CELLS, WALL_NORMAL_COSINE = (
    0.25,
    0.7,
)  # [cells] from a wall, and cosine, at which a face lies on it
CURVATURE_WEIGHT = (
    5.7  # [-] a normal that turns by 1 / sqrt of this per cell has half its confidence
)
MAX_NORMAL_TURN_PER_CELL = (
    0.5  # [rad] largest turn of a normal per cell: edges are as round as two cells
)


@dataclass(frozen=True)
class BuiltObject:
    """One object in the domain: its Gaussians, their volumes [m3], and its placement."""

    cloud: GaussianCloud
    volume: np.ndarray
    placement: SimilarityTransform
    collider: Collider | None = None
    theta: np.ndarray | None = None  # (n,) ln J at the start, None for 0
    surface_count: int = 0  # number of first rows that lie on its surface; the others fill it
    passive: GaussianCloud | None = None  # Gaussians without mass that ride along
    summary: str = ""  # text on the particle counts and on the volume convention
    surface_sdf: Callable[[], Collider] | None = None  # builds the signed distance of its surface
    surface_descriptor: np.ndarray | None = None  # (n, 10), see with_surface_descriptor
    velocity: np.ndarray | None = None  # (n, 3) [m/s] of each particle, beside the body's own
    region_counts: tuple[int, ...] = ()  # particles of each region; they are last, in this order

    def select(self, rows: np.ndarray) -> "BuiltObject":
        """Return the object with some of its particles; rows: (n,) bool, or their numbers."""
        velocity = None if self.velocity is None else self.velocity[rows]
        cloud, volume = self.cloud.select(rows), self.volume[rows]
        return replace(self, cloud=cloud, volume=volume, velocity=velocity)


def isotropic_gaussians(
    x: np.ndarray, spacing: float | np.ndarray, rgb: np.ndarray, opacity: float,
    shade: np.ndarray | None = None,
) -> GaussianCloud:  # fmt: skip
    """Return round Gaussians at lattice points, as large as a ball of a lattice cell's volume.

    Args:
        x: Lattice points, shape (n, 3) [m].
        spacing: Lattice spacing, or the edge of each point's cube, shape (n,) [m].
        rgb: Colors, shape (n, 3).
        opacity: Opacity of all.
        shade: Factors of the painted light, shape (n,), see `apply_baked_shading`.
    """
    n = len(x)
    return GaussianCloud(
        x,
        np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)),
        np.tile(_UNIT_BALL_RADIUS * np.broadcast_to(spacing, n)[:, None], 3),
        np.full(n, opacity),
        dc_from_rgb(rgb)[:, None, :].astype(np.float32),
        shade,
    )


def bind_passive(x: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return rows of `x` that carry each point (p, 4) int64, and their weights (p, 4).

    Weights sum to 1. x (n, 3), points (p, 3) [m] at rest. The nearest particles count with (1 - d /
    d5)^2 / d, d5 being the distance of the first that does not count: no jump where the nearest
    ones change (Franke and Nielson 1980). With fewer particles than carriers the last one is
    repeated without weight.
    """
    count = min(CARRIERS + 1, len(x))
    distance, rows = scipy.spatial.cKDTree(x).query(points, k=np.arange(1, count + 1))
    radius = distance[:, -1:] if count > CARRIERS else 2.0 * distance[:, -1:] + 1e-300
    safe_distance = np.maximum(distance, 1e-9 * radius + 1e-300)
    weight = (np.maximum(1.0 - distance / np.maximum(radius, 1e-300), 0.0) ** 2 / safe_distance)[
        :, :CARRIERS
    ]
    weight[weight.sum(axis=1) <= 0] = 1.0  # all equally far away
    weight /= weight.sum(axis=1, keepdims=True)
    missing = CARRIERS - weight.shape[1]
    if missing > 0:
        weight = np.pad(weight, ((0, 0), (0, missing)))
        rows = np.pad(rows, ((0, 0), (0, missing)), mode="edge")
    return rows[:, :CARRIERS].astype(np.int64), weight


def with_surface_descriptor(scene: Scene, piece: BuiltObject, needed: bool) -> BuiltObject:
    """Attach the surface descriptor used by contact to the particles of a solid.

    Bodies thinner than about two cells get none: the normals of their two sides would cancel, and
    their particles tell contact more. Nothing is attached unless `needed`.
    """
    plain = replace(piece, surface_sdf=None)
    if piece.surface_sdf is None or not needed:
        return plain
    dx, sdf, x = scene.domain.cell, piece.surface_sdf(), piece.cloud.x
    distance, slope, bend = distance_gradient_hessian(sdf, x, dx / 2)
    steep = np.sqrt((slope**2).sum(axis=1))
    normal = slope / np.maximum(steep, 1e-300)[:, None]
    outer = distance > -SHEET_SEARCH_CELLS * dx
    below = (x - (distance + dx)[:, None] * normal)[outer]
    if (sdf.distance(below) > -SHEET_DEPTH_CELLS * dx).mean() > SHEET_FRACTION:
        return plain
    bend *= np.minimum(
        1.0, MAX_NORMAL_TURN_PER_CELL / dx / np.maximum(np.abs(bend).max(axis=1), 1e-300)
    )[:, None]
    surface = np.column_stack([normal, distance, bend])
    _open_at_walls(scene, x, surface)
    surface[:, :3] /= (
        1.0 + (CURVATURE_WEIGHT * dx**2 * (surface[:, 4:] ** 2).sum(axis=1))[:, None] ** 4
    )
    surface[:, 3] = np.maximum(surface[:, 3], -MAX_DEPTH_CELLS * dx)
    return replace(plain, surface_descriptor=surface)


def _open_at_walls(scene: Scene, x: np.ndarray, surface: np.ndarray) -> None:
    """Continue the surface behind mirroring walls on which a body stands.

    Particles that see the body end at a wall get the descriptor of the nearest other particles,
    extrapolated.

    Args:
        scene: The scene.
        x: Particles, shape (n, 3) [m].
        surface: Surface descriptors, shape (n, 10) (in/out).
    """
    dx, size = scene.domain.cell, scene.domain.size
    nearest = x - surface[:, 3:4] * surface[:, :3]
    ends = np.zeros(len(x), bool)  # those that see the end of the body at a wall
    for k, (kind, _) in enumerate(scene.walls_of_solids):
        axis, inward, position = k // 2, 1.0 - 2.0 * (k % 2), k % 2 * size[k // 2]
        if kind != "separate":
            on = np.abs(nearest[:, axis] - position) < WALL_DISTANCE_CELLS * dx
            on &= -inward * surface[:, axis] > WALL_NORMAL_COSINE
            # Differences about a particle see this end if it may be nearest a cell away.
            ends |= on.any() & (-surface[:, 3] > inward * (x[:, axis] - position) - dx)
    free = np.flatnonzero(~ends & (surface[:, 3] > -dx))
    if not ends.any() or not len(free):
        return
    _, position = scipy.spatial.cKDTree(nearest[free]).query(x[ends])
    source = free[position]
    descriptor, offset = surface[source], x[ends] - x[source]
    close = (offset**2).sum(axis=1) < (2 * dx) ** 2
    turn = (
        np.einsum("nab,nb->na", descriptor[:, CURVATURE_TO_FULL].reshape(-1, 3, 3), offset)
        * close[:, None]
    )
    descriptor[:, 3] += ((descriptor[:, :3] + 0.5 * turn) * offset).sum(axis=1)
    descriptor[:, :3] += turn
    descriptor[:, :3] /= np.maximum(np.sqrt((descriptor[:, :3] ** 2).sum(axis=1)), 1e-300)[:, None]
    surface[ends] = descriptor


def distance_gradient_hessian(
    sdf: Collider, x: np.ndarray, h: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the distance (n,) [m] at x (n, 3), its gradient and its second derivatives.

    They are differences over 2 h [m]. The gradient has the shape (n, 3), the second derivatives
    have (n, 6) [1/m], in the order xx, xy, xz, yy, yz, zz.
    """
    axes = h * np.eye(3)
    center = sdf.distance(x)
    up = [sdf.distance(x + e) for e in axes]
    down = [sdf.distance(x - e) for e in axes]
    slope = np.stack([(u - d) / (2 * h) for u, d in zip(up, down, strict=True)], axis=1)
    bend = []
    for a in range(3):
        bend.append((up[a] + down[a] - 2 * center) / h**2)
        for b in range(a + 1, 3):
            both = sdf.distance(x + axes[a] + axes[b])
            both += sdf.distance(x - axes[a] - axes[b])
            bend.append((both + 2 * center - up[a] - down[a] - up[b] - down[b]) / (2 * h**2))
    return center, slope, np.stack(bend, axis=1)

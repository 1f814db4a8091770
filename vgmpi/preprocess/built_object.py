"""One object in the domain, as it was built, and Gaussians that its particles have or carry.

Particles without a Gaussian of their own get a round one; passive Gaussians ride on particles.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy

from vgmpi.gaussians.cloud import GaussianCloud
from vgmpi.gaussians.spherical_harmonics import dc_from_rgb

from .collider_sdf import Collider
from .placement import SimilarityTransform

_UNIT_BALL_RADIUS = (3 / (4 * np.pi)) ** (1 / 3)  # [-] radius of a ball of volume 1
CARRIERS = 4  # particles that carry a passive Gaussian; they span a tetrahedron


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
    surface_descriptor: np.ndarray | None = None  # (n, 10), see surface_descriptor.py
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

"""Substitution of dropped particles by retained ones: mass, position, color and size.

Images must not show where particles are missing. The remaining surface is drawn wider and a little
further out: seen from the side, fewer discs cover the rim of a body less (the light there falls
with their number times their width, which widening alone does not preserve), so the outline would
shrink. The remaining interior is drawn wider only as far as it stays below the surface: a ball that
shows through it blurs the outline.
"""

from dataclasses import replace

import numpy as np
import scipy

from vgmpi.gaussians.cloud import GaussianCloud, rotation_matrices

# Measured best on generated ducks and balls of 100 to 400 pixels across, and on a capture (docs).
WIDTH_EXPONENT = (
    0.36  # [-] width grows with this power of the number of discs it replaces; 0.5 preserves area
)
MAX_COVERAGE = (
    1.8  # [-] coverage that a surface retains if it had it: less lets the interior show through
)
OUTWARD_SHIFT = 0.27  # [-] outward shift of the surface relative to a disc's growth in width
INTERIOR_WIDTH_RATIO = 0.4  # [-] width of a ball inside relative to its depth below the surface
_INTERIOR_NEIGHBORS = 8  # interior particles that define the inward direction
_SURFACE_NEIGHBORS = 24  # surface neighbors that define the coverage


def visual_weight(cloud: GaussianCloud) -> np.ndarray:
    """Return opacity times area [m2] of each Gaussian (n,)."""
    return cloud.opacity * np.partition(cloud.scale, 0, axis=1)[:, 1:].prod(axis=1)


def thin_axes(cloud: GaussianCloud) -> np.ndarray:
    """Return the directions (n, 3) in which Gaussians are thinnest: normals of flat ones."""
    axes = rotation_matrices(cloud.quat)
    return np.take_along_axis(axes, cloud.scale.argmin(axis=1)[:, None, None], axis=2)[:, :, 0]


def merge_targets(x: np.ndarray, retained: np.ndarray, skin: np.ndarray) -> np.ndarray:
    """Return for each particle the row (n,) of its substitute among the retained ones.

    It is the particle itself or the nearest. A surface particle replaces surface particles and an
    interior particle interior ones, where any of them is left.
    """
    row = np.cumsum(retained) - 1
    for part in (skin, ~skin):
        candidates = retained & part if (retained & part).any() else retained
        dropped = np.flatnonzero(part & ~retained)
        if len(dropped):
            row[dropped] = row[
                np.flatnonzero(candidates)[
                    scipy.spatial.cKDTree(x[candidates]).query(x[dropped])[1]
                ]
            ]
    return row


def merged(
    cloud: GaussianCloud,
    probability: np.ndarray,
    target: np.ndarray,
    retained: np.ndarray,
    skin: np.ndarray,
) -> GaussianCloud:
    """Return the retained Gaussians at the mean position, color and light of the ones they replace.

    Means are weighted by visibility.

    Args:
        cloud: Gaussians before pruning.
        probability: Keep probability of each, shape (n,).
        target: Row of each one's substitute, shape (n,), see `merge_targets`.
        retained: Mask of retained Gaussians, shape (n,).
        skin: Mask of Gaussians on the surface, shape (n,).
    """
    weight = visual_weight(cloud)
    weight = np.maximum(weight, 1e-9 * max(float(weight.max()), 1e-300))
    total = np.bincount(target, weight)

    def mean(values: np.ndarray) -> np.ndarray:
        """Return the weighted mean of values for each substitute."""
        columns = values.reshape(len(values), -1).T.astype(np.float64)
        sums = [np.bincount(target, weight * column) for column in columns]
        return (np.stack(sums, axis=1) / total[:, None]).reshape(-1, *values.shape[1:])

    x, scale, multiplicity = mean(cloud.x), cloud.scale[retained], 1 / probability[retained]
    min_area = np.minimum(
        MAX_COVERAGE / _coverage(cloud, retained, skin), 1.0
    )  # fraction of the area that must remain
    width = (
        scale
        * np.sqrt(multiplicity * np.maximum(multiplicity ** (2 * WIDTH_EXPONENT - 1), min_area))[
            :, None
        ]
    )
    is_surface, inner = skin[retained], cloud.x[~skin]
    if is_surface.any() and len(inner):
        depth = scipy.spatial.cKDTree(cloud.x[skin]).query(x[~is_surface])[0]
        width[~is_surface] = np.minimum(
            width[~is_surface],
            np.maximum(scale[~is_surface], INTERIOR_WIDTH_RATIO * depth[:, None]),
        )
        outward = _outward_directions(cloud.select(retained & skin), inner)
        growth = np.sqrt(
            np.partition(width[is_surface] - scale[is_surface], 0, axis=1)[:, 1:].prod(axis=1)
        )
        x[is_surface] += OUTWARD_SHIFT * growth[:, None] * outward
        # The body must not grow: it may lie against the edge of the domain.
        x = np.clip(x, cloud.x.min(axis=0), cloud.x.max(axis=0))
    shade = None if cloud.shade is None else mean(cloud.shade)
    return replace(cloud.select(retained), x=x, scale=width, sh=mean(cloud.sh), shade=shade)


def _coverage(cloud: GaussianCloud, retained: np.ndarray, skin: np.ndarray) -> np.ndarray:
    """Return how often Gaussians cover the surface at each retained one (k,); infinite inside."""
    coverage = np.full(int(retained.sum()), np.inf)
    surface, is_surface = cloud.select(skin), retained & skin
    if is_surface.any():
        count = min(_SURFACE_NEIGHBORS, len(surface))
        distance, rows = scipy.spatial.cKDTree(surface.x).query(
            cloud.x[is_surface], k=np.arange(1, count + 1)
        )
        # The last neighbor marks the radius of the circle.
        covered = 2 * np.pi * visual_weight(surface)[rows[:, : max(count - 1, 1)]].sum(axis=1)
        coverage[skin[retained]] = covered / np.maximum(np.pi * distance[:, -1] ** 2, 1e-300)
    return np.maximum(coverage, 1e-300)


def _outward_directions(cloud: GaussianCloud, inner: np.ndarray) -> np.ndarray:
    """Return the directions (n, 3) away from the interior along the thin axes of a surface.

    `inner` (m, 3) [m] are points of the interior. Directions are shorter than 1 where a thin axis
    does not point away from the interior: such a Gaussian is no part of a smooth surface.
    """
    rows = scipy.spatial.cKDTree(inner).query(
        cloud.x, k=np.arange(1, min(_INTERIOR_NEIGHBORS, len(inner)) + 1)
    )[1]
    outward = cloud.x - inner[rows].mean(axis=1)
    outward /= np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-300)
    axis = thin_axes(cloud)
    return (outward * axis).sum(axis=1, keepdims=True) * axis

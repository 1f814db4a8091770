"""Pruning of an object's particles.

A fraction of the particles is retained along a Morton curve, which runs through space without
leaving gaps (stratified: no random numbers): larger fractions of the surface where its color or its
direction changes, since a plain area looks the same drawn with few.

Retained particles stand in for the others by mass, position, color and size. Images must not show
where particles are missing. The remaining surface is drawn wider and a little further out: seen
from the side, fewer discs cover the rim of a body less (the light there falls with their number
times their width, which widening alone does not preserve), so the outline would shrink. The
remaining interior is drawn wider only as far as it stays below the surface: a ball that shows
through it blurs the outline.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy

from vgmpi.gaussians import shape_evolution
from vgmpi.gaussians.cloud import GaussianCloud, rotation_matrices
from vgmpi.gaussians.formats.residual_coding import morton_keys

AUTO_DECIBELS = 40.0  # [dB] PSNR of the images at rest that "auto" maintains
AUTO_PER_CELL = 8  # particles per cell that "auto" leaves at least
MAX_PRINTED_SCALE = 0.7  # [-] volume scale up to which the paper prints ratios
_VISIBILITY_EXPONENT = 0.5  # [-] exponent of visibility in the keep weight: measured best of 0..1
_DETAIL_WEIGHT = 0.6  # [-] fraction of the keep weight from local detail: measured best
_COLOR_PER_RADIAN = 0.25  # change of color equivalent to a change of direction by 1 rad
_MIN_COLOR_CHANGE = 1e-3  # change of color that no image shows
_DETAIL_NEIGHBORS = 24  # surface neighbors that define local detail
_MORTON_BITS = 21  # per axis of a Morton key: 63 in all
_SEARCH_RATIO = 1.03  # [-] ratio of bounds at which the search of "auto" ends
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


@dataclass(frozen=True)
class PrunedCloud:
    """Result of pruning a body of n particles.

    cloud, volume [m3]: of the retained particles; retained: (n,) bool; dropped: the other Gaussians
    without invisible ones; summary: a line of text.
    """

    cloud: GaussianCloud
    volume: np.ndarray
    retained: np.ndarray
    dropped: GaussianCloud
    summary: str = ""


def prune_versagauss(
    cloud: GaussianCloud,
    volume: np.ndarray,
    skin: np.ndarray,
    scale: float,
    passive: bool,
    ball: bool,
) -> PrunedCloud:
    """Prune a body by the paper's ratios of surface and interior (printed_keep_fractions).

    Args:
        cloud: Gaussians of the body.
        volume: Their volumes, shape (n,) [m3].
        skin: Mask of Gaussians on the surface, shape (n,).
        scale: Volume scale s'.
        passive: Whether dropped Gaussians will be drawn too, so that none stands in for them.
        ball: Whether particles are drawn as balls of their volumes.
    """
    surface, interior = printed_keep_fractions(scale)
    group = skin.astype(np.int64)
    counts = np.bincount(group, minlength=2)
    probability = keep_probabilities(
        np.array([interior, surface]) * counts, group, importance(cloud, skin)
    )
    pruned = _pruned(cloud, volume, skin, probability, passive)
    description = (
        f"prune = versagauss, {surface:.3g} of the surface and {interior:.3g} of the interior"
    )
    return _with_summary(
        cloud, pruned, description, None if passive else _ReferenceImages(cloud, volume, ball)
    )


def prune_to_quality(
    cloud: GaussianCloud,
    volume: np.ndarray,
    skin: np.ndarray,
    dx: float,
    min_per_cell: int,
    passive: bool,
    ball: bool,
) -> PrunedCloud:
    """Prune a body to as few particles per cell as its image at rest permits.

    Every cell keeps the same fraction, but at least `min_per_cell` particles, such that
    AUTO_DECIBELS hold inside the outline, unless dropped Gaussians are drawn too.

    Args:
        cloud: Gaussians of the body.
        volume: Their volumes, shape (n,) [m3].
        skin: Mask of Gaussians on the surface, shape (n,).
        dx: Cell size [m].
        min_per_cell: Minimum number of particles per cell.
        passive: Whether dropped Gaussians will be drawn too.
        ball: Whether particles are drawn as balls of their volumes.
    """
    cell = np.unique(np.floor(cloud.x / dx).astype(np.int64), axis=0, return_inverse=True)[1]
    cell = cell.ravel()
    count, weight = np.bincount(cell), importance(cloud, skin)
    reference = None if passive else _ReferenceImages(cloud, volume, ball)

    def prune_to(part: float) -> PrunedCloud:
        """Return the cloud with a fraction of each cell."""
        number = np.minimum(count, np.maximum(min_per_cell, part * count))
        return _pruned(cloud, volume, skin, keep_probabilities(number, cell, weight), passive)

    def is_similar(trial: PrunedCloud) -> bool:
        """Return whether the image is similar enough."""
        return reference is None or reference.decibels(trial) >= AUTO_DECIBELS

    good, bad = 1.0, min(1.0, min_per_cell / count.max())
    best = prune_to(bad)
    if is_similar(best):
        good = bad
    else:
        best = prune_to(good)
    while good > _SEARCH_RATIO * bad:
        middle = np.sqrt(good * bad)
        trial = prune_to(middle)
        if is_similar(trial):
            good, best = middle, trial
        else:
            bad = middle
    description = (
        f"prune = auto: {100 * good:.3g} % of the Gaussians of each cell stay,"
        f" at least {min_per_cell}"
    )
    return _with_summary(cloud, best, description, reference)


def printed_keep_fractions(volume_scale: float) -> tuple[float, float]:
    """Return the fractions of surface and interior that are retained, as printed.

    Interior: s'. Surface: s'^(2/3) for s' <= 0.5, s'^(1/3) above. All above MAX_PRINTED_SCALE,
    where nothing is printed. s' is a volume scale: a linear scale s gives s^3.
    """
    if volume_scale > MAX_PRINTED_SCALE:
        return 1.0, 1.0
    return volume_scale ** (2 / 3 if volume_scale <= 0.5 else 1 / 3), volume_scale


def visibility(cloud: GaussianCloud) -> np.ndarray:
    """Return the visibility (n,) relative to the mean: opacity times area, softened."""
    area = visual_weight(cloud)
    # Gaussians that are not drawn have mass and get a part too.
    return np.maximum(area / max(float(area.mean()), 1e-300), 0.01) ** _VISIBILITY_EXPONENT


def importance(cloud: GaussianCloud, skin: np.ndarray) -> np.ndarray:
    """Return the keep weight (n,) of particles: visibility and, on the surface, local detail."""
    weight = visibility(cloud)
    if skin.any():
        weight[skin] *= 1 - _DETAIL_WEIGHT + _DETAIL_WEIGHT * detail(cloud.select(skin))
    return weight


def detail(cloud: GaussianCloud) -> np.ndarray:
    """Return how much color and direction change among the neighbors of each surface Gaussian (n,).

    It is their standard deviation, relative to its mean. Neighbors count by their visibility.
    """
    area, rgb, axis = np.maximum(visual_weight(cloud), 1e-300), cloud.rgb, thin_axes(cloud)
    rows = scipy.spatial.cKDTree(cloud.x).query(
        cloud.x, k=np.arange(1, min(_DETAIL_NEIGHBORS, len(cloud)) + 1)
    )[1]
    total, mean, square = np.zeros(len(cloud)), np.zeros((len(cloud), 3)), np.zeros(len(cloud))
    for row in rows.T:  # one neighbour of each at a time: captures have millions of Gaussians
        weight, change_rgb = area[row], rgb[row] - rgb
        sine_squared = 1 - (axis[row] * axis).sum(axis=1) ** 2  # an axis has no sign
        total += weight
        mean += weight[:, None] * change_rgb
        square += weight * ((change_rgb**2).sum(axis=1) + _COLOR_PER_RADIAN**2 * sine_squared)
    variance = square / total - ((mean / total[:, None]) ** 2).sum(axis=1)
    change = np.sqrt(np.maximum(variance, _MIN_COLOR_CHANGE**2))
    return change / np.average(change, weights=area)


def keep_probabilities(
    target_count: np.ndarray, group: np.ndarray, weight: np.ndarray
) -> np.ndarray:
    """Return keep probabilities (n,), proportional to `weight`, with given sums in each group.

    Args:
        target_count: Sum of each group, shape (groups,), at most the number in it.
        group: Group of every particle, shape (n,).
        weight: Weights, shape (n,).
    """
    groups = len(target_count)
    certain = (target_count >= np.bincount(group, minlength=groups))[group]
    while True:  # Certain ones leave less to the others, which makes more of them certain.
        budget = target_count - np.bincount(group[certain], minlength=groups)
        weight_sum = np.bincount(group, np.where(certain, 0.0, weight), minlength=groups)
        probability = np.where(
            certain, 1.0, weight * (budget / np.maximum(weight_sum, 1e-300))[group]
        )
        if (probability <= 1.0).all():
            return probability
        certain |= probability >= 1.0


def stratified_mask(x: np.ndarray, probability: np.ndarray, skin: np.ndarray) -> np.ndarray:
    """Return a mask (n,) of retained particles that follows the probabilities along a Morton curve.

    The rounding error is carried along the curve (error diffusion): with a probability of 1/k every
    k-th is retained. Surface and interior are walked one after the other, since a line through both
    would thin neither evenly. Particles with a probability of 1 are retained and not counted.
    """
    retained = probability >= 1.0
    candidates = np.flatnonzero(~retained)
    candidates = candidates[np.lexsort((morton(x)[candidates], skin[candidates]))]
    steps = np.floor(np.concatenate([[0.5], 0.5 + np.cumsum(probability[candidates])]))
    retained[candidates[np.diff(steps) > 0]] = True
    return retained


def morton(x: np.ndarray) -> np.ndarray:
    """Return the Morton keys (n,) uint64 of points (n, 3) in the cube around them."""
    low = x.min(axis=0)
    edge = max(float((x.max(axis=0) - low).max()), 1e-300)
    cell = np.minimum((x - low) / edge * 2**_MORTON_BITS, 2**_MORTON_BITS - 1).astype(np.uint64)
    return morton_keys(cell, _MORTON_BITS)


def _pruned(cloud, volume, skin, probability, passive: bool) -> PrunedCloud:
    """Return the pruned cloud for keep probabilities (n,)."""
    retained = stratified_mask(cloud.x, probability, skin)
    if not retained.any():  # in a body of few particles one stands for all
        retained[0] = True
    target = merge_targets(cloud.x, retained, skin)
    survivors = (
        cloud.select(retained) if passive else merged(cloud, probability, target, retained, skin)
    )
    dropped = cloud.select(~retained & (cloud.opacity > 0))
    return PrunedCloud(survivors, np.bincount(target, volume), retained, dropped)


def _with_summary(
    cloud: GaussianCloud,
    pruned: PrunedCloud,
    description: str,
    reference: "_ReferenceImages | None",
) -> PrunedCloud:
    """Return the pruned cloud with its summary."""
    summary = f"{description}: {len(cloud):,} -> {len(pruned.cloud):,} particles"
    if reference is None:
        summary += f", {len(pruned.dropped):,} Gaussians ride along"
    else:
        summary += f", {reference.decibels(pruned):.1f} dB inside its outline at rest"
    return replace(pruned, summary=summary)


class _ReferenceImages:
    """Images of a body at rest; ball: it will be drawn as balls of its particles' volumes."""

    def __init__(self, cloud: GaussianCloud, volume: np.ndarray, ball: bool):
        from . import (
            image_similarity,  # imported here, since it brings numba and only pruning needs it
        )

        self.ball, self.likeness = ball, image_similarity.image_psnr
        views = image_similarity.cameras(cloud.x)
        self.draw = lambda cloud, volume: image_similarity.render_views(
            cloud, views, self.shape(volume)
        )
        self.wanted = self.draw(cloud, volume)

    def shape(self, volume: np.ndarray) -> np.ndarray | None:
        """Return the covariances of balls, or None if the Gaussians are drawn themselves."""
        return (
            shape_evolution.volume_sphere_covariance(volume, np.ones(len(volume)))
            if self.ball
            else None
        )

    def decibels(self, pruned: PrunedCloud) -> float:
        """Return the PSNR [dB] of a pruned body inside the outline."""
        return self.likeness(self.wanted, self.draw(pruned.cloud, pruned.volume)).inside


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

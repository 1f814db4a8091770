"""How the kept particles of a thinned body stand in for those that go: mass, place, colour, size.

Pictures must not show where particles are missing. What is left of the surface is drawn wider, and
a little further out: seen from the side, fewer discs cover the rim of a body less (the light there
falls with their number times their width, which widening alone does not keep), so the outline would
shrink. What is left of the inside is drawn wider only as far as it stays below the surface: a ball
that shows through it blurs the outline.
"""

import numpy as np
from scipy.spatial import cKDTree

from vgmpi.gaussians.cloud import Cloud, rotation_matrices

# measured best on made ducks and balls of 100 to 400 pixels across, and on a capture (docs)
WIDER = 0.36  # power of what a disc stands for by which it is drawn wider: 0.5 keeps its area
LAYERS = 1.8  # times that a surface stays covered, where it was: fewer let the inside through
OUTER = 0.27  # shift of the surface over what a disc grows in width
DEEP = 0.4  # width of a ball inside over its depth below the surface
_INWARD = 8  # particles inside that tell where inside is
_AROUND = 24  # neighbours on the surface that tell how often it is covered


def shown(cloud: Cloud) -> np.ndarray:
    """Opacity times area [m2] of each Gaussian (n,)."""
    return cloud.opacity * np.partition(cloud.scale, 0, axis=1)[:, 1:].prod(axis=1)


def thin_axes(cloud: Cloud) -> np.ndarray:
    """The directions (n, 3) in which Gaussians are thinnest: of flat ones, their normals."""
    axes = rotation_matrices(cloud.quat)
    return np.take_along_axis(axes, cloud.scale.argmin(axis=1)[:, None, None], axis=2)[:, :, 0]


def heirs(x: np.ndarray, kept: np.ndarray, skin: np.ndarray) -> np.ndarray:
    """Row (n,) among the kept ones of that which stands for each particle: itself, or the nearest.

    The surface stands for the surface and the interior for the interior, where any of it is left.
    """
    row = np.cumsum(kept) - 1
    for part in (skin, ~skin):
        left = kept & part if (kept & part).any() else kept
        gone = np.flatnonzero(part & ~kept)
        if len(gone):
            row[gone] = row[np.flatnonzero(left)[cKDTree(x[left]).query(x[gone])[1]]]
    return row


def merged(
    cloud: Cloud, share: np.ndarray, heir: np.ndarray, kept: np.ndarray, skin: np.ndarray
) -> Cloud:
    """The kept Gaussians, each in the middle and in the mean colour and light of those it stands
    for.

    share (n,): chance of each to stay. heir (n,): see `heirs`. kept, skin (n,) bool. Means are
    weighted by what is seen of each.
    """
    weight = shown(cloud)
    weight = np.maximum(weight, 1e-9 * max(float(weight.max()), 1e-300))
    total = np.bincount(heir, weight)

    def mean(values: np.ndarray) -> np.ndarray:
        columns = values.reshape(len(values), -1).T.astype(np.float64)
        sums = [np.bincount(heir, weight * column) for column in columns]
        return (np.stack(sums, axis=1) / total[:, None]).reshape(-1, *values.shape[1:])

    x, scale, stands = mean(cloud.x), cloud.scale[kept], 1 / share[kept]
    least = np.minimum(LAYERS / _layers(cloud, kept, skin), 1.0)  # of the area that stays
    wider = scale * np.sqrt(stands * np.maximum(stands ** (2 * WIDER - 1), least))[:, None]
    on, inner = skin[kept], cloud.x[~skin]
    if on.any() and len(inner):
        depth = cKDTree(cloud.x[skin]).query(x[~on])[0]
        wider[~on] = np.minimum(wider[~on], np.maximum(scale[~on], DEEP * depth[:, None]))
        outer = _facing(cloud.select(kept & skin), inner)
        grown = np.sqrt(np.partition(wider[on] - scale[on], 0, axis=1)[:, 1:].prod(axis=1))
        x[on] += OUTER * grown[:, None] * outer
        # no further than the body reaches: it may lie against the edge of the domain
        x = np.clip(x, cloud.x.min(axis=0), cloud.x.max(axis=0))
    shade = None if cloud.shade is None else mean(cloud.shade)
    return Cloud(x, cloud.quat[kept], wider, cloud.opacity[kept], mean(cloud.sh), shade)


def _layers(cloud: Cloud, kept: np.ndarray, skin: np.ndarray) -> np.ndarray:
    """How often the Gaussians around each kept one cover the surface (k,); infinite inside."""
    found = np.full(int(kept.sum()), np.inf)
    surface, on = cloud.select(skin), kept & skin
    if on.any():
        count = min(_AROUND, len(surface))
        away, near = cKDTree(surface.x).query(cloud.x[on], k=np.arange(1, count + 1))
        # the last one marks where the circle ends
        covered = 2 * np.pi * shown(surface)[near[:, : max(count - 1, 1)]].sum(axis=1)
        found[skin[kept]] = covered / np.maximum(np.pi * away[:, -1] ** 2, 1e-300)
    return np.maximum(found, 1e-300)


def _facing(cloud: Cloud, inner: np.ndarray) -> np.ndarray:
    """The directions (n, 3) away from points `inner` (m, 3) [m] along the thin axes of a surface.

    Shorter than 1 where a thin axis does not point away from the inside: such a Gaussian is no
    part of a smooth surface.
    """
    near = cKDTree(inner).query(cloud.x, k=np.arange(1, min(_INWARD, len(inner)) + 1))[1]
    away = cloud.x - inner[near].mean(axis=1)
    away /= np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-300)
    thin = thin_axes(cloud)
    return (away * thin).sum(axis=1, keepdims=True) * thin

"""Fewer particles for an object: which stay, and how they stand in for those that go.

Kept are shares of the particles along a Morton curve, which runs through space without leaving
gaps (stratified: no random numbers): larger shares of the surface where its colour or its direction
changes, since a plain area looks the same drawn with few. How they stand in: merge.py.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from vgmpi.gaussians import evolve
from vgmpi.gaussians.cloud import Cloud
from vgmpi.prepare.merge import heirs, merged, shown, thin_axes

AUTO_DECIBELS = 40.0  # likeness of the pictures at rest down to which "auto" thins
AUTO_PER_CELL = 8  # particles in a cell down to which it does
LARGEST = 0.7  # volume scale up to which the paper's ratios are printed
_SEEN = 0.5  # power of what is seen of a Gaussian in the chance to be kept: measured best of 0..1
_DETAIL = 0.6  # part of that chance that goes with the detail around it: likewise
_TURNED = 0.25  # a change of colour that counts as much as one of direction by a radian
_UNSEEN = 1e-3  # a change of colour that no picture shows
_NEAR = 24  # neighbours on the surface among which detail is looked for
_BITS = 21  # per axis of a place on the Morton curve: 63 in all
_FINE = 1.03  # ratio of two parts between which "auto" does not look


@dataclass(frozen=True)
class Thinned:
    """What is left of a body of n particles: cloud and volume [m3] of those kept (n,) bool.

    dropped: the Gaussians that are not, but for those that nobody saw. said: a line about it.
    """

    cloud: Cloud
    volume: np.ndarray
    kept: np.ndarray
    dropped: Cloud
    said: str = ""


def paper(
    cloud: Cloud, volume: np.ndarray, skin: np.ndarray, scale: float, passive: bool, ball: bool
) -> Thinned:
    """The body thinned by the printed ratios of surface and interior (paper_keep).

    scale: volume scale s'. skin (n,): what lies on the surface. passive: the dropped Gaussians
    will be drawn too, so that none stands in for them. ball: drawn as balls of their volumes.
    """
    surface, interior = paper_keep(scale)
    group = skin.astype(np.int64)
    counts = np.bincount(group, minlength=2)
    share = shares(np.array([interior, surface]) * counts, group, importance(cloud, skin))
    found = _thinned(cloud, volume, skin, share, passive)
    how = f"prune = paper, {surface:.3g} of the surface and {interior:.3g} of the interior"
    return _told(cloud, found, how, None if passive else _Portrait(cloud, volume, ball))


def auto(
    cloud: Cloud,
    volume: np.ndarray,
    skin: np.ndarray,
    dx: float,
    least: int,
    passive: bool,
    ball: bool,
) -> Thinned:
    """The body with as few particles in cells of edge dx [m] as its picture at rest allows.

    The same part of every cell, but at least `least` particles; so many that AUTO_DECIBELS hold
    inside its outline, unless the dropped ones are drawn too (`passive`). The other arguments are
    those of `paper`.
    """
    cell = np.unique(np.floor(cloud.x / dx).astype(np.int64), axis=0, return_inverse=True)[1]
    cell = cell.ravel()
    count, weight = np.bincount(cell), importance(cloud, skin)
    portrait = None if passive else _Portrait(cloud, volume, ball)

    def keeping(part: float) -> Thinned:
        number = np.minimum(count, np.maximum(least, part * count))
        return _thinned(cloud, volume, skin, shares(number, cell, weight), passive)

    def alike(tried: Thinned) -> bool:
        return portrait is None or portrait.decibels(tried) >= AUTO_DECIBELS

    good, bad = 1.0, min(1.0, least / count.max())
    found = keeping(bad)
    if alike(found):
        good = bad
    else:
        found = keeping(good)
    while good > _FINE * bad:
        middle = np.sqrt(good * bad)
        tried = keeping(middle)
        if alike(tried):
            good, found = middle, tried
        else:
            bad = middle
    how = f"prune = auto: {100 * good:.3g} % of the Gaussians of each cell stay, at least {least}"
    return _told(cloud, found, how, portrait)


def paper_keep(volume_scale: float) -> tuple[float, float]:
    """Shares of surface and of interior that are kept, as printed.

    Interior: s'. Surface: s'^(2/3) for s' <= 0.5, s'^(1/3) above. All above LARGEST, where nothing
    is printed. s' is a volume scale: a linear scale s gives s^3.
    """
    if volume_scale > LARGEST:
        return 1.0, 1.0
    return volume_scale ** (2 / 3 if volume_scale <= 0.5 else 1 / 3), volume_scale


def seen(cloud: Cloud) -> np.ndarray:
    """How much of a Gaussian is seen, relative to the mean: opacity times area, softened (n,)."""
    area = shown(cloud)
    # what is not drawn has mass: it gets its part too
    return np.maximum(area / max(float(area.mean()), 1e-300), 0.01) ** _SEEN


def importance(cloud: Cloud, skin: np.ndarray) -> np.ndarray:
    """How much each particle is wanted, relative to the others (n,): what is seen of it, and on the
    surface (skin (n,) bool) the detail it is part of."""
    weight = seen(cloud)
    if skin.any():
        weight[skin] *= 1 - _DETAIL + _DETAIL * detail(cloud.select(skin))
    return weight


def detail(cloud: Cloud) -> np.ndarray:
    """How much colour and direction change among the neighbours of each Gaussian of a surface (n,):
    their standard deviation, relative to its mean. Neighbours count by what is seen of them."""
    area, rgb, thin = np.maximum(shown(cloud), 1e-300), cloud.rgb, thin_axes(cloud)
    near = cKDTree(cloud.x).query(cloud.x, k=np.arange(1, min(_NEAR, len(cloud)) + 1))[1]
    total, mean, square = np.zeros(len(cloud)), np.zeros((len(cloud), 3)), np.zeros(len(cloud))
    for row in near.T:  # one neighbour of each at a time: captures have millions of Gaussians
        weight, other = area[row], rgb[row] - rgb
        turned = 1 - (thin[row] * thin).sum(axis=1) ** 2  # an axis has no sign
        total += weight
        mean += weight[:, None] * other
        square += weight * ((other**2).sum(axis=1) + _TURNED**2 * turned)
    variance = square / total - ((mean / total[:, None]) ** 2).sum(axis=1)
    change = np.sqrt(np.maximum(variance, _UNSEEN**2))
    return change / np.average(change, weights=area)


def shares(wanted: np.ndarray, group: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Shares (n,) in 0..1, in proportion to `weight` (n,), that add up to `wanted` in each group.

    wanted: (groups,), at most the number in each; group: of every particle (n,).
    """
    groups = len(wanted)
    sure = (wanted >= np.bincount(group, minlength=groups))[group]
    while True:  # those sure to be kept leave less to the others, which makes more of them sure
        left = wanted - np.bincount(group[sure], minlength=groups)
        rest = np.bincount(group, np.where(sure, 0.0, weight), minlength=groups)
        share = np.where(sure, 1.0, weight * (left / np.maximum(rest, 1e-300))[group])
        if (share <= 1.0).all():
            return share
        sure |= share >= 1.0


def stratified(x: np.ndarray, share: np.ndarray, skin: np.ndarray) -> np.ndarray:
    """Mask (n,) of those kept: of every stretch of the Morton curve its share, as near as may be.

    The error of rounding is carried along the curve (error diffusion): with a share of 1/k every
    k-th is kept. Surface and interior are walked one after the other, since a line through both
    would thin neither evenly. Particles with a share of 1 are kept and not counted.
    """
    kept = share >= 1.0
    thin = np.flatnonzero(~kept)
    thin = thin[np.lexsort((morton(x)[thin], skin[thin]))]
    whole = np.floor(np.concatenate([[0.5], 0.5 + np.cumsum(share[thin])]))
    kept[thin[np.diff(whole) > 0]] = True
    return kept


def morton(x: np.ndarray) -> np.ndarray:
    """Place (n,) uint64 of points (n, 3) on the Morton curve through the cube around them."""
    low = x.min(axis=0)
    edge = max(float((x.max(axis=0) - low).max()), 1e-300)
    at = np.minimum((x - low) / edge * 2**_BITS, 2**_BITS - 1).astype(np.uint64)
    key = np.zeros(len(x), dtype=np.uint64)
    for bit in range(_BITS):
        for axis in range(3):
            one = (at[:, axis] >> np.uint64(bit)) & np.uint64(1)
            key |= one << np.uint64(3 * bit + axis)
    return key


def _thinned(cloud, volume, skin, share, passive: bool) -> Thinned:
    kept = stratified(cloud.x, share, skin)
    if not kept.any():  # a body of few particles: one stands for all
        kept[0] = True
    heir = heirs(cloud.x, kept, skin)
    left = cloud.select(kept) if passive else merged(cloud, share, heir, kept, skin)
    dropped = cloud.select(~kept & (cloud.opacity > 0))
    return Thinned(left, np.bincount(heir, volume), kept, dropped)


def _told(cloud: Cloud, found: Thinned, how: str, portrait: "_Portrait | None") -> Thinned:
    said = f"{how}: {len(cloud):,} -> {len(found.cloud):,} particles"
    if portrait is None:
        said += f", {len(found.dropped):,} Gaussians ride along"
    else:
        said += f", {portrait.decibels(found):.1f} dB inside its outline at rest"
    return replace(found, said=said)


class _Portrait:
    """Pictures of a body at rest; ball: it will be drawn as balls of its particles' volumes."""

    def __init__(self, cloud: Cloud, volume: np.ndarray, ball: bool):
        from vgmpi.prepare import quality  # numba comes with it: only who prunes waits

        self.ball, self.likeness = ball, quality.likeness
        views = quality.cameras(cloud.x)
        self.draw = lambda cloud, volume: quality.pictures(cloud, views, self.shape(volume))
        self.wanted = self.draw(cloud, volume)

    def shape(self, volume: np.ndarray) -> np.ndarray | None:
        return evolve.fluid(volume, np.ones(len(volume))) if self.ball else None

    def decibels(self, found: Thinned) -> float:
        return self.likeness(self.wanted, self.draw(found.cloud, found.volume)).inside

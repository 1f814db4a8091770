"""Parts of a capture that a scene leaves out: what its selection crops, and floaters.

Floaters are the few Gaussians away from the rest that would set the size and place of a capture.
Training leaves faint or lone Gaussians far from what is seen. The extent of a capture is that of
its clusters: cubes that hold enough opacity, joined with those next to them. Gaussians outside the
box of all clusters that count are floaters. Opacities weigh, sizes do not, so that a wide faint
Gaussian in the middle changes nothing.
"""

import logging
from dataclasses import dataclass, replace

import numpy as np
import scipy

from vgmpi.gaussians.cloud import GaussianCloud, rotation_matrices
from vgmpi.runtime.message_text import did_you_mean
from vgmpi.scene.captures import Select
from vgmpi.scene.objects import Object

from .placement import PlacementError

_OUTLIER_NEIGHBORS = 8
_VALUES_TOLD = 10  # values of a column that a message names
log = logging.getLogger("vgmpi")

CUBES = 32  # [-] cubes along the longest side of what is seen
NEIGHBORS = 8  # [-] Gaussians, whose distance bounds the size of a cube from below
SAMPLES = 4096  # [Gaussians] at which that distance is measured
SEEN_OPACITY = 0.3  # [-] opacity of a cube that is seen in any case
SEEN_SHARE = 0.05  # [-] the least of a cube that is seen, relative to the median
CLUSTER_SHARE = 0.01  # [-] opacity of a cluster that counts, relative to the largest one
MAX_SHARE = 0.03  # [-] of all opacity; if more lies outside, the parts are the object's own
MAX_REACH = 4  # [cubes] that a Gaussian joins along its axes, up to two standard deviations
_AXIS_LIMIT = 1 << 20  # [cubes] from the middle, beyond which all cubes are one
_SIDES = np.array(
    [(i, j, k) for i in (-1, 0, 1) for j in (-1, 0, 1) for k in (-1, 0, 1) if (i, j, k) > (0, 0, 0)]
)


def crop(cloud: GaussianCloud, select: Select | None) -> GaussianCloud:
    """Return the Gaussians inside the selection, in the order and coordinates of the file.

    Columns of labels have served their purpose and are dropped.

    Raises:
        PlacementError: If the file has no such column of labels, or none of its values is selected.
    """
    labels = cloud.labels
    if labels:
        cloud = replace(cloud, labels={})
    if select is None:
        return cloud
    mask = cloud.opacity >= select.min_opacity
    if select.property is not None:
        mask &= _labeled(labels, select.property, select.values)
    if select.box is not None:
        low, high = np.asarray(select.box)
        mask &= ((cloud.x >= low) & (cloud.x <= high)).all(axis=1)
    if select.sphere is not None:
        offset = cloud.x - np.asarray(select.sphere.center)
        mask &= (offset**2).sum(axis=1) <= select.sphere.radius**2
    cloud = cloud.select(mask)
    if select.outlier_sigma > 0 and len(cloud) > _OUTLIER_NEIGHBORS:
        distance = (
            scipy.spatial.cKDTree(cloud.x)
            .query(cloud.x, _OUTLIER_NEIGHBORS + 1)[0][:, 1:]
            .mean(axis=1)
        )
        cloud = cloud.select(distance <= distance.mean() + select.outlier_sigma * distance.std())
    return cloud


def _labeled(labels: dict[str, np.ndarray], name: str, values: tuple[int, ...]) -> np.ndarray:
    """Return the mask of Gaussians whose label is one of some values.

    Raises:
        PlacementError: If there is no such column, or it has none of the values.
    """
    if name not in labels:
        names = ", ".join(labels) if labels else "none"
        raise PlacementError(
            "select",
            f"property '{name}' is no column of integers of the file{did_you_mean(name, labels)};"
            f" known: {names}",
        )
    mask = np.isin(labels[name], np.asarray(values))
    if not mask.any():
        present = np.unique(labels[name])
        more = " ..." if len(present) > _VALUES_TOLD else ""
        some = ", ".join(map(str, present[:_VALUES_TOLD]))
        raise PlacementError(
            "select",
            f"no Gaussian has one of the values {', '.join(map(str, values))} of '{name}', which"
            f" has {len(present):,}: {some}{more}",
        )
    return mask


@dataclass(frozen=True)
class Floaters:
    """Floaters of a cloud.

    Attributes:
        mask: Which Gaussians are floaters, shape (n,).
        share: Their share of all opacity.
        box: Lower and upper corner of the centers of all others, in file units, shape (2, 3).
    """

    mask: np.ndarray
    share: float
    box: np.ndarray

    def describe(self, count: int, is_body: bool) -> str:
        """Return a line about floaters among `count` Gaussians of a body, or of scenery."""
        margin = 1e-3 * float(np.ptp(self.box, axis=0).max())
        corners = self.box + [[-margin], [margin]]
        low, high = (", ".join(f"{value:.9g}" for value in corner) for corner in corners)
        effect = "are left out" if is_body else "do not count for its size and place"
        return (
            f"{int(self.mask.sum()):,} of {count:,} Gaussians ({100 * self.share:.2g} % of the"
            f" opacity) lie apart from what is seen and {effect}, as with select ="
            f" {{ box = [[{low}], [{high}]] }}; select = {{ keep_floaters = true }} keeps them"
        )


def capture_floaters(obj: Object, cloud: GaussianCloud) -> Floaters | None:
    """Return the floaters that an object leaves out, with a line about them; None without any.

    They stay where neither size nor place of the object depends on its extent.

    Args:
        obj: Object made of a capture.
        cloud: Its Gaussians in the units of their file.
    """
    by_extent = obj.position is not None or any(
        getattr(obj, key) is not None for key in ("height", "width", "depth")
    )
    if not by_extent or (obj.select is not None and obj.select.keep_floaters):
        return None
    floaters = find_floaters(cloud)
    if floaters is not None:
        log.warning("'%s': %s", obj.name, floaters.describe(len(cloud), obj.role == "body"))
    return floaters


def find_floaters(cloud: GaussianCloud) -> Floaters | None:
    """Return the floaters of a capture, or None if it has none.

    Args:
        cloud: Gaussians in the units of their file.
    """
    x, opacity = cloud.x, cloud.opacity
    if len(x) <= NEIGHBORS or not opacity.sum() > 0:  # too few for clusters
        return None
    low, middle, high = np.stack(
        [_weighted_quantiles(x[:, axis], opacity, (0.025, 0.5, 0.975)) for axis in range(3)], axis=1
    )
    extent = float((high - low).max())
    if not extent > 0:
        return None
    edge = _cube_edge(x, extent)
    cells = _cubes(x, middle, edge)
    key, cube_of = np.unique(_keys(cells), return_inverse=True)
    cube_opacity = np.bincount(cube_of, opacity, len(key))
    typical = float(_weighted_quantiles(cube_opacity, cube_opacity, 0.5))
    is_visible = cube_opacity >= min(SEEN_OPACITY, SEEN_SHARE * typical)
    bridges = _bridges(cloud, middle, edge, is_visible[cube_of] & (opacity >= SEEN_SHARE))
    cluster = _clusters(key[is_visible], bridges)
    weight = np.bincount(cluster, cube_opacity[is_visible])
    counts = np.zeros(len(key), dtype=bool)
    counts[is_visible] = weight[cluster] >= CLUSTER_SHARE * weight.max()
    core = x[counts[cube_of]]
    low, high = core.min(axis=0) - edge, core.max(axis=0) + edge
    mask = ((x < low) | (x > high)).any(axis=1)
    share = float(opacity[mask].sum() / opacity.sum())
    if not mask.any() or share > MAX_SHARE:
        return None
    others = x[~mask]
    return Floaters(mask, share, np.stack([others.min(axis=0), others.max(axis=0)]))


def _cube_edge(x: np.ndarray, extent: float) -> float:
    """Return the edge of the cubes for Gaussians at x (n, 3) [file units] of this extent."""
    sample = x[:: -(-len(x) // SAMPLES)]
    distance = scipy.spatial.cKDTree(x).query(sample, NEIGHBORS + 1)[0][:, -1]
    return max(extent / CUBES, 1.5 * float(np.median(distance)))


def _weighted_quantiles(values: np.ndarray, weights: np.ndarray, shares) -> np.ndarray:
    """Return the values below which the given shares of the weights lie."""
    order = np.argsort(values, kind="stable")
    total = np.cumsum(weights[order])
    return values[order[np.searchsorted(total, np.asarray(shares) * total[-1])]]


def _cubes(x: np.ndarray, middle: np.ndarray, edge: float) -> np.ndarray:
    """Return the cubes (n, 3) of points (n, 3), counted from the middle; far ones are clipped."""
    reach = np.clip(np.floor((x - middle) / edge), -_AXIS_LIMIT + 2, _AXIS_LIMIT - 2)
    return reach.astype(np.int64)


def _keys(cells: np.ndarray) -> np.ndarray:
    """Return one number per cube (..., 3)."""
    shifted = cells + _AXIS_LIMIT
    return (shifted[..., 0] << 42) | (shifted[..., 1] << 21) | shifted[..., 2]


def _bridges(
    cloud: GaussianCloud, middle: np.ndarray, edge: float, mask: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return pairs of cubes, as two arrays of keys, that Gaussians of a mask join by their size."""
    chosen = np.flatnonzero(mask & (2 * cloud.scale.max(axis=1) > edge))
    starts, ends = [], []
    axes = np.swapaxes(rotation_matrices(cloud.quat[chosen]), 1, 2)
    home = _keys(_cubes(cloud.x[chosen], middle, edge))
    for axis in range(3):
        reach = np.minimum(2 * cloud.scale[chosen, axis], MAX_REACH * edge)
        for step in [*range(-MAX_REACH, 0), *range(1, MAX_REACH + 1)]:
            inside = abs(step) * edge <= reach
            shift = step * edge * axes[inside, axis]
            ends.append(_keys(_cubes(cloud.x[chosen[inside]] + shift, middle, edge)))
            starts.append(home[inside])
    return np.concatenate(starts), np.concatenate(ends)


def _clusters(key: np.ndarray, bridges: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Return the cluster of each cube: cubes that touch, or that a bridge joins, are one.

    Args:
        key: Sorted keys of the cubes, shape (m,).
        bridges: Keys of both ends of each bridge; an end may lie in or next to a cube of `key`.
    """
    pairs = []
    steps = _keys(_SIDES) - _keys(np.zeros(3, dtype=np.int64))
    for starts, ends, offsets in (
        (key, key, steps),
        (*bridges, np.concatenate([[0], steps, -steps])),
    ):
        for offset in offsets:
            place = np.minimum(np.searchsorted(key, ends + offset), len(key) - 1)
            hit = key[place] == ends + offset
            pairs.append(np.stack([np.searchsorted(key, starts[hit]), place[hit]]))
    first, second = np.concatenate(pairs, axis=1)
    graph = scipy.sparse.coo_array(
        (np.ones(len(first), dtype=np.int8), (first, second)), shape=(len(key),) * 2
    )
    return scipy.sparse.csgraph.connected_components(graph, directed=False)[1]

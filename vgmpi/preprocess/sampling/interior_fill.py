"""Filling of the hollow interior of a capture: Gaussians lie on surfaces, matter does not."""

import itertools
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import ArrayLike

from vgmpi.gaussians.cloud import GaussianCloud
from vgmpi.runtime import process_limits

from .voxels import BYTES_NEIGHBORS, Voxels, covered_voxels

MIN_ENCLOSED_FRACTION = (
    0.5  # [-] of all directions: those in which the surface is met from its inner side
)
# [-] weight of directions from below in openness: captures stand on something, and their undersides
# were seen by no camera.
FROM_BELOW_WEIGHT = 0.1
_DOWN_COSINE = -0.5  # [-] cosine to the object's up below which a direction comes from below
_OPENNESS_SIGMA = 1.0  # [voxels] over which openness is averaged on either side of the surface
_WEIGHT = {
    1: 1 / 21,
    2: 4 / 105,
    3: 9 / 280,
}  # [-] weights of directions along faces, edges, corners
_ADVICE = "remove outliers with select, or set fill = false"
_STEPS = [step for step in itertools.product((-1, 0, 1), repeat=3) if any(step)]
_MAX_VOXELS = 2**29  # voxels in the box of one object


class VoxelGridTooLargeError(ValueError):
    """Error for a cloud whose box has too many voxels; one line that says what to do."""


class MissingInterior(NamedTuple):
    """Points that a cloud lacks.

    interior_points (n, 3) [m]: centers of voxels inside; enclosed (n,): whether the surface
    encloses them on all sides; gap_points (m, 3) [m]: centers of voxels on the surface.
    """

    interior_points: np.ndarray
    enclosed: np.ndarray
    gap_points: np.ndarray

    def inside_box(self, size: np.ndarray) -> "MissingInterior":
        """Return the points between the origin and the far corner `size` (3,) [m] of a box."""
        interior_kept, gaps_kept = (
            ((points >= 0) & (points <= size)).all(axis=1)
            for points in (self.interior_points, self.gap_points)
        )
        return MissingInterior(
            self.interior_points[interior_kept],
            self.enclosed[interior_kept],
            self.gap_points[gaps_kept],
        )


def interior(
    cloud: GaussianCloud, spacing: float, mode: bool | str, up: ArrayLike = (0.0, 0.0, 1.0)
) -> MissingInterior:
    """Return the interior and gap points that a placed cloud lacks.

    Voxels that contain a Gaussian's center are in neither. Voxels of the surface are those a
    Gaussian covers from a center elsewhere: without particles there a coarse capture would be a
    sieve.

    Args:
        cloud: Placed cloud.
        spacing: Voxel edge [m].
        mode: True or "visible" fills the enclosed and, where the surface has holes, the nearly
            enclosed space; "closed" only the enclosed space; False leaves the cloud as it is.
        up: Unit vector that pointed up in the capture, shape (3,).

    Raises:
        VoxelGridTooLargeError: The box has too many voxels.
    """
    if mode is False:
        return MissingInterior(np.empty((0, 3)), np.empty(0, dtype=bool), np.empty((0, 3)))
    voxels = Voxels.enclosing(cloud.x, spacing)
    if np.prod(np.array(voxels.shape, dtype=float)) > _MAX_VOXELS:
        size = " x ".join(map(str, voxels.shape))
        raise VoxelGridTooLargeError(
            f"its box of {size} voxels of {spacing:g} m is too large to fill: {_ADVICE}"
        )
    try:
        voxels.afford(BYTES_NEIGHBORS)  # the largest need: the volume fractions
    except process_limits.InsufficientMemoryError as error:
        raise VoxelGridTooLargeError(f"{error}: {_ADVICE}") from None
    surface = covered_voxels(cloud, voxels)
    closed = scipy.ndimage.binary_fill_holes(surface) & ~surface
    inside = closed if mode == "closed" else closed | interior_by_visibility(surface, up)
    free = np.ones(inside.size, dtype=bool)
    free[voxels.index(cloud.x)] = False
    inside &= free.reshape(inside.shape)
    gap_points = voxels.centers(surface & free.reshape(inside.shape))
    return MissingInterior(voxels.centers(inside), closed[inside], gap_points)


def interior_by_visibility(surface: np.ndarray, up: ArrayLike = (0.0, 0.0, 1.0)) -> np.ndarray:
    """Return the empty voxels that see the inner side of the surface almost all around.

    The outer side is the one from which more of the outside is seen: between two legs the surface
    is met all around as well, but from outside. Where neither side sees more, as between layers
    that lie close, it counts as the outer one.

    Args:
        surface: Mask of surface voxels.
        up: Unit vector, shape (3,), see FROM_BELOW_WEIGHT.
    """
    open_ = scipy.ndimage.gaussian_filter(
        visible_fraction(surface, up), _OPENNESS_SIGMA, truncate=2.0
    )
    fraction = np.zeros(surface.shape, dtype=np.float32)
    for step in _STEPS:
        rising = _moved(open_, step) > _moved(open_, tuple(-s for s in step))
        sides = np.where(rising, np.int8(1), np.int8(-1)) * surface
        fraction += np.float32(_weight(step)) * (_first_side(sides, step) > 0)
    return (fraction >= MIN_ENCLOSED_FRACTION) & ~surface


def visible_fraction(surface: np.ndarray, up: ArrayLike = (0.0, 0.0, 1.0)) -> np.ndarray:
    """Return the fraction of all directions in which each voxel does not meet the surface.

    Directions from below count by FROM_BELOW_WEIGHT. The 26 directions to the neighbors are
    weighted as on a sphere (Lebedev 1976, order 7).
    """
    fraction = np.zeros(surface.shape, dtype=np.float32)
    for step in _STEPS:
        below = np.dot(step, up) < _DOWN_COSINE * np.linalg.norm(step)
        weight = np.float32(_weight(step) * (FROM_BELOW_WEIGHT if below else 1.0))
        fraction += weight * (_first_side(surface.view(np.int8), step) == 0)
    return fraction


def _weight(step: tuple[int, ...]) -> float:
    """Return the weight of a direction."""
    return _WEIGHT[sum(map(abs, step))]


def _moved(values: np.ndarray, step: tuple[int, ...]) -> np.ndarray:
    """Return the value of each voxel's neighbor `step` away; at edges that of the last voxel."""
    for axis, shift in enumerate(step):
        if shift:
            index = np.clip(np.arange(values.shape[axis]) + shift, 0, values.shape[axis] - 1)
            values = np.take(values, index, axis=axis)
    return values


def _first_side(sides: np.ndarray, step: tuple[int, ...]) -> np.ndarray:
    """Return the side of the surface that the line from each voxel along `step` meets first.

    It is 1 or -1, or 0 if it meets nothing. The voxels beside a diagonal step count too: it would
    slip through a wall of one voxel. Where they disagree the majority counts, and -1 wins a draw.

    Args:
        sides: Side of each surface voxel, 1 or -1, and 0 elsewhere, int8.
        step: Direction, -1, 0 or 1 per axis.
    """
    lead_axis = next(axis for axis in range(3) if step[axis])
    backward = tuple(axis for axis in range(3) if step[axis] > 0)
    turned = np.flip(sides, backward)
    along = [lead_axis, *(axis for axis in range(3) if axis != lead_axis)]
    turned = turned.transpose(along)  # lines now come from lower indices on all their axes
    moves = [step[axis] != 0 for axis in along[1:]]
    shifts = [(a, b) for a in range(1 + moves[0]) for b in range(1 + moves[1])]
    met = np.zeros(turned.shape, dtype=np.int8)
    for k in range(len(turned)):
        votes, is_met = np.zeros_like(met[k]), np.zeros(met[k].shape, dtype=bool)
        for sheet in turned[max(k - 1, 0) : k + 1]:  # its own sheet and the one before
            for shift in shifts:
                shifted = _shifted(sheet, shift)
                votes += shifted
                is_met |= shifted != 0
        before = _shifted(met[k - 1], (int(moves[0]), int(moves[1]))) if k else met[0]
        met[k] = np.where(is_met, np.where(votes > 0, np.int8(1), np.int8(-1)), before)
    out = met.transpose(np.argsort(along))
    return np.flip(out, backward)


def _shifted(sheet: np.ndarray, by: tuple[int, int]) -> np.ndarray:
    """Return the sheet moved up by 0 or 1 along its axes; new cells are empty."""
    out = np.zeros_like(sheet)
    out[by[0] :, by[1] :] = sheet[: sheet.shape[0] - by[0], : sheet.shape[1] - by[1]]
    return out


def filling(
    x: np.ndarray, surface: GaussianCloud, spacing: float, opacity: float | np.ndarray
) -> GaussianCloud:
    """Return round Gaussians in the plain color, and light, of the nearest well visible Gaussian.

    Args:
        x: Positions, shape (n, 3) [m].
        surface: Gaussians of the surface.
        spacing: Particle spacing [m].
        opacity: Opacity of all, or of each, shape (n,).
    """
    visible = surface.opacity > min(0.3, float(surface.opacity.max()) / 2)
    visible_cloud = surface.select(visible)
    color = visible_cloud.sh[:, 0]
    nearest: np.ndarray | int = 0
    if len(x) and (color != color[:1]).any():  # deep inside, the search for the nearest is slow
        nearest = scipy.spatial.cKDTree(visible_cloud.x).query(x)[1]
    sh = np.zeros((len(x), *surface.sh.shape[1:]), dtype=np.float32)
    sh[:, 0] = color[nearest]
    return GaussianCloud(
        x,
        np.tile([1.0, 0.0, 0.0, 0.0], (len(x), 1)),
        np.full((len(x), 3), 0.45 * spacing),
        np.full(len(x), opacity),
        sh,
        None
        if visible_cloud.shade is None
        else np.broadcast_to(visible_cloud.shade[nearest], len(x)),
    )


def joined(first: GaussianCloud, second: GaussianCloud) -> GaussianCloud:
    """Return both clouds, one after the other; render model and record are those of the first."""
    names = ("x", "quat", "scale", "opacity", "sh")
    painted = first.shade is not None or second.shade is not None
    x, quat, scale, opacity, sh = (
        np.concatenate([getattr(first, n), getattr(second, n)]) for n in names
    )
    shade = np.concatenate([first.shades, second.shades]) if painted else None
    return replace(
        first, x=x, quat=quat, scale=scale, opacity=opacity, sh=sh, shade=shade, labels={}
    )

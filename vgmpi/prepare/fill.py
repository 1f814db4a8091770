"""Fill the hollow inside of a capture: Gaussians lie on surfaces, matter does not."""

import itertools
from typing import NamedTuple

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from vgmpi import room
from vgmpi.gaussians.cloud import Cloud
from vgmpi.prepare.voxels import NEIGHBOURS, Voxels, covered

INSIDE = 0.5  # share of all directions in which the surface is met from its inner side
# weight of directions from below in what is open: captures stand on something, and their undersides
# were seen by no camera
BELOW = 0.1
_DOWN = -0.5  # least cosine to the object's up at which a direction does not come from below
_NEAR = 1.0  # voxels over which openness is averaged on either side of the surface
_WEIGHT = {1: 1 / 21, 2: 4 / 105, 3: 9 / 280}  # of directions along faces, edges, corners
_ADVICE = "remove outliers with select, or set fill = false"
_STEPS = [step for step in itertools.product((-1, 0, 1), repeat=3) if any(step)]
_LARGEST = 2**29  # voxels in the box of one object


class TooLarge(ValueError):
    """A cloud whose box has too many voxels; one line that says what to do."""


class Lack(NamedTuple):
    """What a cloud lacks: centres [m] of voxels inside it (n, 3), whether the surface encloses them
    on all sides (n,), and centres on its surface (m, 3)."""

    inner: np.ndarray
    enclosed: np.ndarray
    gaps: np.ndarray


def interior(
    cloud: Cloud, spacing: float, mode: bool | str, up: np.ndarray = (0.0, 0.0, 1.0)
) -> Lack:
    """What a placed cloud lacks.

    Voxels that hold a Gaussian's centre are in neither. Voxels of the surface are those a Gaussian
    covers from a centre elsewhere: without particles there a coarse capture would be a sieve.
    mode: True or "shown" fills what the surface encloses, or nearly encloses where it has holes;
    "closed" only what it encloses; False leaves the cloud as it is. up (3,): unit vector that
    pointed up in the capture. Raises TooLarge.
    """
    if mode is False:
        return Lack(np.empty((0, 3)), np.empty(0, dtype=bool), np.empty((0, 3)))
    voxels = Voxels.around(cloud.x, spacing)
    if np.prod(np.array(voxels.shape, dtype=float)) > _LARGEST:
        size = " x ".join(map(str, voxels.shape))
        raise TooLarge(f"its box of {size} voxels of {spacing:g} m is too large to fill: {_ADVICE}")
    try:
        voxels.afford(NEIGHBOURS)  # which share what is filled
    except room.TooLarge as error:
        raise TooLarge(f"{error}: {_ADVICE}") from None
    surface = covered(cloud, voxels)
    closed = ndimage.binary_fill_holes(surface) & ~surface
    inside = closed if mode == "closed" else closed | enclosed_by_sight(surface, up)
    free = np.ones(inside.size, dtype=bool)
    free[voxels.index(cloud.x)] = False
    inside &= free.reshape(inside.shape)
    gaps = voxels.centers(surface & free.reshape(inside.shape))
    return Lack(voxels.centers(inside), closed[inside], gaps)


def enclosed_by_sight(surface: np.ndarray, up: np.ndarray = (0.0, 0.0, 1.0)) -> np.ndarray:
    """Empty voxels (shape, bool) that see the surface (shape, bool) almost all around, and see it
    from its inner side.

    The outer side is the one from which more of the outside is seen: between two legs the surface
    is met all around as well, but from without. Where neither side sees more, as between layers
    that lie close, it counts as the outer one. up (3,): see BELOW.
    """
    open_ = ndimage.gaussian_filter(openness(surface, up), _NEAR, truncate=2.0)
    share = np.zeros(surface.shape, dtype=np.float32)
    for step in _STEPS:
        rising = _moved(open_, step) > _moved(open_, tuple(-s for s in step))
        sides = np.where(rising, np.int8(1), np.int8(-1)) * surface
        share += np.float32(_weight(step)) * (_first(sides, step) > 0)
    return (share >= INSIDE) & ~surface


def openness(surface: np.ndarray, up: np.ndarray = (0.0, 0.0, 1.0)) -> np.ndarray:
    """Share of all directions in which each voxel (shape) does not meet the surface; those from
    below count by BELOW.

    By the 26 directions to the neighbours, weighted as on a sphere (Lebedev 1976, order 7).
    """
    share = np.zeros(surface.shape, dtype=np.float32)
    for step in _STEPS:
        below = np.dot(step, up) < _DOWN * np.linalg.norm(step)
        weight = np.float32(_weight(step) * (BELOW if below else 1.0))
        share += weight * (_first(surface.view(np.int8), step) == 0)
    return share


def _weight(step: tuple[int, ...]) -> float:
    return _WEIGHT[sum(map(abs, step))]


def _moved(values: np.ndarray, step: tuple[int, ...]) -> np.ndarray:
    """The value (shape) of each voxel's neighbour `step` away; at the edges of the last one."""
    for axis, by in enumerate(step):
        if by:
            at = np.clip(np.arange(values.shape[axis]) + by, 0, values.shape[axis] - 1)
            values = np.take(values, at, axis=axis)
    return values


def _first(sides: np.ndarray, step: tuple[int, ...]) -> np.ndarray:
    """What the line from each voxel along `step` (-1, 0, 1 per axis) meets first (shape, int8):
    1 or -1 of `sides` (shape, int8: 0 where there is no surface), or 0 where it meets nothing.

    The voxels beside a diagonal step count too: it would slip through a wall of one voxel. Where
    they disagree the majority has it, and -1 wins a draw.
    """
    lead = next(axis for axis in range(3) if step[axis])
    turned = np.flip(sides, [axis for axis in range(3) if step[axis] > 0])
    along = [lead, *(axis for axis in range(3) if axis != lead)]
    turned = turned.transpose(along)  # lines now come from lower numbers on all axes they follow
    moves = [step[axis] != 0 for axis in along[1:]]
    beside = [(a, b) for a in range(1 + moves[0]) for b in range(1 + moves[1])]
    met = np.zeros(turned.shape, dtype=np.int8)
    for k in range(len(turned)):
        votes, some = np.zeros_like(met[k]), np.zeros(met[k].shape, dtype=bool)
        for sheet in turned[max(k - 1, 0) : k + 1]:  # the voxel's own, and the sheet before
            for shift in beside:
                near = _shifted(sheet, shift)
                votes += near
                some |= near != 0
        before = _shifted(met[k - 1], (int(moves[0]), int(moves[1]))) if k else met[0]
        met[k] = np.where(some, np.where(votes > 0, np.int8(1), np.int8(-1)), before)
    out = met.transpose(np.argsort(along))
    return np.flip(out, [axis for axis in range(3) if step[axis] > 0])


def _shifted(sheet: np.ndarray, by: tuple[int, int]) -> np.ndarray:
    """The sheet moved up by 0 or 1 along its axes; what comes in is empty."""
    out = np.zeros_like(sheet)
    out[by[0] :, by[1] :] = sheet[: sheet.shape[0] - by[0], : sheet.shape[1] - by[1]]
    return out


def filling(x: np.ndarray, surface: Cloud, spacing: float, opacity: float | np.ndarray) -> Cloud:
    """Round Gaussians at `x` (n, 3) in the plain colour, and its light, of the nearest well visible
    one.

    opacity: of all, or of each (n,).
    """
    visible = surface.opacity > min(0.3, float(surface.opacity.max()) / 2)
    shown = surface.select(visible)
    colour = shown.sh[:, 0]
    near: np.ndarray | int = 0
    if len(x) and (colour != colour[:1]).any():  # deep inside, the nearest takes long to be found
        near = cKDTree(shown.x).query(x)[1]
    sh = np.zeros((len(x), *surface.sh.shape[1:]), dtype=np.float32)
    sh[:, 0] = colour[near]
    return Cloud(
        x,
        np.tile([1.0, 0.0, 0.0, 0.0], (len(x), 1)),
        np.full((len(x), 3), 0.45 * spacing),
        np.full(len(x), opacity),
        sh,
        None if shown.shade is None else np.broadcast_to(shown.shade[near], len(x)),
    )


def joined(first: Cloud, second: Cloud) -> Cloud:
    """Both clouds, one after the other."""
    names = ("x", "quat", "scale", "opacity", "sh")
    painted = first.shade is not None or second.shade is not None
    return Cloud(
        *(np.concatenate([getattr(first, n), getattr(second, n)]) for n in names),
        np.concatenate([first.shades, second.shades]) if painted else None,
    )

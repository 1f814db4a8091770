"""Fill the hollow inside of a capture: Gaussians lie on surfaces, matter does not."""

import itertools

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from vgmpi import room
from vgmpi.gaussians.cloud import Cloud
from vgmpi.prepare.voxels import NEIGHBOURS, Voxels, covered

# shares of all directions in which the surface is met, seen from inside a shell with holes
CERTAIN = 0.85  # inside: the corner between two outer walls has 3/4
DOUBTFUL = 0.55  # outside up to this: in a flat hole it is 1/2
VOTES = 5  # of 6 axis directions that meet the surface, quick to find: likely inside
LEAKING = 0.5  # share of what is likely inside below which the closed filling has leaked out
_WEIGHT = {1: 1 / 21, 2: 4 / 105, 3: 9 / 280}  # of directions along faces, edges, corners
_AXES = [step for step in itertools.product((-1, 0, 1), repeat=3) if sum(map(abs, step)) == 1]
_ADVICE = "remove outliers with select, or set fill = false"
_LARGEST = 2**29  # voxels in the box of one object


class TooLarge(ValueError):
    """A cloud whose box has too many voxels; one line that says what to do."""


def interior(cloud: Cloud, spacing: float, mode: bool | str) -> tuple[np.ndarray, np.ndarray]:
    """What a placed cloud lacks: centres [m] of voxels inside it (n, 3), and on its surface (m, 3).

    Voxels that hold a Gaussian's centre are in neither. Voxels of the surface are those a Gaussian
    covers from a centre elsewhere: without particles there a coarse capture would be a sieve.
    mode: True fills what the surface encloses, or nearly encloses where it has holes; "closed"
    only what it encloses; False leaves the cloud as it is. Raises TooLarge.
    """
    if mode is False:
        return np.empty((0, 3)), np.empty((0, 3))
    voxels = Voxels.around(cloud.x, spacing)
    if np.prod(np.array(voxels.shape, dtype=float)) > _LARGEST:
        size = " x ".join(map(str, voxels.shape))
        raise TooLarge(f"its box of {size} voxels of {spacing:g} m is too large to fill: {_ADVICE}")
    try:
        voxels.afford(NEIGHBOURS)  # which share what is filled
    except room.TooLarge as error:
        raise TooLarge(f"{error}: {_ADVICE}") from None
    surface = covered(cloud, voxels)
    inside = ndimage.binary_fill_holes(surface) & ~surface
    if mode is True:
        likely = sum(_met(surface, step).view(np.int8) for step in _AXES) >= VOTES
        if inside.sum() < LEAKING * (likely & ~surface).sum():
            inside |= enclosed_by_sight(surface)
    free = np.ones(inside.size, dtype=bool)
    free[voxels.index(cloud.x)] = False
    free = free.reshape(inside.shape)
    return voxels.centers(inside & free), voxels.centers(surface & free)


def enclosed_by_sight(surface: np.ndarray) -> np.ndarray:
    """Empty voxels (shape, bool) that see the surface almost all around.

    Those that meet it in a share CERTAIN of all directions are inside, up to DOUBTFUL outside;
    between the two whichever reaches a voxel first through free space has it, the inside being
    twice as fast. One threshold alone loses the space below a hole or fills outer corners.
    """
    share = sight(surface)
    share[surface] = 0.0
    open_ = ~surface & (share < CERTAIN) & (share > DOUBTFUL)
    inside, outside = share >= CERTAIN, ~surface & (share <= DOUBTFUL)
    while True:
        more = ndimage.binary_dilation(inside, iterations=2, mask=inside | open_) & open_
        less = ndimage.binary_dilation(outside) & open_ & ~more
        if not (more.any() or less.any()):
            return inside
        inside |= more
        outside |= less
        open_ &= ~(more | less)


def sight(surface: np.ndarray) -> np.ndarray:
    """Share of all directions in which each voxel (shape) meets the surface.

    By the 26 directions to the neighbours, weighted as on a sphere (Lebedev 1976, order 7).
    """
    share = np.zeros(surface.shape, dtype=np.float32)
    for step in itertools.product((-1, 0, 1), repeat=3):
        if any(step):
            share += np.float32(_WEIGHT[sum(map(abs, step))]) * _met(surface, step)
    return share


def _met(surface: np.ndarray, step: tuple[int, ...]) -> np.ndarray:
    """Whether the line from each voxel along `step` (-1, 0, 1 per axis) meets the surface.

    The voxels beside a diagonal step count too: it would slip through a wall of one voxel.
    """
    lead = next(axis for axis in range(3) if step[axis])
    turned = np.flip(surface, [axis for axis in range(3) if step[axis] > 0])
    along = [lead, *(axis for axis in range(3) if axis != lead)]
    turned = turned.transpose(along)  # lines now come from lower numbers on all axes they follow
    moves = [step[axis] != 0 for axis in along[1:]]
    beside = [(a, b) for a in range(1 + moves[0]) for b in range(1 + moves[1])]
    met = np.zeros(turned.shape, dtype=bool)
    for k in range(len(turned)):
        for shift in beside:  # within the sheet, then from the sheet before
            met[k] |= _shifted(turned[k], shift)
        if k:
            for shift in beside:
                met[k] |= _shifted(turned[k - 1], shift)
            met[k] |= _shifted(met[k - 1], (int(moves[0]), int(moves[1])))
    out = met.transpose(np.argsort(along))
    return np.flip(out, [axis for axis in range(3) if step[axis] > 0])


def _shifted(sheet: np.ndarray, by: tuple[int, int]) -> np.ndarray:
    """The sheet moved up by 0 or 1 along its axes; what comes in is empty."""
    out = np.zeros_like(sheet)
    out[by[0] :, by[1] :] = sheet[: sheet.shape[0] - by[0], : sheet.shape[1] - by[1]]
    return out


def filling(x: np.ndarray, surface: Cloud, spacing: float, opacity: float) -> Cloud:
    """Round Gaussians at `x` (n, 3) in the plain colour of the nearest well visible one."""
    visible = surface.opacity > min(0.3, float(surface.opacity.max()) / 2)
    shown = surface.select(visible)
    near = cKDTree(shown.x).query(x)[1] if len(x) else np.empty(0, dtype=int)
    sh = np.zeros((len(x), *surface.sh.shape[1:]), dtype=np.float32)
    sh[:, 0] = shown.sh[near, 0]
    return Cloud(
        x,
        np.tile([1.0, 0.0, 0.0, 0.0], (len(x), 1)),
        np.full((len(x), 3), 0.45 * spacing),
        np.full(len(x), opacity),
        sh,
    )


def joined(first: Cloud, second: Cloud) -> Cloud:
    """Both clouds, one after the other."""
    names = ("x", "quat", "scale", "opacity", "sh")
    return Cloud(*(np.concatenate([getattr(first, n), getattr(second, n)]) for n in names))

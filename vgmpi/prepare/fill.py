"""Fill the hollow inside of a capture: Gaussians lie on surfaces, matter does not."""

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from vgmpi.gaussians.cloud import Cloud
from vgmpi.prepare.voxels import Voxels, covered

VOTES = 5  # of 6 axis directions that must meet the surface, seen from inside a leaking shell
LEAKING = 0.5  # share of the volume found by votes below which the closed filling has leaked out
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
        raise TooLarge(
            f"its box of {size} voxels of {spacing:g} m is too large to fill: remove outliers with"
            " select, or set fill = false"
        )
    surface = covered(cloud, voxels)
    inside = ndimage.binary_fill_holes(surface) & ~surface
    if mode is True:
        voted = enclosed_by_votes(surface)
        if inside.sum() < LEAKING * voted.sum():
            inside |= voted
    free = np.ones(inside.size, dtype=bool)
    free[voxels.index(cloud.x)] = False
    free = free.reshape(inside.shape)
    return voxels.centers(inside & free), voxels.centers(surface & free)


def enclosed_by_votes(surface: np.ndarray) -> np.ndarray:
    """Empty voxels that see the surface in at least VOTES of the 6 axis directions."""
    votes = np.zeros(surface.shape, dtype=np.int8)
    for axis in range(3):
        seen = np.maximum.accumulate(surface, axis=axis)
        votes += seen
        votes += np.flip(np.maximum.accumulate(np.flip(surface, axis), axis=axis), axis)
    return (votes >= VOTES) & ~surface


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

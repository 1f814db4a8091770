"""Voxels of the particle spacing, aligned with the lattice of particles: occupancy and volumes."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from vgmpi import room
from vgmpi.gaussians.cloud import Cloud, rotation_matrices

COVERED = 0.3  # summed opacity from which a voxel counts as part of a surface
# bytes of a voxel that shares by counts and by neighbours take at least, and a collider's distances
COUNTED, NEIGHBOURS, DISTANCES = 8, 24, 28
LEAST = 0.02  # part of a voxel that particles in it stand for at least
_REACH = 1.5  # standard deviations over which a Gaussian covers voxels
_MOST = 12  # samples along one axis of a Gaussian


@dataclass(frozen=True)
class Voxels:
    """A dense box of voxels. start: index (3,) of its first voxel; spacing: their edge [m]."""

    start: np.ndarray
    shape: tuple[int, int, int]
    spacing: float

    @classmethod
    def around(cls, x: np.ndarray, spacing: float, margin: int = 2) -> "Voxels":
        """The box around points (n, 3) with `margin` empty voxels on every side."""
        start = np.floor(x.min(axis=0) / spacing).astype(np.int64) - margin
        stop = np.floor(x.max(axis=0) / spacing).astype(np.int64) + 1 + margin
        return cls(start, tuple(int(n) for n in stop - start), spacing)

    def afford(self, each: int) -> None:
        """Raises room.TooLarge where `each` bytes for every voxel are more than there are."""
        size = " x ".join(map(str, self.shape))
        needed = each * float(np.prod(np.array(self.shape, dtype=float)))
        room.check(needed, f"its box of {size} voxels of {self.spacing:g} m takes at least")

    def solid(self, share: np.ndarray | None, shell: np.ndarray) -> np.ndarray:
        """Voxels (shape, bool) that are at least half inside; without shares those of a shell."""
        if share is not None:
            return share >= 0.5
        out = np.zeros(self.shape, dtype=bool)
        out.ravel()[self.index(shell)] = True
        return out

    def index(self, x: np.ndarray) -> np.ndarray:
        """Flat index (n,) of the voxel of each point; -1 outside the box."""
        local = np.floor(x / self.spacing).astype(np.int64) - self.start
        inside = ((local >= 0) & (local < self.shape)).all(axis=1)
        flat = (local[:, 0] * self.shape[1] + local[:, 1]) * self.shape[2] + local[:, 2]
        return np.where(inside, flat, -1)

    def centers(self, mask: np.ndarray) -> np.ndarray:
        """Middle (n, 3) [m] of each voxel where `mask` (shape) is true."""
        return (np.argwhere(mask) + self.start + 0.5) * self.spacing


def share_by_neighbours(voxels: Voxels, shell: np.ndarray, inner: np.ndarray) -> np.ndarray:
    """Which part of each voxel (shape) lies inside a solid known by points only.

    shell (n, 3): points on the surface, inner (m, 3): points inside, none in a voxel of the shell.
    A voxel of the shell is inside by the share of inner voxels among its neighbours that are not
    shell, and by one half where there is no inner one. Counted in full, the shell made bodies of
    20 voxels across 20-50 % too heavy; with this they are right within 3 %.
    """
    kind = np.zeros((2, *voxels.shape))
    for mask, points in zip(kind, (shell, inner), strict=True):
        mask.ravel()[voxels.index(points)] = 1.0
    full = np.ones((3, 3, 3))
    near = ndimage.convolve(kind[1], full, mode="constant")
    far = 27.0 - near - ndimage.convolve(kind[0], full, mode="constant")
    share = np.where(near > 0.5, near / np.maximum(near + far, 1.0), 0.5)
    return np.where(kind[0] > 0, share, kind[1])


def share_by_count(voxels: Voxels, fine: Iterable[np.ndarray], fineness: int) -> np.ndarray:
    """As share_by_neighbours, from the points inside of a `fineness` times finer lattice, in parts
    (m, 3)."""
    total = np.zeros(int(np.prod(voxels.shape)), dtype=np.int64)
    for part in fine:
        at = voxels.index(part)
        at = at[at >= 0]
        if len(at):
            first = at.min()
            counts = np.bincount(at - first)
            total[first : first + len(counts)] += counts
    return (total / fineness**3).reshape(voxels.shape)


def volumes(voxels: Voxels, x: np.ndarray, share: np.ndarray | None) -> np.ndarray:
    """Volume [m3] of each particle (n,): its voxel's part inside, shared by the particles in it.

    x: (n, 3). share: (shape), raised to LEAST where a particle is: all need some mass; without it
    all of a voxel is inside.
    """
    _, mine, count = np.unique(voxels.index(x), return_inverse=True, return_counts=True)
    part = 1.0 if share is None else np.maximum(share.ravel()[voxels.index(x)], LEAST)
    return voxels.spacing**3 * part / count[mine]


def covered(cloud: Cloud, voxels: Voxels) -> np.ndarray:
    """Whether the summed opacity of a voxel makes it part of the surface (shape, bool).

    A Gaussian larger than a voxel counts in all voxels its disc covers, weighted by its profile:
    its centre alone would leave holes between the centres of a coarse capture.
    """
    order = np.argsort(-cloud.scale, axis=1, kind="stable")[:, :2]
    radii = np.take_along_axis(cloud.scale, order, axis=1)
    frames = rotation_matrices(cloud.quat)
    axes = np.take_along_axis(frames, order[:, None, :], axis=2) * radii[:, None, :]  # (n, 3, 2)
    count = np.clip(np.ceil(2 * _REACH * radii / voxels.spacing), 1, _MOST).astype(int)
    total = np.zeros(int(np.prod(voxels.shape)) + 1)  # the last one collects what is outside
    for a, b in np.unique(count, axis=0):
        rows = (count == (a, b)).all(axis=1)
        for s in _samples(a):
            for t in _samples(b):
                x = cloud.x[rows] + s * axes[rows, :, 0] + t * axes[rows, :, 1]
                weight = cloud.opacity[rows] * np.exp(-0.5 * (s * s + t * t))
                np.add.at(total, voxels.index(x), weight)
    return (total[:-1] > COVERED).reshape(voxels.shape)


def _samples(count: int) -> np.ndarray:
    return (np.arange(count) + 0.5) * (2 * _REACH / count) - _REACH

"""Filling of closed scenery, so that the space that a mesh encloses hides light, too.

Scenery of a mesh is a skin. Where a cone of light is wider than the skin is thick, the skin hides
only the part of it that its volume fills, so that light shone through. Points inside hide the rest.
"""

from typing import NamedTuple

import numpy as np

MAX_CELLS = 200  # [cells] of the grid of a body along its longest side
COARSER = 3.0  # [spacings of the skin] least cell size, so that the skin has no gaps
MARGIN = 2  # [cells] empty space around a body
DEPTH = 2.0  # [spacings of the skin] of points below it, so that they do not darken its creases


class SceneryFilling(NamedTuple):
    """Points inside of closed scenery.

    Attributes:
        x: Positions at rest, shape (n, 3) [m].
        volume: Volumes, shape (n,) [m3].
        parent: Rows of the Gaussians of scenery that are nearest, shape (n,).
        pose: Numbers of their poses in the frames, shape (n,), -1 for static ones.
    """

    x: np.ndarray
    volume: np.ndarray
    parent: np.ndarray
    pose: np.ndarray

    def positions(self, poses) -> np.ndarray:
        """Return the positions (n, 3) [m] in a frame with some poses (4, 4)."""
        x = self.x.copy()
        for number, pose in enumerate(poses):
            moved, matrix = self.pose == number, np.asarray(pose)
            x[moved] = x[moved] @ matrix[:3, :3].T + matrix[:3, 3]
        return x


def fill_scenery(
    x: np.ndarray, normal: np.ndarray, skins: list[np.ndarray], spacing: np.ndarray,
    moving: list[np.ndarray], cell: float, others: np.ndarray,
) -> SceneryFilling:  # fmt: skip
    """Return points inside of closed scenery.

    Args:
        x, normal: Gaussians of scenery at rest, shape (n, 3) [m], and their outward normals.
        skins: Rows of each body that is a skin.
        spacing: Spacings of the Gaussians, shape (n,) [m].
        moving: Rows of each body that moves.
        cell: Cell size of the occlusion [m], the largest distance of the points.
        others: Particles at rest, shape (m, 3) [m]; space with some of them stays empty.
    """
    points, volumes = [np.zeros((0, 3))], [np.zeros(0)]
    parents, poses = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
    for rows in skins:
        gap = float(np.median(spacing[rows]))
        inside, nearest, volume = enclosed_points(x[rows], normal[rows], gap, cell, others)
        if not len(inside):
            continue
        numbers = [k for k, members in enumerate(moving) if np.isin(rows[0], members)]
        points.append(inside)
        volumes.append(np.full(len(inside), volume))
        parents.append(rows[nearest])
        poses.append(np.full(len(inside), numbers[0] if numbers else -1))
    return SceneryFilling(
        np.concatenate(points), np.concatenate(volumes), np.concatenate(parents),
        np.concatenate(poses),
    )  # fmt: skip


def enclosed_points(
    x: np.ndarray, normal: np.ndarray, spacing: float, cell: float, others: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float]:
    """Return points (n, 3) [m] that fill what a skin encloses, with their nearest rows of it.

    Args:
        x, normal: Gaussians of the skin, shape (n, 3) [m], and their outward normals.
        spacing: Their spacing [m].
        cell: Largest distance of the points [m].
        others: Points of other bodies, shape (m, 3) [m]; space with some of them stays empty.

    Returns:
        Points, rows (n,), and the volume of a point [m3].
    """
    from scipy import ndimage
    from scipy.spatial import cKDTree

    low, size = x.min(axis=0), np.ptp(x, axis=0)
    h = max(COARSER * spacing, float(size.max()) / MAX_CELLS)
    shape = (size / h).astype(int) + 1 + 2 * MARGIN
    is_skin = np.zeros(shape, bool)
    is_skin[tuple(((x - low) / h).astype(int).T + MARGIN)] = True
    regions, count = ndimage.label(~is_skin)
    is_filled = np.ones(count + 1, bool)
    is_filled[[0, regions[0, 0, 0]]] = False
    number = np.floor((others - low) / h).astype(int) + MARGIN
    number = number[((number >= 0) & (number < shape)).all(axis=1)]
    is_filled[regions[tuple(number.T)]] = False
    filled = is_filled[regions]
    filled |= is_skin & ndimage.binary_dilation(filled, np.ones((3, 3, 3), bool))
    times = int(np.ceil(h / cell))
    parts = (np.indices((times, times, times)).reshape(3, -1).T + 0.5) / times
    points = ((np.argwhere(filled)[:, None] - MARGIN + parts) * h + low).reshape(-1, 3)
    nearest = cKDTree(x).query(points)[1]
    inside = ((points - x[nearest]) * normal[nearest]).sum(axis=1) < -DEPTH * spacing
    return points[inside], nearest[inside], (h / times) ** 3

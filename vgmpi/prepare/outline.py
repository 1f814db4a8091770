"""The surface of a solid body as contact knows it: its direction and distance from each particle
at rest, which move with the particle (kernels/layers/offsets.py)."""

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from vgmpi.kernels.layers.offsets import DEEPEST
from vgmpi.planning.channels import BEND
from vgmpi.prepare.collider import Collider
from vgmpi.prepare.pieces import Piece
from vgmpi.scene.scene import Scene

NEAR = 0.6  # cells from the surface within which a body is looked at for how thin it is
# cells that a body is deep a cell below its surface, whose edges are so too, and the share of its
# particles at the surface below which it may be less
DEEP, THIN = 0.6, 0.2
ON_WALL, FACING = 0.25, 0.7  # cells from a wall, and cosine, by which a face lies on it
SHARP = 5.7  # a normal that turns by 1 over the root of this in a cell is half sure
BENT = 0.5  # most that a normal may turn over a cell: edges are as round as two cells


def outlined(scene: Scene, piece: Piece, asked: bool) -> Piece:
    """The piece with what contact knows of its surface, where that is asked for and the body is not
    thinner than some two cells: of a sheet the two sides cancel, and its particles tell more."""
    done = replace(piece, outline=None)
    if piece.outline is None or not asked:
        return done
    dx, outline, x = scene.domain.cell, piece.outline(), piece.cloud.x
    distance, slope, bend = around(outline, x, dx / 2)
    steep = np.sqrt((slope**2).sum(axis=1))
    normal = slope / np.maximum(steep, 1e-300)[:, None]
    outer = distance > -NEAR * dx
    below = (x - (distance + dx)[:, None] * normal)[outer]
    if (outline.distance(below) > -DEEP * dx).mean() > THIN:
        return done
    bend *= np.minimum(1.0, BENT / dx / np.maximum(np.abs(bend).max(axis=1), 1e-300))[:, None]
    surface = np.column_stack([normal, distance, bend])
    _open_at_walls(scene, x, surface)
    surface[:, :3] /= 1.0 + (SHARP * dx**2 * (surface[:, 4:] ** 2).sum(axis=1))[:, None] ** 4
    surface[:, 3] = np.maximum(surface[:, 3], -DEEPEST * dx)
    return replace(done, surface=surface)


def _open_at_walls(scene: Scene, x: np.ndarray, surface: np.ndarray) -> None:
    """Of particles (n, 3) at mirroring walls on which their body stands, the surface (n, 10) as if
    it went on behind them: that of the nearest particles a bit off."""
    dx, size = scene.domain.cell, scene.domain.size
    nearest = x - surface[:, 3:4] * surface[:, :3]
    ends = np.zeros(len(x), bool)  # those that see the end of the body at a wall
    for k, (kind, _) in enumerate(scene.domain.walls):
        axis, inward, at = k // 2, 1.0 - 2.0 * (k % 2), k % 2 * size[k // 2]
        if kind != "separate":
            on = np.abs(nearest[:, axis] - at) < ON_WALL * dx
            on &= -inward * surface[:, axis] > FACING
            # differences about a particle see the end where it may be the nearest a cell away
            ends |= on.any() & (-surface[:, 3] > inward * (x[:, axis] - at) - dx)
    free = np.flatnonzero(~ends & (surface[:, 3] > -dx))
    if not ends.any() or not len(free):
        return
    _, at = cKDTree(nearest[free]).query(x[ends])
    other = free[at]
    found, way = surface[other], x[ends] - x[other]
    close = (way**2).sum(axis=1) < (2 * dx) ** 2
    turn = np.einsum("nab,nb->na", found[:, BEND].reshape(-1, 3, 3), way) * close[:, None]
    found[:, 3] += ((found[:, :3] + 0.5 * turn) * way).sum(axis=1)
    found[:, :3] += turn
    found[:, :3] /= np.maximum(np.sqrt((found[:, :3] ** 2).sum(axis=1)), 1e-300)[:, None]
    surface[ends] = found


def around(outline: Collider, x: np.ndarray, h: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Distance (n,) [m] at points (n, 3), its gradient (n, 3) and second derivatives (n, 6) [1/m]:
    xx, xy, xz, yy, yz, zz, by differences over 2 h [m]."""
    axes = h * np.eye(3)
    here = outline.distance(x)
    up = [outline.distance(x + e) for e in axes]
    down = [outline.distance(x - e) for e in axes]
    slope = np.stack([(u - d) / (2 * h) for u, d in zip(up, down, strict=True)], axis=1)
    bend = []
    for a in range(3):
        bend.append((up[a] + down[a] - 2 * here) / h**2)
        for b in range(a + 1, 3):
            both = outline.distance(x + axes[a] + axes[b])
            both += outline.distance(x - axes[a] - axes[b])
            bend.append((both + 2 * here - up[a] - down[a] - up[b] - down[b]) / (2 * h**2))
    return here, slope, np.stack(bend, axis=1)

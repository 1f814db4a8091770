"""Rigid colliders as the grid sees them: distance and normal at the nodes near them."""

import numpy as np

from .blocks import EDGE, Lattice

# cells from a collider's surface within which its nodes are kept: beyond, none keeps anything apart
# from it, see kernels/contact.py (a node is at most 1.5 deep in what flows, which is met at .25)
REACH = 1.8


class Solids:
    """Distance and outward normal of all colliders together, for the node blocks they can touch.

    nodes: (n, 64, 4) outward normal and distance [m]; whose: (n, 64) the number of the nearest,
    where that is `asked`, else (0, 64). Called with blocks (m, 3) it gives their rows, -1 where
    there is none. Colliders offer distance(points) -> (m,) [m], negative inside, and normal(points)
    -> (m, 3).
    """

    def __init__(self, colliders: list, lattice: Lattice, real: np.dtype, asked: bool = False):
        self._low = -1  # node blocks reach one block beyond the particles'
        self._shape = np.array(lattice.shape) + 2
        grid = np.stack(np.meshgrid(*(np.arange(n) for n in self._shape), indexing="ij"), -1)
        block = grid.reshape(-1, 3) + self._low
        dx = lattice.dx
        centre = (EDGE * block - 1 + (EDGE - 1) / 2) * dx
        half = 0.5 * np.sqrt(3.0) * (EDGE - 1)
        near = np.zeros(len(block), bool)
        for collider in colliders:
            close = collider.distance(centre) < (half + REACH) * dx
            if getattr(collider, "hull", None) is not None:  # it goes on for ever
                low, high = collider.ends()
                beyond = np.maximum(np.maximum(low - centre, centre - high), 0.0)
                close &= (beyond**2).sum(axis=1) < ((half + REACH) * dx) ** 2
            near |= close
        self._row = np.where(near, np.cumsum(near) - 1, -1)
        inside = np.stack(np.meshgrid(*(np.arange(EDGE),) * 3, indexing="ij"), -1).reshape(-1, 3)
        points = (EDGE * block[near][:, None, :] - 1 + inside).reshape(-1, 3) * dx
        self._colliders = colliders
        self.moves = np.zeros((0, 64, 3), real)  # they are at rest
        nodes, whose = self.surface(points)
        self.nodes = nodes.astype(real).reshape(-1, 64, 4)
        self.whose = whose[: len(whose) * asked].reshape(-1, 64)

    def surface(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Outward normal and distance [m] (n, 4) of the nearest collider at points (n, 3) [m], and
        its number (n,)."""
        out, whose = np.full((len(points), 4), np.inf), np.zeros(len(points), np.int64)
        for number, collider in enumerate(self._colliders):
            distance = collider.distance(points)
            closer = distance < out[:, 3]
            out[closer, 3] = distance[closer]
            out[closer, :3] = collider.normal(points[closer])
            whose[closer] = number
        return out, whose

    def __call__(self, block: np.ndarray) -> np.ndarray:
        b = block - self._low
        inside = np.all((b >= 0) & (b < self._shape), axis=1)
        b = np.where(inside[:, None], b, 0)
        flat = (b[:, 0] * self._shape[1] + b[:, 1]) * self._shape[2] + b[:, 2]
        return np.where(inside, self._row[flat], -1)

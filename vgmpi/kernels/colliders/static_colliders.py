"""Static rigid colliders as the grid sees them: distance and normal at nearby nodes."""

import numpy as np

from vgmpi.parallel.block_lattice import BLOCK_EDGE, BlockLattice

# REACH is the distance [cells] from a collider's surface within which nodes are stored. There is no
# contact beyond it (contact_impulses.py): a node is at most 1.5 cells deep in a flowing
# phase, and contact with that begins at 0.25 cells.
SDF_BAND_CELLS = 1.8


class StaticColliders:
    """Distance and outward normal of all colliders together, for the node blocks near them.

    Calling it with blocks (m, 3) returns their rows, -1 for blocks without.

    Attributes:
        nodes: Outward normal and distance [m], shape (n, 64, 4).
        collider_number: Number of the nearest collider, shape (n, 64) if requested, else (0, 64).
    """

    def __init__(
        self, colliders: list, lattice: BlockLattice, real: np.dtype, numbered: bool = False
    ):
        """Evaluate the colliders at the nodes of all blocks near them.

        Args:
            colliders: Objects with distance(points) -> (m,) [m], negative inside, and
                normal(points) -> (m, 3).
            lattice: Lattice of the blocks.
            real: Floating-point type of nodal values.
            numbered: Store the number of the nearest collider.
        """
        self._low = -1  # node blocks extend one block beyond those of particles
        self._shape = np.array(lattice.shape) + 2
        grid = np.stack(np.meshgrid(*(np.arange(n) for n in self._shape), indexing="ij"), -1)
        block = grid.reshape(-1, 3) + self._low
        dx = lattice.dx
        centre = (BLOCK_EDGE * block - 1 + (BLOCK_EDGE - 1) / 2) * dx
        half = 0.5 * np.sqrt(3.0) * (BLOCK_EDGE - 1)
        is_near = np.zeros(len(block), bool)
        for collider in colliders:
            close = collider.distance(centre) < (half + SDF_BAND_CELLS) * dx
            if getattr(collider, "hull", None) is not None:  # its distance function is not bounded
                low, high = collider.ends()
                gap = np.maximum(np.maximum(low - centre, centre - high), 0.0)
                close &= (gap**2).sum(axis=1) < ((half + SDF_BAND_CELLS) * dx) ** 2
            is_near |= close
        self._row = np.where(is_near, np.cumsum(is_near) - 1, -1)
        inside = np.stack(np.meshgrid(*(np.arange(BLOCK_EDGE),) * 3, indexing="ij"), -1).reshape(
            -1, 3
        )
        points = (BLOCK_EDGE * block[is_near][:, None, :] - 1 + inside).reshape(-1, 3) * dx
        self._colliders = colliders
        self.moves = np.zeros((0, 64, 3), real)  # the colliders are at rest
        nodes, collider_number = self.surface(points)
        self.nodes = nodes.astype(real).reshape(-1, 64, 4)
        self.collider_number = collider_number[: len(collider_number) * numbered].reshape(-1, 64)

    def surface(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the nearest collider's outward normal and distance [m], and its number.

        For points (n, 3) [m] the shapes are (n, 4) and (n,).
        """
        out, collider_number = np.full((len(points), 4), np.inf), np.zeros(len(points), np.int64)
        for number, collider in enumerate(self._colliders):
            distance = collider.distance(points)
            closer = distance < out[:, 3]
            out[closer, 3] = distance[closer]
            out[closer, :3] = collider.normal(points[closer])
            collider_number[closer] = number
        return out, collider_number

    def __call__(self, block: np.ndarray) -> np.ndarray:
        """Return the row of each block (m, 3) among those near a collider, else -1."""
        b = block - self._low
        inside = np.all((b >= 0) & (b < self._shape), axis=1)
        b = np.where(inside[:, None], b, 0)
        flat = (b[:, 0] * self._shape[1] + b[:, 1]) * self._shape[2] + b[:, 2]
        return np.where(inside, self._row[flat], -1)

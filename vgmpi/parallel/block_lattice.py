"""Block of a particle and order of the blocks: index arithmetic alone, no MPI.

Nodes are numbered from 0 at the west, south and floor walls; the base node of a particle is floor(x
/ dx - 1/2). Block b holds the base nodes 4 b - 1 to 4 b + 2, so that the ghost node -1, the wall
node 0 and its mirror 1 lie in one block. Positions inside a block are fixed-point integers relative
to its center: x / dx = 4 b + 1.5 + xi 2^-bits.
"""

from typing import NamedTuple

import numpy as np

from vgmpi.runtime.jit import kernel

BLOCK_EDGE = 4  # [nodes] per block and axis
BLOCK_CENTER = 1.5  # [cells] from the wall to the center of block 0
# fractional bits of a fixed-point position, and its integer type, by precision
BITS: dict[np.dtype, int] = {np.dtype(np.float32): 29, np.dtype(np.float64): 52}
INTEGER: dict[np.dtype, np.dtype] = {
    np.dtype(np.float32): np.dtype(np.int32),
    np.dtype(np.float64): np.dtype(np.int64),
}


class BlockLattice(NamedTuple):
    """Lattice of all blocks of a domain."""

    cells: tuple[int, int, int]
    dx: float  # [m]

    @property
    def shape(self) -> tuple[int, int, int]:
        """Number of blocks along each axis; base nodes run from -1 to cells - 1."""
        x, y, z = self.cells
        return x // BLOCK_EDGE + 1, y // BLOCK_EDGE + 1, z // BLOCK_EDGE + 1

    @property
    def levels(self) -> int:
        """Bits per axis of the Hilbert curve through all blocks."""
        return max(1, int(max(self.shape) - 1).bit_length())

    def code(self, block: np.ndarray) -> np.ndarray:
        """Return one number per block, (n, 3) -> (n,) int64.

        Unlike the Hilbert key it is cheap to invert.
        """
        _, ny, nz = self.shape
        return (block[:, 0].astype(np.int64) * ny + block[:, 1]) * nz + block[:, 2]

    def block(self, code: np.ndarray) -> np.ndarray:
        """Return the block of each code, the inverse of `code`, shape (n, 3) int64."""
        _, ny, nz = self.shape
        return np.stack([code // (ny * nz), code // nz % ny, code % nz], 1)

    def key(self, block: np.ndarray) -> np.ndarray:
        """Return the place of each block (n, 3) on the Hilbert curve."""
        return hilbert_index(block, self.levels)

    def place(self, x: np.ndarray, real: np.dtype) -> tuple[np.ndarray, np.ndarray]:
        """Return the blocks (n, 3) and fixed-point positions (3, n) of positions x (n, 3) [m]."""
        bits = BITS[np.dtype(real)]
        s = x / self.dx - 0.5
        block = np.floor((s + 1.0) / BLOCK_EDGE).astype(np.int64)
        inside = np.rint(np.ldexp(x / self.dx - BLOCK_CENTER - BLOCK_EDGE * block, bits)).astype(
            np.int64
        )
        # Rounding may reach the first position of the next block.
        over = inside >= 2 << bits
        block += over
        inside -= over * (4 << bits)
        return block, np.ascontiguousarray(inside.T).astype(INTEGER[np.dtype(real)])

    def position(self, block: np.ndarray, xi: np.ndarray, real: np.dtype) -> np.ndarray:
        """Return the positions of fixed-point positions in blocks, shape (n, 3) float64 [m].

        Args:
            block: Block of each particle, shape (n, 3).
            xi: Fixed-point positions, shape (3, n).
            real: Floating-point type of the particles; it sets the number of bits.
        """
        bits = BITS[np.dtype(real)]
        return (
            np.ldexp(xi.T.astype(np.float64), -bits) + (BLOCK_EDGE * block + BLOCK_CENTER)
        ) * self.dx


@kernel
def hilbert_index(points, levels):
    """Return the Hilbert index of points (n, 3) with `levels` bits per axis, shape (n,) int64.

    References:
        Skilling 2004.
    """
    out, x = np.zeros(len(points), np.int64), np.zeros(3, np.int64)
    for n in range(len(points)):
        for a in range(3):
            x[a] = points[n, a]
        for level in range(levels - 1, 0, -1):
            low = (1 << level) - 1  # mask of the lower bits
            for a in range(3):
                if x[a] >> level & 1:
                    x[0] ^= low
                else:
                    swap = (x[0] ^ x[a]) & low
                    x[0] ^= swap
                    x[a] ^= swap
        x[1] ^= x[0]
        x[2] ^= x[1]
        turn = 0
        for level in range(levels - 1, 0, -1):
            if x[2] >> level & 1:
                turn ^= (1 << level) - 1
        for level in range(levels - 1, -1, -1):
            for a in range(3):
                out[n] = out[n] << 1 | ((x[a] ^ turn) >> level & 1)
    return out


def position_limits(block: np.ndarray, cells: tuple[int, int, int]) -> np.ndarray:
    """Return position limits [cells from block center], half a cell beyond walls, (n, 3, 2)."""
    low = -2.0 - BLOCK_EDGE * block
    high = np.array(cells) - 1.0 - BLOCK_EDGE * block
    return np.stack([np.maximum(low, -5.0), np.minimum(high, 5.0)], -1)

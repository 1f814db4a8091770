"""Which block a particle lies in, and the order of blocks: index maths alone, no MPI.

Nodes are numbered from 0 at the west, south and floor walls; a particle's base node is floor(x / dx
- 1/2). Block b holds the base nodes 4 b - 1 .. 4 b + 2, so that the ghost node -1, the wall node 0
and its mirror 1 lie in one block. Positions inside a block are fixed-point integers relative to its
middle: x / dx = 4 b + 1.5 + xi 2^-bits.
"""

from typing import NamedTuple

import numpy as np

from ..device.jit import kernel

EDGE = 4  # nodes of a block along an axis
MIDDLE = 1.5  # of block 0, in cells from the wall
BITS: dict[np.dtype, int] = {np.dtype(np.float32): 29, np.dtype(np.float64): 52}
INTEGER: dict[np.dtype, np.dtype] = {
    np.dtype(np.float32): np.dtype(np.int32),
    np.dtype(np.float64): np.dtype(np.int64),
}


class Lattice(NamedTuple):
    """The blocks of a domain."""

    cells: tuple[int, int, int]
    dx: float  # [m]

    @property
    def shape(self) -> tuple[int, int, int]:
        """Blocks along each axis; base nodes run from -1 to cells - 1."""
        x, y, z = self.cells
        return x // EDGE + 1, y // EDGE + 1, z // EDGE + 1

    @property
    def levels(self) -> int:
        """Bits per axis of the Hilbert curve through all blocks."""
        return max(1, int(max(self.shape) - 1).bit_length())

    def code(self, block: np.ndarray) -> np.ndarray:
        """One number per block (n, 3) -> (n,) int64; unlike the Hilbert key it is cheap to take
        apart.
        """
        _, ny, nz = self.shape
        return (block[:, 0].astype(np.int64) * ny + block[:, 1]) * nz + block[:, 2]

    def block(self, code: np.ndarray) -> np.ndarray:
        """Inverse of `code`: (n, 3) int64."""
        _, ny, nz = self.shape
        return np.stack([code // (ny * nz), code // nz % ny, code % nz], 1)

    def key(self, block: np.ndarray) -> np.ndarray:
        """Place of each block (n, 3) on the Hilbert curve."""
        return hilbert(block, self.levels)

    def place(self, x: np.ndarray, real: np.dtype) -> tuple[np.ndarray, np.ndarray]:
        """Blocks (n, 3) and fixed-point positions (3, n) of positions x (n, 3) [m]."""
        bits = BITS[np.dtype(real)]
        s = x / self.dx - 0.5
        block = np.floor((s + 1.0) / EDGE).astype(np.int64)
        inside = np.rint(np.ldexp(x / self.dx - MIDDLE - EDGE * block, bits)).astype(np.int64)
        # rounding may land on the next block's first position
        over = inside >= 2 << bits
        block += over
        inside -= over * (4 << bits)
        return block, np.ascontiguousarray(inside.T).astype(INTEGER[np.dtype(real)])

    def position(self, block: np.ndarray, xi: np.ndarray, real: np.dtype) -> np.ndarray:
        """Positions (n, 3) [m], float64, of fixed-point positions xi (3, n) in blocks (n, 3)."""
        bits = BITS[np.dtype(real)]
        return (np.ldexp(xi.T.astype(np.float64), -bits) + (EDGE * block + MIDDLE)) * self.dx


@kernel
def hilbert(points, levels):
    """Hilbert index of points (n, 3) with `levels` bits per axis (Skilling 2004): (n,) int64."""
    out, x = np.zeros(len(points), np.int64), np.zeros(3, np.int64)
    for n in range(len(points)):
        for a in range(3):
            x[a] = points[n, a]
        for level in range(levels - 1, 0, -1):
            low = (1 << level) - 1  # the bits below
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

"""Diffusion of colors between Gaussians through a background grid, as velocities in PIC.

    c_i = sum_p w_ip V_p c_p / sum_p w_ip V_p,     (S c)_p = sum_i w_ip c_i

with quadratic B-splines w of cells of size dx and volumes V_p. One transfer S conserves
sum_p V_p c_p. It mixes over a cell in any time step: applied every step it would be a diffusion of
0.25 dx2 / dt. `relax` follows dc/dt = (S c - c) / T instead, whose diffusion is 0.25 dx2 / T.

Sums run over the particles in their order. Sorted by id, as in a run's frames, they do not depend
on the distribution of the run over ranks.
"""

import math

import numpy as np

from vgmpi.runtime.compile_cache import njit_cached

EDGE = 4  # [nodes] edge of a block of nodes
MAX_RELAXATION = 100.0  # [T] longest time in one call of `relax`, whose work grows with it
_CUT = 1e-7  # [-] total weight of the terms of `relax` that may be dropped


class Transfer:
    """Operator S for particles at fixed positions.

    Args:
        x: Positions, shape (n, 3) [m].
        volume: Volumes, shape (n,) [m3], >= 0.
        dx: Cell size [m].
    """

    def __init__(self, x: np.ndarray, volume: np.ndarray, dx: float):
        position = np.asarray(x, dtype=np.float64) / dx
        base = np.floor(position - 0.5)  # lowest of the three nodes along each axis
        self._offset = position - base  # [cells] of the particle from that node, 0.5 .. 1.5
        node = base.astype(np.int64)
        self._local = node & (EDGE - 1)
        self._own, self._neighbor_blocks, blocks = _blocks(node // EDGE)
        self._volume = np.ascontiguousarray(volume, dtype=np.float64)
        self._mass = np.zeros(EDGE**3 * blocks)
        _scatter(*self._stencil(), self._volume, np.ones((len(position), 1)), self._mass[:, None])

    def _stencil(self):
        """Return the stencil arguments of the compiled functions."""
        return self._own, self._neighbor_blocks, self._local, self._offset

    def smoothed(self, c: np.ndarray) -> np.ndarray:
        """Return S c for c (n, m) as float64 (n, m)."""
        first, c = _shifted(c)
        return first + self._apply(c)

    def relax(self, c: np.ndarray, age: float) -> np.ndarray:
        """Return the colors (n, m) after a time of `age` T: exp(age (S - 1)) c.

        The age is at most MAX_RELAXATION. The result is a mean of S^k c with the weights of
        Poisson's distribution: every weight is positive, so that no color leaves the range of the
        others, and each term conserves sum V c.

        Raises:
            ValueError: If age is out of range.
        """
        if not 0 <= age <= MAX_RELAXATION:
            raise ValueError(f"age is {age}: allowed is 0 .. {MAX_RELAXATION:g}")
        first, c = _shifted(c)
        weight, k = math.exp(-age), 0
        remaining = 1.0 - weight
        out = weight * c
        while remaining > _CUT:
            k += 1
            c = self._apply(c)
            weight *= age / k
            remaining -= weight
            # the last term gets the remaining weight, so that the weights add up to 1
            out += (weight if remaining > _CUT else weight + remaining) * c
        if k == 0:
            out += remaining * c
        return first + out

    def _apply(self, c: np.ndarray) -> np.ndarray:
        """Apply S once to shifted colors."""
        sums = np.zeros((len(self._mass), c.shape[1]))
        _scatter(*self._stencil(), self._volume, c, sums)
        has_volume = self._mass > 0
        sums[has_volume] /= self._mass[has_volume, None]
        out = np.empty_like(c)
        _gather(*self._stencil(), has_volume, sums, c, out)
        return out


def _shifted(c: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the first row of c (n, m), and c minus it, so that equal colors stay exactly so."""
    c = np.asarray(c, dtype=np.float64)
    first = c[:1].copy()
    return first, np.ascontiguousarray(c - first)


def _blocks(block: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
    """Number the blocks of nodes that are needed.

    Args:
        block: Block of each particle's lowest node, shape (n, 3).

    Returns:
        Row of each particle in the next array, shape (n,); numbers of the 8 upper neighbor blocks,
        z fastest, shape (blocks of particles, 8); and the number of blocks.
    """
    low = block.min(axis=0, initial=0)
    size = block.max(axis=0, initial=0) - low + 2

    def code(b):
        """Return the linear index of a block."""
        return (b[..., 0] * size[1] + b[..., 1]) * size[2] + b[..., 2]

    particle_codes, own = np.unique(code(block - low), return_inverse=True)
    corner = np.stack(np.unravel_index(particle_codes, size), axis=-1)
    steps = np.indices((2, 2, 2)).reshape(3, 8).T
    corner_codes = code(corner[:, None, :] + steps)
    block_codes, neighbor_blocks = np.unique(corner_codes, return_inverse=True)
    return own.reshape(-1), np.ascontiguousarray(neighbor_blocks.reshape(-1, 8)), len(block_codes)


@njit_cached(error_model="numpy")
def _weights(offset, w):
    """Write the quadratic B-splines at the three nodes along each axis to w (3, 3)."""
    for a in range(3):
        d = offset[a]
        w[a, 0] = 0.5 * (1.5 - d) * (1.5 - d)
        w[a, 1] = 0.75 - (d - 1.0) * (d - 1.0)
        w[a, 2] = 0.5 * (d - 0.5) * (d - 0.5)


@njit_cached(error_model="numpy")
def _node(neighbor_blocks, own, i, j, k):
    """Return the row of the node at i, j, k from the lowest node of a particle's block."""
    corner = ((i >> 2) * 2 + (j >> 2)) * 2 + (k >> 2)
    return neighbor_blocks[own, corner] * 64 + ((i & 3) * 4 + (j & 3)) * 4 + (k & 3)


@njit_cached(error_model="numpy")
def _scatter(own, neighbor_blocks, local, offset, volume, c, sums):
    """Scatter particles to nodes, particle after particle: sums[i] += w_ip V_p c_p."""
    w = np.empty((3, 3))
    for p in range(len(own)):
        _weights(offset[p], w)
        for i in range(3):
            for j in range(3):
                for k in range(3):
                    weight = w[0, i] * w[1, j] * w[2, k] * volume[p]
                    node = _node(
                        neighbor_blocks, own[p], local[p, 0] + i, local[p, 1] + j, local[p, 2] + k
                    )
                    for m in range(c.shape[1]):
                        sums[node, m] += weight * c[p, m]


@njit_cached(error_model="numpy")
def _gather(own, neighbor_blocks, local, offset, has_volume, nodes, c, out):
    """Gather nodes to particles: out_p = sum_i w_ip nodes_i; c_p replaces nodes without volume."""
    w = np.empty((3, 3))
    for p in range(len(own)):
        _weights(offset[p], w)
        for m in range(c.shape[1]):
            out[p, m] = 0.0
        for i in range(3):
            for j in range(3):
                for k in range(3):
                    weight = w[0, i] * w[1, j] * w[2, k]
                    node = _node(
                        neighbor_blocks, own[p], local[p, 0] + i, local[p, 1] + j, local[p, 2] + k
                    )
                    for m in range(c.shape[1]):
                        out[p, m] += weight * (nodes[node, m] if has_volume[node] else c[p, m])

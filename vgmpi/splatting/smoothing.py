"""Colour that travels between Gaussians through a grid, as velocities do in PIC.

    c_i = sum_p w_ip V_p c_p / sum_p w_ip V_p,     (S c)_p = sum_i w_ip c_i

with quadratic B-splines w of cells of size dx and volumes V_p. One transfer S keeps sum_p V_p c_p:
what nodes get is what particles give. It mixes over a cell, whatever the time that has passed: done
every step it would be a diffusion of 0.25 dx2 / dt. `relaxed` follows dc/dt = (S c - c) / T
instead, whose diffusion is 0.25 dx2 / T.

Sums run over the particles in the order they are given. Sorted by id, as in a run's frames, they do
not depend on how the run was shared among ranks.
"""

import math

import numpy as np

from vgmpi.caching import cached

EDGE = 4  # nodes along the edge of a block of nodes
MOST_AGE = 100.0  # times T in one call of `relaxed`: the work grows with it
_CUT = 1e-7  # of the weights of `relaxed` that may be left away


class Transfer:
    """S for particles where they are: x (n, 3) [m], volume (n,) [m3] >= 0, dx [m]."""

    def __init__(self, x: np.ndarray, volume: np.ndarray, dx: float):
        at = np.asarray(x, dtype=np.float64) / dx
        base = np.floor(at - 0.5)  # the lowest of the three nodes along each axis
        self._offset = at - base  # of the particle from it [cells], 0.5 .. 1.5
        node = base.astype(np.int64)
        self._local = node & (EDGE - 1)
        self._own, self._around, blocks = _blocks(node // EDGE)
        self._volume = np.ascontiguousarray(volume, dtype=np.float64)
        self._mass = np.zeros(EDGE**3 * blocks)
        _collect(*self._place(), self._volume, np.ones((len(at), 1)), self._mass[:, None])

    def _place(self):
        return self._own, self._around, self._local, self._offset

    def smoothed(self, c: np.ndarray) -> np.ndarray:
        """S c for c (n, m): float64 (n, m)."""
        first, c = _shifted(c)
        return first + self._once(c)

    def relaxed(self, c: np.ndarray, age: float) -> np.ndarray:
        """Colours (n, m) after a time of `age` T, at most MOST_AGE: exp(age (S - 1)) c.

        As a mean of S^k c with the weights of Poisson's distribution: every weight is positive, so
        that no colour leaves the range of the others, and each term keeps sum V c.
        """
        if not 0 <= age <= MOST_AGE:
            raise ValueError(f"age is {age}: allowed is 0 .. {MOST_AGE:g}")
        first, c = _shifted(c)
        weight, k = math.exp(-age), 0
        left = 1.0 - weight
        out = weight * c
        while left > _CUT:
            k += 1
            c = self._once(c)
            weight *= age / k
            left -= weight
            # the last term takes what is left, so that the weights add up to 1
            out += (weight if left > _CUT else weight + left) * c
        if k == 0:
            out += left * c
        return first + out

    def _once(self, c: np.ndarray) -> np.ndarray:
        sums = np.zeros((len(self._mass), c.shape[1]))
        _collect(*self._place(), self._volume, c, sums)
        full = self._mass > 0
        sums[full] /= self._mass[full, None]
        out = np.empty_like(c)
        _spread(*self._place(), full, sums, c, out)
        return out


def _shifted(c: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The first row of c (n, m), and all rows without it: equal colours then stay exactly so."""
    c = np.asarray(c, dtype=np.float64)
    first = c[:1].copy()
    return first, np.ascontiguousarray(c - first)


def _blocks(block: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
    """Numbers for the blocks of nodes that are needed, and no others.

    block: (n, 3) block of each particle's lowest node. Returns own (n,), the row of `around`;
    around (blocks of particles, 8): numbers of the blocks beside, z fastest; how many there are.
    """
    low = block.min(axis=0, initial=0)
    size = block.max(axis=0, initial=0) - low + 2

    def code(b):
        return (b[..., 0] * size[1] + b[..., 1]) * size[2] + b[..., 2]

    mine, own = np.unique(code(block - low), return_inverse=True)
    corner = np.stack(np.unravel_index(mine, size), axis=-1)
    steps = np.indices((2, 2, 2)).reshape(3, 8).T
    beside = code(corner[:, None, :] + steps)
    known, around = np.unique(beside, return_inverse=True)
    return own.reshape(-1), np.ascontiguousarray(around.reshape(-1, 8)), len(known)


@cached(error_model="numpy")
def _weights(offset, w):
    """Quadratic B-splines at the three nodes along each axis, into w (3, 3)."""
    for a in range(3):
        d = offset[a]
        w[a, 0] = 0.5 * (1.5 - d) * (1.5 - d)
        w[a, 1] = 0.75 - (d - 1.0) * (d - 1.0)
        w[a, 2] = 0.5 * (d - 0.5) * (d - 0.5)


@cached(error_model="numpy")
def _node(around, own, i, j, k):
    """Row of the node i, j, k from the lowest node of the block of a particle."""
    beside = ((i >> 2) * 2 + (j >> 2)) * 2 + (k >> 2)
    return around[own, beside] * 64 + ((i & 3) * 4 + (j & 3)) * 4 + (k & 3)


@cached(error_model="numpy")
def _collect(own, around, local, offset, volume, c, sums):
    """sums[i] += w_ip V_p c_p, particle after particle."""
    w = np.empty((3, 3))
    for p in range(len(own)):
        _weights(offset[p], w)
        for i in range(3):
            for j in range(3):
                for k in range(3):
                    share = w[0, i] * w[1, j] * w[2, k] * volume[p]
                    node = _node(around, own[p], local[p, 0] + i, local[p, 1] + j, local[p, 2] + k)
                    for m in range(c.shape[1]):
                        sums[node, m] += share * c[p, m]


@cached(error_model="numpy")
def _spread(own, around, local, offset, full, nodes, c, out):
    """out_p = sum_i w_ip nodes_i; where a node has no volume c_p stands for it."""
    w = np.empty((3, 3))
    for p in range(len(own)):
        _weights(offset[p], w)
        for m in range(c.shape[1]):
            out[p, m] = 0.0
        for i in range(3):
            for j in range(3):
                for k in range(3):
                    share = w[0, i] * w[1, j] * w[2, k]
                    node = _node(around, own[p], local[p, 0] + i, local[p, 1] + j, local[p, 2] + k)
                    for m in range(c.shape[1]):
                        out[p, m] += share * (nodes[node, m] if full[node] else c[p, m])

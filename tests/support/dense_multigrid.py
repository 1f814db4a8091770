"""Multigrid conjugate gradients of the implicit pressure in NumPy, on dense grids of a domain.

The twin of vgmpi/features/implicit_pressure/pressure_solver.py. Arrays of cells have the shape m,
those of nodes m + 1 along each axis; the first cell is one before the domain.
"""

import itertools
from typing import NamedTuple

import numpy as np

CORNERS = list(itertools.product((0, 1), repeat=3))
MAX_EIGENVALUE, RESPONSE_QUANTA, MAX_RESPONSE, REST_BITS = 8 / 3, 2.0**30, 64.0, 40


def _at(corner, shape):
    return tuple(slice(c, c + n) for c, n in zip(corner, shape, strict=True))


def push(phi):
    """D^T: potentials of cells -> nodes, shape (3, ...)."""
    padded, shape = np.pad(phi, 1), np.array(phi.shape) + 1
    out = np.zeros((3, *shape))
    for corner in CORNERS:
        for a in range(3):
            out[a] += 0.25 * (1 - 2 * corner[a]) * padded[_at(corner, shape)]
    return out


def divergence(u):
    """D: nodes (3, ...) -> cells."""
    shape = np.array(u.shape[1:]) - 1
    return sum(
        0.25 * (2 * corner[a] - 1) * u[a][_at(corner, shape)]
        for corner in CORNERS
        for a in range(3)
    )


class Level(NamedTuple):
    """Responses of nodes and cells with pressure."""

    response: np.ndarray  # (3, nodes)
    wet: np.ndarray  # (cells)

    @property
    def scale(self):
        """Inverse diagonal."""
        total = self.response.sum(0)
        share = sum(total[_at(corner, self.wet.shape)] for corner in CORNERS) / 16
        holds = self.wet & (share > 0)
        return np.where(holds, 1 / np.where(holds, share, 1), 0.0)

    def times(self, phi):
        """Product of the system's matrix and a potential."""
        return divergence(self.response * push(phi)) * (self.scale > 0)

    def sweep(self, right, phi, number, least):
        """Chebyshev sweeps from phi on."""
        middle, half = 0.5 * (MAX_EIGENVALUE + least), 0.5 * (MAX_EIGENVALUE - least)
        rho, weight, inertia, step = half / middle, 1 / middle, 0.0, 0.0
        for _ in range(number):
            step = weight * self.scale * (right - self.times(phi)) + inertia * step
            phi = phi + step
            following = 1 / (2 * middle / half - rho)
            weight, inertia, rho = 2 * following / half, following * rho, following
        return phi


def _coarsened(level, limit):
    shape = [(n + 1) // 2 for n in level.wet.shape]
    wet = np.pad(level.wet, [(0, 2 * c - n) for c, n in zip(shape, level.wet.shape, strict=True)])
    wet = wet.reshape(shape[0], 2, shape[1], 2, shape[2], 2).any((1, 3, 5))
    quanta = np.floor(np.minimum(level.response, limit) * RESPONSE_QUANTA + 0.5)
    quanta = np.concatenate([quanta, (quanta.sum(0) > 0)[None]])
    quanta = np.pad(quanta, [(0, 0), *((1, 3),) * 3])
    sums = np.zeros((4, *(c + 1 for c in shape)))
    for near in itertools.product(range(3), repeat=3):
        part = tuple(slice(p, p + 2 * c + 1, 2) for p, c in zip(near, shape, strict=True))
        sums += np.prod([1 + (p == 1) for p in near]) * quanta[(slice(None), *part)]
    response = 2 * sums[:3] / (np.maximum(sums[3], 1) * RESPONSE_QUANTA)
    for a, c in enumerate(shape):
        np.moveaxis(response[a], a, 0)[[0, c]] = 0
    return Level(response, wet)


def _interpolation(n):
    """Matrix (n, coarse cells) along an axis."""
    coarse = (n + 1) // 2
    out = np.zeros((n, coarse))
    for i in range(n):
        other = i // 2 + (1 if i % 2 else -1)
        out[i, i // 2] += 0.75
        out[i, other if 0 <= other < coarse else i // 2] += 0.25
    return out


def _along_axes(values, matrices):
    return np.einsum("xa,yb,zc,abc->xyz", *matrices, values)


class Multigrid:
    """Levels above a system, down to one of 4 cells along each axis."""

    def __init__(self, level):
        self.levels, limit = [level], MAX_RESPONSE
        while len(self.levels) == 1 or max(self.levels[-1].wet.shape) > 4:
            self.levels.append(_coarsened(self.levels[-1], limit))
            limit = np.inf

    def cycle(self, right, quantum=0.0, number=0):
        """Approximate solution for a right-hand side."""
        level, zero = self.levels[number], np.zeros_like(right)
        if number == len(self.levels) - 1:
            return level.sweep(right, zero, 16, 0.02)
        phi = level.sweep(right, zero, 3, 0.3)
        rest = (right - level.times(phi)) * (level.scale > 0)
        if quantum:
            rest = quantum * np.floor(rest / quantum + 0.5)
        matrices = [_interpolation(n) for n in right.shape]
        coarse = _along_axes(rest, [m.T for m in matrices])
        coarse *= self.levels[number + 1].scale > 0
        change = self.cycle(coarse, quantum, number + 1)
        phi = phi + _along_axes(change, matrices) * (level.scale > 0)
        return level.sweep(right, phi, 3, 0.3)


def conjugate_gradients(level, right, phi, iterations=4):
    """Potential after some iterations from phi on."""
    multigrid, residual = Multigrid(level), right - level.times(phi)
    quantum = 2.0 ** (np.ceil(np.log2(np.abs(residual).max())) - REST_BITS)
    direction, before = 0.0, np.inf
    for _ in range(iterations):
        correction = multigrid.cycle(residual, quantum)
        now = (residual * correction).sum()
        direction = correction + now / before * direction
        product, before = level.times(direction), now
        length = now / (direction * product).sum()
        phi, residual = phi + length * direction, residual - length * product
    return phi


def dense_values(solver, values, size, axes=1):
    """Numbers of the blocks on the grid of the domain, from one cell before it on."""
    shape = [n + size for n in solver.domain[0]]
    grid = np.zeros((axes, *shape))
    values = values.reshape(-1, axes, 64)[: solver.count]
    offsets = np.stack(np.unravel_index(np.arange(64), (4, 4, 4)), 1)
    index = 4 * solver.lattice.block[:, None] + offsets
    inside = ((index >= 0) & (index < shape)).all(2)
    for a in range(axes):
        grid[a][tuple(index[inside].T)] = values[:, a][inside]
    return grid if axes > 1 else grid[0]

"""Dilatation of liquids by the means of cells, in plain NumPy (kernels/cell_stencil_sums.py)."""

import numpy as np

from .dense_grid import Stencil


def sum_cell_pressure(out: np.ndarray, stencil: Stencil, tau: np.ndarray) -> np.ndarray:
    """Subtract the impulses of the mean stress from a field; return the deviatoric stress.

    Args:
        out (in/out): Field of impulses, shape (..., 3).
        stencil: Stencil of the particles.
        tau: Volume times stress times time, shape (n, 3, 3).
    """
    mean = np.trace(tau, axis1=1, axis2=2) / 3.0
    for index, gradient in stencil.by_cells():
        np.add.at(out, index, -mean[:, None] * gradient)
    return tau - mean[:, None, None] * np.eye(3)


def cell_divergence(field: np.ndarray, stencil: Stencil) -> np.ndarray:
    """Return the mean divergence of the cells around each particle, interpolated, shape (n,).

    Args:
        field: Vectors at the nodes, shape (..., 3).
        stencil: Stencil of the particles.
    """
    return np.sum([(field[index] * gradient).sum(1) for index, gradient in stencil.by_cells()], 0)


def with_divergence(L: np.ndarray, divergence: np.ndarray) -> np.ndarray:
    """Return velocity gradients (n, 3, 3) with another trace (n,), equal along the axes."""
    added = (divergence - np.trace(L, axis1=1, axis2=2)) / 3.0
    return L + added[:, None, None] * np.eye(3)

"""Volume of liquids, in plain NumPy: density correction, divergence of cells, and spray.

See docs/explanation/transfer-schemes.md.
"""

import numpy as np

from vgmpi.kernels.transfer.liquid_volume import (
    CORRECTION_RATE,
    FULL_FILL,
    FULL_RESPONSE_FILL,
    LEAST_RESPONSE,
    LEAST_RESPONSE_FILL,
    MIN_FILL,
    SURFACE_SLOPE,
)

from .dense_grid import Dense, Stencil


def density_corrected_gradient(
    dense: Dense, mass: np.ndarray, stencil: Stencil, space: float, J: np.ndarray, L: np.ndarray
) -> np.ndarray:
    """Return velocity gradients with the density correction, shape (n, 3, 3) [1/s].

    Crowded particles shrink, and particles with free space inside the fluid swell, by the
    difference of the mass of a cell and the particle's J.

    Args:
        dense: Background grid.
        mass: Nodal masses [kg].
        stencil: Stencil of the particles.
        space: 1 / mass of a full cell at rest [1/kg].
        J: Volume ratio, shape (n,).
        L: Velocity gradients, shape (n, 3, 3) [1/s].
    """
    mass = dense.complete_wall_mass(mass)
    crowd = space * dense.gather(mass, stencil)[:, 0]
    slope = dense.gather_slopes(mass, stencil)[:, 0]
    surface_slope = SURFACE_SLOPE * space * dense.dx * np.linalg.norm(slope, axis=1)
    excess = crowd * J - 1.0
    inner = np.clip((crowd - MIN_FILL) / (FULL_FILL - MIN_FILL), 0.0, 1.0)
    error = np.maximum(excess, 0.0) + inner * np.minimum(excess + surface_slope, 0.0)
    return L - (CORRECTION_RATE / 3.0 * error)[:, None, None] * np.eye(3)


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


def without_spray_divergence(L: np.ndarray, fill_fraction: np.ndarray) -> np.ndarray:
    """Return velocity gradients without the divergence that is withheld, shape (n, 3, 3) [1/s].

    Args:
        L: Velocity gradients, shape (n, 3, 3) [1/s].
        fill_fraction: Filled fraction of the space around each particle, shape (n,).
    """
    fills = LEAST_RESPONSE_FILL, FULL_RESPONSE_FILL
    response = np.interp(fill_fraction, fills, (LEAST_RESPONSE, 1.0))
    divergence = np.trace(L, axis1=1, axis2=2)
    return L - ((1.0 - response) * divergence / 3.0)[:, None, None] * np.eye(3)

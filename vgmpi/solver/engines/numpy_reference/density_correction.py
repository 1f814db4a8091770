"""Density correction of liquids, in plain NumPy; see docs/explanation/transfer-schemes.md."""

import numpy as np

from vgmpi.kernels.transfer.liquid_volume import (
    CORRECTION_RATE,
    FULL_FILL,
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

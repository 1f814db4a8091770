"""Divergence that the equation of state of sparse liquid receives (kernels/transfer/)."""

import numpy as np

from vgmpi.kernels.transfer.liquid_volume import (
    FULL_RESPONSE_FILL,
    LEAST_RESPONSE,
    LEAST_RESPONSE_FILL,
)


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

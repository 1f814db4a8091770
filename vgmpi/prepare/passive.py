"""Gaussians without mass: which particles carry each of them, and with what weight."""

import numpy as np
from scipy.spatial import cKDTree

CARRIERS = 4  # particles that carry a passive Gaussian: as many as span a tetrahedron


def bound(x: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows of `x` that carry each point (p, 4) int64, and their weights (p, 4), which sum to 1.

    x (n, 3), points (p, 3) [m] at rest. The nearest particles count with (1 - d / d5)^2 / d, d5
    being the distance of the first that does not count: no jump where the nearest ones change
    (Franke and Nielson 1980). With fewer particles than carriers the last one is repeated without
    weight.
    """
    near = min(CARRIERS + 1, len(x))
    away, rows = cKDTree(x).query(points, k=np.arange(1, near + 1))
    reach = away[:, -1:] if near > CARRIERS else 2.0 * away[:, -1:] + 1e-300
    some = np.maximum(away, 1e-9 * reach + 1e-300)
    weight = (np.maximum(1.0 - away / np.maximum(reach, 1e-300), 0.0) ** 2 / some)[:, :CARRIERS]
    weight[weight.sum(axis=1) <= 0] = 1.0  # all equally far away
    weight /= weight.sum(axis=1, keepdims=True)
    lacking = CARRIERS - weight.shape[1]
    if lacking > 0:
        weight = np.pad(weight, ((0, 0), (0, lacking)))
        rows = np.pad(rows, ((0, 0), (0, lacking)), mode="edge")
    return rows[:, :CARRIERS].astype(np.int64), weight

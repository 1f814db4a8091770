"""Passive Gaussians: the particles that carry each of them, with weights."""

import numpy as np
import scipy

CARRIERS = 4  # particles that carry a passive Gaussian; they span a tetrahedron


def bind_passive(x: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return rows of `x` that carry each point (p, 4) int64, and their weights (p, 4).

    Weights sum to 1. x (n, 3), points (p, 3) [m] at rest. The nearest particles count with (1 - d /
    d5)^2 / d, d5 being the distance of the first that does not count: no jump where the nearest
    ones change (Franke and Nielson 1980). With fewer particles than carriers the last one is
    repeated without weight.
    """
    count = min(CARRIERS + 1, len(x))
    distance, rows = scipy.spatial.cKDTree(x).query(points, k=np.arange(1, count + 1))
    radius = distance[:, -1:] if count > CARRIERS else 2.0 * distance[:, -1:] + 1e-300
    safe_distance = np.maximum(distance, 1e-9 * radius + 1e-300)
    weight = (np.maximum(1.0 - distance / np.maximum(radius, 1e-300), 0.0) ** 2 / safe_distance)[
        :, :CARRIERS
    ]
    weight[weight.sum(axis=1) <= 0] = 1.0  # all equally far away
    weight /= weight.sum(axis=1, keepdims=True)
    missing = CARRIERS - weight.shape[1]
    if missing > 0:
        weight = np.pad(weight, ((0, 0), (0, missing)))
        rows = np.pad(rows, ((0, 0), (0, missing)), mode="edge")
    return rows[:, :CARRIERS].astype(np.int64), weight

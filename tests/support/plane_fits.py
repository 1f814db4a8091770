"""Values of particles at points of a vertical plane, for slabs of a few cells."""

import numpy as np


def values_at(
    x: np.ndarray, values: np.ndarray, points: list[tuple[float, float]], dx: float
) -> np.ndarray:
    """Return values (n, k) at points (n, 2): planes through the particles within a cell.

    Args:
        x: Positions of the particles, shape (m, 3) [m].
        values: Their values, shape (m, k).
        points: Points (x, z) [m].
        dx: Cell size [m].
    """
    found = []
    for point in points:
        away = x[:, ::2] - point
        weight = np.sqrt(np.prod(np.maximum(0, 1 - np.abs(away) / dx), 1))
        near = weight > 0
        matrix = np.column_stack([np.ones(near.sum()), away[near]]) * weight[near, None]
        found.append(np.linalg.lstsq(matrix, values[near] * weight[near, None], rcond=None)[0][0])
    return np.array(found)

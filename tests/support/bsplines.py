"""Quadratic B-spline from its definition, beside which transfers are tested."""

import numpy as np


def quadratic_bspline(distance):
    """Values at distances from the middle [cells], of any shape."""
    d = np.abs(distance)
    return np.where(d < 0.5, 0.75 - d * d, np.where(d < 1.5, 0.5 * (1.5 - d) ** 2, 0.0))

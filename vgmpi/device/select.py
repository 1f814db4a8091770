"""Choice between two values by a condition, for every engine."""

import numpy as np


def select(mask, a, b):
    """a where `mask` holds, b elsewhere; both are evaluated.

    `mask` is a comparison, or comparisons joined by & and |; its opposite is np.logical_not(mask),
    since ~ of Python's own True is a number. One of a and b should be the particle's: of two plain
    numbers comes a double. np.where would hand back an array for single numbers, which compiled
    code has to allocate.
    """
    return np.where(mask, a, b)[()]

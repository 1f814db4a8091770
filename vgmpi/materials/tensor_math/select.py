"""Elementwise choice between two values by a condition, for every engine."""

import numpy as np


def select(mask, a, b):
    """Return a where `mask` holds and b elsewhere; both are evaluated.

    np.where would return an array for single numbers, which compiled code has to allocate.

    Args:
        mask: A comparison, or comparisons joined by & and |. Its opposite is np.logical_not(mask),
            since ~ of Python's own True is a number.
        a, b: Values, at least one of them the particle's: two plain numbers would give a double.
    """
    return np.where(mask, a, b)[()]

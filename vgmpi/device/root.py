"""The cube root of a double with the same bits on every machine: a library's need not have."""

import numpy as np

from .jit import within

# of the exponent's bias, less what makes a third of the bits best (fdlibm)
_THIRD = 715094163 << 32


@within
def cube_root(x):
    """The cube root of a number above 0, to a rounding or two: Halley's iteration, by which an
    error becomes its cube, from a third of the exponent, which is within 4 %."""
    x = np.float64(x)
    t = np.int64(x.view(np.int64) // 3 + _THIRD).view(np.float64)
    for _ in range(3):
        r = x / (t * t)
        t = t + t * ((r - t) / (t + t + r))
    return t

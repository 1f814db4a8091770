"""Cube root of a double with the same bits on every machine, unlike that of a library."""

import numpy as np

from vgmpi.runtime.jit import always_inline

# two thirds of the exponent's bias, adjusted so that a third of the bits is closest (fdlibm)
_EXPONENT_OFFSET = 715094163 << 32


@always_inline
def cube_root(x):
    """Return the cube root of a positive number, to a rounding or two.

    Halley's iteration, which cubes the error in each step, starts from a third of the exponent,
    which is within 4 %.
    """
    x = np.float64(x)
    t = np.int64(x.view(np.int64) // 3 + _EXPONENT_OFFSET).view(np.float64)
    for _ in range(3):
        r = x / (t * t)
        t = t + t * ((r - t) / (t + t + r))
    return t

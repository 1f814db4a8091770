"""Compile options of numba in this package."""

import numba.extending

from .compile_cache import njit_cached
from .compile_key import FP_CONTRACTION

__all__ = ["FP_CONTRACTION", "always_inline", "device_function", "kernel", "view_function"]

# Fastmath stays off: the order of every sum is part of the result.
kernel = njit_cached(nogil=True, error_model="numpy")
# A device function borrows the arrays that it is given: it counts no references to them, which takes
# longer than the arithmetic of a node. So it may neither make nor return arrays, nor call one that
# returns arrays: that is a view function.
device_function = njit_cached(nogil=True, error_model="numpy", inline="never", _nrt=False)
view_function = njit_cached(nogil=True, error_model="numpy", inline="never")
# Inlining pays: passing vectors in memory costs more than the arithmetic of some rows.
always_inline = numba.extending.register_jitable(forceinline=True)

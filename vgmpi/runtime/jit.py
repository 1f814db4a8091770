"""Compile options of numba in this package."""

import numba.extending

from .compile_cache import njit_cached
from .compile_key import FP_CONTRACTION

__all__ = ["FP_CONTRACTION", "always_inline", "device_function", "kernel"]

# Fastmath stays off: the order of every sum is part of the result.
kernel = njit_cached(nogil=True, error_model="numpy")
device_function = njit_cached(nogil=True, error_model="numpy", inline="never")
# Inlining pays: passing vectors in memory costs more than the arithmetic of some rows.
always_inline = numba.extending.register_jitable(forceinline=True)

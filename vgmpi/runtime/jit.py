"""Compile options of numba in this package."""

import functools

import numba.extending

from .callee_code import CalleeCompiler
from .compile_cache import njit_cached
from .compile_key import FP_CONTRACTION

__all__ = [
    "FP_CONTRACTION",
    "always_inline",
    "array_function",
    "borrowing_kernel",
    "device_function",
    "inlined_overload",
    "kernel",
    "overload",
]

# Fastmath stays off: the order of every sum is part of the result.
kernel = njit_cached(nogil=True, error_model="numpy")
# A device function borrows the arrays that it is given: counting references to them takes longer
# than the arithmetic of a node. So it may neither make nor return arrays, nor call a function that
# returns some; these are array functions. The same holds for kernels whose loops are so short.
borrowing_kernel = njit_cached(nogil=True, error_model="numpy", _nrt=False)
device_function = njit_cached(nogil=True, error_model="numpy", inline="never", _nrt=False)
array_function = njit_cached(nogil=True, error_model="numpy", inline="never")
# Inlining pays: passing vectors in memory costs more than the arithmetic of some rows.
always_inline = numba.extending.register_jitable(forceinline=True, pipeline_class=CalleeCompiler)
# numba's own, for what compiled code alone calls
overload = functools.partial(
    numba.extending.overload, strict=False, jit_options={"pipeline_class": CalleeCompiler}
)
inlined_overload = functools.partial(
    numba.extending.overload,
    strict=False,
    jit_options={"pipeline_class": CalleeCompiler, "forceinline": True},
)

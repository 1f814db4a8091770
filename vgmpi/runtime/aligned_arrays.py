"""Aligned arrays: they begin at a cache line, so that a vector load never straddles two lines."""

import math

import numpy as np

LINE = 64  # [bytes] cache line


def aligned_zeros(shape: int | tuple[int, ...], dtype) -> np.ndarray:
    """Return a contiguous array of zeros that begins at a multiple of 64 bytes (NumPy: 16)."""
    dtype = np.dtype(dtype)
    size = math.prod(shape if isinstance(shape, tuple) else (shape,)) * dtype.itemsize
    raw = np.zeros(size + LINE, np.uint8)
    first = -raw.ctypes.data % LINE
    return raw[first : first + size].view(dtype).reshape(shape)


def with_capacity(array: np.ndarray, rows: int) -> np.ndarray:
    """Return the array if it has enough rows, else a larger one without its content."""
    if rows <= len(array):
        return array
    return aligned_zeros((rows + rows // 4, *array.shape[1:]), array.dtype)

"""Arrays that begin at a cache line, so that a vector load never straddles two of them."""

import numpy as np

LINE = 64  # bytes


def aligned(shape: int | tuple[int, ...], dtype) -> np.ndarray:
    """Zeros, contiguous, beginning at a multiple of 64 bytes; numpy itself promises 16."""
    dtype = np.dtype(dtype)
    size = int(np.prod(shape, dtype=np.int64)) * dtype.itemsize
    raw = np.zeros(size + LINE, np.uint8)
    first = -raw.ctypes.data % LINE
    return raw[first : first + size].view(dtype).reshape(shape)


def grown(array: np.ndarray, rows: int) -> np.ndarray:
    """The array itself if it has the rows, else a larger one; its content is not kept."""
    if rows <= len(array):
        return array
    return aligned((rows + rows // 4, *array.shape[1:]), array.dtype)

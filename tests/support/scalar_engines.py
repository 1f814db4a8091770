"""One function of scalars on every engine that runs laws."""

import time

import numpy as np
from numba import njit

from vgmpi.kernels.simd import vector16
from vgmpi.kernels.simd.material_dispatch import store_state_vector

ENGINES = ("arrays", "scalars", "compiled", "lanes")


def on_lanes(function):
    """Compiled (f, out) -> None: `function` of a tuple of nine, for columns of f, 16 at a time.

    f: (9, n), out: (m, n), n a multiple of 16; the function is a numba one.
    """

    @njit(error_model="numpy")
    def go(f, out):
        cap = f.shape[1]
        flat, flat_out = f.reshape(f.size), out.reshape(out.size)
        for p in range(0, cap, vector16.SIMD_WIDTH):
            a, b, c = (
                vector16.load(flat, p),
                vector16.load(flat, p + cap),
                vector16.load(flat, p + 2 * cap),
            )
            q = p + 3 * cap
            d, e, g = (
                vector16.load(flat, q),
                vector16.load(flat, q + cap),
                vector16.load(flat, q + 2 * cap),
            )
            q += 3 * cap
            h, i, j = (
                vector16.load(flat, q),
                vector16.load(flat, q + cap),
                vector16.load(flat, q + 2 * cap),
            )
            store_state_vector(flat_out, p, cap, function((a, b, c, d, e, g, h, i, j)))

    return go


def run(engine, function, given):
    """`function` of a tuple of nine scalars, returning a tuple, of each column: (m, n).

    given: (9, n), n a multiple of 16.
    """
    real = given.dtype.type
    if engine == "arrays":
        return np.array(function(tuple(given)))
    if engine == "scalars":
        return np.array([function(tuple(column)) for column in given.T]).T
    compiled = njit(function, error_model="numpy")
    if engine == "compiled":
        columns = [compiled(tuple(real(v) for v in column)) for column in given.T]
        return np.array(columns).astype(real).T
    size = len(function(tuple(real(v) for v in given[:, 0])))
    out = np.full((size, given.shape[1]), np.nan, real)
    on_lanes(compiled)(given, out)
    return out


def nanoseconds(function, given, size) -> float:
    """Time of `function` per column in lanes [ns]: the best of many rounds."""
    go = on_lanes(njit(function, error_model="numpy", forceinline=True))
    out = np.empty((size, given.shape[1]), given.dtype)
    best = np.inf
    for _ in range(100):
        begin = time.perf_counter()
        go(given, out)
        best = min(best, time.perf_counter() - begin)
    return best / given.shape[1] * 1e9

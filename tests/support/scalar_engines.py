"""One function of scalars on every engine that runs laws."""

import numpy as np
from numba import njit

from vgmpi.kernels.particle_records import load_tensor
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
            store_state_vector(flat_out, p, cap, function(load_tensor(flat, p, cap)))

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

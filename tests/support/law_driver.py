"""Laws driven by a given velocity gradient, without a grid, 16 particles at a time or one."""

import time

import numpy as np
from numba import njit

from vgmpi.kernels.simd import material_dispatch, vector16
from vgmpi.kernels.simd.material_dispatch import load_state_vector, store_state_vector
from vgmpi.materials.material import law_function


def law_of(table, real):
    """The law's numbers in the precision `real`."""
    law = table.law()
    return type(law)(*(real(v) for v in law))


def rest_of(table):
    return tuple(v for values in table.carries.values() for v in values)


@njit(error_model="numpy")
def _drive(law, f, L, dt, steps):
    """`steps` advances of all columns of f (channels, n) in place, on lanes."""
    cap = f.shape[1]
    flat = f.reshape(f.size)
    for p in range(0, cap, vector16.SIMD_WIDTH):
        for _ in range(steps):
            state = material_dispatch.advance(law, load_state_vector(law, flat, p, cap), L, dt)
            store_state_vector(flat, p, cap, state)


@njit(error_model="numpy")
def _stress(law, f, L, out):
    cap = f.shape[1]
    flat, flat_out = f.reshape(f.size), out.reshape(out.size)
    for p in range(0, cap, vector16.SIMD_WIDTH):
        store_state_vector(
            flat_out, p, cap, material_dispatch.stress(law, load_state_vector(law, flat, p, cap), L)
        )


def drive(table, state, L, dt, steps, real=np.float64):
    """State (channels,) after `steps` steps of L (3, 3) [1/s], on lanes."""
    f = np.repeat(np.asarray(state, real)[:, None], 16, axis=1)
    _drive(law_of(table, real), f, tuple(real(v) for v in np.ravel(L)), real(dt), steps)
    assert (f == f[:, :1]).all()
    return f[:, 0].copy()


def stress_of(table, state, real=np.float64):
    """Kirchhoff stress (3, 3) [Pa] of a state at rest, on lanes."""
    f = np.repeat(np.asarray(state, real)[:, None], 16, axis=1)
    out = np.full((6, 16), np.nan, real)
    _stress(law_of(table, real), f, (real(0),) * 9, out)
    return full(out[:, 0])


def full(six):
    xx, yy, zz, xy, xz, yz = (float(v) for v in six)
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def engines_differ(table, f, L, dt, real):
    """Largest difference of advance and stress between numpy in double precision and lanes in
    `real`, numpy in `real`: (of states, of stresses [Pa]). f: (channels, n), n a multiple of 16.
    """
    law, wide, f = law_of(table, real), table.law(), f.astype(real)
    L = tuple(real(v) for v in np.ravel(L))
    advance, stress = law_function(wide, "advance"), law_function(wide, "stress")
    want = advance(wide, tuple(f.astype(float)), tuple(map(float, L)), float(dt))
    tau = stress(wide, want, tuple(map(float, L)))
    plain = advance(law, tuple(f), L, real(dt))
    vectors = f.copy()
    _drive(law, vectors, L, real(dt), 1)
    out = np.full((6, f.shape[1]), np.nan, real)
    _stress(law, vectors, L, out)
    state = max(np.abs(np.subtract(got, want)).max() for got in (plain, vectors))
    return state, np.abs(np.subtract(out, tau)).max()


def nanoseconds(table, f, real=np.float32):
    """(advance, stress) on lanes per particle [ns]: the best of many rounds. f: (channels, n)."""
    law, f, n = law_of(table, real), f.astype(real), f.shape[1]
    L = tuple(real(v) for v in (0.1, -0.2, 0.3, 0.1, -0.4, 0.2, 0.1, 0.3, 0.3))
    out, best = np.empty((6, n), real), [np.inf, np.inf]
    for _ in range(200):
        moved = f.copy()
        begin = time.perf_counter()
        _drive(law, moved, L, real(1e-3), 1)
        middle = time.perf_counter()
        _stress(law, f, L, out)
        end = time.perf_counter()
        best = [min(best[0], middle - begin), min(best[1], end - middle)]
    return best[0] / n * 1e9, best[1] / n * 1e9

"""A step of laws with a yield surface on every engine; their states are B and one number."""

import numpy as np
import pytest
from numba import njit

from tests.support.law_driver import law_of
from vgmpi.kernels.particle_records import load_tensor
from vgmpi.kernels.simd import material_dispatch, vector16
from vgmpi.kernels.simd.material_dispatch import load_state_vector, store_state_vector
from vgmpi.materials.material import law_owner

REALS = (np.float32, np.float64)
EVERY_ENGINE = pytest.mark.parametrize(
    "engine, real", [(engine, real) for engine in ("plain", "lanes") for real in REALS]
)


@njit(error_model="numpy")
def step(law, f, out, dt):
    """The state (7, n) after dt at L, both from f (16, n), its stress, J, c^2 and energy to out
    (16, n), on lanes.
    """
    cap = f.shape[1]
    flat, flat_out = f.reshape(f.size), out.reshape(out.size)
    for p in range(0, cap, vector16.SIMD_WIDTH):
        L = load_tensor(flat, p + 7 * cap, cap)
        state = material_dispatch.advance(law, load_state_vector(law, flat, p, cap), L, dt)
        store_state_vector(flat_out, p, cap, state)
        store_state_vector(flat_out, p + 7 * cap, cap, material_dispatch.stress(law, state, L))
        vector16.store(flat_out, p + 13 * cap, material_dispatch.volume_ratio(law, state))
        vector16.store(flat_out, p + 14 * cap, material_dispatch.wave_speed2(law, state))
        vector16.store(flat_out, p + 15 * cap, material_dispatch.energy(law, state))


def plain(law, f, dt):
    """The same in Python, of arrays or of numbers."""
    table, L = law_owner(type(law)), tuple(f[7:])
    state = table.advance(law, tuple(f[:7]), L, dt)
    rest = (table.volume_ratio, table.wave_speed2, table.energy)
    return state + table.stress(law, state, L) + tuple(g(law, state) for g in rest)


def driven(table, engine, real, moves, state=(0.0,) * 7):
    """What (16,) `step` says after (L (3, 3), steps) of `moves`, each step 1 s, from a state.

    engine: "plain" or "lanes", where 16 particles do the same.
    """
    law, f = law_of(table, real), np.zeros((16, 16), real)
    f[:7] = np.reshape(state, (7, 1))
    out = np.zeros_like(f)
    for L, steps in moves:
        f[7:] = np.reshape(L, (9, 1))
        for _ in range(steps):
            if engine == "lanes":
                step(law, f, out, real(1))
            else:
                out[:] = np.array(plain(law, f, real(1)))
            f[:7] = out[:7]
    assert (out == out[:, :1]).all()
    return out[:, 0].astype(float)


def strained(n, low, high, seed=1):
    """f (16, n): elastic states with strains of 10^low to 10^high, most under pressure, v_c, and L:
    in all directions."""
    random = np.random.default_rng(seed)
    size = 10 ** random.uniform(low, high, n)
    h = random.normal(size=(n, 3, 3)) * size[:, None, None] / 3
    h -= np.eye(3) * (size * random.uniform(0, 1, n))[:, None, None]
    b = h + h.transpose(0, 2, 1) + h @ h.transpose(0, 2, 1)
    v_c = np.where(random.random(n) < 0.5, 0, 0.3 * size * random.normal(size=n))
    rows = [b[:, i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
    return np.array([*rows, v_c, *random.normal(size=(9, n)) * size])

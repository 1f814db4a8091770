"""Laws with a yield surface are written as the others are: the same on every engine."""

import time

import numpy as np
import pytest
from numba import njit

from tests.support.plastic_step import REALS, law_of, plain, step
from vgmpi.kernels.simd import material_dispatch, vector16
from vgmpi.kernels.simd.material_dispatch import load_state_vector, store_state_vector
from vgmpi.materials import registry

N = 960
TABLES = {  # that yield within the strains of the states here
    "sand": {"youngs_modulus": 1e6, "friction_angle": "27 deg"},
    "snow": {},
    "metal": {"youngs_modulus": 1e6, "yield_stress": 1e3, "hardening_modulus": 1e5},
}


@pytest.fixture(params=TABLES)
def table(request):
    return registry[request.param](kind=request.param, **TABLES[request.param])


@njit(error_model="numpy")
def _compiled(law, state, L, dt):
    state = material_dispatch.advance(law, state, L, dt)
    rest = (
        material_dispatch.volume_ratio(law, state),
        material_dispatch.wave_speed2(law, state),
        material_dispatch.energy(law, state),
    )
    return state, material_dispatch.stress(law, state, L), rest


def compiled(law, f, dt):
    """The same compiled for one particle."""
    real = f.dtype.type
    state, tau, rest = _compiled(
        law, *(tuple(real(v) for v in part) for part in (f[:7], f[7:])), dt
    )
    return state + tau + rest


def states(seed=1):
    """f (16, N): elastic states of strain about 1e-9 to .1, v_c, and L: in all directions."""
    random = np.random.default_rng(seed)
    size = 10 ** random.uniform(-9, -1, N)
    h = random.normal(size=(N, 3, 3)) * size[:, None, None] / 3
    h -= np.eye(3) * (size * random.uniform(0, 1, N))[:, None, None]  # most under pressure
    b = h + h.transpose(0, 2, 1) + h @ h.transpose(0, 2, 1)
    v_c = np.where(random.random(N) < 0.5, 0, 0.3 * size * random.normal(size=N))
    L = random.normal(size=(9, N)) * size
    rows = [b[:, i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
    return np.array([*rows, v_c, *L])


def scales(table, f):
    """Size of each output (16, N): of strains, stresses, J, c^2 and energies."""
    law, strain = table.law(), np.abs(f[:7]).max(0) + np.abs(f[7:]).max(0)
    # a hardening law multiplies also what is lost of its history
    stiff = (2 * law.mu + 3 * law.lam) * factor(table)
    one = np.ones_like(strain)
    c2 = stiff / law.density * one
    return np.array([strain] * 7 + [stiff * strain] * 6 + [one, c2, stiff * strain**2])


def factor(table):
    return getattr(table, "max_hardening_factor", 1.0)


@pytest.mark.parametrize("real", REALS)
def test_all_engines_agree_to_rounding(table, real):
    f, law, dt = states().astype(real), law_of(table, real), real(0.3)
    want = np.array(plain(table.law(), f.astype(np.float64), float(dt)))
    allowed = 30 * np.finfo(real).eps * scales(table, f.astype(np.float64))
    on_lanes = np.full_like(f, np.nan)
    step(law, f, on_lanes, dt)
    arrays = np.array(plain(law, f, dt))
    few = slice(None, None, 7)
    one = np.array([plain(law, column, dt) for column in f.T[few]]).T
    jit = np.array([compiled(law, column, dt) for column in f.T[few]]).T
    assert arrays.dtype == one.dtype == real
    pairs = {"lanes": (on_lanes, want), "arrays": (arrays, want)}
    pairs |= {"scalars": (one, want[:, few]), "compiled": (jit, want[:, few])}
    for name, (got, right) in pairs.items():
        limit = allowed if right is want else allowed[:, few]
        worst = (np.abs(got - right) / limit).max()
        print(f"{name} {real.__name__}: {30 * worst:.1f} eps")
        assert worst <= 1, name


@njit(error_model="numpy")
def advance(law, f, out, dt):
    cap = f.shape[1]
    flat, flat_out = f.reshape(f.size), out.reshape(out.size)
    for p in range(0, cap, vector16.SIMD_WIDTH):
        store_state_vector(
            flat_out,
            p,
            cap,
            material_dispatch.advance(law, load_state_vector(law, flat, p, cap), NINE, dt),
        )


@njit(error_model="numpy")
def stress(law, f, out, dt):
    cap = f.shape[1]
    flat, flat_out = f.reshape(f.size), out.reshape(out.size)
    for p in range(0, cap, vector16.SIMD_WIDTH):
        store_state_vector(
            flat_out,
            p,
            cap,
            material_dispatch.stress(law, load_state_vector(law, flat, p, cap), NINE),
        )


NINE = (0.1, -0.2, 0.3, 0.1, -0.4, 0.2, 0.1, 0.3, -0.1)


@pytest.mark.parametrize("real", REALS)
def test_its_price(table, real):
    """Printed; a law that left the vector registers would cost ten times as much."""
    f, law = states().astype(real), law_of(table, real)
    out = np.empty_like(f)
    for part in (advance, stress, step):
        best = np.inf
        for _ in range(200):
            begin = time.perf_counter()
            part(law, f, out, real(0.01))
            best = min(best, time.perf_counter() - begin)
        name = "all five functions" if part is step else part.__name__
        print(f"{table.kind}, {name}, {real.__name__}: {best / N * 1e9:.1f} ns per particle")
        assert best / N < 1e-6

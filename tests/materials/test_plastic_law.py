"""Laws with a yield surface are written as the others are: the same on every engine."""

import time

import numpy as np
import pytest
from numba import njit

from tests.support.law_driver import law_of, nanoseconds
from tests.support.plastic_step import REALS, plain, step, strained
from vgmpi.kernels.simd import material_dispatch
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
    f, law, dt = strained(N, -9, -1).astype(real), law_of(table, real), real(0.3)
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


@pytest.mark.parametrize("real", REALS)
def test_its_price(table, real):
    """Printed; a law that left the vector registers would cost ten times as much."""
    f, law = strained(N, -9, -1).astype(real), law_of(table, real)
    out, best = np.empty_like(f), np.inf
    for _ in range(200):
        begin = time.perf_counter()
        step(law, f, out, real(0.01))
        best = min(best, time.perf_counter() - begin)
    advance, stress = nanoseconds(table, f[:7], real)
    whole = best / N * 1e9
    print(f"{table.kind}, {real.__name__} [ns]: {advance:.1f}, {stress:.1f}, all five {whole:.1f}")
    assert max(advance, stress, whole) < 1000

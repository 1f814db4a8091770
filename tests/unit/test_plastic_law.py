"""A law with a yield surface, written as the others are, on every engine (tests/grains.py)."""

import time

import numpy as np
import pytest
from numba import njit

from tests import grains
from tests.grains import Grains
from vgmpi.kernels import lanes, laws
from vgmpi.kernels.laws import lane_state, store_state
from vgmpi.materials.base import material, registry

REALS = (np.float32, np.float64)
N = 960


@pytest.fixture(autouse=True)
def known():
    """Grains are a material while a test of this file runs."""
    material(Grains)
    laws.make_callable(grains)
    yield
    del registry["grains"]


@njit(error_model="numpy")
def step(law, f, out, dt):
    """The state (7, n) after dt at L, both from f (16, n), its stress, J, c^2 and energy to out
    (16, n), on lanes.
    """
    cap = f.shape[1]
    flat, flat_out = f.reshape(f.size), out.reshape(out.size)
    for p in range(0, cap, lanes.COUNT):
        q = p + 7 * cap
        c0, c1, c2 = lanes.load(flat, q), lanes.load(flat, q + cap), lanes.load(flat, q + 2 * cap)
        q += 3 * cap
        c3, c4, c5 = lanes.load(flat, q), lanes.load(flat, q + cap), lanes.load(flat, q + 2 * cap)
        q += 3 * cap
        c6, c7, c8 = lanes.load(flat, q), lanes.load(flat, q + cap), lanes.load(flat, q + 2 * cap)
        L = (c0, c1, c2, c3, c4, c5, c6, c7, c8)
        state = laws.advance(law, lane_state(law, flat, p, cap), L, dt)
        store_state(flat_out, p, cap, state)
        store_state(flat_out, p + 7 * cap, cap, laws.stress(law, state, L))
        lanes.store(flat_out, p + 13 * cap, laws.volume_ratio(law, state))
        lanes.store(flat_out, p + 14 * cap, laws.wave_speed2(law, state))
        lanes.store(flat_out, p + 15 * cap, laws.energy(law, state))


def plain(law, f, dt):
    """The same in Python, of arrays or of numbers."""
    state = Grains.advance(law, tuple(f[:7]), tuple(f[7:]), dt)
    rest = (Grains.volume_ratio, Grains.wave_speed2, Grains.energy)
    return state + Grains.stress(law, state, tuple(f[7:])) + tuple(g(law, state) for g in rest)


@njit(error_model="numpy")
def _compiled(law, state, L, dt):
    state = laws.advance(law, state, L, dt)
    rest = laws.volume_ratio(law, state), laws.wave_speed2(law, state), laws.energy(law, state)
    return state, laws.stress(law, state, L), rest


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


def law_of(real):
    law = Grains().law()
    return type(law)(*(real(v) for v in law))


def scales(f):
    """Size of each output (16, N): of strains, stresses, J, c^2 and energies."""
    law, strain = Grains().law(), np.abs(f[:7]).max(0) + np.abs(f[7:]).max(0)
    stiff = 2 * law.mu + 3 * law.lam
    one = np.ones_like(strain)
    c2 = stiff / law.density * one
    return np.array([strain] * 7 + [stiff * strain] * 6 + [one, c2, stiff * strain**2])


@pytest.mark.parametrize("real", REALS)
def test_all_engines_agree_to_rounding(real):
    f, law, dt = states().astype(real), law_of(real), real(0.3)
    want = np.array(plain(Grains().law(), f.astype(np.float64), float(dt)))
    allowed = 30 * np.finfo(real).eps * scales(f.astype(np.float64))
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


def logarithm(b):
    """ln b / 2 and its eigenvectors by numpy; b (n, 3, 3)."""
    d, q = np.linalg.eigh(b)
    return 0.5 * np.log(d), q


def square(rows):
    """Six rows (6, n) -> (n, 3, 3)."""
    return rows[[0, 3, 4, 3, 1, 5, 4, 5, 2]].T.reshape(-1, 3, 3)


def test_it_is_the_return_mapping_of_drucker_and_prager():
    """Written anew with numpy's matrices, case by case, as in Klar 2016, section 6.3."""
    f, table = states(), Grains()
    f = f[:, np.abs(f[:6]).max(0) > 1e-4]  # numpy takes the logarithm of b itself
    law, dt, unity = table.law(), 0.3, np.eye(3)
    move = unity + dt * f[7:].T.reshape(-1, 3, 3)
    e, q = logarithm(move @ (square(f[:6]) + unity) @ move.transpose(0, 2, 1))
    opened = f[6] + e.sum(1)
    shifted = e + f[6][:, None] / 3
    seen = {"open": 0, "yields": 0, "elastic": 0}
    for n, s in enumerate(shifted):
        trace = s.sum()
        deviator = s - trace / 3
        size = np.sqrt((deviator**2).sum())
        excess = size + (3 * law.lam + 2 * law.mu) / (2 * law.mu) * trace * law.slope
        if trace >= 0:
            shifted[n], case = 0.0, "open"
        elif excess > 0:
            shifted[n], case = s - excess * deviator / size, "yields"
        else:
            case = "elastic"
        seen[case] += 1
    assert min(seen.values()) > 20, seen
    got = np.array(plain(law, f, dt))
    b = np.einsum("nij,nj,nkj->nik", q, np.exp(2 * shifted), q)
    tau = 2 * law.mu * shifted + law.lam * shifted.sum(1, keepdims=True)
    tau = np.einsum("nij,nj,nkj->nik", q, tau, q)
    assert np.abs(square(got[:6]) + unity - b).max() < 1e-13
    assert np.abs(got[6] - (opened - shifted.sum(1))).max() < 1e-13
    assert np.abs(square(got[7:13]) - tau).max() < 1e-12 * law.lam
    assert np.allclose(got[13], np.exp(opened), rtol=1e-13)


def test_small_strains_are_not_lost_in_single_precision():
    """10,000 steps of pressing by 1e-9 each: 1 - 1e-9 is 1 in single precision."""
    law, one = law_of(np.float32), np.float32
    state = tuple(one(0) for _ in range(7))
    L = tuple(one(v) for v in (-1, 0, 0, 0, -1, 0, 0, 0, -1))
    for _ in range(10_000):
        state = Grains.advance(law, state, L, one(1e-9))
    assert {type(v) for v in state} == {one}
    assert np.allclose(state[:3], np.expm1(-2e-5), rtol=1e-2)
    assert np.abs(state[3:]).max() < 1e-8


@njit(error_model="numpy")
def advance(law, f, out, dt):
    cap = f.shape[1]
    flat, flat_out = f.reshape(f.size), out.reshape(out.size)
    for p in range(0, cap, lanes.COUNT):
        store_state(flat_out, p, cap, laws.advance(law, lane_state(law, flat, p, cap), NINE, dt))


@njit(error_model="numpy")
def stress(law, f, out, dt):
    cap = f.shape[1]
    flat, flat_out = f.reshape(f.size), out.reshape(out.size)
    for p in range(0, cap, lanes.COUNT):
        store_state(flat_out, p, cap, laws.stress(law, lane_state(law, flat, p, cap), NINE))


NINE = (0.1, -0.2, 0.3, 0.1, -0.4, 0.2, 0.1, 0.3, -0.1)


@pytest.mark.parametrize("real", REALS)
def test_its_price(real):
    """Printed; a law that left the vector registers would cost ten times as much."""
    f, law = states().astype(real), law_of(real)
    out = np.empty_like(f)
    for part in (advance, stress, step):
        best = np.inf
        for _ in range(200):
            begin = time.perf_counter()
            part(law, f, out, real(0.01))
            best = min(best, time.perf_counter() - begin)
        name = "all five functions" if part is step else part.__name__
        print(f"{name}, {real.__name__}: {best / N * 1e9:.1f} ns per particle")
        assert best / N < 1e-6

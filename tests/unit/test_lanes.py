"""Laws on vector lanes: the same text as on scalars, and the layout of the particles fits."""

import numpy as np
import pytest
from numba import njit

from vgmpi.device import jit as _jit  # noqa: F401  (the cache folder)
from vgmpi.kernels import lanes
from vgmpi.kernels.laws import lane_state, stress
from vgmpi.materials import registry

REAL = {"single": (np.float32, 2e-6), "double": (np.float64, 2e-14)}


@njit
def stresses(law, f, out):
    """The stress of all particles, 16 at a time, from a group's array (channels, cap)."""
    cap = f.shape[1]
    flat = f.reshape(f.size)
    for p in range(0, cap, lanes.COUNT):
        q = p + 3 * cap
        c0, c1, c2 = lanes.load(flat, q), lanes.load(flat, q + cap), lanes.load(flat, q + 2 * cap)
        q += 3 * cap
        c3, c4, c5 = lanes.load(flat, q), lanes.load(flat, q + cap), lanes.load(flat, q + 2 * cap)
        q += 3 * cap
        c6, c7, c8 = lanes.load(flat, q), lanes.load(flat, q + cap), lanes.load(flat, q + 2 * cap)
        state = lane_state(law, flat, p + 13 * cap, cap)
        t0, t1, t2, t3, t4, t5 = stress(law, state, (c0, c1, c2, c3, c4, c5, c6, c7, c8))
        lanes.store(out[0], p, t0)
        lanes.store(out[1], p, t1)
        lanes.store(out[2], p, t2)
        lanes.store(out[3], p, t3)
        lanes.store(out[4], p, t4)
        lanes.store(out[5], p, t5)


CASES = [
    ("fluid", {"viscosity": 0.1}, 1),
    ("elastic", {"youngs_modulus": 1e5}, 9),
]


@pytest.mark.parametrize("precision", REAL)
@pytest.mark.parametrize("kind, keys, channels", CASES, ids=["fluid", "elastic"])
def test_a_law_on_lanes_is_the_law(kind, keys, channels, precision):
    real, tolerance = REAL[precision]
    table = registry[kind](kind=kind, **keys)
    law = type(table.law())(*(real(v) for v in table.law()))
    rng = np.random.default_rng(5)
    f = rng.uniform(-0.2, 0.2, (13 + channels, 16 * 40)).astype(real)
    f[13:, :64] *= 1e-6  # near rest, where 1 + x would lose the digits
    f[13:, 64:80] = 0
    out = np.full((6, f.shape[1]), np.nan, real)
    stresses(law, f, out)
    state, L = f[13:].astype(np.float64), f[3:12].astype(np.float64)
    want = np.array(table.stress(table.law(), tuple(state), tuple(L)))
    size = np.abs(want).max(0) + 1e-300
    assert np.isfinite(out).all()
    assert (np.abs(out - want) / size).max() < 60 * tolerance
    if kind == "elastic":
        assert (out[:, 64:80] == 0).all()


def functions():
    @njit
    def go(x, out):
        for p in range(0, len(x), lanes.COUNT):
            v = lanes.load(x, p)
            lanes.store(out[0], p, np.exp(v))
            lanes.store(out[1], p, np.expm1(v))
            lanes.store(out[2], p, np.log1p(abs(v)))
            lanes.store(out[3], p, np.sqrt(abs(v)))
            lanes.store(out[4], p, np.maximum(v, 0.5) - np.minimum(1, v) * -v / 2)

    return go


@pytest.mark.parametrize("precision", REAL)
def test_functions_of_lanes(precision):
    real, tolerance = REAL[precision]
    x = np.concatenate([np.linspace(-20, 20, 640), np.geomspace(1e-12, 1, 160)]).astype(real)
    out = np.empty((5, len(x)), real)
    functions()(x, out)
    x = x.astype(np.float64)
    wants = (
        np.exp(x),
        np.expm1(x),
        np.log1p(abs(x)),
        np.sqrt(abs(x)),
        np.maximum(x, 0.5) + np.minimum(1, x) * x / 2,
    )
    for found, want in zip(out, wants, strict=True):
        assert (np.abs(found - want) <= tolerance * np.abs(want)).all()

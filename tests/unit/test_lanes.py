"""Laws on vector lanes: the same text as on scalars, and the layout of the particles fits."""

import numpy as np
import pytest
from numba import njit

from vgmpi.device import jit as _jit  # noqa: F401  (the cache folder)
from vgmpi.kernels import lanes
from vgmpi.kernels.laws import stress
from vgmpi.materials import registry

REAL = {"single": (np.float32, 16, 2e-6), "double": (np.float64, 16, 2e-14)}


@njit
def fluid_stress(law, f, out, width):
    for p in range(0, f.shape[1], width):
        L = (
            lanes.load(f[3], p),
            lanes.load(f[4], p),
            lanes.load(f[5], p),
            lanes.load(f[6], p),
            lanes.load(f[7], p),
            lanes.load(f[8], p),
            lanes.load(f[9], p),
            lanes.load(f[10], p),
            lanes.load(f[11], p),
        )
        t = stress(law, (lanes.load(f[13], p),), L)
        lanes.store(out[0], p, t[0])
        lanes.store(out[1], p, t[1])
        lanes.store(out[2], p, t[2])
        lanes.store(out[3], p, t[3])
        lanes.store(out[4], p, t[4])
        lanes.store(out[5], p, t[5])


@njit
def solid_stress(law, f, out, width):
    for p in range(0, f.shape[1], width):
        h = (
            lanes.load(f[13], p),
            lanes.load(f[14], p),
            lanes.load(f[15], p),
            lanes.load(f[16], p),
            lanes.load(f[17], p),
            lanes.load(f[18], p),
            lanes.load(f[19], p),
            lanes.load(f[20], p),
            lanes.load(f[21], p),
        )
        t = stress(law, h, h)
        lanes.store(out[0], p, t[0])
        lanes.store(out[1], p, t[1])
        lanes.store(out[2], p, t[2])
        lanes.store(out[3], p, t[3])
        lanes.store(out[4], p, t[4])
        lanes.store(out[5], p, t[5])


CASES = [
    ("fluid", {"viscosity": 0.1}, fluid_stress, 1),
    ("elastic", {"youngs_modulus": 1e5}, solid_stress, 9),
]


@pytest.mark.parametrize("precision", REAL)
@pytest.mark.parametrize("kind, keys, kernel, channels", CASES, ids=["fluid", "elastic"])
def test_a_law_on_lanes_is_the_law(kind, keys, kernel, channels, precision):
    real, width, tolerance = REAL[precision]
    table = registry[kind](kind=kind, **keys)
    law = type(table.law())(*(real(v) for v in table.law()))
    rng = np.random.default_rng(5)
    f = rng.uniform(-0.2, 0.2, (13 + channels, 16 * 40)).astype(real)
    f[13:, :64] *= 1e-6  # near rest, where 1 + x would lose the digits
    f[13:, 64:80] = 0
    out = np.full((6, f.shape[1]), np.nan, real)
    kernel(law, f, out, width)
    state, L = f[13:].astype(np.float64), f[3:12].astype(np.float64)
    want = np.array(table.stress(table.law(), tuple(state), tuple(L if channels == 1 else state)))
    size = np.abs(want).max(0) + 1e-300
    assert np.isfinite(out).all()
    assert (np.abs(out - want) / size).max() < 60 * tolerance
    assert (out[:, 64:80] == 0).all() or channels == 1


def functions():
    @njit
    def go(x, out, width):
        for p in range(0, len(x), width):
            v = lanes.load(x, p)
            lanes.store(out[0], p, np.exp(v))
            lanes.store(out[1], p, np.expm1(v))
            lanes.store(out[2], p, np.log1p(abs(v)))
            lanes.store(out[3], p, np.sqrt(abs(v)))
            lanes.store(out[4], p, np.maximum(v, 0.5) - np.minimum(1, v) * -v / 2)

    return go


@pytest.mark.parametrize("precision", REAL)
def test_functions_of_lanes(precision):
    real, width, tolerance = REAL[precision]
    x = np.concatenate([np.linspace(-20, 20, 640), np.geomspace(1e-12, 1, 160)]).astype(real)
    out = np.empty((5, len(x)), real)
    functions()(x, out, width)
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

"""exp, expm1, log, log1p and cbrt of lanes over their whole range, in units of the last place.

Singles are compared with numpy's doubles, doubles with its long doubles (64 bits of mantissa).
"""

import numpy as np
import pytest
from numba import njit

from vgmpi.kernels.simd import math_functions as _functions  # noqa: F401  (what is tested
from vgmpi.kernels.simd import vector16
from vgmpi.runtime import jit as _jit  # noqa: F401  (the cache folder)

MORE = {np.float32: np.float64, np.float64: np.longdouble}
ERRORS = {
    "exp": 1,
    "expm1": 2,
    "log": 1,
    "log1p": 3,
    "cbrt": 1,
}  # as kernels/simd/math_functions.py says


@njit
def _all(x, out):
    for p in range(0, len(x), vector16.SIMD_WIDTH):
        v = vector16.load(x, p)
        vector16.store(out[0], p, np.exp(v))
        vector16.store(out[1], p, np.expm1(v))
        vector16.store(out[2], p, np.log(v))
        vector16.store(out[3], p, np.log1p(v))
        vector16.store(out[4], p, np.cbrt(v))


def found(name, x):
    """The function of a vector of any length, through lanes."""
    padded = np.resize(x, -len(x) // 16 * -16)
    out = np.empty((len(ERRORS), len(padded)), x.dtype)
    _all(padded, out)
    return out[list(ERRORS).index(name), : len(x)]


def inputs(name, real):
    """Many numbers of the whole range for which the function is promised."""
    rng, info = np.random.default_rng(1), np.finfo(real)
    tiny, largest = float(info.smallest_subnormal), float(info.max)
    # from the smallest denormal to the largest number
    sizes = np.exp(rng.uniform(np.log(tiny), np.log(largest), 40_000))
    if name in ("exp", "expm1"):
        most = 87.0 if real is np.float32 else 708.0
        small = sizes[sizes < most]
        x = np.concatenate([rng.uniform(-most, most, 40_000), rng.uniform(-1, 1, 20_000), small])
        x = np.concatenate([x, -small])
    elif name == "log":
        x = np.concatenate([sizes, rng.uniform(0, 3, 40_000), 1 + rng.normal(0, 1e-3, 20_000)])
    elif name == "log1p":
        x = np.concatenate([sizes, -sizes[sizes < 1], rng.uniform(-1, 3, 40_000)])
        x = x[x.astype(real) > -1]
    else:
        x = np.concatenate([sizes, -sizes, rng.uniform(-8, 8, 20_000)])
    return x.astype(real)


def errors(name, x):
    """Distance from the true value in units of its last place."""
    want = getattr(np, name)(x.astype(MORE[x.dtype.type]))
    unit = np.spacing(np.abs(want).astype(x.dtype)).astype(want.dtype)
    return np.abs(found(name, x) - want) / unit


@pytest.mark.parametrize("real", MORE)
@pytest.mark.parametrize("name", ERRORS)
def test_accuracy(name, real):
    allowed = ERRORS[name]
    x = inputs(name, real)
    off = errors(name, x)
    print(
        f"{name} {real.__name__}: {off.max():.2f} ulp at {x[off.argmax()]:.9g}, allowed {allowed}"
    )
    assert off.max() <= allowed


@pytest.mark.parametrize("real", MORE)
def test_the_ends(real):
    tiny, inf, nan = np.finfo(real).smallest_subnormal, np.inf, np.nan
    most = 87.0 if real is np.float32 else 708.0
    low, high = np.exp(-most), np.exp(most)
    cases = {  # x, value, x, value ...
        "exp": (0, 1, -0.0, 1, tiny, 1, inf, high, -inf, low, nan, nan),
        "expm1": (0, 0, tiny, tiny, -tiny, -tiny, inf, high, -inf, -1, nan, nan),
        "log": (1, 0, 0, -inf, -0.0, -inf, -tiny, nan, -1, nan, inf, inf, -inf, nan, nan, nan),
        "log1p": (0, 0, tiny, tiny, -1, -inf, -1.5, nan, inf, inf, -inf, nan, nan, nan),
        "cbrt": (0, 0, -0.0, -0.0, 1, 1, -8, -2, inf, inf, -inf, -inf, nan, nan),
    }
    for name, pairs in cases.items():
        x, want = np.array(pairs, real).reshape(-1, 2).T
        got = found(name, x)
        assert np.allclose(got, want, rtol=4 * np.finfo(real).eps, atol=0, equal_nan=True), name
        if name == "cbrt":
            assert (np.signbit(got) == np.signbit(want))[~np.isnan(want)].all()


@pytest.mark.parametrize("real", MORE)
def test_beyond_its_range_exp_stays_where_it_ended(real):
    most = real(87 if real is np.float32 else 708)
    x = np.array([most, 2 * most, 1e30, -most, -2 * most, -1e30], real)
    got = found("exp", x)
    assert (got[:3] == got[0]).all() and (got[3:] == got[3]).all()
    assert np.isfinite(got).all() and (got > 0).all()

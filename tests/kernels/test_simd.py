"""Laws on vector lanes: the same text as on scalars, and the layout of the particles fits."""

from typing import NamedTuple

import numpy as np
import pytest
from numba import njit

from vgmpi.kernels.particle_records import load_tensor
from vgmpi.kernels.simd import vector16
from vgmpi.kernels.simd.material_dispatch import (
    load_state_scalar,
    load_state_vector,
    store_state_vector,
    stress,
)
from vgmpi.materials import registry
from vgmpi.materials.tensor_math.select import select
from vgmpi.runtime import jit as _jit  # noqa: F401  (the cache folder)

REAL = {"single": (np.float32, 2e-6), "double": (np.float64, 2e-14)}


@njit
def stresses(law, f, out):
    """The stress of all particles, 16 at a time, from a group's array (channels, cap)."""
    cap = f.shape[1]
    flat = f.reshape(f.size)
    for p in range(0, cap, vector16.SIMD_WIDTH):
        state = load_state_vector(law, flat, p + 13 * cap, cap)
        tau = stress(law, state, load_tensor(flat, p + 3 * cap, cap))
        store_state_vector(out.reshape(out.size), p, cap, tau)


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
        for p in range(0, len(x), vector16.SIMD_WIDTH):
            v = vector16.load(x, p)
            vector16.store(out[0], p, np.exp(v))
            vector16.store(out[1], p, np.expm1(v))
            vector16.store(out[2], p, np.log1p(abs(v)))
            vector16.store(out[3], p, np.sqrt(abs(v)))
            vector16.store(out[4], p, np.maximum(v, 0.5) - np.minimum(1, v) * -v / 2)

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


def choices(x, y, bound):
    """A formula with what a law may use to choose; plain Python, no branch."""
    outside = (x < -bound) | (x >= bound) | np.logical_not(y <= 2.0)
    first = select(outside & (bound > 0.0), y, 3.0 * x)
    second = select((x == y) | (x != x), -1.0, select(x > y, x, y) ** 2)
    third = select(bound > 100.0, x, np.copysign(np.floor(y), x))
    fourth = select(x > 0.0, 1.0, 0.0) + np.maximum(x, y) - np.minimum(bound, x) ** 3
    return first, second, third, fourth, (2.0 + y * y) ** -3 + x**1 + x**0


one = njit(choices)


@njit
def sixteen(x, y, bound, out):
    for p in range(0, len(x), vector16.SIMD_WIDTH):
        a, b, c, d, e = _on_lanes(vector16.load(x, p), vector16.load(y, p), bound)
        vector16.store(out[0], p, a)
        vector16.store(out[1], p, b)
        vector16.store(out[2], p, c)
        vector16.store(out[3], p, d)
        vector16.store(out[4], p, e)


_on_lanes = one


def numbers(real, n=320):
    x, y = np.random.default_rng(8).uniform(-3, 3, (2, n)).astype(real)
    x[:16] = y[:16]  # equal
    x[16:24], y[24:32] = 0.5, -0.5  # at the bound
    return x, y


@pytest.mark.parametrize("precision", REAL)
def test_one_text_chooses_alike_on_every_engine(precision):
    real, tolerance = REAL[precision]
    x, y = numbers(real)
    out = np.empty((5, len(x)), real)
    for bound in (real(0.5), real(-1), real(101)):
        sixteen(x, y, bound, out)
        want = choices(x, y, bound)
        assert np.abs(out - want).max() <= tolerance * 50
        assert 0 < (out[0] == y).mean() < 1 or bound != 0.5
        for p in range(0, len(x), 7):
            for result in (choices(x[p], y[p], bound), one(x[p], y[p], bound)):
                assert np.abs(np.subtract(result, out[:, p])).max() <= tolerance * 50
            a, b, c, _, e = choices(x[p], y[p], bound)
            assert {type(a), type(b), type(c), type(e)} == {real}
            plain = choices(float(x[p]), float(y[p]), float(bound))
            assert np.abs(np.subtract(plain, out[:, p])).max() <= tolerance * 50


@njit
def extremes(x, y, out):
    for p in range(0, len(x), vector16.SIMD_WIDTH):
        a, b = vector16.load(x, p), vector16.load(y, p)
        vector16.store(out[0], p, np.maximum(a, b))
        vector16.store(out[1], p, np.minimum(a, b))
        vector16.store(out[2], p, np.maximum(a, 0.0))
        vector16.store(out[3], p, np.minimum(1.0, a))
        vector16.store(out[4], p, select(a < b, 1.0, 0.0))
        vector16.store(out[5], p, select(a <= b, 1.0, 0.0))
        vector16.store(out[6], p, select(a > b, 1.0, 0.0))
        vector16.store(out[7], p, select(a >= b, 1.0, 0.0))
        vector16.store(out[8], p, select(a == b, 1.0, 0.0))
        vector16.store(out[9], p, select(a != b, 1.0, 0.0))


@pytest.mark.parametrize("precision", REAL)
def test_what_is_not_a_number_is_treated_as_numpy_does(precision):
    real, _ = REAL[precision]
    nan, inf = np.nan, np.inf
    pairs = [(nan, 1), (1, nan), (nan, nan), (2, 1), (1, 2), (-inf, inf), (nan, inf), (-1, -1)]
    x, y = np.resize(np.array(pairs, real), (16, 2)).T.copy()
    out = np.empty((10, 16), real)
    extremes(x, y, out)
    want = [np.maximum(x, y), np.minimum(x, y), np.maximum(x, 0), np.minimum(1, x)]
    want += [x < y, x <= y, x > y, x >= y, x == y, x != y]
    assert np.array_equal(out, want, equal_nan=True)


def material_with(channels):
    """A material that only carries so many numbers, in two parts where there are two."""

    class Law(NamedTuple):
        factor: float

    Law.__name__ = f"Law{channels}"

    class Carrier:
        carries = {"a": (0.0,) * (channels // 2), "b": (0.0,) * (channels - channels // 2)}

    Carrier.Law = Law
    return Carrier


CARRIERS = {n: material_with(n) for n in (0, 1, 2, 7, 12)}


@njit
def copied(law, f, out):
    """All states from channel 1 on of f (channels, cap) to out, 16 at a time; a constant first."""
    cap = f.shape[1]
    flat, flat_out = f.reshape(f.size), out.reshape(out.size)
    for p in range(0, cap, vector16.SIMD_WIDTH):
        store_state_vector(flat_out, p + cap, cap, load_state_vector(law, flat, p + cap, cap))
        store_state_vector(flat_out, p, cap, (law.factor,))


@njit
def column(law, f, p):
    return load_state_scalar(law, f, 1, p)


@pytest.mark.parametrize("precision", REAL)
@pytest.mark.parametrize("channels", CARRIERS)
def test_a_state_of_any_length(monkeypatch, channels, precision):
    """The first channel is another's, the last one too."""
    real, _ = REAL[precision]
    carrier = CARRIERS[channels]
    monkeypatch.setitem(registry, "carrier", carrier)
    law = carrier.Law(real(2))
    f = np.random.default_rng(3).normal(size=(channels + 2, 48)).astype(real)
    out = np.zeros_like(f)
    copied(law, f, out)
    assert (out[0] == 2).all() and (out[-1] == 0).all()
    assert (out[1:-1] == f[1:-1]).all()
    for p in (0, 5, 47):
        assert column(law, f, p) == tuple(f[1:-1, p]) == load_state_scalar(law, f, 1, p)
        assert len(column(law, f, p)) == channels


def test_materials_with_equal_fields_are_told_apart():
    """numba goes by the class's name (see kernels/simd/material_dispatch.py)."""
    names = [cls.Law.__name__ for cls in registry.values()]
    assert len(set(names)) == len(names)

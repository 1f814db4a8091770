"""Eigenvalues, eigenvectors and rotations of 3x3 tensors, on every engine.

Allowed errors are in units of the precision's eps times the norm of the tensor.
"""

import re
from fractions import Fraction

import hypothesis
import numpy as np
import pytest
from hypothesis import strategies
from llvmlite import binding
from numba import njit

from tests.support.scalar_engines import ENGINES, on_lanes, run
from vgmpi.materials.tensor_math import symmetric_eigen
from vgmpi.materials.tensor_math.symmetric_eigen import eigen, from_principal
from vgmpi.materials.tensor_math.tensor import left_cauchy_green_minus_one, rotation
from vgmpi.runtime.jit import FP_CONTRACTION

REALS = (np.float32, np.float64)
VALUES, BACK, ORTHONORMAL = 10, 8, 8  # numpy's own eigenvalues in double are off by 6
N = 1600


def rotations(random, n):
    q, _ = np.linalg.qr(random.normal(size=(n, 3, 3)))
    return q * np.sign(np.linalg.det(q))[:, None, None]


def with_values(d, q):
    """Q diag(d) Q^T: (n, 3, 3)."""
    return np.einsum("nij,nj,nkj->nik", q, d, q)


def families():
    """Kinds of symmetric tensors, (N, 3, 3) each."""
    random = np.random.default_rng(0)
    q, normal = rotations(random, N), random.normal(size=(N, 3))
    some = with_values(normal, q)
    small = 10 ** random.uniform(-17, -1, (N, 1))
    pair = normal.copy()
    pair[:, 1] = pair[:, 0] * (1 + small[:, 0])
    twin = normal.copy()
    twin[:, 1] = twin[:, 0]
    diagonal = normal[:, :, None] * np.eye(3)
    noise = random.normal(size=(N, 3, 3)) * 10 ** random.uniform(-17.5, 0, (N, 1, 1))
    noise = noise + noise.transpose(0, 2, 1)
    plane = some.copy()
    plane[:, 2, :] = plane[:, :, 2] = 0
    shear = np.zeros((N, 3, 3))
    shear[:, 0, 1] = shear[:, 1, 0] = normal[:, 0]
    whole = random.integers(-2, 3, (N, 3, 3)).astype(float)
    whole = np.tril(whole) + np.tril(whole, -1).transpose(0, 2, 1)
    signs = random.choice([-1, 1], (N, 3))
    return {
        "random": some,
        "spread": with_values(signs * 10 ** random.uniform(-6, 6, (N, 3)), q),
        "three nearly equal": with_values(1 + small * normal, q),
        "two nearly equal": with_values(pair, q),
        "two equal": with_values(twin, q),
        "rank one": normal[:, :, None] * normal[:, None, :],
        "diagonal": diagonal,
        "nearly diagonal": diagonal + noise,
        "nearly the unit tensor": np.eye(3) + noise,
        "small strain": 1e-9 * some,
        "tiny strain": 1e-14 * some,
        "large": 1e15 * some,
        "whole numbers": whole,
        # the mean is then off by as much as the tensor is
        "roundings of doubles": np.eye(3) + np.finfo(np.float64).eps * whole,
        "roundings of singles": np.eye(3) + np.finfo(np.float32).eps * whole,
        "roundings on the diagonal": np.eye(3) * (1 + np.finfo(np.float32).eps * whole),
        "and in doubles": np.eye(3) * (1 + np.finfo(np.float64).eps * whole),
        "plane": plane,
        "shear": shear,
        "multiples of unity": np.eye(3) * normal[:, :1, None],
        "zero": np.zeros((N, 3, 3)),
    }


FAMILIES = families()


def six(m):
    """(n, 3, 3) -> (9, n): 00, 11, 22, 01, 02, 12 and three unused."""
    rows = [m[:, i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
    return np.array([*rows, *rows[:3]])


def decompose(a):
    d, q = eigen(a[:6])
    return d + q


def check(m, found):
    """m: (n, 3, 3), found: (12, n) values and vectors; both of one precision."""
    eps = np.finfo(m.dtype).eps
    exact = m.astype(np.longdouble)
    d, q = found[:3].T.astype(np.longdouble), found[3:].T.reshape(-1, 3, 3).astype(np.longdouble)
    norm = np.sqrt((exact**2).sum((1, 2)))
    # LAPACK loses digits where the squares of entries are denormal numbers
    lost = np.abs(m) < 1e-30 * norm[:, None, None]
    want = np.linalg.eigvalsh(np.where(lost, 0.0, m).astype(np.float64))
    off = np.abs(np.sort(d, 1) - want).max(1)
    back = np.abs(with_values(d, q) - exact).max((1, 2))
    unit = np.abs(np.einsum("nij,nik->njk", q, q) - np.eye(3)).max((1, 2))
    said = [
        float(np.max(e / eps / np.where(norm > 0, norm, 1)))
        for e in (off, back, unit * np.where(norm > 0, norm, 1))
    ]
    assert said[0] <= VALUES and said[1] <= BACK and said[2] <= ORTHONORMAL, said
    assert (np.linalg.det(q.astype(np.float64)) > 0).all()
    return said


@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("engine", ENGINES)
def test_eigenvalues_and_vectors(engine, real):
    worst = np.zeros(3)
    for name, m in FAMILIES.items():
        # one at a time takes its time
        m = (m if engine in ("arrays", "lanes") else m[:64]).astype(real)
        found = run(engine, decompose, six(m))
        assert found.dtype == real
        worst = np.maximum(worst, check(m, found))
        if name in ("zero", "multiples of unity"):
            assert np.abs(found[:3] - m[:, 0, 0]).max() <= 2 * np.finfo(real).eps * 4
    print(f"{engine} {real.__name__}: values {worst[0]:.1f}, back {worst[1]:.1f}, unit", worst[2])


entries = strategies.floats(-1e6, 1e6)


@hypothesis.settings(max_examples=400, deadline=None)
@hypothesis.example((1.07026443e-154, 1.07026443e-154, 0.0, 0.0, 5.0, 1.07026443e-154))
@hypothesis.given(strategies.tuples(*[entries] * 6))
def test_eigen_of_whatever_comes(a):
    for real in REALS:
        s = np.array(a, real)
        x, y, z, u, v, w = s
        m = np.array([[[x, u, v], [u, y, w], [v, w, z]]])
        if np.abs(s).max() > 1e-10:  # deviations of 1e-18 are not seen
            check(m, np.array(decompose(tuple(s)))[:, None])


@pytest.mark.parametrize("engine", ENGINES)
def test_what_is_not_a_number_is_seen(engine):
    m = np.repeat(FAMILIES["random"][:1], 16, 0)
    m[0, 0, 0] = m[1, 1, 2] = np.nan
    m[2, 0, 1] = np.inf
    with np.errstate(all="ignore"):
        found = run(engine, decompose, six(m))
    assert np.isnan(found[:3, :3]).any(0).all() and np.isfinite(found[:, 3:]).all()


def logarithm(h):
    """ln V of F = I + H = V R."""
    d, q = eigen(left_cauchy_green_minus_one(h))
    return from_principal(q, (0.5 * np.log1p(d[0]), 0.5 * np.log1p(d[1]), 0.5 * np.log1p(d[2])))


@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("engine", ENGINES)
def test_logarithmic_strain(engine, real):
    """Of strains down to 1e-9, which beside 1 are lost in single precision."""
    random = np.random.default_rng(2)
    n = 160
    size = 10 ** random.uniform(-9, -0.7, n)
    h = (random.normal(size=(9, n)) * size / 3).astype(real)
    got = run(engine, logarithm, h)
    H = h.T.reshape(n, 3, 3).astype(np.longdouble)
    # ln(I + B) / 2 as a series where B is small, by numpy elsewhere
    B = H + H.transpose(0, 2, 1) + H @ H.transpose(0, 2, 1)
    d, q = np.linalg.eigh(B.astype(np.float64))
    want = with_values(0.5 * np.log1p(d), q)
    off = np.abs(got - six(want)[:6]).max(0) / np.abs(want).max((1, 2))
    assert off.max() < 16 * np.finfo(real).eps


@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("engine", ENGINES)
def test_rotation(engine, real):
    """R of V R, for stretches up to ten."""
    random = np.random.default_rng(3)
    n = 320
    for most in (1.01, 2, 10):
        s = most ** random.uniform(-1, 1, (n, 3))
        s[:3] = [[most, 1 / most, 1], [most] * 3, [1 / most] * 3]
        R = rotations(random, n)
        F = (with_values(s, rotations(random, n)) @ R).astype(real)
        got = run(engine, rotation, np.ascontiguousarray(F.reshape(n, 9).T)).T.reshape(n, 3, 3)
        u, _, v = np.linalg.svd(F.astype(np.float64))
        eps = np.finfo(real).eps
        assert np.abs(got - u @ v).max() < (4 * eps if real is np.float32 else 100 * eps)
        got = got.astype(np.float64)
        assert np.abs(got @ got.transpose(0, 2, 1) - np.eye(3)).max() < 4 * eps


@pytest.mark.parametrize("real", REALS)
def test_lanes_stay_vectors(real):
    """All in line: no call, no vector kept in memory by LLVM's own wish, nothing scalar."""
    go = on_lanes(njit(decompose, error_model="numpy", forceinline=True))
    m = six(FAMILIES["random"][:16]).astype(real)
    go(m, np.empty((12, 16), real))
    (text,) = go.inspect_llvm().values()
    body = max(text.split("\ndefine "), key=lambda part: part.count("<16 x "))
    kind = "float" if real is np.float32 else "double"
    assert body.count(f"fmul contract <16 x {kind}>") > 50
    assert not re.search(r"alloca [^\n]*<16 x|call [^\n]*@_ZN", body)
    assert not re.search(rf"f(mul|add|sub|div)( contract)? {kind}", body)


def turned_and_angle(given):
    """Second of two vectors, turned by the angle of the last numbers, and its cosine and sine."""
    c, s, _ = symmetric_eigen._turn(given[6], given[7])
    return (*symmetric_eigen._turned(given[:3], given[3:6], c, s)[1], c, s)


@pytest.mark.skipif(
    not (FP_CONTRACTION and binding.get_host_cpu_features().get("fma")),
    reason="no instruction has a product and a sum",
)
@pytest.mark.parametrize("real", REALS)
def test_which_product_of_a_turn_is_rounded(real):
    """Of c w + s u it is s u, however the compiler comes by it: results of runs depend on it."""
    given = np.random.default_rng(4).normal(size=(9, 160)).astype(real)
    found = run("lanes", turned_and_angle, given)
    c, s = found[3:]
    for u, w, out in zip(given[:3], given[3:6], found, strict=False):
        terms = zip(c.tolist(), w.tolist(), (s * u).tolist(), strict=True)
        fused = [float(Fraction(x) * Fraction(y) + Fraction(z)) for x, y, z in terms]
        assert (out == np.array(fused, real)).all()
        assert (out != c * w + s * u).any()

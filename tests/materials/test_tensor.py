"""3x3 tensors as scalars do what numpy's matrices do, on every engine."""

import numpy as np
import pytest

from tests.support.scalar_engines import ENGINES, run
from vgmpi.materials.tensor_math import tensor

REALS = (np.float32, np.float64)
N = 48


def matrices(seed, size=1.0, n=N):
    return np.random.default_rng(seed).normal(size=(n, 3, 3)) * size


def nine(m, real):
    """(n, 3, 3) -> (9, n)."""
    return np.ascontiguousarray(m.reshape(-1, 9).T.astype(real))


def square(t):
    """(9, n) or six rows of a symmetric one -> (n, 3, 3) in double; (1, n) -> (n,)."""
    if len(t) == 1:
        return t[0].astype(np.float64)
    if len(t) == 6:
        t = t[[0, 3, 4, 3, 1, 5, 4, 5, 2]]
    return t.T.reshape(-1, 3, 3).astype(np.float64)


B = (0.3, -1.2, 0.8, 2.0, 0.5, -0.7, 1.1, 0.9, -0.4)
# function of nine scalars, the same of matrices
CASES = {
    "transpose": (tensor.transpose, lambda m, b: m.transpose(0, 2, 1)),
    "product": (lambda a: tensor.product(a, B), lambda m, b: m @ b),
    "product_transposed": (lambda a: tensor.product_transposed(a, B), lambda m, b: m @ b.T),
    "cofactors": (
        tensor.cofactors,
        lambda m, b: np.linalg.det(m)[:, None, None] * np.linalg.inv(m).transpose(0, 2, 1),
    ),
    "inverse": (tensor.inverse, lambda m, b: np.linalg.inv(m)),
    "det": (
        lambda a: (tensor.det(a),),
        lambda m, b: np.linalg.det(m),
    ),
    "full": (lambda a: tensor.symmetric_to_full(a[:6]), lambda m, b: symmetric(m)),
}


def symmetric(m):
    return square(nine(m, np.float64)[:6])


@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("name", CASES)
def test_matrices(name, engine, real):
    function, same = CASES[name]
    m = matrices(1)
    m = m[np.abs(np.linalg.det(m)) > 0.3][:32].astype(real).astype(np.float64)
    got = square(run(engine, function, nine(m, real)))
    want = same(m, np.array(B).reshape(3, 3))
    assert np.abs(got - want).max() < 300 * np.finfo(real).eps


def moved(t):
    """b - I of the six first numbers after a step with fixed A."""
    a = (0.01, -0.2, 0.3, 0.1, 0.2, -0.1, 0.05, -0.3, 0.1)
    return tensor.moved_left_cauchy_green_minus_one(t[:6], a)


@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("engine", ENGINES)
def test_a_step_of_the_left_cauchy_green_tensor(engine, real):
    t = nine(matrices(2), real)
    F = np.eye(3) + np.array([[0.01, -0.2, 0.3], [0.1, 0.2, -0.1], [0.05, -0.3, 0.1]])
    b = square(t[:6]) + np.eye(3)
    got = square(run(engine, moved, t))
    assert np.abs(got - (F @ b @ F.T - np.eye(3))).max() < 60 * np.finfo(real).eps


@pytest.mark.parametrize("engine", ENGINES)
def test_small_steps_of_it_are_not_lost(engine):
    """An increment of 1e-9 on a strain of 1e-9, in single precision."""
    a = nine(matrices(3, 1e-9)[:16], np.float32)

    def step(t):  # b - I made of the numbers of A, so that one argument does
        return tensor.moved_left_cauchy_green_minus_one((t[0], t[4], t[8], t[1], t[2], t[5]), t)

    got = square(run(engine, step, a)).astype(np.float64)
    A = square(a)
    B = square(a[[0, 4, 8, 1, 2, 5]])
    want = B + A + A.transpose(0, 2, 1)
    assert np.abs(got - want).max() < 1e-6 * np.abs(want).max()


def test_the_volume_of_a_step_is_that_of_its_determinant():
    """The error is of third order: the volume rate alone would leave the second."""
    L = np.random.default_rng(7).normal(size=(200, 3, 3))
    for dt in (1e-2, 1e-3):
        wanted = np.linalg.slogdet(np.eye(3) + dt * L)[1]
        got = tensor.log_volume_change(tuple(L.reshape(-1, 9).T), dt)
        norm = dt * np.linalg.norm(L, axis=(1, 2))
        assert (np.abs(got - wanted) < norm**3).all()
        assert (np.abs(dt * np.trace(L, axis1=1, axis2=2) - wanted) > norm**3).mean() > 0.9


def test_a_steady_rotation_keeps_its_volume():
    """Particles move along the chords of a circle: their velocity has a divergence."""
    turn, dt = 1e-2, 1e-3
    rotation = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0]])
    L = (np.vstack([rotation, [0, 0, 1]]) - np.eye(3)) / dt
    assert np.trace(L) * dt == pytest.approx(-(turn**2), rel=1e-3)
    assert abs(tensor.log_volume_change(tuple(L.ravel()), dt)) < 1e-3 * turn**2

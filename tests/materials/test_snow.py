"""Snow against the formulas of Stomakhin et al. 2013: yield limits, plastic volume, hardening."""

import numpy as np
import pytest

from tests.support.plastic_step import EVERY_ENGINE, driven, plain
from vgmpi.materials.snow import Snow

SIDEWAYS = np.diag([1.0, 0, 0])


def snow(**keys):
    return Snow(kind="snow", **keys)


@EVERY_ENGINE
@pytest.mark.parametrize("step", [-1e-3, 1e-3])
def test_stretches_stay_at_their_limits(engine, real, step):
    table = snow()
    out = driven(table, engine, real, [(step * SIDEWAYS, 100)])
    limit = 1 - table.critical_compression if step < 0 else 1 + table.critical_stretch
    assert out[0] == pytest.approx(limit**2 - 1, rel=1e-5)
    assert np.abs(out[1:6]).max() == 0
    # the rest of the stretch is plastic
    assert out[6] == pytest.approx(100 * np.log1p(step) - np.log(limit), rel=1e-4)


@EVERY_ENGINE
@pytest.mark.parametrize("step", [-1e-3, 1e-3])
def test_hardening(engine, real, step):
    """tau = exp(xi (1 - Jp)) (lam + 2 mu) ln(limit), lam + 2 mu = E (1 - nu) / ((1 + nu) (1 - 2
    nu)).
    """
    table = snow(youngs_modulus=1e5, poisson_ratio=0.2, hardening_coefficient=8.0)
    out = driven(table, engine, real, [(step * SIDEWAYS, 100)])
    limit = 1 - table.critical_compression if step < 0 else 1 + table.critical_stretch
    Jp = (1 + step) ** 100 / limit
    stiff = np.exp(8 * (1 - Jp)) * 1e5 * 0.8 / (1.2 * 0.6)
    assert out[7] == pytest.approx(stiff * np.log(limit), rel=1e-3)
    assert out[14] >= stiff / table.density


@EVERY_ENGINE
@pytest.mark.parametrize("step", [-5e-3, 5e-3])
def test_hardening_has_a_limit(engine, real, step):
    table = snow(max_hardening_factor=4.0)
    law = table.law()
    out = driven(table, engine, real, [(step * SIDEWAYS, 100)])
    factor = out[7] / ((law.lam + 2 * law.mu) * (law.low if step < 0 else law.high))
    assert factor == pytest.approx(4.0 if step < 0 else 0.25, rel=1e-4)


@EVERY_ENGINE
def test_below_the_limits_it_is_elastic(engine, real):
    out = driven(snow(), engine, real, [(-1e-4 * SIDEWAYS, 200), (1e-4 * SIDEWAYS, 200)])
    assert out[6] == 0
    assert abs(out[0]) < 5e-6


def test_every_direction():
    """Random strains: no principal stretch leaves the range, elastic and plastic volume make up the
    whole.
    """
    random, table = np.random.default_rng(2), snow()
    f = np.zeros((16, 300))
    f[7:] = 0.05 * random.normal(size=(9, 300))
    out = np.array(plain(table.law(), f, 1.0))
    b = np.eye(3) + out[[0, 3, 4, 3, 1, 5, 4, 5, 2]].T.reshape(-1, 3, 3)
    stretch = np.sqrt(np.linalg.eigvalsh(b))
    assert stretch.min() > 1 - table.critical_compression - 1e-12
    assert stretch.max() < 1 + table.critical_stretch + 1e-12
    assert np.ptp(stretch) > 0.03
    whole = np.linalg.det(np.eye(3) + f[7:].T.reshape(-1, 3, 3))
    assert out[13] * np.exp(out[6]) == pytest.approx(whole, rel=1e-12)


def test_stress_of_hardened_snow_is_the_derivative_of_its_energy():
    law, h = snow().law(), 1e-6
    B = (-0.02, 0.004, -0.01, 0.003, -0.005, 0.002)
    zero = (0.0,) * 9
    for ln_jp in (-0.1, 0.2):
        tau = Snow.stress(law, (*B, ln_jp), zero)
        for a, slot in enumerate((0, 4, 8)):
            L = np.zeros(9)
            L[slot] = h
            from_here = [Snow.energy(law, (*moved(B, s * L), ln_jp)) for s in (1, -1)]
            want = (from_here[0] - from_here[1]) / (2 * h)
            assert tau[a] == pytest.approx(want, rel=1e-6, abs=1e-6 * law.mu)


def moved(B, A):
    b = np.eye(3) + np.array(B)[[0, 3, 4, 3, 1, 5, 4, 5, 2]].reshape(3, 3)
    move = np.eye(3) + A.reshape(3, 3)
    b = move @ b @ move.T - np.eye(3)
    return tuple(b[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]])

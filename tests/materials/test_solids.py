"""Plasticine and the corotated solid, held to numbers worked out by hand."""

import numba
import numpy as np
import pytest
from pydantic import ValidationError

from tests.materials.test_paste import REALS, states
from tests.support.law_driver import drive, engines_differ, nanoseconds, rest_of, stress_of
from vgmpi.materials import registry
from vgmpi.materials.material import HyperelasticMaterial
from vgmpi.materials.tensor_math import tensor


def plasticine(**keys):
    keys = {"youngs_modulus": 5e6, "yield_stress": 6e4, "residual_yield_stress": 2e4, **keys}
    return registry["plasticine"](kind="plasticine", softening_strain=0.3, **keys)


def tension(tau):
    s = tau - np.trace(tau) / 3 * np.eye(3)
    return np.sqrt(1.5 * (s * s).sum())


@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("dt", (1e-4, 1e-2))
def test_softening_curve(real, dt):
    """Stretched without change of volume: the stress in tension falls in a straight line over 0.3
    of plastic strain from 6e4 to 2e4 Pa, and stays there.
    """
    stuff = plasticine()
    L = np.diag([1.0, -0.5, -0.5])
    state, seen = rest_of(stuff), []
    for _ in range(20):
        state = drive(stuff, state, L, dt, round(0.02 / dt), real)
        worked = float(state[6])
        want = max(6e4 - (6e4 - 2e4) * worked / 0.3, 2e4)
        assert tension(stress_of(stuff, state, real)) == pytest.approx(want, rel=1e-3)
        seen.append(worked)
    assert seen[0] < 0.05 and seen[-1] > 0.35


def test_what_was_worked_stays_weak():
    """Unloaded and bent the other way it yields at the stress that is left."""
    stuff = plasticine()
    state = drive(stuff, rest_of(stuff), np.diag([1.0, -0.5, -0.5]), 1e-3, 150)
    left, worked = tension(stress_of(stuff, state)), state[6]
    assert 3e4 < left < 5e4
    back, dt = np.diag([-1.0, 0.5, 0.5]), left / (3 * stuff.law().mu) / 100
    unloaded = drive(stuff, state, back, dt, 150)
    assert unloaded[6] == worked  # half way to yielding on the other side
    assert drive(stuff, unloaded, back, dt, 100)[6] > worked


def test_it_must_not_soften_faster_than_it_unloads():
    with pytest.raises(ValidationError, match="faster than it can be unloaded"):
        plasticine(youngs_modulus=1e5)
    with pytest.raises(ValidationError, match="at most yield_stress"):
        plasticine(residual_yield_stress=7e4)


@pytest.mark.parametrize("real", REALS)
def test_engines_agree(real):
    stuff = plasticine()
    f = np.vstack([states(stuff), np.random.default_rng(3).uniform(0, 0.5, 960)])
    L = np.random.default_rng(2).normal(size=(3, 3))
    state, tau = engines_differ(stuff, f, L, 1e-3, real)
    law, eps = stuff.law(), np.finfo(real).eps
    print(f"{state / eps:.1f} eps, stress {tau / (law.lam + 2 * law.mu) / eps:.1f} eps")
    assert state < 10 * eps and tau < 30 * eps * (law.lam + 2 * law.mu)


def test_solids_hand_on_what_they_carry_beside_their_stretch():
    """Plain and compiled: H moves and tells the volume as it does alone."""
    h, L = np.random.default_rng(4).uniform(-0.1, 0.1, (2, 9)).tolist()
    for more in ((), (3.0,), (3.0, 5.0)):
        for function in (lambda f: f, numba.njit):
            advance, ratio = (
                function(HyperelasticMaterial.advance),
                function(HyperelasticMaterial.volume_ratio),
            )
            moved = advance(0.0, (*h, *more), tuple(L), 1e-3)
            assert moved[9:] == more
            assert moved[:9] == tensor.update_deformation_gradient(h, L, 1e-3)
            assert ratio(0.0, moved) == 1.0 + tensor.det_minus_one(moved[:9])


def test_corotated_is_the_polar_formula():
    """tau = 2 mu (F - R) F^T + lam (J - 1) J I with R by a singular value decomposition."""
    stuff = registry["corotated"](kind="corotated", youngs_modulus=1e6, poisson_ratio=0.3)
    law, random = stuff.law(), np.random.default_rng(1)
    for size in (1e-6, 1e-2, 0.3):
        H = random.uniform(-size, size, (3, 3))
        F = np.eye(3) + H
        u, _, v = np.linalg.svd(F)
        J = np.linalg.det(F)
        want = 2 * law.mu * (F - u @ v) @ F.T + law.lam * (J - 1) * J * np.eye(3)
        got = stress_of(stuff, tuple(H.flat))
        assert np.abs(got - want).max() < 1e-14 * law.mu


def test_elastic_solids_agree_where_strains_are_small():
    keys = {"youngs_modulus": 1e6, "poisson_ratio": 0.3}
    one = registry["corotated"](kind="corotated", **keys)
    other = registry["elastic"](kind="elastic", **keys)
    H = np.random.default_rng(2).uniform(-1, 1, (3, 3))
    apart = []
    for size in (1e-3, 1e-4):
        state = tuple((size * H).flat)
        a, b = stress_of(one, state), stress_of(other, state)
        apart.append(np.abs(a - b).max() / np.abs(a).max())
    assert apart[0] < 1e-2 and apart[1] == pytest.approx(apart[0] / 10, rel=0.1)


def test_price():
    f = np.vstack([states(plasticine()), np.zeros(960)])
    H = np.random.default_rng(3).uniform(-0.1, 0.1, (9, 960))
    corotated = registry["corotated"](kind="corotated", youngs_modulus=1e6)
    elastic = registry["elastic"](kind="elastic", youngs_modulus=1e6)
    fluid = registry["fluid"](kind="fluid")
    for stuff, given in ((plasticine(), f), (corotated, H), (elastic, H), (fluid, H[:1])):
        advance, stress = nanoseconds(stuff, given)
        print(f"{stuff.kind}: advance {advance:.1f} ns, stress {stress:.1f} ns per particle")
        assert advance + stress < 1000

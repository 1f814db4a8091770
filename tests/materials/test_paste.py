"""Paste and the flow beyond a yield stress (materials/tensor_math/viscoplastic_flow.py), held to
Herschel and Bulkley.

In steady simple shear tau = yield_stress + consistency_index rate^flow_index, whatever the time
step; below the yield stress nothing flows. Foam is the case of flow_index 1 behind Hencky's
elasticity.
"""

import numpy as np
import pytest
from scipy.optimize import brentq

from tests.support.law_driver import drive, engines_differ, nanoseconds, rest_of, stress_of
from vgmpi.materials import registry
from vgmpi.materials.tensor_math import viscoplastic_flow

REALS = (np.float32, np.float64)
STEPS = (1e-6, 1e-5, 1e-4, 1e-3, 1e-2)  # [s]


def paste(**keys):
    keys = {"yield_stress": 100.0, "consistency_index": 20.0, "shear_modulus": 1e4, **keys}
    return registry["paste"](kind="paste", **keys)


def foam(**keys):
    keys = {"yield_stress": 25.0, "viscosity": 4.0, "youngs_modulus": 5000.0, **keys}
    return registry["foam"](kind="foam", **keys)


def shear(rate):
    L = np.zeros((3, 3))
    L[0, 1] = rate
    return L


@pytest.mark.parametrize("flow_index", (0.2, 0.3, 0.5, 1.0, 1.5, 2.0))
def test_the_share_of_flow_solves_its_equation(flow_index):
    """a z^n + z = 1 by bisection, over 30 orders of magnitude of a."""
    for a in 10.0 ** np.linspace(-15, 15, 61):
        # excess 1, stiffness 1: K = a
        z = float(viscoplastic_flow.herschel_bulkley(1.0, 1.0, np.log(a), flow_index))

        def residual(u, a=a):
            return np.logaddexp(u, np.log(a) + flow_index * u)

        u = brentq(residual, -1000 / flow_index, 0.0, xtol=1e-14, rtol=1e-14)
        assert z == pytest.approx(np.exp(u), rel=1e-9 if flow_index < 0.3 else 1e-12, abs=1e-15)


def test_bingham_is_the_case_of_index_one():
    for excess, stiffness, viscosity in ((3.0, 1e-3, 5.0), (1e-6, 2.0, 0.1), (1e4, 1.0, 1.0)):
        z = viscoplastic_flow.herschel_bulkley(excess, stiffness, np.log(viscosity), 1.0)
        assert z == pytest.approx(viscoplastic_flow.bingham(stiffness, viscosity), rel=1e-13)


@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("flow_index", (0.3, 0.5, 1.0, 1.3))
def test_steady_shear_is_herschel_and_bulkley_at_any_step(real, flow_index):
    stuff, rate = paste(flow_index=flow_index), 5.0
    want = 100.0 + 20.0 * rate**flow_index
    found = []
    for dt in STEPS:
        steps = int(0.1 / dt)  # a shear of 0.5: yields at 0.01
        found.append(
            stress_of(stuff, drive(stuff, rest_of(stuff), shear(rate), dt, steps, real), real)
        )
    got = [tau[0, 1] for tau in found]
    print(f"n = {flow_index}, {real.__name__}: {np.array(got) / want}")
    assert got == pytest.approx([want] * 5, rel=0.01)
    # what pulls along the flow is of second order in stress and in strain per step
    for dt, tau in zip(STEPS, found, strict=True):
        assert abs(tau[0, 0] - tau[1, 1]) < 3 * want**2 / 1e4 + 1e4 * (dt * rate) ** 2


@pytest.mark.parametrize("real", REALS)
def test_foam_is_bingham_at_any_step(real):
    stuff, rate = foam(), 2.0
    want = 25.0 + 4.0 * rate
    for dt in (1e-5, 1e-4, 1e-3, 1e-2):
        state = drive(stuff, rest_of(stuff), shear(rate), dt, int(0.2 / dt), real)
        assert stress_of(stuff, state, real)[0, 1] == pytest.approx(want, rel=0.01)
        b = np.eye(3) + state[[0, 3, 4, 3, 1, 5, 4, 5, 2]].reshape(3, 3).astype(float)
        assert np.linalg.det(b) == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("stuff", (paste(), foam()))
def test_it_holds_its_yield_stress_at_rest(real, stuff):
    """Sheared to 90 % of the yield stress it keeps every digit; beyond, it creeps back to it."""
    mu = stuff.law().mu
    below = 0.9 * stuff.yield_stress / mu
    state = drive(stuff, rest_of(stuff), shear(below), 1e-2, 100, real)
    tau = stress_of(stuff, state, real)[0, 1]
    assert tau == pytest.approx(0.9 * stuff.yield_stress, rel=2e-3)
    later = drive(stuff, state, np.zeros((3, 3)), 1e-2, 20_000, real)
    assert stress_of(stuff, later, real)[0, 1] == pytest.approx(tau, rel=1e-6)
    beyond = drive(stuff, rest_of(stuff), shear(30 * below), 1e-3, 100, real)
    size = shear_stress(stress_of(stuff, beyond, real))
    assert size > 1.01 * stuff.yield_stress
    later = drive(stuff, beyond, np.zeros((3, 3)), 1e-2, 20_000, real)
    size = shear_stress(stress_of(stuff, later, real))
    assert size == pytest.approx(stuff.yield_stress, rel=1e-3)


def shear_stress(tau):
    s = tau - np.trace(tau) / 3 * np.eye(3)
    return np.sqrt(0.5 * (s * s).sum())


@pytest.mark.parametrize("stuff", (paste(), foam()))
def test_turning_while_flowing_turns_the_stress(stuff):
    """One step of L from Q b Q^T with Q L Q^T gives the turned stress."""
    random = np.random.default_rng(4)
    q, _ = np.linalg.qr(random.normal(size=(3, 3)))
    L = random.normal(size=(3, 3))
    one = drive(stuff, rest_of(stuff), L, 1e-3, 100)
    other = drive(stuff, rest_of(stuff), q @ L @ q.T, 1e-3, 100)
    tau = stress_of(stuff, one)
    assert shear_stress(tau) > stuff.yield_stress
    assert np.abs(stress_of(stuff, other) - q @ tau @ q.T).max() < 1e-9 * np.abs(tau).max()


def test_paste_keeps_the_volume_of_its_elastic_strain_at_one():
    stuff = paste()
    L, dt, steps = 10 * np.array([[0, 1, 0], [0.3, 0, 0], [0, 0.5, 0]]), 1e-3, 500
    state = drive(stuff, rest_of(stuff), L, dt, steps)
    b = np.eye(3) + state[1:][[0, 3, 4, 3, 1, 5, 4, 5, 2]].reshape(3, 3)
    assert np.linalg.det(b) == pytest.approx(1.0, abs=1e-5)
    space = steps * np.log(np.linalg.det(np.eye(3) + dt * L))
    assert state[0] == pytest.approx(space, rel=1e-4)


@pytest.mark.parametrize("stuff", (paste(), foam()))
def test_flow_takes_energy(stuff):
    """Over closed cycles of strain the work done on it is never given back."""
    random, dt = np.random.default_rng(5), 1e-3
    law, state, work = stuff.law(), rest_of(stuff), 0.0
    for _ in range(200):
        L = 20 * random.normal(size=(3, 3))
        L -= np.trace(L) / 3 * np.eye(3)
        state = type(stuff).advance(law, state, tuple(L.flat), dt)
        work += dt * (stress_of(stuff, state) * L).sum()
        assert work >= float(type(stuff).energy(law, state)) >= 0.0


def states(stuff, n=960, seed=1):
    """(channels, n) on both sides of the yield stress."""
    random = np.random.default_rng(seed)
    h = random.normal(size=(n, 3, 3)) * 10 ** random.uniform(-6, -1.3, n)[:, None, None]
    F = np.eye(3) + h
    J = np.linalg.det(F)
    b = F @ F.transpose(0, 2, 1)
    volume = "theta" in stuff.carries
    b = b / (np.cbrt(J) ** 2)[:, None, None] if volume else b
    b -= np.eye(3)
    six = [b[:, i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
    return np.array([np.log(J), *six] if volume else six)


@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("stuff", (paste(flow_index=0.4), foam()))
def test_engines_agree(real, stuff):
    L = np.random.default_rng(2).normal(size=(3, 3))
    law = stuff.law()
    stiff = law.k * law.gamma if hasattr(law, "k") else law.lam + 2 * law.mu
    state, tau = engines_differ(stuff, states(stuff), L, 1e-3, real)
    eps = np.finfo(real).eps
    print(f"{real.__name__}: {state / eps:.1f} eps, stress {tau / stiff / eps:.1f} eps")
    assert state < 10 * eps and tau < 20 * eps * stiff
    assert np.isfinite(tau)


def test_price():
    for stuff in (paste(flow_index=0.4), foam()):
        advance, stress = nanoseconds(stuff, states(stuff))
        print(f"{stuff.kind}: advance {advance:.1f} ns, stress {stress:.1f} ns per particle")
        assert advance + stress < 1000

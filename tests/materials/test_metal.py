"""Metal against the theory of von Mises: yield stress, slope of hardening, volume, unloading."""

import numpy as np
import pytest

from tests.support.plastic_step import EVERY_ENGINE, driven
from vgmpi.materials.von_mises import Metal

E, NU, Y, H = 1e9, 0.25, 1e6, 2e7
MU = E / (2 * (1 + NU))
STEP = 1e-5
PULL = STEP * np.diag([1.0, -0.5, -0.5])


def metal(**keys):
    given = {"youngs_modulus": E, "poisson_ratio": NU, "yield_stress": Y, "hardening_modulus": H}
    return Metal(kind="metal", **(given | keys))


def difference(out):
    """Axial minus lateral stress: what a bar under tension bears."""
    return out[7] - out[8]


def strain(steps):
    """Axial strain of `steps` pulls at constant volume: 2/3 of axial minus lateral."""
    return steps * (np.log1p(STEP) - np.log1p(-STEP / 2)) * 2 / 3


@EVERY_ENGINE
def test_tension_below_the_yield_stress_is_elastic(engine, real):
    out = driven(metal(), engine, real, [(PULL, 70)])
    assert difference(out) == pytest.approx(3 * MU * strain(70), rel=1e-3)
    assert 0.7 * Y < difference(out) < Y
    assert out[6] == 0


@EVERY_ENGINE
def test_tension_reaches_the_yield_stress(engine, real):
    out = driven(metal(hardening_modulus=0), engine, real, [(PULL, 500)])
    assert difference(out) == pytest.approx(Y, rel=1e-4)
    assert out[6] == pytest.approx(strain(500) - Y / (3 * MU), rel=1e-3)
    assert out[13] == pytest.approx(1, abs=1e-6)


@EVERY_ENGINE
def test_slope_of_hardening(engine, real):
    """d sigma / d eps = 3 mu H / (3 mu + H), and the stress is Y + H times the plastic strain."""
    few, many = (driven(metal(), engine, real, [(PULL, n)]) for n in (300, 1300))
    slope = (difference(many) - difference(few)) / (strain(1300) - strain(300))
    assert slope == pytest.approx(3 * MU * H / (3 * MU + H), rel=2e-3)
    assert difference(many) == pytest.approx(Y + H * many[6], rel=1e-4)


@EVERY_ENGINE
def test_it_springs_back_and_yields_again_where_it_stopped(engine, real):
    there = driven(metal(), engine, real, [(PULL, 500)])
    partly = driven(metal(), engine, real, [(PULL, 500), (-PULL, 50)])
    again = driven(metal(), engine, real, [(PULL, 500), (-PULL, 50), (PULL, 50)])
    assert difference(there) - difference(partly) == pytest.approx(3 * MU * strain(50), rel=2e-3)
    assert partly[6] == there[6]
    assert difference(again) == pytest.approx(difference(there), rel=2e-4)


@EVERY_ENGINE
def test_pressure_alone_does_not_yield(engine, real):
    out = driven(metal(), engine, real, [(-1e-3 * np.eye(3), 50)])
    K = E / (3 * (1 - 2 * NU))
    assert out[6] == 0
    assert out[7:10] == pytest.approx(3 * K * 50 * np.log1p(-1e-3), rel=1e-4)


@EVERY_ENGINE
def test_shear(engine, real):
    """Simple shear: |tau_xy| reaches Y / sqrt(3)."""
    L = np.zeros((3, 3))
    L[0, 1] = STEP
    out = driven(metal(hardening_modulus=0), engine, real, [(L, 1000)])
    assert out[10] == pytest.approx(Y / np.sqrt(3), rel=1e-4)

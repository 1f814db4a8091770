"""Motion that is restored: what a pass through the grid takes, and gives back."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.simulate import begin, by_id, totals
from vgmpi.planning.plan import MAX_CORRECTION_INTERVAL

SCENE = """
[domain]
size = [0.4, 0.32, 0.32]
cell = 0.02
gravity = [0, 0, -9.8]
[time]
end = 1
cfl = CFL
[accuracy]
precision = "double"
transfer = "apic-corrected"
[material.water]
kind = "fluid"
[material.rubber]
kind = "elastic"
youngs_modulus = 1e5
[[object]]
name = "drop"
material = "water"
shape = { sphere = { center = [0.14, 0.16, 0.16], radius = 0.06 } }
[[object]]
name = "cube"
material = "rubber"
shape = { box = [[0.2, 0.1, 0.1], [0.3, 0.2, 0.2]] }
"""


def simulation(folder, velocity=None, cfl=0.4):
    return begin(folder, SCENE.replace("CFL", str(cfl)), velocity=velocity)[0]


def test_what_is_given_back_has_no_momentum(tmp_path):
    """Nor angular momentum, nor does it move anything or cost time."""
    random = np.random.default_rng(1)
    run = simulation(tmp_path, lambda x: random.normal(0.0, 1.0, x.shape))
    before, (x, v) = totals(run), by_id(run, "x", "v")
    run.correct_transfers(1e-4)
    after, (moved, given) = totals(run), by_id(run, "x", "v")
    assert np.abs(given - v).max() > 1.0, "it does nothing"
    assert (moved == x).all() and run.time == 0.0
    scale = np.abs(v).sum(1).mean() * before["mass"]
    assert np.abs(after["momentum"] - before["momentum"]).max() < 1e-13 * scale
    assert np.abs(after["angular"] - before["angular"]).max() < 1e-13 * scale


def test_affine_motion_loses_nothing(tmp_path):
    """Of bodies that touch nothing: there is nothing to give back."""
    A = np.array([[0.5, 2, 0], [-1, 0.3, 1], [0, 0.7, -0.2]])
    run = simulation(tmp_path, lambda x: x @ A.T)
    for group in run.groups:
        at = group.index()
        group.put("C", at, np.tile(A.ravel(), (len(at), 1)))
    (v,) = by_id(run, "v")
    run.correct_transfers(1e-4)
    assert np.abs(by_id(run, "v")[0] - v).max() < 1e-13


def test_a_smooth_motion_gets_back_what_a_transfer_takes(tmp_path):
    """N steps of no time lose N times what one does, to first order: that is given back."""

    def wave(x):
        return np.stack([np.sin(20 * x[:, 2]), np.zeros(len(x)), np.zeros(len(x))], 1)

    left = []
    for restored in (False, True):
        run = simulation(tmp_path, wave)
        run.advance(1e-9)  # velocities are now what nodes know
        (start,) = by_id(run, "v")
        run.plan = replace(run.plan, correction_interval=MAX_CORRECTION_INTERVAL if restored else 0)
        for _ in range(
            MAX_CORRECTION_INTERVAL + 1
        ):  # of which the last but one begins by giving back
            run.advance(1e-9)
        left.append(float(np.sqrt(((by_id(run, "v")[0] - start) ** 2).mean())))
    lost, still = left
    assert still < 0.5 * lost, left


@pytest.mark.parametrize("cfl, every", [(0.1, 3), (0.4, 3), (0.5, 2), (0.65, 2), (0.7, 1), (1, 1)])
def test_how_often(tmp_path, cfl, every):
    assert simulation(tmp_path, cfl=cfl).plan.correction_interval == every

"""Sparse liquid: the part of the divergence that its volume follows, by the filled fraction."""

import numpy as np
import pytest

from tests.support.bsplines import quadratic_bspline
from tests.support.engine_pair import beside, worst
from tests.support.simulate import begin, by_id
from tests.support.small_scenes import MIXES_WITH_MILK, SEEPS_THROUGH_GRAINS, WEIGHTLESS
from vgmpi.kernels.transfer.liquid_volume import (
    FULL_RESPONSE_FILL,
    LEAST_RESPONSE,
    LEAST_RESPONSE_FILL,
)

SPRAY = (
    WEIGHTLESS
    + """
[accuracy]
pressure = "explicit"
precision = "double"
transfer = "apic"
volume_correction = "VOLUME"
[material.water]
kind = "KIND"
[[object]]
name = "body"
material = "water"
shape = { box = [[0, 0, 0], [0.06, 0.06, 0.06]] }
[[object]]
name = "drop"
material = "water"
shape = { box = [[0.15, 0.15, 0.15], [0.16, 0.16, 0.16]] }
"""
)
MILK = (
    MIXES_WITH_MILK
    + """
[[object]]
name = "guest"
material = "milk"
shape = { box = [[0.02, 0.02, 0.02], [0.03, 0.03, 0.03]] }
[[object]]
name = "drop of milk"
material = "milk"
shape = { box = [[0.15, 0.05, 0.15], [0.16, 0.06, 0.16]] }
"""
)
SAND = (
    SEEPS_THROUGH_GRAINS
    + """
[[object]]
name = "bed"
material = "grains"
shape = { box = [[0, 0, 0], [0.04, 0.06, 0.06]] }
"""
)
OTHERS = {"": "", "mixing": MILK, "drag": SAND}  # phases that share space with the spray
RATE, DT = 0.5, 1e-4  # [1/s] of the expansion, [s]


def expanding(folder, kind="fluid", volume="none", others=""):
    """The two engines on a body in a corner of walls and a lone drop, which expand alike."""
    keys = f'{kind}"\npreset = "jam' if kind == "paste" else kind
    text = SPRAY.replace("KIND", keys).replace("VOLUME", volume) + others
    simulation, made = begin(folder, text)
    C = np.tile(RATE * np.eye(3).ravel(), (len(made.x), 1))
    v = RATE * made.x  # as the mirror images beyond the walls at 0
    return made, beside(simulation.plan, made.colliders, made.x, v, made.vol0, made.object, C=C)


@pytest.mark.parametrize(
    "kind, volume, others",
    [
        *((k, v, "") for k in ("fluid", "paste") for v in ("none", "density", "shifting")),
        *(("fluid", v, others) for others in OTHERS if others for v in ("none", "shifting")),
    ],
)
def test_engines_agree_in_spray(tmp_path, kind, volume, others):
    _, engines = expanding(tmp_path, kind, volume, OTHERS[others])
    for _ in range(12):
        for engine in engines:
            engine.advance(DT)
    assert max(worst(*engines).values()) < 1e-12


def test_a_lone_drop_follows_the_least_part_and_a_body_all(tmp_path):
    made, engines = expanding(tmp_path)
    for engine in engines:
        engine.advance(DT)
        x, J = by_id(engine, "x", "J")
        drop = made.object == 1
        interior = (x < 0.045).all(1)
        assert J[drop] - 1.0 == pytest.approx(LEAST_RESPONSE * 3 * RATE * DT, rel=1e-3)
        assert J[interior] - 1.0 == pytest.approx(3 * RATE * DT, rel=1e-3)
        assert np.linalg.norm(x, axis=1).min() < 0.01  # also in the corner of three walls


def test_a_drop_in_another_liquid_follows_all(tmp_path):
    made, engines = expanding(tmp_path, others=MILK)
    for engine in engines:
        engine.advance(DT)
        x, J = by_id(engine, "x", "J")
        whole = (made.object == 0) & (x < 0.045).all(1) | (made.object == 2)
        assert whole.sum() > 50
        assert J[whole] - 1.0 == pytest.approx(3 * RATE * DT, rel=1e-3)
        lone = (made.object == 1) | (made.object == 3)
        assert lone.sum() == 2
        assert J[lone] - 1.0 == pytest.approx(LEAST_RESPONSE * 3 * RATE * DT, rel=1e-3)


def test_the_fills_lie_below_those_of_surfaces():
    """Half a spacing below a flat surface 0.61 to 0.66 is filled."""
    nodes, depth = np.arange(-9, 3), 0.25 + 0.5 * np.arange(18)
    for phase in np.linspace(0.0, 1.0, 9):
        mass = 0.5 * quadratic_bspline(phase - depth[:, None] - nodes).sum(0)
        flat = (quadratic_bspline(phase - 0.25 - nodes) * mass).sum()
        assert FULL_RESPONSE_FILL < 0.61 < flat < 0.66
        assert flat**2 > 0.9 * FULL_RESPONSE_FILL  # along an edge
        assert flat**3 > 2.0 * LEAST_RESPONSE_FILL  # at a corner

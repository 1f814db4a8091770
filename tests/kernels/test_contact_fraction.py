"""A flow loses the less of its approach to a surface, the farther a node is from it."""

import numpy as np
import pytest

from tests.kernels.test_contact import ALL3, Node, meeting
from vgmpi.kernels.grid import contact_impulses
from vgmpi.solver.engines.numpy_reference import contact as plain


@pytest.mark.parametrize("distance, fraction", [
    (-1.5, 1.0), (0.0, 1.0), (0.25, 1.0), (0.45, 0.75), (0.65, 0.5), (1.0, 0.0625), (1.05, 0.0),
    (1.7, 0.0),
])  # fmt: skip
def test_a_flow_loses_less_of_its_approach_farther_from_a_surface(distance, fraction):
    """All of it within a quarter of a cell, none beyond 1.05 cells; two surfaces, or none: all."""
    flow = meeting(distance, -distance, known=False)
    assert contact_impulses.contact_fraction(flow) == pytest.approx(fraction)
    assert plain._contact_fraction(distance) == pytest.approx(fraction)
    for known, one_resolved in ((True, True), (False, False)):
        m = flow._replace(both_resolved=known, one_resolved=one_resolved)
        assert contact_impulses.contact_fraction(m) == 1.0


@pytest.mark.parametrize("fraction", [0.3, 0.8])
def test_a_pair_keeps_the_rest_of_its_approach(fraction):
    """The approach left is what the pair keeps, momentum is exact, energy never rises."""
    approached = 0
    for seed in range(200):
        node = Node(seed, 2, [(0, 1)], friction=0.0, fraction=fraction)
        before, after = node.approach(node.v)[0], node.resolve()
        remains = (1.0 - fraction) * before if before > 0.0 else before
        assert node.approach(after)[0] == pytest.approx(remains, abs=1e-12)
        node.check(after)
        approached += before > 0.0
    assert 50 < approached < 150


def test_pairs_that_keep_some_approach_are_resolved_as_in_plain_numpy():
    """Three phases, one of which keeps a part of its approach to both others."""
    for seed in range(100):
        node = Node(seed, 3, ALL3, spread=1.0)
        node.fraction[:] = (1.0, 0.5, 0.2)
        still = (None, np.zeros(3), np.zeros(4), 1.0)
        pairs = [
            (a, b, n, mu, part, still)
            for (a, b, n, mu), part in zip(node.pairs, node.fraction, strict=True)
        ]
        twin = node.v.copy()
        plain._resolve(twin, node.m, pairs)
        assert node.resolve() == pytest.approx(twin, rel=1e-9, abs=1e-11)

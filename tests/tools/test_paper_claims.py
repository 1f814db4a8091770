"""What is measured of the gallery's runs, on particles whose answer is known."""

from types import SimpleNamespace

import numpy as np
import pytest

from tests.benchmarks.paper.paper_claims import concentration_variance, heap_slope


class Given:
    """A run with particles that are given: name -> (n, 3) [m]."""

    cell = 0.01

    def __init__(self, **bodies):
        self.bodies = bodies
        self.run = SimpleNamespace(times=[0.0])

    def positions(self, name, frame=-1):
        return self.bodies[name]


def grid(*ends):
    """Particles half a centimetre apart (n, 3) [m] from 0 to ends [m]."""
    axes = [np.arange(0.0025, end, 0.005) for end in ends]
    return np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)


@pytest.mark.parametrize("degrees", [15.0, 32.0])
def test_the_flanks_of_a_cone_have_its_slope(degrees):
    x = grid(0.6, 0.6, 0.3)
    height = 0.2 * np.tan(np.radians(degrees))
    out = np.linalg.norm(x[:, :2] - 0.3, axis=1)
    cone = x[x[:, 2] < height * (1 - out / 0.2)]
    assert heap_slope(Given(castle=cone)) == pytest.approx(degrees, abs=1.5)


def test_liquids_apart_and_mixed():
    x = grid(0.2, 0.2, 0.2)
    low = x[:, 2] < 0.1
    apart, higher = concentration_variance(Given(heavy=x[low], light=x[~low]))
    assert apart == pytest.approx(1.0) and higher == pytest.approx(0.1)
    every = np.arange(len(x)) % 2 == 0
    mixed, higher = concentration_variance(Given(heavy=x[every], light=x[~every]))
    assert mixed < 1e-9 and abs(higher) < 0.01

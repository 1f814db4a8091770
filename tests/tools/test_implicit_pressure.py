"""The study of implicit pressures in the plane: what its table rests on."""

import numpy as np

from tests.benchmarks import implicit_pressure
from tests.benchmarks.plane_liquid import GHOSTS, PlaneLiquid, divergence, push, solve_pressure


def test_water_at_rest_has_hydrostatic_pressure():
    """rho g h, to 1.5 % of the floor's (rms), after 5 s; it does not sink by 1 %."""
    liquid, measured = implicit_pressure.pool_at_rest(10, {})
    assert measured["pressure"] < 0.015 and abs(measured["sunk"]) < 0.01
    assert liquid.steps < 500


def test_sweeps_solve_the_system():
    """Nodes of a full box that moves at random have no divergence after 400 sweeps."""
    n = (8, 6)
    shape = tuple(k + 1 + 2 * GHOSTS for k in n)
    rng = np.random.default_rng(0)
    inverse_mass, filled = np.zeros(shape), np.zeros(shape)
    inner = tuple(slice(GHOSTS, GHOSTS + k + 1) for k in n)
    cells = tuple(slice(GHOSTS, GHOSTS + k) for k in n)
    inverse_mass[inner], filled[cells] = rng.uniform(0.5, 2.0, (n[0] + 1, n[1] + 1)), 1.0
    u = np.zeros((2, *shape))
    u[:, GHOSTS + 1 : GHOSTS + n[0], GHOSTS + 1 : GHOSTS + n[1]] = rng.normal(size=(2, 7, 5))
    before, p, after = np.zeros(shape), np.zeros(shape), np.zeros(shape)
    divergence(u, n, filled, before)
    active = filled > 0
    solve_pressure(p, -before, filled, inverse_mass, active, 0.0, 1.0, n, 400, 0.01)
    push(p, filled, inverse_mass, u, n, 1.0)
    divergence(u, n, filled, after)
    assert np.abs(after).max() < 1e-3 * np.abs(before).max()


def test_an_implicit_pressure_keeps_momentum():
    """A drop that flies keeps its momentum to rounding."""
    x = implicit_pressure.lattice(8, 14, 8, 14)
    v = np.tile([3.0, 1.0], (len(x), 1)) + 0.5 * (x - x.mean(0))
    liquid = PlaneLiquid((24, 24), x, v, 1e4, 0.0)
    before = liquid.v.sum(0)
    liquid.advance(0.5)
    assert np.abs(liquid.v.sum(0) - before).max() < 1e-11 * np.abs(before).max()

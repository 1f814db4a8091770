"""Multigrid conjugate gradients of the implicit pressure: their twin in NumPy, and symmetry."""

import numpy as np
import pytest

from tests.support import dense_multigrid
from tests.support.simulate import advance, begin
from vgmpi.features.implicit_pressure.pressure_solver import PressureSolver

# an odd number of cells along two axes, a stick wall, water in a corner and in the air
SCENE = """
[domain]
size = [0.34, 0.42, 0.38]
cell = 0.02
boundary = { default = "slip", south = "stick" }
[time]
end = 0.2
frames = 3
[accuracy]
precision = "double"
pressure = "implicit"
[material.water]
kind = "fluid"
max_speed = 2
[[object]]
name = "pool"
material = "water"
shape = { box = [[0, 0, 0], [0.16, 0.42, 0.24]] }
[[object]]
name = "drop"
material = "water"
velocity = [-0.5, 0.2, 0]
shape = { sphere = { center = [0.26, 0.2, 0.28], radius = 0.05 } }
"""


def dense(solver, values, size, axes=1):
    """Numbers of the blocks on the grid of the domain, from one cell before it on."""
    shape = [n + size for n in solver.domain]
    grid = np.zeros((axes, *shape))
    values = values.reshape(-1, axes, 64)[: solver.count]
    offsets = np.stack(np.unravel_index(np.arange(64), (4, 4, 4)), 1)
    index = 4 * solver.lattice.block[:, None] + offsets
    inside = ((index >= 0) & (index < shape)).all(2)
    for a in range(axes):
        grid[a][tuple(index[inside].T)] = values[:, a][inside]
    return grid if axes > 1 else grid[0]


@pytest.fixture
def recorded(tmp_path, monkeypatch):
    """Steps of the scene: (level of the twin, right-hand side, first phi, last phi, solver)."""
    solve, steps = PressureSolver.solve, []

    def record(self, phi):
        level = self.level
        response = dense(self, level.inverse, 2, 3).copy()
        system = dense_multigrid.Level(response, dense(self, level.scale, 1) > 0)
        before = [dense(self, values, 1).copy() for values in (level.residual, phi)]
        solve(self, phi)
        steps.append((system, *before, dense(self, phi, 1).copy(), self))

    monkeypatch.setattr(PressureSolver, "solve", record)
    simulation, _ = begin(tmp_path, SCENE)
    advance(simulation, 0.06)
    assert len(steps) > 4
    return steps


def test_the_solution_is_that_of_numpy(recorded):
    """To 1e-12 of the largest potential, in each step."""
    for system, right, first, phi, _ in recorded:
        expected = dense_multigrid.conjugate_gradients(system, right, first)
        assert np.abs(phi - expected).max() < 1e-12 * np.abs(expected).max()


def test_the_cycle_is_symmetric_and_positive(recorded):
    """Conjugate gradients need a symmetric preconditioner."""
    system = recorded[-1][0]
    cycle = dense_multigrid.Multigrid(system).cycle
    a, b = (
        system.times(np.random.default_rng(seed).normal(size=system.wet.shape) * system.wet)
        for seed in (1, 2)
    )
    za, zb = cycle(a), cycle(b)
    assert (a * zb).sum() == pytest.approx((b * za).sum(), rel=1e-9)
    assert (a * za).sum() > 0

"""Multigrid conjugate gradients of the implicit pressure: their twin in NumPy, and symmetry."""

import numpy as np
import pytest

from tests.support import dense_multigrid
from tests.support.dense_multigrid import dense_values
from tests.support.simulate import advance, begin
from vgmpi.features.implicit_pressure.coupling import ImplicitPressure
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


@pytest.fixture
def recorded(tmp_path, monkeypatch):
    """Steps of the scene: (level of the twin, right-hand side, first phi, last phi, solver)."""
    solve, steps = PressureSolver.solve, []

    def record(self, phi):
        level = self.level
        response = dense_values(self, level.inverse, 2, 3).copy()
        system = dense_multigrid.Level(response, dense_values(self, level.scale, 1) > 0)
        before = [dense_values(self, values, 1).copy() for values in (level.residual, phi)]
        solve(self, phi)
        steps.append((system, *before, dense_values(self, phi, 1).copy(), self))

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


PADDLE = """
[[object]]
name = "paddle"
role = "scenery"
collider = true
shape = { box = [[0.06, 0.1, -0.2], [0.12, 0.3, 0.16]] }
motion = { velocity = [0.2, 0.1, 0.3], angular_velocity = "30 rpm", axis = "y" }
"""


def free_part(distance):
    """Part of a node that a face at a distance [cells] leaves, by quadratic splines."""
    d = np.clip(distance, -1.5, 1.5)
    near = 0.5 + 0.75 * d - d**3 / 3
    return np.select([d <= -0.5, d >= 0.5], [(d + 1.5) ** 3 / 6, 1 - (1.5 - d) ** 3 / 6], near)


def curved(distance):
    """Distances [cells], moved by an eighth of their second differences where these are known."""
    around = np.pad(distance, 1, constant_values=np.inf)
    total = -6 * np.where(np.isfinite(distance), distance, 0.0)
    for axis in range(3):
        for side in (0, 2):
            place = [slice(1, -1)] * 3
            place[axis] = slice(side, side + distance.shape[axis])
            total = total + around[tuple(place)]
    return np.where(np.isfinite(total) & (np.abs(distance) < 2), distance + total / 8, distance)


def share_beyond(distance, axis):
    """What a collider has of the nodes beyond walls across an axis, 1 elsewhere.

    distance: of the collider from the nodes [cells], of which the first are beyond the lower walls
    and the last on the upper ones, which it does not come near.
    """
    d = np.moveaxis(distance, axis, 0)
    share = np.ones_like(d)
    share[0] = share[-1] = 0
    share[1] = 1 - free_part(d[0])
    return np.moveaxis(share, 0, axis)


def thin_and_closed(nodes, fill):
    """Nodes of walls of two or three cells, and those of them next to a face without liquid.

    nodes: normals and distances [cells], (4, ...); fill: filled part of the nodes.
    """
    thin, closed = np.zeros(fill.shape, bool), np.zeros(fill.shape, bool)
    for place in np.argwhere((nodes[3] < -0.25) & (nodes[3] > -1.5)):
        around = tuple(slice(i - 1, i + 2) for i in place)
        near = (nodes[3][around] > -1.01) & np.isfinite(nodes[3][around])
        normals, wet = nodes[:3][(slice(None), *around)][:, near].T, fill[around][near] > 0.05
        outside, opposite = nodes[3][around][near] > -0.01, normals @ normals.T < -0.5
        thin[tuple(place)] = opposite.any()
        dry = outside & ~wet & ~((outside & wet)[None, :] & ~opposite).any(1)
        closed[tuple(place)] = opposite.any() and dry.any()
    return thin, closed


def node_values(solver, rows, values, size, default=0.0):
    """Dense grid of values (n, 64, size) that only the blocks with a row have."""
    every = np.full((solver.count, 64, size), default)
    every[rows >= 0] = values[rows[rows >= 0]]
    return dense_values(solver, every.transpose(0, 2, 1).reshape(-1), 2, size)


def test_colliders_share_nodes_as_in_numpy(tmp_path, monkeypatch):
    """Responses and right-hand side beside a collider that moves, to 1e-12."""
    couple_nodes, solve, steps = ImplicitPressure.couple_nodes, PressureSolver.solve, []

    def record(self, nodes, span, gravity):
        solver, rows, dx = self.solver, nodes.blocks.solid, self.plan.dx
        velocity = node_values(
            solver, np.arange(solver.count), nodes.velocities.reshape(-1, 64, 4), 4
        )
        normals = node_values(solver, rows, self.colliders.nodes, 4, np.inf)
        normals[3] /= dx
        moves = node_values(solver, rows, self.colliders.moves, 3) / dx
        steps.append([velocity[:3] / dx, velocity[3] / self.liquids.mass_of_cell, normals, moves])
        couple_nodes(self, nodes, span, gravity)

    def record_system(self, phi):
        fields = (self.level.inverse, 2, 3), (self.level.residual, 1), (self.level.scale, 1)
        if len(steps[-1]) == 4:  # later ones of a step have open cells
            steps[-1] += [dense_values(self, *field).copy() for field in fields]
        solve(self, phi)

    monkeypatch.setattr(ImplicitPressure, "couple_nodes", record)
    monkeypatch.setattr(PressureSolver, "solve", record_system)
    text = SCENE.replace('name = "pool"', 'name = "pool"\nsubtract = true') + PADDLE
    advance(begin(tmp_path, text)[0], 0.04)
    for v, mass, nodes, moves, inverse, right, scale in steps:
        places = np.indices(mass.shape) - 1
        last = np.array(mass.shape).reshape(3, 1, 1, 1) - 2
        at_wall, south = (places == 0) | (places == last), places[1] == 0
        wet, distance = mass * 2.0 ** at_wall.sum(0), nodes[3]
        thin, closed = thin_and_closed(nodes, wet)
        free = free_part(np.where(thin, distance, curved(distance)))
        free = np.where(closed, 0.0, free)
        share = np.where(wet > 1e-9, np.where(free < 0.5, np.minimum(free, wet), free), 0)
        share = np.where(share < 1e-3, 0, share)
        is_held = (places <= 0) | (places >= last) | south
        response = np.where(is_held | (mass <= 1e-9), 0, share**2 / np.maximum(mass, 1e-9))
        beyond = np.stack([share_beyond(distance, a) for a in range(3)])
        part = np.where(is_held, np.minimum(1 - share, beyond), 1 - share)
        flow = share * v + np.where(free >= 1, 0, part * moves)
        expected = -dense_multigrid.divergence(flow) * (scale > 0)
        assert (free < 0.4).any() and np.abs(expected).max() > 0
        assert np.abs(inverse - response).max() < 1e-12 * response.max()
        assert np.abs(right - expected).max() < 1e-12 * np.abs(expected).max()

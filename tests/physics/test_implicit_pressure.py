"""An implicit pressure: the projection itself, water at rest, waves, and the board's water cases.

The numbers from outside are those of the explicit pressure's tests: hydrostatics, Lamb's period of
a standing wave, Koshizuka and Oka's front of a collapsing column, and the volume of the water.
"""

import numpy as np
import pytest

import vgmpi
from tests.physics import test_hydrostatic, test_slosh
from tests.support.simulate import advance, begin, by_id, totals
from vgmpi.features.implicit_pressure import pressure_solver
from vgmpi.tools.bench.board.board_cases import CASES
from vgmpi.tools.bench.board.board_run import timed_run
from vgmpi.tools.bench.board.vgmpi_board_solver import Solver

IMPLICIT = 'pressure = "implicit"'
DROPS = """
[domain]
size = [0.32, 0.24, 0.24]
cell = 0.02
gravity = [0, 0, 0]
[time]
end = 0.2
frames = 41
[accuracy]
precision = "double"
pressure = "implicit"
[material.water]
kind = "fluid"
[[object]]
name = "slow"
material = "water"
shape = { sphere = { center = [0.19, 0.12, 0.12], radius = 0.05 } }
[[object]]
name = "fast"
material = "water"
velocity = [0.8, 0.1, 0]
shape = { box = [[0.06, 0.08, 0.08], [0.12, 0.16, 0.16]] }
"""


def test_momentum_is_exact(tmp_path):
    """Two drops that collide far from walls."""
    simulation, _ = begin(tmp_path, DROPS)
    before = totals(simulation)["momentum"]
    advance(simulation, 0.12)
    after = totals(simulation)["momentum"]
    assert simulation.step >= 10
    assert np.abs(after - before).max() < 1e-12 * np.abs(before).max()


def nodal_grid(simulation, values, size):
    """Numbers of node blocks (blocks, 64, size) on the grid of the domain's nodes."""
    grid = np.zeros((*(n + 1 for n in simulation.plan.cells), size))
    offsets = np.stack(np.unravel_index(np.arange(64), (4, 4, 4)), 1)
    index = 4 * simulation.exchange.tables.coordinates[:, None] - 1 + offsets
    inside = ((index >= 0) & (index <= simulation.plan.cells)).all(2)
    grid[tuple(index[inside].T)] = values[inside]
    return grid


def divergence_matrix(cells, shape):
    """Divergence of nodal velocities (nodes, 3) in the cells (n, 3), dense."""
    matrix = np.zeros((len(cells), *shape, 3))
    for row, cell in zip(matrix, cells, strict=True):
        for corner in np.ndindex(2, 2, 2):
            sign = np.where(np.array(corner) == 1, 0.25, -0.25)
            row[tuple(cell + corner)] += sign
    return matrix.reshape(len(cells), -1)


def test_iterations_converge_to_the_projection(tmp_path, monkeypatch):
    """With 30 iterations the nodes have the velocities that NumPy's dense solution has."""
    monkeypatch.setattr(pressure_solver, "ITERATIONS", 30)
    simulation, _ = begin(tmp_path, DROPS)
    advance(simulation, 0.05)
    stage, grids = simulation.features["implicit_pressure"], []
    couple_nodes = type(stage).couple_nodes

    def recorded(self, nodes, span, gravity):
        velocities = nodes.velocities[: self.solver.count].reshape(-1, 64, 4)
        grids.append(nodal_grid(simulation, velocities, 4))
        couple_nodes(self, nodes, span, gravity)
        grids.append(nodal_grid(simulation, velocities, 4))

    monkeypatch.setattr(type(stage), "couple_nodes", recorded)
    simulation.advance(0.002)
    before, after = grids
    filled = stage.fields.filled[: 64 * stage.solver.count].reshape(-1, 64, 1)
    cells = np.argwhere(nodal_grid(simulation, filled, 1)[..., 0] > 0)
    mass = before[..., 3] / stage.liquids.mass_of_cell
    inverse = np.where(mass > 1e-9, 1.0 / np.maximum(mass, 1e-9), 0.0)
    inverse = np.repeat(inverse.reshape(-1, 1), 3, 1).reshape(-1)
    matrix = divergence_matrix(cells, mass.shape)
    v = before[..., :3].reshape(-1)
    phi = np.linalg.lstsq((matrix * inverse) @ matrix.T, -matrix @ v, rcond=None)[0]
    expected = v + inverse * (matrix.T @ phi)
    assert len(cells) > 50 and np.abs(matrix @ v).max() > 1e-3
    assert np.abs(matrix @ expected).max() < 1e-9
    wet = inverse > 0
    assert np.abs(after[..., :3].reshape(-1) - expected)[wet].max() < 1e-6 * np.abs(v).max()


COLUMN = """
[domain]
size = [0.96, 0.08, {height}]
cell = 0.01
[time]
end = 0.1
frames = 2
[accuracy]
pressure = "implicit"
[material.water]
kind = "fluid"
max_speed = 4
[[object]]
name = "column"
material = "water"
shape = {{ box = [[0, 0, 0], [0.64, 0.08, {depth}]] }}
"""


@pytest.mark.parametrize(
    "cells", [64, *(pytest.param(n, marks=pytest.mark.slow) for n in (128, 256))]
)
def test_divergence_that_is_left(tmp_path, monkeypatch, cells):
    """A column that collapses, from no pressure on: at most 1.5 % of the divergence (rms)."""
    solve, left = pressure_solver.PressureSolver.solve, []

    def record(self, phi):
        phi[:] = 0
        right = np.linalg.norm(self.level.residual)
        solve(self, phi)
        left.append(float(np.linalg.norm(self.level.residual)) / right)

    monkeypatch.setattr(pressure_solver.PressureSolver, "solve", record)
    text = COLUMN.format(depth=cells / 100, height=cells / 80)
    advance(begin(tmp_path, text)[0], 0.06)
    assert len(left) > 5 and max(left) < 0.015


@pytest.mark.parametrize("times_as_deep", [1, 4])
def test_water_at_rest(tmp_path, times_as_deep):
    """The pressure is rho g (H - z) to 0.5 % of rho g H, 16 and 64 cells deep, and the water does
    not move.
    """
    depth = times_as_deep * test_hydrostatic.H
    text = test_hydrostatic.SCENE.format(
        ramp="", end=1.0, precision="single", initial_pressure="hydrostatic"
    ).replace('pressure = "explicit"', IMPLICIT)
    text = text.replace("0.16", repr(depth)).replace("0.2]", f"{depth + 0.04:g}]")
    heights = test_hydrostatic.HEIGHTS
    for k, z in enumerate(heights):
        text += test_hydrostatic.PROBE.format(name=f"p{k}", z=z * depth)
    middle = []
    scene = vgmpi.load(tmp_path / "rest.toml", text=text)
    run = vgmpi.run(scene, on_frame=lambda now: middle.append(now.array("positions")[:, 2].mean()))
    assert run.code == 0
    assert np.ptp(middle) < 1e-3 * depth
    for k, z in enumerate(heights):
        pressure = [row["pressure"] for row in run.probes[f"p{k}"] if row["time"] > 0.5]
        assert np.mean(pressure) / (1000 * 9.8 * depth) == pytest.approx(1 - z, abs=0.005)


@pytest.mark.parametrize("cells, max_error, min_left", [(20, 0.03, 0.95), (40, 0.01, 0.99)])
def test_waves_do_not_lock(tmp_path, cells, max_error, min_left):
    """With 8 particles per cell: Lamb's period, and what a period leaves of the amplitude."""
    period, left = test_slosh.sloshing(tmp_path, cells, IMPLICIT, particles=8)
    assert abs(period / test_slosh.PERIOD - 1) < max_error
    assert left > min_left


@pytest.mark.parametrize(
    "name, max_error, max_steps", [("dam_break", 0.04, 600), ("level", 0.01, 1500)]
)
def test_water_cases_of_the_board(name, max_error, max_steps):
    """The errors of explicit runs (0.029, 0.002) in an eighth of their steps (2783, 13371)."""
    case, solver = CASES[name], Solver(name, {"accuracy.pressure": "implicit"})
    run = timed_run(solver, case)
    assert run["error"] < max_error
    assert run["steps"] < max_steps


def test_the_pressure_of_vortices(tmp_path):
    """Particles carry the pressure of the flow: rho U^2 / 4 (cos 2kx + cos 2kz) in a full box."""
    speed, edge = 0.5, 0.24  # [m/s], [m]
    k, half = np.pi / edge, speed / 2
    simulation, _ = begin(
        tmp_path,
        f"""
[domain]
size = [{edge}, 0.04, {edge}]
cell = 0.01
gravity = [0, 0, 0]
[time]
end = 1
frames = 2
[accuracy]
{IMPLICIT}
[material.water]
kind = "fluid"
max_speed = 1
[[object]]
name = "water"
material = "water"
initial_pressure = "zero"
shape = {{ box = [[0, 0, 0], [{edge}, 0.04, {edge}]] }}
velocity_mode = [
  {{ amplitude = [{half}, 0, {-half}], wave_vector = [{k}, 0, {k}] }},
  {{ amplitude = [{half}, 0, {half}], wave_vector = [{k}, 0, {-k}] }},
]
""",
    )
    advance(simulation, 0.03)
    x, pressure = by_id(simulation, "x", "pressure")
    exact = 250 * speed**2 * (np.cos(2 * k * x[:, 0]) + np.cos(2 * k * x[:, 2]))
    error = (pressure - pressure.mean()) - exact
    assert np.sqrt((error**2).mean()) < 0.06 * exact.std()

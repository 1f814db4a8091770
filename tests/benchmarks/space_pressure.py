"""python -m tests.benchmarks.space_pressure CASE: the solver with an implicit pressure, on trial.

Water cases of the board with the solver's own transfers and walls, and a stage between the update
of the nodes and the gathering that finds the pressures of the cells as `plane_liquid` does. The
liquid's own pressure is turned off by a stiffness of almost nothing. It is a trial on one rank and
one thread: pressures lie on a grid of the whole tank, and positions are corrected after the step.
"""

import argparse
import time

import numpy as np
from numba import njit

from vgmpi.apps.bench.board.board_cases import CASES, GRAVITY, BoardState
from vgmpi.apps.bench.board.vgmpi_board_solver import Solver
from vgmpi.solver import simulation as steps
from vgmpi.solver.step_to_target import next_step

DENSITY = 1000.0  # [kg/m3]
SURFACE_FILL = 0.5  # cells with less have no pressure
MAX_EIGENVALUE = 8 / 3  # of the system, each row over its diagonal
MAX_MOVE = 0.3  # [cells] of a particle by the correction of positions
SWEEPS, LEAST = (20, 10), (0.05, 0.1)  # of pressures and of positions: number, least eigenvalue
# the liquid's own pressure does nothing; and what the default does for it
SOFT = {
    "material.water.max_speed": 0.002,
    "accuracy.transfer": "apic",
    "accuracy.volume_correction": "none",
}
FASTMATH = {"cache": True, "fastmath": True}


@njit(**FASTMATH)
def push(p, filled, inverse_mass, spans, dt, u):
    """Add to the nodes what the pressures of their cells do within dt.

    Args:
        p, filled: Pressures and filled shares; cell (i, j, k) is at (i + 1, j + 1, k + 1).
        inverse_mass: Of each node and axis, 0 where it may not move, shape (3, ...).
        spans: Nodes of each column along z up to the highest that has liquid, shape (...).
        dt: Time step [s].
        u: Velocities of the nodes [cells/s], shape (3, ...) (in/out).
    """
    q = p * filled
    for i in range(spans.shape[0]):
        for j in range(spans.shape[1]):
            for k in range(spans[i, j]):
                a, b = q[i, j, k], q[i, j, k + 1]
                c, d = q[i, j + 1, k], q[i, j + 1, k + 1]
                e, f = q[i + 1, j, k], q[i + 1, j, k + 1]
                g, h = q[i + 1, j + 1, k], q[i + 1, j + 1, k + 1]
                t = np.float32(0.25) * dt
                u[0, i, j, k] += t * inverse_mass[0, i, j, k] * (a + b + c + d - e - f - g - h)
                u[1, i, j, k] += t * inverse_mass[1, i, j, k] * (a + b + e + f - c - d - g - h)
                u[2, i, j, k] += t * inverse_mass[2, i, j, k] * (a + c + e + g - b - d - f - h)


@njit(**FASTMATH)
def divergence(u, spans, out):
    """Divergence of nodal velocities in the cells of each column."""
    for i in range(spans.shape[0] - 1):
        for j in range(spans.shape[1] - 1):
            last = max(spans[i, j], spans[i + 1, j], spans[i, j + 1], spans[i + 1, j + 1])
            for k in range(last):
                x = u[0, i + 1, j, k] + u[0, i + 1, j + 1, k] - u[0, i, j, k] - u[0, i, j + 1, k]
                x += u[0, i + 1, j, k + 1] + u[0, i + 1, j + 1, k + 1]
                x -= u[0, i, j, k + 1] + u[0, i, j + 1, k + 1]
                y = u[1, i, j + 1, k] + u[1, i + 1, j + 1, k] - u[1, i, j, k] - u[1, i + 1, j, k]
                y += u[1, i, j + 1, k + 1] + u[1, i + 1, j + 1, k + 1]
                y -= u[1, i, j, k + 1] + u[1, i + 1, j, k + 1]
                z = u[2, i, j, k + 1] + u[2, i + 1, j, k + 1] - u[2, i, j, k] - u[2, i + 1, j, k]
                z += u[2, i, j + 1, k + 1] + u[2, i + 1, j + 1, k + 1]
                z -= u[2, i, j + 1, k] + u[2, i + 1, j + 1, k]
                out[i + 1, j + 1, k + 1] = np.float32(0.25) * (x + y + z)


@njit(**FASTMATH)
def solve_pressure(p, right, filled, inverse_mass, active, spans, dt, sweeps, least):
    """Chebyshev sweeps for dt D M^-1 D^T V p dt = right in the active cells, from p on."""
    u = np.zeros_like(inverse_mass)
    response, step, scale = np.zeros_like(p), np.zeros_like(p), np.zeros_like(p)
    share = inverse_mass[0] + inverse_mass[1] + inverse_mass[2]
    for i in range(spans.shape[0] - 1):
        for j in range(spans.shape[1] - 1):
            for k in range(share.shape[2] - 1):
                if active[i + 1, j + 1, k + 1]:
                    own = 0.0
                    for a in range(2):
                        for b in range(2):
                            own += share[i + a, j + b, k] + share[i + a, j + b, k + 1]
                    own /= 16
                    scale[i + 1, j + 1, k + 1] = 1.0 / (dt * dt * own * filled[i + 1, j + 1, k + 1])
    middle, half = 0.5 * (MAX_EIGENVALUE + least), 0.5 * (MAX_EIGENVALUE - least)
    rho, weight, inertia = half / middle, 1.0 / middle, 0.0
    for sweep in range(sweeps):
        u[:] = 0
        push(p, filled, inverse_mass, spans, dt, u)
        divergence(u, spans, response)
        if sweep:
            following = 1.0 / (2.0 * middle / half - rho)
            inertia, weight = following * rho, 2.0 * following / half
            rho = following
        w, v = np.float32(weight), np.float32(inertia)
        for i in range(p.shape[0]):
            for j in range(p.shape[1]):
                for k in range(p.shape[2]):
                    residual = right[i, j, k] - dt * response[i, j, k]
                    step[i, j, k] = w * scale[i, j, k] * residual + v * step[i, j, k]
                    p[i, j, k] += step[i, j, k]


@njit(**FASTMATH)
def move_particles(x, places, xi, moves, n, unit):
    """Move particles by the displacements of the nodes.

    Args:
        x: Positions, shape (particles, 3) [cells].
        places: Places of the particles in xi.
        xi: Fixed-point positions, shape (3, ...) (in/out).
        moves: Displacements, shape (3, ...) [cells].
        n: Cells along each axis.
        unit: Fixed-point units in a cell.
    """
    w, at, sign = np.empty((3, 3)), np.empty((3, 3), np.int64), np.empty((3, 3))
    for p in range(len(x)):
        for a in range(3):
            base = int(np.floor(x[p, a] - 0.5))
            r = x[p, a] - 0.5 - base
            w[a, 0], w[a, 1], w[a, 2] = 0.5 * (1 - r) ** 2, 0.75 - (r - 0.5) ** 2, 0.5 * r * r
            for i in range(3):  # the image of a node beyond a wall
                node = abs(base + i)
                at[a, i] = node if node <= n[a] else 2 * n[a] - node
                sign[a, i] = 1.0 if at[a, i] == base + i else -1.0
        way = np.zeros(3)
        for i in range(3):
            for j in range(3):
                for k in range(3):
                    weight = w[0, i] * w[1, j] * w[2, k]
                    way[0] += weight * sign[0, i] * moves[0, at[0, i], at[1, j], at[2, k]]
                    way[1] += weight * sign[1, j] * moves[1, at[0, i], at[1, j], at[2, k]]
                    way[2] += weight * sign[2, k] * moves[2, at[0, i], at[1, j], at[2, k]]
        for a in range(3):
            moved = x[p, a] + min(max(way[a], -MAX_MOVE), MAX_MOVE)
            moved = min(max(moved, 1e-4), n[a] - 1e-4)
            xi[a, places[p]] += int(np.rint((moved - x[p, a]) * unit))


class ImplicitPressure:
    """The stage: called in the place of the coupling at surfaces, and after each step."""

    def __init__(self, simulation: steps.Simulation):
        self.simulation, self.n = simulation, np.array(simulation.plan.cells)
        self.shape = tuple(self.n + 2)
        self.pressure = np.zeros(self.shape, np.float32)
        self.moves = np.zeros((3, *self.shape), np.float32)
        self.cells = tuple(slice(1, k + 1) for k in self.n)
        self.tables = None
        self.seconds = [0.0, 0.0]  # of the processor: pressures, correction of positions

    def __call__(self, engine, slip, pins, bodies, dt, gravity):
        """Change the velocities of the nodes, and find the displacements of the next correction."""
        began = time.process_time()
        dx = self.simulation.plan.dx
        nodes, (i, j, k) = self._find_nodes(engine)
        rows = nodes[self.inside]
        mass = np.zeros(self.shape, np.float32)
        mass[i, j, k] = rows[:, 3] / (DENSITY * dx**3)
        u = np.zeros((3, *self.shape), np.float32)
        u[:, i, j, k] = rows[:, :3].T / dx
        filled, inverse_mass, spans = self._fill_cells(mass)
        active = filled >= SURFACE_FILL
        step = np.float32(dt)
        response = np.zeros(self.shape, np.float32)
        divergence(u, spans, response)
        self.pressure *= active
        right = np.where(active, -step * response, np.float32(0))
        system = filled, inverse_mass, active, spans
        solve_pressure(self.pressure, right, *system, step, SWEEPS[0], np.float32(LEAST[0]))
        push(self.pressure, filled, inverse_mass, spans, step, u)
        rows[:, :3] = dx * u[:, i, j, k].T
        nodes[self.inside] = rows
        excess = self._find_excess(filled, active)
        potential = np.zeros(self.shape, np.float32)
        one = np.float32(1)
        solve_pressure(potential, excess, *system, one, SWEEPS[1], np.float32(LEAST[1]))
        self.moves[:] = 0
        push(potential, filled, inverse_mass, spans, one, self.moves)
        self.seconds[0] += time.process_time() - began

    def _find_nodes(self, engine):
        """Return the nodes of this rank, (blocks, 64, 4), and the indices of those in the tank."""
        tables = engine.tables
        nodes = engine.layers["momentum"].nodes[: len(tables.phase)].reshape(-1, 64, 4)
        if tables is not self.tables:
            self.tables = tables
            corner = 4 * np.repeat(tables.at, np.diff(tables.first), axis=0) - 1
            index = corner[:, None] + np.stack(np.unravel_index(np.arange(64), (4, 4, 4)), 1)
            self.inside = ((index >= 0) & (index <= self.n)).all(2)
            self.index = tuple(index[self.inside].T)
        return nodes, self.index

    def _fill_cells(self, mass):
        """Return filled shares of cells, inverse masses by axis, and the spans of columns."""
        full, n = mass.copy(), self.n
        inverse_mass = np.zeros((3, *self.shape), np.float32)
        np.divide(1, mass, out=inverse_mass[0], where=mass > 1e-9)
        inverse_mass[1:] = inverse_mass[0]
        for axis in range(3):  # nodes on walls stand for half a cell, and stay on them
            ends = np.moveaxis(full, axis, 0)
            ends[[0, n[axis]]] *= 2
            np.moveaxis(inverse_mass[axis], axis, 0)[[0, n[axis]]] = 0
        filled = np.zeros(self.shape, np.float32)
        for a in (0, 1):
            for b in (0, 1):
                for c in (0, 1):
                    filled[self.cells] += full[a : n[0] + a, b : n[1] + b, c : n[2] + c] / 8
        wet = mass[: n[0] + 1, : n[1] + 1, : n[2] + 1] > 0
        spans = np.where(wet.any(2), n[2] + 1 - wet[:, :, ::-1].argmax(2), 0)
        return filled, inverse_mass, spans

    def _find_excess(self, filled, active):
        """Return what cells hold above 1; below 1 only where all neighbors hold liquid."""
        n, inside = self.n, np.ones(self.n, bool)
        neighbors = np.pad(active[self.cells], 1, constant_values=True)
        for a in range(3):
            for b in range(3):
                for c in range(3):
                    inside &= neighbors[a : n[0] + a, b : n[1] + b, c : n[2] + c]
        excess = np.where(active, filled - 1, np.float32(0))
        excess[self.cells] = np.where(inside, excess[self.cells], np.maximum(excess[self.cells], 0))
        return excess

    def correct_positions(self) -> None:
        """Move the particles, and forget the volume that they integrated."""
        began = time.process_time()
        for group in self.simulation.groups:
            places = group.index()
            x = group.positions() / self.simulation.plan.dx
            move_particles(x, places, group.xi, self.moves, self.n, 2.0**group.bits)
            group.f[group.plan.channels.first("theta"), places] = 0
        self.seconds[1] += time.process_time() - began


def run_case(name: str, cell: float | None, cfl: float) -> str:
    """Return a row of the table: the case with an implicit pressure."""
    options: dict = SOFT | {"time.cfl": cfl} | ({} if cell is None else {"domain.cell": cell})
    case, solver = CASES[name], Solver(name, options)
    couple_surfaces = steps.couple_surfaces
    try:
        for end in (case.interval, case.end):  # the first compiles
            steps.couple_surfaces = couple_surfaces
            solver.restart()
            simulation = solver.simulation
            stage = ImplicitPressure(simulation)
            steps.couple_surfaces = stage
            simulation.max_stray -= 1.2 * MAX_MOVE
            x, v = solver.state()
            measure, began = case.measure(solver.volume, x, solver.cell), time.process_time()
            for k in range(1, round(end / case.interval) + 1):
                advance(solver, stage, k * case.interval, cfl)
                measure.record(BoardState(simulation.time, *solver.state()))
            seconds = time.process_time() - began
    finally:
        steps.couple_surfaces = couple_surfaces
    result = ", ".join(f"{key} {value:.4f}" for key, value in measure.result().items())
    solve, move = (value / case.end for value in stage.seconds)
    return (
        f"| {name} | {1e3 * solver.cell:.1f} | {simulation.step:,} | {seconds / case.end:.2f} |"
        f" {solve:.2f} | {move:.2f} | {result} |"
    )


def advance(solver: Solver, stage: ImplicitPressure, goal: float, cfl: float) -> None:
    """Advance to a time [s]; what falls through a cell has the speed that bounds a step, too."""
    simulation, cell = solver.simulation, solver.cell
    while simulation.time < goal:
        bound = min(simulation.bound(), cfl * cell / np.sqrt(2 * GRAVITY * cell))
        dt, lands = next_step(simulation.time, goal, bound)
        simulation.advance(dt, end=goal if lands else None)
        stage.correct_positions()


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("cases", nargs="+", choices=("dam_break", "level", "splash"))
    parser.add_argument("--cell", type=float, help="[m]; default: that of the scene")
    parser.add_argument("--cfl", type=float, default=0.4, help="cells per step, default 0.4")
    args = parser.parse_args()
    print("| case | cell [mm] | steps | s / s | of it pressures | positions | measured |")
    print("|---|---|---|---|---|---|---|")
    for name in args.cases:
        print(run_case(name, args.cell, args.cfl), flush=True)


if __name__ == "__main__":
    main()

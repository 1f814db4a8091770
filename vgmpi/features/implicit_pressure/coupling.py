"""Implicit pressure of liquids in a step: sweeps that make the nodal velocities divergence-free.

The nodes have the velocities of all other forces. A first system finds the pressures of the cells,
and a second one the displacements that spread what crowds; particles take both up when they gather
(pressure_transfer.py). The number of sweeps is fixed, so that all ranks agree.
See docs/explanation/implicit-pressure.md.
"""

import numpy as np

from vgmpi.features.active_feature import ActiveFeature, NodeState, StartContext
from vgmpi.kernels.step_records import StepSpan
from vgmpi.parallel.block_lattice import BLOCK_EDGE
from vgmpi.parallel.block_ownership import BlockDirectory
from vgmpi.parallel.cell_exchange import cell_topology
from vgmpi.parallel.exchange_topology import ExchangeTopology, counting_owner

from . import pressure_system
from .plan import DISPLACEMENT
from .pressure_solver import PressureSolver
from .pressure_system import pressure_fields
from .pressure_transfer import PARTICLE_PRESSURE


class ImplicitPressure(ActiveFeature):
    """Implicit pressure at the nodes of a rank."""

    couples_nodes = True

    def __init__(self, context: StartContext, solver: PressureSolver):
        """Take the constants of a plan, which has one liquid of one density, and its solver."""
        plan = self.plan = context.plan
        self.lattice, self.ranks, self.threads = context.lattice, context.ranks, context.threads
        group = next(group for group in plan.groups if group.volume.separate_pressure)
        self.mass_of_cell = group.density * plan.dx**3
        # relative pressure of a particle per potential of a cell and inverse time step
        self.stiffness = float(group.law.k) / (group.density * plan.dx**2)  # type: ignore[attr-defined]
        self.solver = solver

    def set_topology(self, tables: ExchangeTopology, census: BlockDirectory) -> None:
        """Take new tables after a sort.

        Args:
            tables: Topology of this rank.
            census: Segments of this rank and nearby ones.
        """
        rank, real = self.ranks.rank, self.plan.real
        cells = cell_topology(tables, census, self.lattice, rank)
        index = (
            BLOCK_EDGE * tables.coordinates[:, None]
            - 1
            + np.stack(np.unravel_index(np.arange(64), (BLOCK_EDGE,) * 3), 1)
        )
        inside = ((index >= 0) & (index < self.plan.cells)).all(2)
        cells = cells._replace(region=cells.region & inside, counted=cells.counted & inside)
        self.solver.set_topology(tables.coordinates, cells, counting_owner(tables, rank))
        self.blocks = len(tables.coordinates)
        self.fields = pressure_fields(self.blocks, real)
        self.fields.region[: 64 * self.blocks] = cells.region.reshape(-1)
        self.beyond = (~inside).astype(real).reshape(-1)

    def couple_nodes(self, nodes: NodeState, span: StepSpan, gravity: np.ndarray) -> None:
        """Change the velocities of the nodes in a step, and find the displacements.

        Args:
            nodes: Nodes of the rank.
            span: The step.
            gravity: Acceleration, shape (3,) [m/s2].
        """
        fields, plan, dt, solver = self.fields, self.plan, span.dt, self.solver
        level, lattice, exchange = solver.level, solver.lattice, solver.exchange
        assert exchange is not None
        velocity, pressure = nodes.velocities, nodes.fields[PARTICLE_PRESSURE].nodes
        walls, real, blocks = nodes.walls, plan.real.type, nodes.block_rows
        solver.take_rows(nodes.each, nodes.call, blocks, blocks)
        solver.each(
            blocks, pressure_system.set_nodes, lattice, walls.cells, walls.kinds, velocity,
            pressure, self.mass_of_cell, plan.dx, fields, level,
        )  # fmt: skip
        guess_scale = real(dt * self.stiffness)
        solver.each(blocks, pressure_system.set_cells, lattice, guess_scale, fields, level)
        exchange.exchange(fields.filled)
        cells, wet = self._find_wet_blocks()
        exchange.exchange(fields.phi)
        solver.take_rows(nodes.each, nodes.call, cells, wet)
        solver.solve(fields.phi)
        solver.respond(fields.phi)
        solver.each(wet, pressure_system.add_velocities, plan.dx, level, velocity)
        scale = real(1.0 / (dt * self.stiffness))
        solver.each(wet, pressure_system.store_node_pressure, lattice, scale, fields)
        count = 64 * self.blocks
        fields.cover[:count] = fields.filled[:count] + self.beyond
        solver.each(cells, pressure_system.set_excess, lattice, fields, level)
        solver.find_moves()
        moves = nodes.gathered[DISPLACEMENT]
        moves[:] = 0
        solver.each(wet, pressure_system.store_moves, fields, level, moves)

    def _find_wet_blocks(self) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """Return the blocks that have cells with pressure, and those next to them, by thread."""
        count, threads, solver = self.blocks, self.threads, self.solver
        wet = np.zeros(count + 1, bool)
        wet[:count] = (self.fields.filled[: 64 * count].reshape(count, 64) > 0).any(1)
        reached = wet[solver.lattice.low.reshape(count, 8)].any(1)
        own = wet[:count] & (solver.level.scale[: 64 * count].reshape(count, 64) > 0).any(1)
        shares = [np.array_split(np.flatnonzero(rows), threads) for rows in (own, reached)]
        return shares[0], shares[1]

"""Implicit pressure of liquids in a step: sweeps that make the nodal velocities divergence-free.

The nodes have the velocities of all other forces. A first system finds the pressures of the cells,
and a second one the displacements that spread what crowds; particles take both up when they gather
(pressure_transfer.py). The number of sweeps is fixed, so that all ranks agree.
See docs/explanation/implicit-pressure.md.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from vgmpi.features.active_feature import ActiveFeature, NodeState, StartContext
from vgmpi.kernels.step_records import StepSpan
from vgmpi.parallel.block_lattice import BLOCK_EDGE
from vgmpi.parallel.block_ownership import BlockDirectory
from vgmpi.parallel.cell_exchange import CellExchange, cell_topology
from vgmpi.parallel.exchange_topology import ExchangeTopology
from vgmpi.runtime.aligned_arrays import aligned_zeros

from . import pressure_system
from .plan import DISPLACEMENT
from .pressure_system import Lattice, PressureFields
from .pressure_transfer import PARTICLE_PRESSURE

MAX_EIGENVALUE = 8.0 / 3.0  # of the system in space, each row over its diagonal
# With fewer blocks, one thread sweeps faster than two that wait for each other at every sweep: two
# save about 6 us per block and step, and wait 4.8 ms (vgmpi bench board --only dam_break splash).
SHARED_BLOCKS = 800
FIELD_SIZES = {"u": 192, "inverse": 192}  # numbers of a block; 64 in all other fields


class Sweeps(NamedTuple):
    """Chebyshev sweeps over a system."""

    number: int
    min_eigenvalue: float  # [-] below it, the sweeps do little


PRESSURE_SWEEPS, POSITION_SWEEPS = Sweeps(20, 0.05), Sweeps(10, 0.1)


def chebyshev_factors(sweeps: Sweeps) -> list[tuple[float, float]]:
    """Return (factor of the residual, factor of the last change) of each sweep.

    References:
        Golub and Varga 1961: Chebyshev semi-iterative methods. Numer. Math. 3, 147-156.
    """
    middle = 0.5 * (MAX_EIGENVALUE + sweeps.min_eigenvalue)
    half = 0.5 * (MAX_EIGENVALUE - sweeps.min_eigenvalue)
    rho, factors = half / middle, [(1.0 / middle, 0.0)]
    for _ in range(sweeps.number - 1):
        following = 1.0 / (2.0 * middle / half - rho)
        factors.append((2.0 * following / half, following * rho))
        rho = following
    return factors


class ImplicitPressure(ActiveFeature):
    """Implicit pressure at the nodes of a rank."""

    couples_nodes = True

    def __init__(self, context: StartContext):
        """Take the constants of a plan, which has one liquid of one density."""
        plan = self.plan = context.plan
        self.lattice, self.ranks, self.threads = context.lattice, context.ranks, context.threads
        group = next(group for group in plan.groups if group.volume.separate_pressure)
        self.mass_of_cell = group.density * plan.dx**3
        # relative pressure of a particle per potential of a cell and inverse time step
        self.stiffness = float(group.law.k) / (group.density * plan.dx**2)  # type: ignore[attr-defined]
        self.exchange: CellExchange | None = None
        systems = PRESSURE_SWEEPS, POSITION_SWEEPS
        self.sweeps = [np.array(chebyshev_factors(s), plan.real) for s in systems]
        self.fields = self._make_fields(0)

    def _make_fields(self, blocks: int) -> PressureFields:
        """Return fields of zeros with room for some blocks and the row of no block."""
        return PressureFields(
            *(aligned_zeros((blocks + 1) * FIELD_SIZES.get(name, 64), self.plan.real)
              for name in PressureFields._fields)
        )  # fmt: skip

    def set_topology(self, tables: ExchangeTopology, census: BlockDirectory) -> None:
        """Take new tables after a sort.

        Args:
            tables: Topology of this rank.
            census: Segments of this rank and nearby ones.
        """
        cells = cell_topology(tables, census, self.lattice, self.ranks.rank)
        if self.exchange is not None:
            self.exchange.link.close()
        self.exchange = CellExchange(self.ranks, cells, self.plan.real)
        count = len(tables.coordinates)
        if len(self.fields.mass) < 64 * (count + 1):
            self.fields = self._make_fields(count + count // 4)
        for values in self.fields:
            values[:] = 0
        grid = cells.neighbors.reshape(count, 3, 3, 3)
        index = (
            BLOCK_EDGE * tables.coordinates[:, None]
            - 1
            + np.stack(np.unravel_index(np.arange(64), (BLOCK_EDGE,) * 3), 1)
        )
        inside = ((index >= 0) & (index < self.plan.cells)).all(2)
        self.beyond = (~inside).astype(self.plan.real).reshape(-1)
        self.grid = Lattice(
            tables.coordinates,
            grid[:, 1::-1, 1::-1, 1::-1].reshape(-1),
            grid[:, 1:, 1:, 1:].reshape(-1),
            cells.neighbors.reshape(-1),
            (cells.region & inside).astype(self.plan.real).reshape(-1),
        )
        self.blocks = count

    def couple_nodes(self, nodes: NodeState, span: StepSpan, gravity: np.ndarray) -> None:
        """Change the velocities of the nodes in a step, and find the displacements.

        Args:
            nodes: Nodes of the rank.
            span: The step.
            gravity: Acceleration, shape (3,) [m/s2].
        """
        self.nodes, fields, plan, dt = nodes, self.fields, self.plan, span.dt
        assert self.exchange is not None
        velocity, pressure = nodes.velocities, nodes.fields[PARTICLE_PRESSURE].nodes
        walls, real, blocks = nodes.walls, plan.real.type, nodes.block_rows
        self._each(
            blocks, pressure_system.set_nodes, self.grid, walls.cells, walls.kinds, velocity,
            pressure, self.mass_of_cell, plan.dx, fields,
        )  # fmt: skip
        self._each(blocks, pressure_system.set_cells, self.grid, real(dt * self.stiffness), fields)
        self.exchange.exchange(fields.filled)
        cells, wet = self._find_wet_blocks()
        self.exchange.exchange(fields.phi)
        self._solve(cells, wet, 0)
        self._each(wet, pressure_system.respond, self.grid, fields)
        self._each(wet, pressure_system.add_velocities, plan.dx, fields, velocity)
        scale = real(1.0 / (dt * self.stiffness))
        self._each(wet, pressure_system.store_node_pressure, self.grid, scale, fields)
        count = 64 * self.blocks
        fields.cover[:count] = fields.filled[:count] + self.beyond
        fields.phi[:] = 0
        self._each(cells, pressure_system.set_excess, self.grid, fields)
        self._solve(cells, wet, 1)
        self._each(wet, pressure_system.respond, self.grid, fields)
        moves = nodes.gathered[DISPLACEMENT]
        moves[:] = 0
        self._each(wet, pressure_system.store_moves, fields, moves)

    def _find_wet_blocks(self) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """Return the blocks that have cells with pressure, and those next to them, by thread."""
        count, threads = self.blocks, self.threads
        wet = np.zeros(len(self.fields.filled) // 64, bool)
        wet[:count] = (self.fields.filled[: 64 * count].reshape(count, 64) > 0).any(1)
        reached = wet[self.grid.low.reshape(count, 8)].any(1)
        own = wet[:count] & (self.fields.scale[: 64 * count].reshape(count, 64) > 0).any(1)
        shares = [np.array_split(np.flatnonzero(rows), threads) for rows in (own, reached)]
        return shares[0], shares[1]

    def _solve(self, cells: list[np.ndarray], nodes: list[np.ndarray], system: int) -> None:
        """Relax a system from phi on; phi is known on all cells around those of this rank."""
        factors = self.sweeps[system]
        assert self.exchange is not None
        if self.threads == 1 or sum(map(len, cells)) < SHARED_BLOCKS:
            cells, nodes = [np.concatenate(cells)], [np.concatenate(nodes)]
            if not self.exchange.has_neighbors:  # one call in place of many
                self._each(cells, pressure_system.sweep, nodes[0], self.grid, factors, self.fields)
                return
        for weight, inertia in factors:
            self._each(nodes, pressure_system.respond, self.grid, self.fields)
            self._each(cells, pressure_system.relax, self.grid, weight, inertia, self.fields)
            self.exchange.exchange(self.fields.phi)

    def _each(self, rows: Sequence[np.ndarray], kernel, *arguments) -> None:
        """Call a kernel with the rows of each thread, or here with those of a single one."""
        if len(rows) == 1:
            self._call(0, rows, kernel, arguments)
        else:
            self.nodes.each(self._call, rows, kernel, arguments)

    def _call(self, thread: int, rows: Sequence[np.ndarray], kernel, arguments: tuple) -> None:
        self.nodes.call(kernel, rows[thread], *arguments)

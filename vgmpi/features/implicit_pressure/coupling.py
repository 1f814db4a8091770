"""Implicit pressure of liquids in a step: sweeps that make the nodal velocities divergence-free.

The nodes have the velocities of all other forces. A first system finds the pressures of the cells,
and a second one the displacements that spread what crowds; particles take both up when they gather
(pressure_transfer.py). The number of sweeps is fixed, so that all ranks agree.
See docs/explanation/implicit-pressure.md.
"""

from typing import NamedTuple

import numpy as np

from vgmpi.features.active_feature import (
    ActiveFeature,
    NodeState,
    PushedBodies,
    StartContext,
    WallInflow,
)
from vgmpi.kernels.step_records import StepSpan
from vgmpi.parallel.block_lattice import BLOCK_EDGE
from vgmpi.parallel.block_ownership import BlockDirectory
from vgmpi.parallel.cell_exchange import NODES_OF_PATCH, CellExchange, cell_topology
from vgmpi.parallel.exchange_topology import ExchangeTopology, counting_owner

from . import pressure_system
from .body_response import BodyResponse, let_liquids_stick
from .kernels import boundaries
from .liquid_rows import LiquidRows, Liquids
from .plan import DISPLACEMENT
from .pressure_solver import PressureSolver
from .pressure_system import INWARD_STEPS, ColliderNodes, NodeReactions, pressure_fields
from .solid_response import SolidResponse, select_nodes
from .suction_limit import SuctionLimit


class SharedBlocks(NamedTuple):
    """Blocks in which liquids share nodes with colliders or solids, shape (n,) each."""

    colliders: np.ndarray  # near colliders
    nodes: np.ndarray  # with nodes near colliders or of solids
    cells: np.ndarray  # with cells around these nodes


class ImplicitPressure(ActiveFeature):
    """Implicit pressure at the nodes of a rank."""

    couples_nodes = True

    def __init__(self, context: StartContext, solver: PressureSolver, suction: SuctionLimit | None):
        """Take the constants of a plan, its solver, and the suction that liquids bear, or None."""
        plan = self.plan = context.plan
        self.lattice, self.ranks = context.lattice, context.ranks
        self.liquids = Liquids(plan)
        self.solver, self.colliders, self.suction = solver, context.collider_nodes, suction
        self.features = context.features
        self.response: BodyResponse | None = None
        deformable = [
            system for feature in self.features.values() for system in feature.deformable_solids
        ]
        self.solids: SolidResponse | None = None
        if deformable:
            self.solids = SolidResponse(deformable, self.liquids.mass_of_cell, plan)
            solver.solids = self.solids
        self.node_exchange: CellExchange | None = None  # of nodes around, where colliders are

    @property
    def separating_walls(self) -> np.ndarray:
        """Return whether walls across each axis let liquids go, shape (3, 2)."""
        kinds = np.array([kind for kind, _ in self.plan.walls.liquids]).reshape(3, 2)
        return kinds == "separate"

    def set_topology(self, tables: ExchangeTopology, census: BlockDirectory) -> None:
        """Take new tables after a sort.

        Args:
            tables: Topology of this rank.
            census: Segments of this rank and nearby ones.
        """
        rank, real = self.ranks.rank, self.plan.real
        cells = cell_topology(tables, census, self.lattice, rank)
        # of the four nodes, or the cells above them, along each axis of a block: (n, 4, 3)
        index = BLOCK_EDGE * tables.coordinates[:, None] - 1 + np.arange(BLOCK_EDGE)[:, None]
        inside = ~_any_axis((index < 0) | (index >= self.plan.cells))
        cells = cells._replace(region=cells.region & inside, counted=cells.counted & inside)
        self.solver.set_topology(tables.coordinates, cells, counting_owner(tables, rank))
        if (self.colliders is not None or self.solids is not None) and self.ranks.size > 1:
            if self.node_exchange is not None:
                self.node_exchange.link.close()
            topology = cell_topology(tables, census, self.lattice, rank, NODES_OF_PATCH)
            self.node_exchange = CellExchange(self.ranks, topology, real)
        self.fields = pressure_fields(self.solver.count, real)
        self.fields.region[: 64 * self.solver.count] = cells.region.reshape(-1)
        self.liquids.set_topology(tables)
        if self.suction is not None:
            self.suction.set_topology(self.solver)
        is_filled = np.zeros(self.solver.count, bool)
        if self.solids is not None:
            filled = [nodes for each in self.features.values() for nodes in each.filled_nodes]
            is_filled = self.solids.fill_nodes(filled, self.solver, tables.coordinates, self.fields)
        near_colliders = np.flatnonzero(tables.solid >= 0)
        self.shared = SharedBlocks(near_colliders, near_colliders, near_colliders)
        if self.solids is not None:
            self.solids.set_topology(self.solver.lattice, is_filled)
            filled_cells = self.solver.lattice.cells_at(is_filled)
            covered = np.concatenate([near_colliders, filled_cells, *self.solids.cells])
            nodes = np.union1d(near_colliders, self.solids.blocks)
            self.shared = SharedBlocks(near_colliders, nodes, np.unique(covered))
        if self.colliders is not None:  # they act on the liquid by the pressure
            is_liquid = self.liquids.rows.per_cell[tables.phase] > 0
            self.reserved_nodes = np.repeat(is_liquid[:, None], 64, 1).astype(np.uint8)
        closed = self.solver.domain.closed
        is_beyond = ((index < 0) & closed[:, 0]) | ((index >= self.plan.cells) & closed[:, 1])
        self.outside = _any_axis(is_beyond).astype(real).reshape(-1)
        separates, last = self.separating_walls, np.array(self.plan.cells)
        on_wall = ((index == 0) & separates[:, 0]) | ((index == last) & separates[:, 1])
        touches = on_wall.any((1, 2))
        self.separating = np.flatnonzero(touches)
        self.beside_separating = self.solver.lattice.cells_at(touches)
        on_any_wall = ((index == 0) | (index == last)).any((1, 2))
        self.at_walls = np.flatnonzero(((index <= 0) | (index >= last)).any((1, 2)))
        self.at_boundaries = self.solver.lattice.cells_at(
            on_any_wall | is_filled | (tables.solid >= 0)
        )
        inflows = [inflow for each in self.features.values() for inflow in each.wall_inflows]
        self.inflows = [_select_inflow(inflow, tables.coordinates) for inflow in inflows]

    def couple_nodes(self, nodes: NodeState, span: StepSpan, gravity: np.ndarray) -> None:
        """Change the velocities of the nodes in a step, and find the displacements.

        Args:
            nodes: Nodes of the rank.
            span: The step.
            gravity: Acceleration, shape (3,) [m/s2].
        """
        fields, plan, dt, solver = self.fields, self.plan, span.dt, self.solver
        level, lattice = solver.level, solver.lattice
        velocity, walls = nodes.velocities, nodes.walls
        bodies, liquids = self._pushed_bodies(), self.liquids.rows_in(nodes.fields, dt)
        colliders = self._colliders_at(nodes, bodies)
        if bodies is not None:
            let_liquids_stick(bodies, nodes, dt, gravity)
        self._hold_nodes(nodes, span)
        if self.solids is not None:
            self.solids.exchange_momentum(nodes, liquids, dt)
        cells, wet = self._set_system(nodes, colliders, liquids, span)
        if self.solids is not None:
            assert solver.exchange is not None
            self.solids.begin(fields, level, solver.exchange)
        if bodies is not None:
            solver.bodies = self._begin_response(nodes, colliders, bodies, dt, gravity)
        if self.suction is not None:
            self.suction.begin()
        solver.solve(fields.phi)
        if self.suction is not None:
            per_pressure = dt * plan.dx / self.liquids.mass_of_cell
            self.suction.open_cells(
                nodes, self.shared.cells, colliders, fields, per_pressure, dt
            )  # fmt: skip
        solver.respond(fields.phi)
        if bodies is not None and solver.bodies is not None:
            bodies.add_impulses(solver.bodies.find_impulses(fields.phi))
            solver.bodies = None  # they stand while positions are corrected
        if self.solids is not None:
            self.solids.leave_liquids(fields, level, True)
        solver.each(wet, pressure_system.add_velocities, liquids, fields, level, velocity)
        reaction = nodes.reactions[0]
        if reaction is not None:
            own = self.liquids.mass_of_cell * plan.dx * fields.phi.astype(float) * solver.counted
            nodes.call(
                boundaries.record_pressure, self.at_boundaries, lattice, walls, colliders, own,
                fields, level, self._reactions(reaction),
            )  # fmt: skip
        nodes.call(
            boundaries.hold_at_separating_walls, self.separating, lattice, walls, liquids,
            fields, level, velocity, reaction,
        )  # fmt: skip
        if self.solids is not None:
            self.solids.add_velocities(liquids, velocity)
            self.solids.rub_at_walls(self.separating, fields, level, reaction)
            self.solids.leave_liquids(fields, level, False)
            self._hold_nodes(nodes, span)
        scale = plan.real.type(1.0 / (dt * self.liquids.stiffness))
        solver.each(wet, pressure_system.store_node_pressure, lattice, scale, fields)
        if self.solids is not None:
            self.solids.stop_spray(liquids, fields, self._reactions(reaction))
        if len(self.shared.colliders):
            nodes.call(
                boundaries.stop_at_colliders, self.shared.colliders, lattice, walls, liquids,
                colliders, fields, velocity, reaction,
            )  # fmt: skip
            if bodies is not None:
                nodes.call(
                    boundaries.reserve_nodes, self.shared.colliders, liquids, colliders, fields,
                    self.reserved_nodes,
                )  # fmt: skip
        self._find_displacements(nodes, colliders, liquids, cells, wet)

    def _reactions(self, sums) -> NodeReactions:
        """Return what records reactions at nodes in sums, or None."""
        none = np.zeros((0, 64), np.int64)
        return NodeReactions(sums, none if self.solids is None else self.solids.pinned_rows)

    def _hold_nodes(self, nodes: NodeState, span: StepSpan) -> None:
        """Let other features hold nodes of solids: what they take up so far is a reaction."""
        for feature in self.features.values():
            feature.hold_nodes(nodes, span)

    def _set_system(
        self, nodes: NodeState, colliders: ColliderNodes, liquids: LiquidRows, span: StepSpan
    ) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """Set the system of the pressure in a step. Collective.

        Returns:
            Blocks that have cells with pressure, and those next to them, by thread.
        """
        fields, plan, solver, blocks = self.fields, self.plan, self.solver, nodes.block_rows
        level, lattice, exchange = solver.level, solver.lattice, solver.exchange
        assert exchange is not None
        solver.take_rows(nodes.each, nodes.call, blocks, blocks)
        solver.each(blocks, pressure_system.set_nodes, liquids, nodes.velocities, fields, level)
        nodes.call(
            pressure_system.hold_at_walls, self.at_walls, lattice, nodes.walls, fields, level
        )
        self._let_in(span.end)
        if self.node_exchange is not None:
            self.node_exchange.exchange(fields.fill)
        if self.solids is not None:
            self.solids.read_parts(nodes, fields)
            if self.node_exchange is not None:
                self.node_exchange.exchange(fields.solid)
        nodes.call(
            pressure_system.share_nodes, self.shared.nodes, lattice, nodes.walls, plan.dx,
            colliders, fields, level,
        )  # fmt: skip
        guess_scale = plan.real.type(span.dt * self.liquids.stiffness)
        has_solids = self.solids is not None
        has_grains = self.solids is not None and bool(self.solids.sands)
        if self.solids is not None:
            self.solids.add_rough_answers(fields, level)
        solver.each(
            blocks, pressure_system.set_cells, lattice, guess_scale, has_solids, has_grains,
            fields, level,
        )  # fmt: skip
        exchange.exchange(fields.filled)
        if self.separating_walls.any():
            exchange.exchange(fields.phi)
            nodes.call(
                boundaries.release_nodes, self.separating, lattice, nodes.walls, liquids,
                nodes.velocities, fields, level,
            )  # fmt: skip
            self._let_in(span.end)
            nodes.call(
                pressure_system.set_cells, self.beside_separating, lattice, guess_scale,
                has_solids, has_grains, fields, level,
            )  # fmt: skip
            exchange.exchange(fields.filled)
        self._spread_inward(nodes)
        cells, wet = self._find_wet_blocks(len(blocks))
        exchange.exchange(fields.phi)
        solver.take_rows(nodes.each, nodes.call, cells, wet)
        return cells, wet

    def _find_displacements(
        self, nodes: NodeState, colliders: ColliderNodes, liquids: LiquidRows,
        cells: list[np.ndarray], wet: list[np.ndarray],
    ) -> None:  # fmt: skip
        """Find the displacements that spread what crowds. Collective.

        Args:
            nodes, colliders, liquids: Nodes of the rank, and colliders and liquids at them.
            cells, wet: See `_set_system`.
        """
        fields, solver, count = self.fields, self.solver, 64 * self.solver.count
        fields.cover[:count] = fields.filled[:count] + self.outside + fields.covered[:count]
        if self.suction is not None:  # what opens is not filled
            fields.cover[self.suction.is_open > 0] = 0
        solver.each(cells, pressure_system.set_excess, solver.lattice, fields, solver.level)
        solver.find_moves()
        moves = nodes.gathered[DISPLACEMENT]
        moves[:] = 0
        solver.each(wet, pressure_system.store_moves, liquids, fields, solver.level, moves)
        nodes.call(
            boundaries.stop_moves, self.separating, solver.lattice, nodes.walls, liquids, moves
        )
        if len(self.shared.colliders):
            nodes.call(
                boundaries.push_out_of_colliders, self.shared.colliders, liquids, colliders, moves
            )

    def _let_in(self, time: float) -> None:
        """Hold the nodes of walls through which liquid enters at a time [s] at its velocity."""
        level, share = self.solver.level, self.fields.share.reshape(-1, 64)
        velocities, responses = level.u.reshape(-1, 3, 64), level.inverse.reshape(-1, 3, 64)
        flows = [flow for flow in self.inflows if flow[0].begin <= time <= flow[0].end]
        for _, block, node in flows:
            velocities[block, :, node] = responses[block, :, node] = 0
        for inflow, block, node in flows:
            per_cell = share[block, node, None] / self.plan.dx
            velocities[block, :, node] += per_cell * inflow.velocities

    def _pushed_bodies(self) -> PushedBodies | None:
        """Return the free bodies of the run, or None without any."""
        features = self.features.values()
        return next((each.pushed_bodies for each in features if each.pushed_bodies), None)

    def _colliders_at(self, nodes: NodeState, bodies: PushedBodies | None) -> ColliderNodes:
        """Return the colliders at the nodes in this step."""
        real, colliders = self.plan.real, self.colliders
        body = number = np.zeros((0, 64), np.int64)
        if colliders is None:
            none = np.zeros((0, 64, 4), real), np.zeros((0, 64, 3), real)
            return ColliderNodes(np.full(self.solver.count, -1), *none, number, body)
        number = colliders.collider_number
        if bodies is not None:
            body = bodies.number_of[number]
        return ColliderNodes(nodes.blocks.solid, colliders.nodes, colliders.moves, number, body)

    def _begin_response(
        self, nodes: NodeState, colliders: ColliderNodes, bodies: PushedBodies, dt: float,
        gravity: np.ndarray,
    ) -> BodyResponse:  # fmt: skip
        """Return how free bodies answer to the pressure in this step. Collective."""
        if self.response is None:
            self.response = BodyResponse(self.ranks, self.liquids.mass_of_cell, self.plan.dx)
        response = self.response
        response.find_rows(
            bodies, self.solver, self.at_boundaries, nodes.walls, colliders, self.fields
        )
        response.begin(bodies, bodies.predict_velocities(dt, gravity))
        return response

    def _spread_inward(self, nodes: NodeState) -> None:
        """Let cells inside of colliders have pressure next to those that have it. Collective."""
        if self.colliders is None and self.solids is None:
            return
        fields, solver, count = self.fields, self.solver, 64 * self.solver.count
        assert solver.exchange is not None
        level = solver.level
        solver.exchange.exchange(fields.covered)
        for _ in range(INWARD_STEPS):
            fields.cover[:] = fields.filled <= 0
            rows, lattice = self.shared.cells, solver.lattice
            nodes.call(pressure_system.spread_inward, rows, lattice, fields, level)
            solver.exchange.exchange(fields.filled)
        is_dry = fields.filled[:count] <= 0
        for values in (level.scale, level.residual, fields.phi):
            values[:count][is_dry] = 0

    def _find_wet_blocks(self, threads: int) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """Return the blocks that have cells with pressure, and those next to them, by thread."""
        count, solver = self.solver.count, self.solver
        wet = np.zeros(count + 1, bool)
        wet[:count] = (self.fields.filled[: 64 * count].reshape(count, 64) > 0).any(1)
        reached = wet[solver.lattice.low.reshape(count, 8)].any(1)
        own = wet[:count] & (solver.level.scale[: 64 * count].reshape(count, 64) > 0).any(1)
        rows = [np.array_split(np.flatnonzero(marks), threads) for marks in (own, reached)]
        return rows[0], rows[1]


def _select_inflow(
    inflow: WallInflow, coordinates: np.ndarray
) -> tuple[WallInflow, np.ndarray, np.ndarray]:
    """Return what enters at the nodes of some blocks, and the block and number of each node.

    Args:
        inflow: What enters.
        coordinates: Coordinates of the blocks, shape (blocks, 3).
    """
    own, block, number = select_nodes(inflow.nodes, coordinates)
    chosen = inflow._replace(nodes=inflow.nodes[own], velocities=inflow.velocities[own])
    return chosen, block, number


def _any_axis(is_marked: np.ndarray) -> np.ndarray:
    """Return whether the nodes of blocks are marked along any axis, (n, 64), given (n, 4, 3)."""
    x, y, z = np.moveaxis(is_marked, 2, 0)
    return (x[:, :, None, None] | y[:, None, :, None] | z[:, None, None]).reshape(len(x), 64)

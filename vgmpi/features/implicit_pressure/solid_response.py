"""Deformable solids in the system of the pressure: they answer to it within the same solution."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from vgmpi.features.active_feature import DeformableSolid, FilledNodes, NodeState
from vgmpi.parallel.block_lattice import BLOCK_EDGE
from vgmpi.parallel.cell_exchange import CellExchange
from vgmpi.runtime.aligned_arrays import aligned_zeros

from .kernels import solid_rows
from .kernels.relaxation import LevelFields
from .kernels.solid_rows import SolidBlocks, SolidRows
from .pressure_system import NodeReactions


class SolidResponse:
    """Deformable solids of a run next to the cells with pressure of a rank."""

    def __init__(self, solids: Sequence[DeformableSolid], mass_of_cell: float, plan: Any):
        """Take the solids, the mass of a full cell [kg], and the plan."""
        self.solids, self.mass_of_cell, self.plan = solids, mass_of_cell, plan
        self.is_solid = np.isin(np.arange(len(plan.phases)), [each.phase for each in solids])
        self.rows: list[SolidRows] = []

    def set_topology(self, lattice: Any, is_filled: np.ndarray) -> None:
        """Take new blocks after a sort.

        Args:
            lattice: Blocks, a Lattice.
            is_filled: Whether pinned parts have nodes of each block, shape (blocks,) bool.
        """
        count, real = len(lattice.block), self.plan.real
        self.lattice = lattice
        self.rows = [solid_rows.solid_rows(count, real) for _ in self.solids]
        self.cells = [self._cells_at(each.block_of) for each in self.solids]
        self.cells_with_solid = [np.zeros(0, np.int64) for _ in self.solids]
        self.nodal_blocks = [np.zeros(0, np.int64) for _ in self.solids]
        blocks = [each.block_of for each in self.solids]
        self.blocks = np.unique(np.concatenate([np.flatnonzero(is_filled), *blocks]))
        sizes = [192 * (len(each.rows) + 1) for each in self.solids]
        self.impulses, self.totals = (
            [aligned_zeros(size, real) for size in sizes] for _ in range(2)
        )

    def fill_nodes(
        self, filled: Sequence[FilledNodes], system: Any, coordinates: np.ndarray, fields: Any
    ) -> np.ndarray:
        """Store what pinned parts have of the nodes; return which blocks have such nodes, (n,).

        Args:
            filled: Nodes that they fill.
            system: System of the pressure with `domain`, a PressureSolver.
            coordinates: Coordinates of the blocks, shape (n, 3).
            fields: PressureFields (pinned out).
        """
        pinned, closed = fields.pinned.reshape(-1, 64), system.domain.closed
        self.pinned_rows = np.full(pinned.shape, -1)
        last = np.array(self.plan.cells)
        for each in filled:
            own, block, number = select_nodes(each.nodes, coordinates)
            nodes = each.nodes[own]
            on_wall = ((nodes == 0) & closed[:, 0]) | ((nodes == last) & closed[:, 1])
            pinned[block, number] += each.parts[own] * 2.0 ** on_wall.sum(1)
            self.pinned_rows[block, number] = each.row
        pinned[:] = np.minimum(pinned, 1.0)
        is_filled: np.ndarray = np.any(pinned[: len(coordinates)] > 0, axis=1)
        return is_filled

    def read_parts(self, nodes: NodeState, fields: Any) -> None:
        """Read the parts of the solids at the nodes.

        Args:
            nodes: Nodes of the rank.
            fields: PressureFields with `pinned` (solid and meeting out).
        """
        self.nodes, real = nodes, self.plan.real.type
        for values in (fields.solid, fields.meeting, fields.solid_part, fields.pinned_part):
            values[:] = 0
        self._find_blocks()
        volumes, per_volume = nodes.fields["impulses"].nodes, real(1.0 / self.plan.dx**3)
        for solid, rows in zip(self.solids, self.rows, strict=True):
            nodes.call(
                solid_rows.read_parts, blocks_of(solid), volumes, self.lattice, nodes.walls,
                per_volume, rows, fields,
            )  # fmt: skip
        fields.solid[:] += fields.pinned

    def _find_blocks(self) -> None:
        """Find the blocks with nodes at which impulses reach a solid, and the cells at these."""
        for k, solid in enumerate(self.solids):
            if np.array_equal(self.nodal_blocks[k], solid.occupied_rows):
                continue
            self.nodal_blocks[k] = solid.occupied_rows
            self.cells_with_solid[k] = self._cells_at(solid.block_of[solid.occupied_rows])
            for values in self.rows[k]:
                values[:] = 0

    def _cells_at(self, blocks: np.ndarray) -> np.ndarray:
        """Return the blocks of the cells that have nodes in some blocks."""
        return self.lattice.cells_at(np.bincount(blocks, minlength=len(self.lattice.block)) > 0)

    def begin(self, fields: Any, level: LevelFields, exchange: CellExchange) -> None:
        """Take what the solids have of the nodes, and subtract what they do. Collective.

        Args:
            fields: PressureFields with `solid_scale`.
            level: LevelFields (in/out).
            exchange: Exchange of the cells around those of this rank.
        """
        nodes, lattice = self.nodes, self.lattice
        real = self.plan.real.type
        per_length = real(1.0 / self.plan.dx)
        for solid, rows, cells in zip(self.solids, self.rows, self.cells_with_solid, strict=True):
            nodes.call(solid_rows.scale_parts, blocks_of(solid), fields, rows)
            nodes.call(solid_rows.set_means, cells, lattice, rows)
            exchange.exchange(rows.mean)
            nodes.call(
                solid_rows.read_velocities, blocks_of(solid), nodes.velocities, per_length, rows,
            )  # fmt: skip
            nodes.call(
                solid_rows.add_divergence, cells, lattice, real(-1), rows, level, level.residual
            )
        self.level = level

    def add_product(self, potential: np.ndarray, product: np.ndarray) -> None:
        """Add what the solids answer to a potential to its product with the system. Collective.

        Args:
            potential: Numbers of cells, known around those of this rank, flat.
            product: Numbers of cells, flat (in/out).
        """
        nodes, lattice, real = self.nodes, self.lattice, self.plan.real.type
        self.answers = []
        parts = zip(self.solids, self.rows, self.cells_with_solid, self.impulses, strict=True)
        for solid, rows, cells, impulses in parts:
            np.multiply(rows.mean, potential, out=rows.weighted)
            factor = real(self.mass_of_cell / solid.mass_of_cell)
            nodes.call(
                solid_rows.set_tractions, blocks_of(solid), lattice, factor, potential, rows,
                impulses,
            )  # fmt: skip
            answer = solid.answer(impulses)
            self.answers.append(answer)
            nodes.call(solid_rows.store_answer, blocks_of(solid), answer, rows)
            nodes.call(
                solid_rows.add_divergence, cells, lattice, real(1), rows, self.level, product
            )

    def begin_totals(self) -> None:
        """Begin the sums of the answers with the last ones."""
        for total, answer in zip(self.totals, self.answers, strict=True):
            total[:] = answer

    def add_to_totals(self, factor: float) -> None:
        """Add the last answers times a factor to their sums."""
        for total, answer in zip(self.totals, self.answers, strict=True):
            total += factor * answer

    def add_velocities(self, velocity: np.ndarray) -> None:
        """Add the sums of the answers to the velocities of the nodes.

        Args:
            velocity: Velocity [m/s] and mass [kg], shape (node blocks, 256) (in/out).
        """
        dx = self.plan.real.type(self.plan.dx)
        for solid, total in zip(self.solids, self.totals, strict=True):
            self.nodes.call(
                solid_rows.add_velocities, blocks_of(solid), solid.uptake, dx, total, velocity
            )

    def stop_spray(self, liquids: Any, fields: Any, reactions: NodeReactions) -> None:
        """Stop liquids that approach solids where no pressure acts.

        Args:
            liquids: LiquidRows.
            fields: PressureFields, with `solid` known around the nodes of this rank.
            reactions: Records the reactions of pinned parts.
        """
        nodes = self.nodes
        nodes.call(
            solid_rows.stop_at_solids, self.blocks, self.lattice, nodes.walls, self.is_solid,
            liquids, fields, nodes.velocities, reactions,
        )  # fmt: skip


def blocks_of(solid: DeformableSolid) -> SolidBlocks:
    """Return the blocks of a solid for kernels."""
    return SolidBlocks(
        solid.occupied_rows, solid.rows, solid.block_of, solid.is_attached, solid.loose
    )


def select_nodes(
    nodes: np.ndarray, coordinates: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return which nodes (n, 3) are those of some blocks, and the block and number of each of them.

    Args:
        nodes: Nodes, shape (n, 3).
        coordinates: Coordinates of the blocks, shape (blocks, 3).
    """
    row_of = {tuple(block): row for row, block in enumerate(coordinates.tolist())}
    block, step = np.divmod(nodes + 1, BLOCK_EDGE)
    rows = np.array([row_of.get(tuple(each), -1) for each in block.tolist()], np.int64)
    own = rows >= 0
    number = np.ravel_multi_index(tuple(step[own].T), (BLOCK_EDGE,) * 3)
    return own, rows[own], number

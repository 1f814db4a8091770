"""Deformable solids in the system of the pressure: they answer to it within the same solution.

Liquids flow through sands with drag; other solids keep them out.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from vgmpi.features.active_feature import (
    DeformableSolid,
    DeformableSolids,
    FilledNodes,
    NodeState,
)
from vgmpi.parallel.block_lattice import BLOCK_EDGE
from vgmpi.parallel.cell_exchange import CellExchange
from vgmpi.runtime.aligned_arrays import aligned_zeros

from .kernels import boundaries, pore_rows, solid_rows
from .kernels.pore_rows import SandDrag
from .kernels.relaxation import LevelFields
from .kernels.solid_rows import SolidBlocks, SolidRows
from .pressure_system import NodeReactions


@dataclass
class SolidPhase:
    """Phase of solids next to the cells with pressure of a rank.

    Attributes:
        part: The phase in its system.
        system: The system.
        number: Number of the system.
        is_porous: Whether liquids flow through it.
        rows: What it has of nodes and cells.
        pores: PoreRows of what it leaves the liquids in its pores, or None.
        cells: Blocks of the cells at its occupied blocks.
        occupied_rows: Those of the last step.
    """

    part: DeformableSolid
    system: DeformableSolids
    number: int
    is_porous: bool
    rows: SolidRows
    pores: Any = None
    cells: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))
    occupied_rows: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))

    @property
    def phase(self) -> int:
        """Return the number of the phase."""
        return self.part.phase

    @property
    def blocks(self) -> SolidBlocks:
        """Return its occupied blocks for kernels."""
        system = self.system
        return SolidBlocks(
            self.part.occupied_rows, system.rows, system.block_of, system.is_attached, system.loose
        )

    @property
    def occupied_blocks(self) -> np.ndarray:
        """Return the blocks of the rank that it occupies."""
        return self.system.block_of[self.part.occupied_rows]


class SolidResponse:
    """Deformable solids of a run next to the cells with pressure of a rank."""

    def __init__(self, systems: Sequence[DeformableSolids], mass_of_cell: float, plan: Any):
        """Take systems of solids, the mass of a full cell [kg], and the plan."""
        self.systems, self.mass_of_cell, self.plan = systems, mass_of_cell, plan
        drags = (feature.pore_drag for feature in plan.features)
        self.drag = next((each for each in drags if each is not None), None)
        porous = np.zeros(len(plan.phases)) if self.drag is None else self.drag.grain_volumes
        self.solids = [
            SolidPhase(
                part, system, k, bool(porous[part.phase]), solid_rows.solid_rows(0, plan.real)
            )
            for k, system in enumerate(systems)
            for part in system.parts
        ]
        impermeable = [solid.phase for solid in self.solids if not solid.is_porous]
        self.is_solid = np.isin(np.arange(len(plan.phases)), impermeable)

    def set_topology(self, lattice: Any, is_filled: np.ndarray) -> None:
        """Take new blocks after a sort.

        Args:
            lattice: Blocks, a Lattice.
            is_filled: Whether pinned parts have nodes of each block, shape (blocks,) bool.
        """
        count, real = len(lattice.block), self.plan.real
        self.lattice = lattice
        for solid in self.solids:
            solid.rows = solid_rows.solid_rows(count, real)
            solid.cells = solid.occupied_rows = np.zeros(0, np.int64)
            if solid.is_porous:
                factor = real.type(self.mass_of_cell / solid.part.mass_of_cell)
                solid.pores = pore_rows.pore_rows(count, factor, real)
        self.cells = [self._cells_at(system.block_of) for system in self.systems]
        blocks = [system.block_of for system in self.systems]
        self.blocks = np.unique(np.concatenate([np.flatnonzero(is_filled), *blocks]))
        sizes = [192 * (len(system.rows) + 1) for system in self.systems]
        self.impulses, self.totals = (
            [aligned_zeros(size, real) for size in sizes] for _ in range(2)
        )
        self.rough: list[Any] = [None for _ in self.systems]  # answers of each node alone
        self.followed = np.zeros(64 * (count + 1), real)  # part of sands' motion, by drag

    @property
    def sand_blocks(self) -> np.ndarray:
        """Return the blocks with nodes of such solids."""
        blocks = [solid.occupied_blocks for solid in self.sands]
        return np.unique(np.concatenate([np.zeros(0, np.int64), *blocks]))

    @property
    def sands(self) -> list[SolidPhase]:
        """Return the sands through which liquids flow."""
        return [solid for solid in self.solids if solid.is_porous]

    def exchange_momentum(self, nodes: NodeState, liquids: Any, dt: float) -> None:
        """Let drag act between sands and the liquids in their pores. Collective.

        Args:
            nodes: Nodes of the rank (velocities in/out).
            liquids: LiquidRows.
            dt: Length of the step [s].
        """
        drag, velocity, real = self.drag, nodes.velocities, self.plan.real
        if drag is None:
            return
        self.followed[:] = 0
        carried = [np.zeros(64 * (len(system.rows) + 1), real) for system in self.systems]
        for solid in self.sands:
            own = SandDrag(
                solid.phase, drag.coefficients[solid.phase], drag.grain_volumes,
                float(drag.porosity[solid.phase]), solid.part.mass_of_cell, dt,
            )  # fmt: skip
            solid.pores.follows[:] = 0
            nodes.call(
                pore_rows.hold_stuck_nodes, solid.blocks, self.lattice, nodes.walls, velocity
            )
            nodes.call(
                pore_rows.find_drag, solid.blocks, liquids, own, velocity, solid.pores,
                self.followed, carried[solid.number], self.impulses[solid.number],
            )  # fmt: skip
        answers = {}
        for k in sorted({solid.number for solid in self.sands}):
            self.rough[k] = self.systems[k].carry(carried[k])
            answers[k] = self.systems[k].answer(self.impulses[k]).copy()
        nodes.call(pore_rows.release_liquids, self.sand_blocks, liquids, self.followed, velocity)
        for solid in self.sands:
            answer = answers[solid.number]
            nodes.call(pore_rows.move_sand, solid.blocks, real.type(1), answer, velocity)
            nodes.call(pore_rows.pull_liquids, solid.blocks, liquids, solid.pores, velocity)

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
            fields: PressureFields with `pinned` (solid, grains and meeting out).
        """
        self.nodes, real, drag = nodes, self.plan.real.type, self.drag
        for values in (
            fields.solid, fields.meeting, fields.solid_part, fields.pinned_part, fields.grains
        ):  # fmt: skip
            values[:] = 0
        self._find_blocks()
        volumes, per_volume = nodes.fields["impulses"].nodes, real(1.0 / self.plan.dx**3)
        for solid in self.solids:
            rows = solid.rows
            if solid.is_porous and drag is not None:
                per_mass = real(drag.grain_volumes[solid.phase] * per_volume)
                nodes.call(
                    pore_rows.read_grains, solid.blocks, nodes.velocities, self.lattice,
                    nodes.walls, per_mass, rows, fields,
                )  # fmt: skip
                continue
            nodes.call(
                solid_rows.read_parts, solid.blocks, volumes, self.lattice, nodes.walls,
                per_volume, rows, fields,
            )  # fmt: skip
        fields.solid[:] += fields.pinned

    def _find_blocks(self) -> None:
        """Find the blocks with nodes at which impulses reach a solid, and the cells at these."""
        for solid in self.solids:
            if np.array_equal(solid.occupied_rows, solid.part.occupied_rows):
                continue
            solid.occupied_rows = solid.part.occupied_rows
            solid.cells = self._cells_at(solid.occupied_blocks)
            for values in solid.rows:
                values[:] = 0

    def _cells_at(self, blocks: np.ndarray) -> np.ndarray:
        """Return the blocks of the cells that have nodes in some blocks."""
        return self.lattice.cells_at(np.bincount(blocks, minlength=len(self.lattice.block)) > 0)

    def add_rough_answers(self, fields: Any, level: LevelFields) -> None:
        """Leave liquids what they answer apart from sands, and add rough answers of these.

        Args:
            fields: PressureFields with `grain_scale`.
            level: LevelFields (inverse in/out).
        """
        nodes = self.nodes
        nodes.call(pore_rows.reduce_responses, self.sand_blocks, self.followed, level)
        for solid in self.sands:
            nodes.call(
                pore_rows.add_rough_answers, solid.blocks, self.lattice, nodes.walls,
                self.rough[solid.number], solid.rows, solid.pores, fields, level,
            )  # fmt: skip

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
        for solid in self.solids:
            rows, pores = solid.rows, solid.pores
            scale = fields.solid_scale if pores is None else fields.grain_scale
            nodes.call(solid_rows.scale_parts, solid.blocks, scale, rows)
            if pores is None:  # it feels no pressure on its own volume, as grains do
                nodes.call(solid_rows.set_means, solid.cells, lattice, rows)
                exchange.exchange(rows.mean)
            nodes.call(solid_rows.read_velocities, solid.blocks, nodes.velocities, per_length, rows)
            nodes.call(
                solid_rows.add_divergence, solid.cells, lattice, real(-1), rows, level,
                level.residual,
            )  # fmt: skip
            if pores is not None:
                nodes.call(pore_rows.set_pushes, solid.blocks, rows, pores, fields)
        self.level = level

    def add_product(self, potential: np.ndarray, product: np.ndarray) -> None:
        """Add what the solids answer to a potential to its product with the system. Collective.

        Args:
            potential: Numbers of cells, known around those of this rank, flat.
            product: Numbers of cells, flat (in/out).
        """
        nodes, lattice, real = self.nodes, self.lattice, self.plan.real.type
        for solid in self.solids:
            rows = solid.rows
            np.multiply(rows.mean, potential, out=rows.weighted)
            factor = real(self.mass_of_cell / solid.part.mass_of_cell)
            nodes.call(
                solid_rows.set_tractions, solid.blocks, lattice, factor, potential, rows,
                self.impulses[solid.number],
            )  # fmt: skip
        self.answers = [
            system.answer(impulses)
            for system, impulses in zip(self.systems, self.impulses, strict=True)
        ]
        for solid in self.solids:
            impulses, answer = self.impulses[solid.number], self.answers[solid.number]
            rows, pores = solid.rows, solid.pores
            if pores is None:
                nodes.call(solid_rows.store_answer, solid.blocks, answer, rows)
            else:
                nodes.call(pore_rows.store_answer, solid.blocks, answer, impulses, rows, pores)
            nodes.call(
                solid_rows.add_divergence, solid.cells, lattice, real(1), rows, self.level, product
            )

    def begin_totals(self) -> None:
        """Begin the sums of the answers with the last ones."""
        for total, answer in zip(self.totals, self.answers, strict=True):
            total[:] = answer

    def add_to_totals(self, factor: float) -> None:
        """Add the last answers times a factor to their sums."""
        for total, answer in zip(self.totals, self.answers, strict=True):
            total += factor * answer

    def leave_liquids(self, fields: Any, level: LevelFields, is_before: bool) -> None:
        """Leave in u what a potential does to liquids alone, or restore the rough answers.

        Args:
            fields: PressureFields.
            level: LevelFields (u and inverse in/out).
            is_before: Whether u is to change, else the responses are what they were.
        """
        change = pore_rows.subtract_rough_answers if is_before else pore_rows.restore_rough_answers
        for solid in self.sands:
            self.nodes.call(change, solid.blocks, solid.rows, solid.pores, fields, level)

    def add_velocities(self, liquids: Any, velocity: np.ndarray) -> None:
        """Add the sums of the answers to the velocities of the nodes, and liquids follow sands.

        Args:
            liquids: LiquidRows.
            velocity: Velocity [m/s] and mass [kg], shape (node blocks, 256) (in/out).
        """
        dx = self.plan.real.type(self.plan.dx)
        for solid in self.solids:
            total, uptake = self.totals[solid.number], solid.system.uptake
            self.nodes.call(solid_rows.add_velocities, solid.blocks, uptake, dx, total, velocity)
            if solid.pores is not None:
                self.nodes.call(
                    pore_rows.push_liquids, solid.blocks, liquids, solid.pores, dx, total, velocity
                )

    def rub_at_walls(
        self, separating: np.ndarray, fields: Any, level: LevelFields, reaction: Any
    ) -> None:
        """Let friction of walls slow sands by what the pressure presses on their grains.

        Args:
            separating: Blocks with nodes on separating walls.
            fields: PressureFields.
            level: LevelFields.
            reaction: Reaction sums (in/out), or None.
        """
        nodes, unit = self.nodes, self.mass_of_cell * self.plan.dx
        for solid in self.sands:
            blocks = solid.blocks
            on_wall = np.isin(blocks.block_of[blocks.occupied], separating)
            blocks = blocks._replace(occupied=blocks.occupied[on_wall])
            nodes.call(
                boundaries.rub_sand, blocks, self.lattice, nodes.walls, unit, fields, level,
                nodes.velocities, reaction,
            )  # fmt: skip

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

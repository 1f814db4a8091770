"""Solution of the system of the pressure: conjugate gradients that multigrid preconditions.

The number of iterations is fixed, so that all ranks agree. Sums over cells are whole numbers of
quanta that follow from the largest residual: they are exact, in any order, on any number of ranks
and threads.

References:
    Tatebe 1993: The multigrid preconditioned conjugate gradient method.
    McAdams, Sifakis and Teran 2010: A parallel multigrid Poisson solver for fluids simulation on
    large grids. Symposium on Computer Animation.
"""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from vgmpi.parallel.cell_exchange import CellExchange, CellTopology
from vgmpi.parallel.coarse_blocks import CoarseBlocks, find_coarse_blocks, lattice_of
from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.runtime.aligned_arrays import aligned_zeros

from .body_response import BodyResponse
from .kernels import multigrid, relaxation
from .kernels.multigrid import WetRows
from .kernels.relaxation import LevelFields, Sweeps, chebyshev_factors, level_fields
from .solid_response import SolidResponse

ITERATIONS = 4
CYCLE_SWEEPS, LAST_SWEEPS = Sweeps(3, 0.3), Sweeps(16, 0.02)
POSITION_SWEEPS = Sweeps(10, 0.1)
REST_BITS = 40  # binary digits of the largest residual that the coarse levels take
MIN_EXPONENT = -60  # of the largest residual: smaller ones are nothing
PRODUCT_BITS, SECOND_BITS = 20, 40  # of a product, in units, and of what rounding leaves
# With fewer blocks, one thread sweeps faster than two that wait for each other at every sweep: two
# save about 6 us per block and step, and wait 4.8 ms (vgmpi bench board --only dam_break splash).
SHARED_BLOCKS = 800


class SystemDomain(NamedTuple):
    """Domain of a system, and what its liquids are like."""

    cells: tuple[int, int, int]
    closed: np.ndarray  # (3, 2) bool, whether walls hold their nodes across
    contrast: float  # largest density of a liquid over the smallest, at most: a power of two


class CoarseLevels:
    """Coarse levels of a multigrid cycle, which all ranks hold and compute alike."""

    def __init__(
        self, blocks: CoarseBlocks, domain: SystemDomain, ranks: SerialCommunicator,
        real: np.dtype,
    ):  # fmt: skip
        """Take the blocks, the domain, the communicator, and the type of numbers."""
        self.blocks, self.closed, self.ranks, self.real = blocks, domain.closed, ranks, real
        self.quanta = real.type(multigrid.RESPONSE_QUANTA / domain.contrast)
        self.max_response = real.type(multigrid.MAX_RESPONSE * domain.contrast)
        count = len(blocks.parent)
        self.level = level_fields(count, real)
        self.sums, self.response_sums = np.zeros((count, 64)), np.zeros((count, 5, 64))
        self.ones = np.ones(64 * (count + 1), real)
        self.factors, self.last_factors = (
            chebyshev_factors(sweeps, real) for sweeps in (CYCLE_SWEEPS, LAST_SWEEPS)
        )

    def set_systems(
        self, call: Callable, finest: LevelFields, counted: tuple[np.ndarray, np.ndarray]
    ) -> None:
        """Set responses and cells with pressure from those of the finest level. Collective.

        Args:
            call: Runs a kernel, see NodeState.
            finest: Fields of the finest level; u is lost.
            counted: 1 for cells, and for nodes, that this rank counts, else 0, flat.
        """
        blocks, level, sums, cells, nodes = self.blocks, self.level, self.response_sums, [], []
        finer, limit, quanta = finest, self.max_response, self.quanta
        finer_rows = np.arange(len(finest.scale) // 64 - 1)
        is_wet = np.any(finest.scale.reshape(-1, 64) > 0, 1)  # the last row is that of no block
        has_cells, block = np.zeros(len(blocks.parent) + 1, bool), blocks.lattice.block
        for number in range(len(blocks.first) - 1):
            first, last = blocks.first[number], blocks.first[number + 1]
            rows = np.arange(first, last)
            is_near = is_wet[blocks.children.reshape(-1, 64)[rows]].any(1)
            if number == 0:  # on any rank: its cells may touch the nodes that this rank counts
                is_near = self.ranks.max(is_near.astype(np.int8)) > 0
            near_rows = rows[is_near]
            sums[rows] = 0.0
            call(multigrid.count_responses, finer_rows, counted[1], limit, quanta, finer)
            call(multigrid.sum_responses, near_rows, blocks.children, finer, counted[0], sums)
            if number == 0 and self.ranks.size > 1:
                sums[rows] = self.ranks.sum(sums[rows].astype(np.int64))
            size = blocks.sizes[number + 1]
            call(multigrid.set_responses, rows, block, size, self.closed, quanta, sums, level)
            call(multigrid.set_diagonal, rows, blocks.lattice, level)
            own = level.scale[64 * first : 64 * last].reshape(-1, 64)
            has_cells[rows] = np.any(own > 0, 1)
            low = blocks.lattice.low.reshape(-1, 8)[rows]
            cells.append(rows[has_cells[rows]])
            nodes.append(rows[has_cells[low].any(1)])
            finer, finer_rows, is_wet = level, rows, has_cells
            counted, limit = (self.ones, self.ones), self.real.type(np.inf)
        self.wet = WetRows(
            np.concatenate(cells), np.cumsum([0, *map(len, cells)]),
            np.concatenate(nodes), np.cumsum([0, *map(len, nodes)]),
        )  # fmt: skip

    def find_correction(self, call: Callable, remainder: np.ndarray, quantum: float) -> np.ndarray:
        """Return the correction of the coarse levels, flat. Collective.

        Args:
            call: Runs a kernel, see NodeState.
            remainder: Whole numbers of the cells that this rank counts, flat.
            quantum: Their unit.
        """
        blocks, level, wet = self.blocks, self.level, self.wet
        rows, block = wet.cells[: wet.first_cell[1]], blocks.lattice.block
        call(
            multigrid.restrict, rows, block, blocks.children, blocks.sizes[0], remainder, self.sums
        )
        if self.ranks.size > 1:
            self.sums[rows] = self.ranks.sum(self.sums[rows].astype(np.int64))
        call(multigrid.set_residual, rows, quantum, self.sums, level)
        call(
            multigrid.cycle,
            wet,
            blocks,
            self.factors,
            self.last_factors,
            self.ones,
            quantum,
            self.sums,
            level,
        )
        return level.correction


class PressureSolver:
    """System of the cells of a rank.

    Attributes:
        lattice: Blocks of this rank, Lattice.
        level: Fields of the finest level: u, inverse, scale and residual are the system.
        bodies: Free bodies that answer to the pressure, or None.
        solids: Deformable solids that do, or None.
    """

    def __init__(self, ranks: SerialCommunicator, domain: SystemDomain, real: np.dtype):
        """Take the communicator, the domain, and the type of the numbers."""
        self.ranks, self.domain, self.real = ranks, domain, real
        self.exchange: CellExchange | None = None
        self.coarse: CoarseLevels | None = None
        self.bodies: BodyResponse | None = None
        self.solids: SolidResponse | None = None
        self.factors = chebyshev_factors(CYCLE_SWEEPS, real)

    def set_topology(
        self, block: np.ndarray, cells: CellTopology, counted_nodes: np.ndarray
    ) -> None:
        """Take new blocks after a sort. Not collective.

        Args:
            block: Blocks of this rank, shape (n, 3).
            cells: Cells of this rank.
            counted_nodes: 1 for the nodes that this rank counts, shape (n, 64).
        """
        if self.exchange is not None:
            self.exchange.link.close()
        self.exchange = CellExchange(self.ranks, cells, self.real)
        self.lattice, self.count = lattice_of(block, cells.neighbors), len(block)
        self.level = level_fields(self.count, self.real)
        self.direction, self.product = (
            aligned_zeros(64 * (self.count + 1), self.real) for _ in range(2)
        )
        self.counted, self.counted_nodes = (
            np.append(marks.reshape(-1), np.zeros(64)).astype(self.real)
            for marks in (cells.counted, counted_nodes)
        )
        self.coarse = None

    def take_rows(
        self,
        each: Callable,
        call: Callable,
        cells: Sequence[np.ndarray],
        nodes: Sequence[np.ndarray],
    ) -> None:
        """Take what runs kernels in this step.

        Args:
            each, call: See NodeState.
            cells: Blocks of cells with pressure, by thread.
            nodes: Blocks of the nodes around them, by thread.
        """
        self._each_thread, self._call_kernel = each, call
        assert self.exchange is not None
        if len(cells) == 1 or sum(map(len, cells)) < SHARED_BLOCKS:
            cells, nodes = [np.concatenate(cells)], [np.concatenate(nodes)]
        self.cells, self.nodes = cells, nodes
        self.is_alone = len(cells) == 1 and not self.exchange.has_neighbors
        self.bodies = None

    def each(self, rows: Sequence[np.ndarray], kernel, *arguments) -> None:
        """Call a kernel with the rows of each thread, or here with those of a single one."""
        if len(rows) == 1:
            self._call(0, rows, kernel, arguments)
        else:
            self._each_thread(self._call, rows, kernel, arguments)

    def _call(self, thread: int, rows: Sequence[np.ndarray], kernel, arguments: tuple) -> None:
        self._call_kernel(kernel, rows[thread], *arguments)

    def respond(self, potential: np.ndarray) -> None:
        """Set u to what a potential, known around the cells of this rank, does to the nodes."""
        self.each(self.nodes, relaxation.respond, self.lattice, potential, self.level)

    def _sweep(self, factors: np.ndarray) -> None:
        """Relax the correction further."""
        assert self.exchange is not None
        if self.is_alone and self.bodies is None:  # one call in place of many
            nodes = self.nodes[0]
            self.each(self.cells, relaxation.sweep, nodes, self.lattice, factors, self.level)
            return
        for weight, inertia in factors:
            self.respond(self.level.correction)
            if self.bodies is not None:
                self.bodies.begin_sweep()
            self.each(self.cells, relaxation.relax, self.lattice, weight, inertia, self.level)
            if self.bodies is not None:
                self.bodies.end_sweep(weight, inertia)
            self.exchange.exchange(self.level.correction)

    def _sweep_from_zero(self, factors: np.ndarray) -> None:
        """Relax a correction of 0."""
        assert self.exchange is not None
        if self.bodies is not None:
            self.bodies.begin_first_sweep()
        self.each(self.cells, relaxation.begin_sweeps, factors[0, 0], self.level)
        if self.bodies is not None:
            self.bodies.end_sweep(*factors[0])
        self.exchange.exchange(self.level.correction)
        self._sweep(factors[1:])

    def find_moves(self) -> None:
        """Set u to the displacements of a system whose right-hand side is the residual."""
        self.level.correction[:] = 0
        self._sweep_from_zero(chebyshev_factors(POSITION_SWEEPS, self.real))
        self.respond(self.level.correction)

    def _multiply(self, potential: np.ndarray, product: np.ndarray) -> None:
        """Store the product of the system and a potential."""
        self.respond(potential)
        self.each(self.cells, relaxation.multiply, self.lattice, product, self.level)
        if self.bodies is not None:
            self.bodies.add_product(potential, product)
        if self.solids is not None:
            self.solids.add_product(potential, product)

    def subtract_product(self, potential: np.ndarray, values: np.ndarray) -> None:
        """Subtract the product of the system and a potential from numbers of cells. Collective."""
        self.product[:] = 0
        if self.bodies is not None:
            self.bodies.find_magnitude(potential)
        self._multiply(potential, self.product)
        values -= self.product

    def is_closed(self, filled: np.ndarray) -> bool:
        """Return whether a constant potential moves nothing: no liquid borders air. Collective.

        Args:
            filled: Above 0 in cells with pressure, known around the cells of this rank.
        """
        self.direction[:] = filled > 0
        self.product[:] = 0
        self.respond(self.direction)
        self.each(self.cells, relaxation.multiply, self.lattice, self.product, self.level)
        return not self.ranks.max(np.array([np.abs(self.product).max()]))[0] > 0

    def solve(self, phi: np.ndarray) -> None:
        """Bring phi nearer to the solution. Collective.

        Args:
            phi: First guess, known around the cells of this rank (in/out).
        """
        level, count = self.level, 64 * self.count
        residual, direction, product = (
            values[:count] for values in (level.residual, self.direction, self.product)
        )
        self.subtract_product(phi, level.residual)
        if self.solids is not None:
            self.solids.begin_totals()
        direction[:] = 0
        magnitude = self._prepare_levels(residual)
        if self.bodies is not None:
            self.bodies.take_magnitude(magnitude)
        before = 0.0
        for iteration in range(ITERATIONS):
            self._precondition(magnitude)
            now = self._inner_product(residual, level.correction, magnitude)
            if iteration:
                direction *= self.real.type(now / before if before > 0 else 0.0)
            direction += level.correction[:count]
            before = now
            self._multiply(self.direction, self.product)
            curvature = self._inner_product(direction, product, magnitude)
            length = self.real.type(now / curvature if curvature > 0 else 0.0)
            phi[:count] += length * direction
            if self.solids is not None:
                self.solids.add_to_totals(length)
            residual -= length * product

    def _prepare_levels(self, residual: np.ndarray) -> float:
        """Return a power of two near the largest residual, once all levels are set. Collective.

        It is 1 where there is no residual.
        """
        own = [float(np.abs(residual).max(initial=0)), float(self.coarse is None)]
        magnitude, is_new = self.ranks.max(np.array(own))
        if is_new:
            blocks = find_coarse_blocks(self.lattice.block, self.domain.cells, self.ranks)
            self.coarse = CoarseLevels(blocks, self.domain, self.ranks, self.real)
        assert self.coarse is not None
        self.coarse.set_systems(self._call_kernel, self.level, (self.counted, self.counted_nodes))
        if not 0 < magnitude < math.inf:
            return 1.0
        return 2.0 ** max(math.ceil(math.log2(magnitude)), MIN_EXPONENT)

    def _precondition(self, magnitude: float) -> None:
        """Set the correction to a multigrid cycle of the residual. Collective."""
        coarse, lattice, level = self.coarse, self.lattice, self.level
        assert coarse is not None and self.exchange is not None
        quantum = magnitude * 2.0**-REST_BITS
        self._sweep_from_zero(self.factors)
        self.respond(level.correction)
        per_quantum = self.real.type(1.0 / quantum)
        self.each(self.cells, relaxation.find_remainder, lattice, self.counted, per_quantum, level)
        if self.bodies is not None:
            self.bodies.correct_remainder(per_quantum)
        correction = coarse.find_correction(self._call_kernel, level.remainder, quantum)
        self.each(
            self.cells, multigrid.interpolate, lattice.block, coarse.blocks.parent_of_finest,
            coarse.blocks.sizes[0], correction, coarse.blocks.lattice, level.scale,
            level.correction,
        )  # fmt: skip
        self.exchange.exchange(level.correction)
        self._sweep(self.factors)

    def _inner_product(self, a: np.ndarray, b: np.ndarray, magnitude: float) -> float:
        """Return the sum of the products of the numbers of all cells of all ranks."""
        sums = np.zeros(2, np.int64)
        unit = (magnitude * magnitude) * 2.0**-PRODUCT_BITS
        rows = np.concatenate(self.cells)
        self._call_kernel(relaxation.sum_products, rows, a, b, self.counted, 1.0 / unit, sums)
        first, second = self.ranks.sum(sums).tolist()
        return ((first << SECOND_BITS) + second) * 2.0**-SECOND_BITS * unit

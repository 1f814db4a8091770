"""Suction that liquids bear: cells in which the pressure would be lower open.

An open cell has the lowest pressure p0, and its volume may grow. With the pressures p of cells and
the divergence D v of the velocities after the step,

    p >= p0,        D v >= 0,        (p - p0) D v = 0

in cells that may open, D v = 0 in all others. The system is solved as if no cell were open. Where a
pressure is too low, it is solved again: cells with too low a pressure open, open ones that would
shrink are held again, at first only those which the velocities before the pressure stretch. In a
domain whose liquid borders no air, the pressure is known but for a constant, and no cell opens.
See docs/explanation/implicit-pressure.md.

References:
    Batty, Bertails, Bridson (2007): A fast variational framework for accurate solid-fluid coupling.
    ACM Trans. Graph. 26 (3), 100.
    Hintermueller, Ito, Kunisch (2002): The primal-dual active set strategy as a semismooth Newton
    method. SIAM J. Optim. 13 (3), 865-888.
"""

from typing import Any, NamedTuple

import numpy as np

from vgmpi.features.active_feature import NodeState
from vgmpi.planning.plan import Plan
from vgmpi.runtime.aligned_arrays import aligned_zeros
from vgmpi.runtime.jit import always_inline, kernel

from .kernels.cell_stencils import corner_node
from .plan import liquid_groups
from .pressure_solver import PressureSolver
from .pressure_system import ColliderNodes, PressureFields

MAX_SOLUTIONS = 3  # after the first one; two find nearly all open cells
MAX_SHRINKAGE = 2e-3  # [-] of the volume of an open cell in a step
UNBOUNDED = 1e30  # of potentials and of rates


class SuctionBounds(NamedTuple):
    """When cells open and close; potentials are those of full cells."""

    at_free_surfaces: float  # lowest potential beside colliders on which liquids slip freely
    elsewhere: float  # lowest potential of all other cells
    max_remaining: float  # [1/s] cells open where the system leaves less of the right-hand side
    max_shrinkage: float  # [1/s] rate at which the volume of an open cell may shrink
    slips: Any  # (colliders,) whether liquids slip freely on each, free bodies among them


class SuctionCells(NamedTuple):
    """Cells of a rank, flat."""

    remaining: np.ndarray  # [1/s] what the potential leaves of the right-hand side
    is_open: np.ndarray  # 1 for open cells, else 0
    changed: np.ndarray  # (1,) above 0 if one has opened or closed


@always_inline
def _touches_free_surface(b, q, lattice, colliders, slips, fields):
    """Return whether a cell has nodes that liquids share with a collider on which they slip.

    Args:
        b, q: Block and number of the cell.
        lattice, colliders, fields: See `find_open_cells`.
        slips: See `SuctionBounds`.
    """
    for corner in range(8):
        block, node = corner_node(b, q, corner, lattice)
        row = colliders.row[block] if block < len(colliders.row) else -1
        n = 64 * block + node
        if row < 0 or not fields.free_part[n] < 1:
            continue
        others = 1.0 - fields.share[n] - fields.grain_part[n] - fields.solid_part[n]
        if others > 0 and (len(colliders.number) == 0 or slips[colliders.number[row, node]]):
            return True
    return False


@kernel
def find_open_cells(rows, lattice, bounds, colliders, fields, scale, cells):
    """Open the cells of some blocks whose potential is too low, and hold open ones that shrink.

    Args:
        rows: Blocks to process, shape (n,).
        lattice: Blocks, Lattice.
        bounds: SuctionBounds.
        colliders: ColliderNodes.
        fields: PressureFields.
        scale: Inverse diagonal, above 0 for the cells with pressure of this rank, flat.
        cells: SuctionCells (is_open and changed in/out).
    """
    remaining, is_open, changed = cells.remaining, cells.is_open, cells.changed
    real = is_open.dtype.type
    lowest = max(bounds.at_free_surfaces, bounds.elsewhere)
    for b in rows:
        for q in range(64):
            c = 64 * b + q
            if not scale[c] > 0:
                continue
            if is_open[c] > 0:
                if remaining[c] > bounds.max_shrinkage:
                    is_open[c], changed[0] = real(0.0), 1
                continue
            phi, filled = float(fields.phi[c]), float(fields.filled[c])
            if not (remaining[c] < bounds.max_remaining and phi < lowest * filled):
                continue
            if phi < bounds.elsewhere * filled or _touches_free_surface(
                b, q, lattice, colliders, bounds.slips, fields
            ):
                is_open[c], changed[0] = real(1.0), 1


class SuctionLimit:
    """Lowest pressure of the liquids of a run.

    Attributes:
        is_everywhere: Whether all cells may open, else only those beside free surfaces.
        is_open: 1 for the cells that were open in the last step, else 0, flat.
    """

    def __init__(self, ambient_pressure: float | None, slips: np.ndarray):
        """Take the pressure of the air [Pa], and whether liquids slip freely on each collider."""
        self.is_everywhere = ambient_pressure is not None
        self.pressure, self.slips = -(ambient_pressure or 0.0), slips

    def set_topology(self, solver: PressureSolver) -> None:
        """Take the solver, which has new blocks after a sort."""
        self.solver = solver
        self.is_open, self.right_side, self.remaining, self.scale = (
            aligned_zeros(64 * (solver.count + 1), solver.real) for _ in range(4)
        )

    def begin(self) -> None:
        """Take the right-hand side of a step, before the system is solved."""
        self.right_side[:] = self.solver.level.residual

    def open_cells(
        self, nodes: NodeState, near_colliders: np.ndarray, colliders: ColliderNodes,
        fields: PressureFields, phi_per_pressure: float, dt: float,
    ) -> None:  # fmt: skip
        """Open cells and solve the system again while some pressure is too low. Collective.

        Args:
            nodes: Nodes of the rank.
            near_colliders: Blocks with cells beside colliders, shape (n,).
            colliders: ColliderNodes.
            fields: PressureFields with the first solution (phi in/out).
            phi_per_pressure: Potential of a full cell per pressure [1/(Pa s)].
            dt: Length of the step [s].
        """
        solver = self.solver
        lowest = phi_per_pressure * self.pressure
        elsewhere = lowest if self.is_everywhere else -UNBOUNDED
        bounds = SuctionBounds(lowest, elsewhere, 0.0, MAX_SHRINKAGE / dt, self.slips)
        rows = np.concatenate(solver.cells) if self.is_everywhere else near_colliders
        self.is_open[:] = 0
        self.remaining[:] = self.right_side
        for number in range(MAX_SOLUTIONS):
            cells = SuctionCells(self.remaining, self.is_open, np.zeros(1, np.int64))
            nodes.call(
                find_open_cells, rows, solver.lattice, bounds, colliders, fields,
                solver.level.scale, cells,
            )  # fmt: skip
            if not solver.ranks.max(cells.changed)[0]:
                return
            if number == 0 and solver.is_closed(fields.filled):
                self.is_open[:] = 0
                return
            self._solve_again(fields, solver.real.type(lowest))
            self.remaining[:] = self.right_side
            solver.subtract_product(fields.phi, self.remaining)
            bounds = bounds._replace(max_remaining=UNBOUNDED)

    def _solve_again(self, fields: PressureFields, lowest: np.floating) -> None:
        """Solve the system with the lowest potential of full cells in the open ones. Collective."""
        solver, level, count = self.solver, self.solver.level, 64 * self.solver.count
        assert solver.exchange is not None
        solver.exchange.exchange(self.is_open)
        is_open = self.is_open[:count] > 0
        fields.phi[:count][is_open] = lowest * fields.filled[:count][is_open]
        level.residual[:], self.scale[:] = self.right_side, level.scale
        level.residual[:count][is_open] = level.scale[:count][is_open] = 0
        if solver.bodies is not None:
            solver.bodies.take_cells()
        solver.solve(fields.phi)
        level.scale[:] = self.scale


def limit_suction(
    ambient_pressure: float | None, plan: Plan, colliders: int
) -> SuctionLimit | None:
    """Return the suction that the liquids of a run bear, or None if they bear any.

    Args:
        ambient_pressure: Key of the scene [Pa].
        plan: Plan of the run.
        colliders: Number of colliders, free bodies among them.
    """
    slips: np.ndarray = np.ones(colliders, bool)
    phases = [group.phase for group in liquid_groups(plan)]
    laws = (feature.adhesion for feature in plan.features)
    law = next((each for each in laws if each is not None), None)
    if law is not None:
        slips = (np.array(law.lengths)[:, phases] == np.inf).all(1)
    if ambient_pressure is None and not slips.any():
        return None
    return SuctionLimit(ambient_pressure, slips)

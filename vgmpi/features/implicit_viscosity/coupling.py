"""Implicit viscosity of liquids in a step: sweeps over the nodes that solve for their velocities.

With the masses M of the nodes and the stiffness K of the cells, the velocities v* after all other
forces but an implicit pressure become v of (M + dt K) v = M v*. This is backward Euler's method:
the balance of steady flows does not depend on the step. The number of sweeps follows from the step
alone, so that all ranks agree. What the sweeps leave over has no momentum, since K does not feel
translations. See docs/explanation/implicit-viscosity.md.
"""

import math
from collections.abc import Sequence

import numpy as np

from vgmpi.features.active_feature import ActiveFeature, NodeState, StartContext
from vgmpi.kernels.grid.phase_nodes import PhaseNodes, cells_of_patch
from vgmpi.kernels.step_records import StepSpan
from vgmpi.parallel.block_ownership import BlockDirectory
from vgmpi.parallel.cell_exchange import CellExchange, phase_topology
from vgmpi.parallel.exchange_topology import ExchangeTopology
from vgmpi.planning.plan import Plan
from vgmpi.runtime.aligned_arrays import aligned_zeros

from .kernels import viscous_nodes, viscous_sweeps
from .kernels.viscous_nodes import CollidersNearby
from .kernels.viscous_sweeps import MAX_EIGENVALUE, viscous_fields
from .plan import ViscousLiquid

FULL = 0.5  # [-] fill from which on a node counts as full: particles that move leave nodes uneven
# What the sweeps leave: of the change of the velocities, and of a flow across some cells, which is
# far smaller than the change where viscosity has long stopped what forces add in a step.
MAX_ERROR, FLOW_CELLS = 0.005, 16.0


def sweep_factors(diffusion: float) -> list[tuple[float, float]]:
    """Return (factor of the residual, factor of the last step) of each sweep.

    Args:
        diffusion: nu dt / dx2. Eigenvalues lie between 1 and 1 + MAX_EIGENVALUE / FULL of it.

    References:
        Golub and Varga 1961: Chebyshev semi-iterative methods. Numer. Math. 3, 147-156.
    """
    highest = 1.0 + MAX_EIGENVALUE / FULL * diffusion
    middle, ratio = 0.5 * (highest + 1.0), (highest - 1.0) / (highest + 1.0)
    error = MAX_ERROR / (1.0 + diffusion * (math.pi / FLOW_CELLS) ** 2)
    number = math.ceil(0.5 * math.sqrt(highest) * math.log(2.0 / error))
    omega, factors = 1.0, [(1.0 / middle, 0.0)]
    for _ in range(number - 1):
        omega = 1.0 / (1.0 - (0.25 * omega if len(factors) > 1 else 0.5) * ratio**2)
        factors.append((omega / middle, omega - 1.0))
    return factors


class ImplicitViscosity(ActiveFeature):
    """Implicit viscosity at the nodes of a rank."""

    couples_nodes = True

    def __init__(self, context: StartContext, liquids: Sequence[ViscousLiquid]):
        """Take what may change in a run, and the liquids with viscosity."""
        self.systems = [LiquidSystem(context, liquid) for liquid in liquids]

    def set_topology(self, tables: ExchangeTopology, census: BlockDirectory) -> None:
        """Take new tables after a sort.

        Args:
            tables: Topology of this rank.
            census: Segments of this rank and nearby ones.
        """
        for system in self.systems:
            system.set_topology(tables, census)

    def couple_nodes(self, nodes: NodeState, span: StepSpan, gravity: np.ndarray) -> None:
        """Change the velocities of the nodes in a step.

        Args:
            nodes: Nodes of the rank.
            span: The step.
            gravity: Acceleration, shape (3,) [m/s2].
        """
        for system in self.systems:
            system.couple(nodes, span.dt)


class LiquidSystem:
    """Nodes of a liquid, which has a velocity field of its own, on a rank."""

    def __init__(self, context: StartContext, liquid: ViscousLiquid):
        """Take the constants of a plan and of a liquid."""
        plan = self.plan = context.plan
        self.lattice, self.ranks, self.threads = context.lattice, context.ranks, context.threads
        self.liquid = liquid
        self.is_own_group = np.array([group.phase == liquid.phase for group in plan.groups])
        self.sticks = sticking_colliders(plan.features, liquid.phase)
        acts = acts_along_normals(plan) or self.sticks.any()
        self.colliders = context.collider_nodes if acts else None
        self.is_cell = cells_of_patch(plan.real)
        self.exchanges: tuple[CellExchange, ...] = ()

    def set_topology(self, tables: ExchangeTopology, census: BlockDirectory) -> None:
        """Take new tables after a sort; see `ImplicitViscosity.set_topology`."""
        rank, real = self.ranks.rank, self.plan.real
        own = phase_topology(
            tables, census, self.lattice, rank, self.liquid.phase, self.is_own_group
        )
        rows = own.rows
        self.nodes = PhaseNodes(rows, tables.solid[own.block_of], own.block, own.nodes.region)
        self.neighbors = own.nodes.neighbors.reshape(-1)
        for exchange in self.exchanges:
            exchange.link.close()
        kinds = own.nodes, own.vectors
        self.exchanges = tuple(CellExchange(self.ranks, each, real) for each in kinds)
        self.near_colliders = np.flatnonzero(self.nodes.solid >= 0)
        count, is_held = len(rows), self.colliders is not None and len(self.near_colliders) > 0
        self.fields = viscous_fields(count, is_held and acts_along_normals(self.plan), real)
        self.velocities = [aligned_zeros(192 * (count + 1), real) for _ in range(2)]
        self.has_normals, self.wet = np.zeros(count, bool), np.zeros(count, bool)
        self.all_rows = np.array_split(np.arange(count), self.threads)

    def couple(self, nodes: NodeState, dt: float) -> None:
        """Change the velocities of the nodes in a step of dt [s]. Collective."""
        plan, liquid, fields, real = self.plan, self.liquid, self.fields, self.plan.real.type
        of_fill, of_vectors = self.exchanges
        self.each, self.call = nodes.each, nodes.call
        unit = liquid.density * plan.dx**3
        self.run(
            self.all_rows, viscous_nodes.set_nodes, self.nodes, nodes.walls, unit,
            nodes.velocities, fields, *self.velocities,
        )  # fmt: skip
        self.hold_at_colliders(nodes)
        of_fill.exchange(fields.fill)
        of_vectors.exchange(self.velocities[0])
        diffusion = liquid.viscosity * dt / plan.dx**2
        self.run(
            self.all_rows, viscous_sweeps.set_cells, self.neighbors, self.is_cell,
            real(diffusion), real(1.0 / FULL), fields, self.wet,
        )  # fmt: skip
        rows = np.array_split(np.flatnonzero(self.wet), self.threads)
        self.solve(rows, sweep_factors(diffusion))
        self.run(
            rows, viscous_nodes.store_velocities, self.nodes, nodes.walls, fields,
            self.velocities[0], nodes.velocities,
        )  # fmt: skip

    def solve(self, rows: Sequence[np.ndarray], factors: list[tuple[float, float]]) -> None:
        """Bring the first of the velocities near to the solution. Collective."""
        real = self.plan.real.type
        for weight, inertia in factors:
            before, after = self.velocities
            self.run(
                rows, viscous_sweeps.sweep, self.neighbors, real(weight), real(inertia),
                self.has_normals, self.fields, before, after,
            )  # fmt: skip
            self.exchanges[1].exchange(after)
            self.velocities = [after, before]

    def hold_at_colliders(self, nodes: NodeState) -> None:
        """Hold the nodes that touch colliders."""
        if self.colliders is None or not len(self.near_colliders):
            return
        nearby = CollidersNearby(
            self.colliders.nodes, self.colliders.collider_number, self.sticks, nodes.velocities,
            nodes.fields["offsets"].nodes,
        )  # fmt: skip
        nodes.call(
            viscous_nodes.hold_at_colliders, self.near_colliders, self.nodes, self.liquid.phase,
            nodes.phases, nearby, self.plan.dx, self.fields, self.has_normals,
        )  # fmt: skip

    def run(self, rows: Sequence[np.ndarray], kernel, *arguments) -> None:
        """Call a kernel with the rows of each thread."""
        self.each(self.run_on_thread, rows, kernel, arguments)

    def run_on_thread(self, thread: int, rows: Sequence[np.ndarray], kernel, arguments) -> None:
        """Call a kernel with the rows of a thread."""
        self.call(kernel, rows[thread], *arguments)


def acts_along_normals(plan: Plan) -> bool:
    """Return whether colliders hold nodes along normals: an implicit pressure has all that does."""
    return not any(group.volume.separate_pressure for group in plan.groups)


def sticking_colliders(plans: Sequence, phase: int) -> np.ndarray:
    """Return whether a phase sticks to each collider, shape (colliders or 1,) bool.

    Args:
        plans: Plans of the features of the run.
        phase: The phase.
    """
    adhesion = next((plan.adhesion for plan in plans if plan.adhesion is not None), None)
    if adhesion is None:
        return np.zeros(1, bool)
    return np.array(adhesion.lengths)[:, phase] == 0.0

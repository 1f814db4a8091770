"""Implicit elasticity in a step: the nodes of a solid answer to impulses together.

With the masses M of the nodes and an isotropic stiffness K of the cells, as stiff as the solid, an
impulse r changes the velocities by (M + beta dt2 K)^-1 r. K feels neither translations nor turns:
momentum stays. It multiplies the change of velocity and not the velocity: waves that are shorter
than the way of some steps are slowed, neither damped nor unstable, at any length of the step.
See docs/explanation/implicit-elasticity.md.

References:
    Olovsson, Simonsson and Unosson 2005: Selective mass scaling for explicit finite element
    analyses. Int. J. Numer. Meth. Eng. 63, 1436-1445.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from vgmpi.features.active_feature import (
    ActiveFeature,
    NodeState,
    StartContext,
    reserved_nodes,
)
from vgmpi.kernels.grid.phase_nodes import PhaseNodes, cells_of_patch
from vgmpi.kernels.step_records import StepSpan
from vgmpi.materials.couplings.interaction import CONTACT
from vgmpi.parallel.block_ownership import BlockDirectory
from vgmpi.parallel.cell_exchange import CellExchange, phase_topology
from vgmpi.parallel.exchange_topology import ExchangeTopology
from vgmpi.runtime.aligned_arrays import aligned_zeros

from .kernels import solid_nodes, solid_sweeps
from .kernels.solid_nodes import Ties, solid_fields
from .plan import ElasticPhase

BETA = 0.5  # [-] of Newmark's family: waves are stable from 1/4 on where K is as stiff as the solid
MAX_EIGENVALUE = 4.5  # [c2 dt2 / dx2] of M^-1 dt2 K; 3.5 within solids
SHARED_BLOCKS = 400  # with fewer, one thread is faster than two that wait for each other
# [-] of the answer to an impulse, relative to the impulse: an error slows or speeds up waves that
# are slowed anyway, and they are stable up to 1
MAX_ERROR = 0.5
# of sands with drag: their nodes answer to the pressure with the mass of liquids, and to their
# stress without it, and both answers must agree
MAX_PORE_ERROR = 0.05
NO_MARKS = np.zeros((0, 64), np.uint8)


def sweep_weights(stiffness: float, error: float = MAX_ERROR) -> list[float]:
    """Return the weights of the sweeps: inverse roots of a polynomial, the first of them 1.

    Eigenvalues lie between 1 and 1 + MAX_EIGENVALUE stiffness. The order keeps the products of the
    first ones small.

    Args:
        stiffness: beta (c dt / dx)2.
        error: Part of the answer of the shortest waves that they may leave.
    """
    highest = 1.0 + MAX_EIGENVALUE * stiffness
    number = 1
    while True:
        ends = math.cos(0.5 * math.pi / number)
        half = (highest - 1.0) / (1.0 + ends)
        if half <= 0.0:
            return [1.0]
        middle = highest - half
        reach = math.acosh(max(middle / half, 1.0))
        if math.cosh(number * reach) >= 1.0 / error:
            break
        number += 1
    angles = (2 * np.arange(number) + 1) * (0.5 * np.pi / number)
    roots, order = middle - half * np.cos(angles), [0]
    while len(order) < number:
        left = [k for k in range(number) if k not in order]
        spans = [float(np.log(np.abs(roots[k] - roots[order])).sum()) for k in left]
        order.append(left[int(np.argmax(spans))])
    return [1.0, *(1.0 / roots[order[1:]]).tolist()]


class ImplicitElasticity(ActiveFeature):
    """Implicit elasticity at the nodes of a rank."""

    filters_impulses = True

    def __init__(self, context: StartContext, solids: Sequence[ElasticPhase]):
        """Take what may change in a run, and the velocity fields of solids."""
        plan = self.plan = context.plan
        self.ranks = context.ranks
        pairs, own = plan.pair_rules, [solid.phase for solid in solids]
        touches = pairs is None or bool((pairs[own] == CONTACT).sum() > len(own))
        stops = any(kind == "separate" for kind, _ in plan.walls.solids)
        self.couples_nodes = plan.collider or stops or (plan.contact.has_pairs and touches)
        self.systems = [SolidSystem(context, solid) for solid in solids]
        self.deformable_solids = self.systems

    def set_topology(self, tables: ExchangeTopology, census: BlockDirectory) -> None:
        """Take new tables after a sort.

        Args:
            tables: Topology of this rank.
            census: Segments of this rank and nearby ones.
        """
        for system in self.systems:
            system.set_topology(tables, census)
        sizes = [192 * (len(system.rows) + 1) for system in self.systems]
        self.impulses, self.expected = (
            [aligned_zeros(size, self.plan.real) for size in sizes] for _ in range(2)
        )

    def filter_stress(self, nodes: NodeState, span: StepSpan) -> None:
        """Let the stress impulses act on the nodes of each solid together.

        Args:
            nodes: Nodes of the rank.
            span: The step.
        """
        nodal, real = nodes.fields["impulses"].nodes, self.plan.real.type
        parts = zip(self.systems, self.impulses, self.expected, strict=True)
        for system, impulses, expected in parts:
            system.begin(nodes, span.dt)
            rows, unit = np.arange(len(system.rows)), system.mass_of_cell
            nodes.call(
                solid_sweeps.take_impulses, rows, system.nodes, real(1.0 / unit), nodal, impulses
            )
            w = system.answer(impulses)
            nodes.call(
                solid_sweeps.store_impulses, rows, system.nodes, real(unit), w,
                system.find_reactions(impulses, w), system.fields, nodes.velocities, nodal,
            )  # fmt: skip
            nodes.call(
                solid_sweeps.expect_velocities, rows, system.nodes, nodes.velocities, w, expected
            )

    def couple_nodes(self, nodes: NodeState, span: StepSpan, gravity: np.ndarray) -> None:
        """Let the impulses of contact act on the nodes of each solid together.

        Contact, and walls that let go, have stopped single nodes: a kink that would be an error of
        the stress.

        Args:
            nodes, span, gravity: See `ActiveFeature.couple_nodes`.
        """
        parts = zip(self.systems, self.impulses, self.expected, strict=True)
        for system, impulses, expected in parts:
            impulses[:] = 0
            touches = np.zeros(1, np.int64)
            nodes.call(
                solid_sweeps.take_contact, system.occupied_rows, system.nodes,
                nodes.walls.cells, nodes.velocities, system.fields, expected, impulses, touches,
            )  # fmt: skip
            if self.ranks.max(touches.astype(float))[0] > 0:
                w = system.answer(impulses)
                nodes.call(
                    solid_sweeps.spread_contact, system.occupied_rows, system.nodes, w,
                    system.fields, impulses, nodes.velocities,
                )  # fmt: skip


class SweepArrays(NamedTuple):
    """Numbers of the sweeps, flat, 192 of each block, and the row of no block."""

    remainder: np.ndarray
    change: np.ndarray
    w: np.ndarray  # changes of velocity


class SolidSystem:
    """Nodes of a phase of solids on a rank: a `DeformableSolid`."""

    def __init__(self, context: StartContext, solid: ElasticPhase):
        """Take what may change in a run, and a solid."""
        self.context, self.solid, self.phase = context, solid, solid.phase
        self.mass_of_cell = solid.density * context.plan.dx**3
        drags = [each.pore_drag for each in context.plan.features if each.pore_drag is not None]
        is_porous = any(drag.grain_volumes[self.phase] > 0 for drag in drags)
        self.error = MAX_PORE_ERROR if is_porous else MAX_ERROR
        self.exchanges: tuple[CellExchange, ...] = ()

    def set_topology(self, tables: ExchangeTopology, census: BlockDirectory) -> None:
        """Take new tables after a sort; see `ImplicitElasticity.set_topology`."""
        context, plan, real = self.context, self.context.plan, self.context.plan.real
        # the pressure of a liquid pushes where another rank has the solid's particles
        meets_liquids = any(group.volume.separate_pressure for group in plan.groups)
        is_own = np.array([meets_liquids or group.phase == self.phase for group in plan.groups])
        own = phase_topology(
            tables, census, context.lattice, context.ranks.rank, self.phase, is_own
        )
        self.rows, self.block_of = own.rows, own.block_of
        self.nodes = PhaseNodes(own.rows, tables.solid[own.block_of], own.block, own.nodes.region)
        self.neighbors = own.nodes.neighbors.reshape(-1)
        for exchange in self.exchanges:
            exchange.link.close()
        kinds = own.nodes, own.vectors
        self.exchanges = tuple(CellExchange(context.ranks, each, real) for each in kinds)
        count = len(own.rows)
        self.fields = solid_fields(count, real)
        self.is_attached, self.loose = self.fields.is_attached, self.fields.loose
        self.uptake = self.fields.uptake
        self.arrays = SweepArrays(*(aligned_zeros(192 * (count + 1), real) for _ in range(3)))
        self.occupied_rows = np.arange(count)
        self.ties = no_ties(real), no_ties(real)

    def begin(self, state: NodeState, dt: float) -> None:
        """Take the masses of the nodes in a step of dt [s]. Collective."""
        self.state = state
        plan, solid, fields = self.context.plan, self.solid, self.fields
        rows = np.arange(len(self.rows))
        of_scalars = self.exchanges[0]
        marks = reserved_nodes(self.context.features)
        state.call(
            solid_nodes.set_nodes, rows, self.nodes, state.walls, self.mass_of_cell,
            state.velocities, state.fields["impulses"].nodes,
            NO_MARKS if marks is None else marks, fields,
        )  # fmt: skip
        for values in (fields.fill, fields.mass, fields.inverse_own):
            of_scalars.exchange(values)
        for values in (fields.is_heavy, fields.follows, fields.is_attached, fields.inverse):
            values[:] = 0  # in blocks that are not near the solid
        reached = self.find_reached_rows()
        state.call(solid_nodes.find_heavy_nodes, reached, self.neighbors, fields)
        of_scalars.exchange(fields.is_heavy)
        state.call(solid_nodes.attach_nodes, reached, self.neighbors, fields)
        self.find_occupied_rows()
        of_scalars.exchange(fields.follows)
        of_scalars.exchange(fields.is_attached)
        # of heavy nodes to those that follow them, and of these to those
        self.ties = self.find_ties(False, self.ties[0]), self.find_ties(True, self.ties[1])
        state.call(solid_nodes.set_inverse, reached, self.ties[0], fields)
        of_scalars.exchange(fields.inverse)
        fields.support[:] = 0
        state.call(solid_nodes.set_support, reached, self.ties[1], fields)
        of_scalars.exchange(fields.support)
        if marks is not None:
            state.call(solid_nodes.hold_nodes, rows, fields)
        courant = solid.wave_speed * dt / plan.dx
        stiffness = self.stiffness = plan.real.type(BETA * courant * courant)
        self.weights = np.array(sweep_weights(stiffness, self.error), plan.real)
        state.call(
            solid_nodes.set_cells, self.occupied_rows, self.neighbors, cells_of_patch(plan.real),
            plan.real.type(stiffness * solid.shear_part), fields,
        )  # fmt: skip
        state.call(
            solid_nodes.set_relative_response, self.occupied_rows, self.ties[1],
            plan.real.type(solid.trace), fields,
        )  # fmt: skip

    def find_reached_rows(self) -> np.ndarray:
        """Return the blocks in or beside which the solid is."""
        is_filled = self.fields.fill.reshape(-1, 64).max(1) > 0
        return np.flatnonzero(is_filled[self.neighbors.reshape(-1, 27)].any(1))

    def find_occupied_rows(self) -> None:
        """Find the blocks with nodes of the solid, or nodes that follow some."""
        own, attached = (
            values[: 64 * len(self.rows)].reshape(-1, 64).any(1)
            for values in (self.fields.mass, self.fields.is_attached)
        )
        self.occupied_rows = np.flatnonzero(own | attached)
        self.arrays.remainder[:] = self.arrays.change[:] = 0  # of blocks that are used no more

    def find_ties(self, of_light: bool, last: Ties) -> Ties:
        """Return the ties of light nodes, or of heavy ones.

        Args:
            of_light: Whether those of light nodes.
            last: Ties of the last step, whose memory serves again.
        """
        storage = Ties(*(part.base if part.base is not None else part for part in last))
        while True:
            counts = np.zeros(2, np.int64)
            self.state.call(
                solid_nodes.find_ties, self.occupied_rows, self.neighbors, self.fields, of_light,
                counts, storage,
            )  # fmt: skip
            number, count = counts.tolist()
            if number <= len(storage.nodes) and count <= len(storage.others):
                break
            real = storage.weights.dtype
            storage = Ties(
                np.zeros(2 * number, np.int64), np.zeros(2 * number + 1, np.int64),
                np.zeros(2 * count, np.int64), np.zeros(2 * count, real),
            )  # fmt: skip
        return Ties(
            storage.nodes[:number], storage.first[: number + 1], storage.others[:count],
            storage.weights[:count],
        )  # fmt: skip

    def carry(self, masses: np.ndarray) -> np.ndarray:
        """Let the nodes carry masses besides their own from now on; see the protocol."""
        fields, of_scalars, state = self.fields, self.exchanges[0], self.state
        rows, real = np.arange(len(self.rows)), self.context.plan.real
        fields.mass[:] += masses
        heaviness = fields.mass * fields.uptake
        np.divide(1, heaviness, out=fields.inverse_own, where=fields.inverse_own > 0)
        of_scalars.exchange(fields.mass)
        of_scalars.exchange(fields.inverse_own)
        state.call(solid_nodes.set_inverse, rows, self.ties[0], fields)
        of_scalars.exchange(fields.inverse)
        if fields.is_held.any():
            state.call(solid_nodes.hold_nodes, rows, fields)
        state.call(
            solid_nodes.set_relative_response, self.occupied_rows, self.ties[1],
            real.type(self.solid.trace), fields,
        )  # fmt: skip
        return fields.inverse / (1 + self.stiffness * fields.inverse * fields.fill)

    def answer(self, impulses: np.ndarray) -> np.ndarray:
        """Return the changes of velocity by impulses, known around the nodes; see the protocol."""
        fields, exchange, state = self.fields, self.exchanges[1], self.state
        pushes, pulls = self.ties
        remainder, change, w = self.arrays
        rows, trace = self.occupied_rows, self.context.plan.real.type(self.solid.trace)
        w[:] = 0
        if not exchange.has_neighbors and len(rows) < SHARED_BLOCKS:  # one call in place of many
            state.call(
                solid_sweeps.sweep, rows, self.neighbors, trace, self.weights, self.ties,
                impulses, fields, self.arrays,
            )  # fmt: skip
            return w
        parts = np.array_split(rows, len(state.block_rows))
        state.call(solid_sweeps.begin_remainder, rows, impulses, fields, remainder)
        for number, weight in enumerate(self.weights):
            if number:
                state.each(
                    self.run_on_thread, parts, solid_sweeps.find_remainder, self.neighbors,
                    trace, impulses, fields, w, remainder,
                )  # fmt: skip
            exchange.exchange(remainder)
            state.call(solid_sweeps.divide_by_mass, rows, pushes, pulls, fields, remainder, change)
            exchange.exchange(change)
            state.call(solid_sweeps.add_change, rows, weight, pulls, pushes, fields, change, w)
            exchange.exchange(w)
        return w

    def find_reactions(self, impulses: np.ndarray, w: np.ndarray) -> np.ndarray:
        """Return what walls hold of impulses with the answer w, flat; none without friction."""
        remainder, trace = self.arrays.remainder, self.context.plan.real.type(self.solid.trace)
        if not np.any(self.state.walls.friction):
            return remainder[:0]
        fields = self.fields._replace(loose=np.ones_like(self.fields.loose))
        self.state.call(
            solid_sweeps.find_remainder, self.occupied_rows, self.neighbors, trace, impulses,
            fields, w, remainder,
        )  # fmt: skip
        return remainder

    def run_on_thread(self, thread: int, parts: list[np.ndarray], kernel, *arguments) -> None:
        """Call a kernel with the rows of a thread.

        Args:
            thread: Number of the thread.
            parts: Rows by thread.
            kernel, arguments: The kernel, and its arguments after the rows.
        """
        self.state.call(kernel, parts[thread], *arguments)


def no_ties(real: np.dtype) -> Ties:
    """Return ties of no nodes."""
    none = np.zeros(0, np.int64)
    return Ties(none, np.zeros(1, np.int64), none, np.zeros(0, real))

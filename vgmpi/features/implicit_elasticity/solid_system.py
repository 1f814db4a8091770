"""System of the nodes of solids: (M + beta dt2 K)^-1 of impulses, by sweeps on all ranks together.

Solids whose answers are as exact as each other's share one system, each in blocks of its own: they
take part in the same sweeps and messages.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from vgmpi.features.active_feature import NodeState, StartContext, reserved_nodes
from vgmpi.kernels.grid.phase_nodes import PhaseNodes, cells_of_patch
from vgmpi.parallel.block_ownership import BlockDirectory
from vgmpi.parallel.cell_exchange import CellExchange, join_topologies, phase_topology
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


class SweepArrays(NamedTuple):
    """Numbers of the sweeps, flat, 192 of each block, and the row of no block."""

    remainder: np.ndarray
    change: np.ndarray
    w: np.ndarray  # changes of velocity


@dataclass
class SolidPart:
    """Phase of solids in a system: a `DeformableSolid`.

    Attributes:
        phase: The phase.
        mass_of_cell: Mass of a full cell [kg].
        solid: The phase as planned.
        rows: Numbers of its blocks in the system.
        occupied_rows: See `DeformableSolid`.
        stiffness: beta (c dt / dx)2 of a step.
    """

    phase: int
    mass_of_cell: float
    solid: ElasticPhase
    rows: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))
    occupied_rows: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))
    stiffness: float = 0.0


class SolidSystem:
    """Nodes of phases of solids on a rank: a `DeformableSolids`."""

    def __init__(self, context: StartContext, solids: Sequence[ElasticPhase], error: float):
        """Take what may change in a run, solids, and the error of an answer, see MAX_ERROR."""
        self.context, self.error = context, error
        cell = context.plan.dx**3
        self.parts = [SolidPart(solid.phase, solid.density * cell, solid) for solid in solids]
        self.exchanges: tuple[CellExchange, ...] = ()

    def set_topology(self, tables: ExchangeTopology, census: BlockDirectory) -> None:
        """Take new tables after a sort; see `ImplicitElasticity.set_topology`."""
        context, plan, real = self.context, self.context.plan, self.context.plan.real
        # the pressure of a liquid pushes where another rank has the solid's particles
        meets_liquids = any(group.volume.separate_pressure for group in plan.groups)
        topologies = []
        for part in self.parts:
            is_own = [meets_liquids or group.phase == part.phase for group in plan.groups]
            topologies.append(
                phase_topology(
                    tables, census, context.lattice, context.ranks.rank, part.phase,
                    np.array(is_own),
                )
            )  # fmt: skip
        own = join_topologies(topologies)
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
        self.trace, first = np.zeros(count, real), 0
        for part, topology in zip(self.parts, topologies, strict=True):
            part.rows = part.occupied_rows = np.arange(first, first + len(topology.rows))
            self.trace[part.rows] = part.solid.trace
            first += len(topology.rows)
        self.ties = no_ties(real), no_ties(real)

    def begin(self, state: NodeState, dt: float) -> None:
        """Take the masses of the nodes in a step of dt [s]. Collective."""
        self.state = state
        plan, fields = self.context.plan, self.fields
        rows, of_scalars = np.arange(len(self.rows)), self.exchanges[0]
        marks = reserved_nodes(self.context.features)
        for part in self.parts:
            state.call(
                solid_nodes.set_nodes, part.rows, self.nodes, state.walls, part.mass_of_cell,
                state.velocities, state.fields["impulses"].nodes,
                NO_MARKS if marks is None else marks, fields,
            )  # fmt: skip
        for values in (fields.fill, fields.mass, fields.inverse_own):
            of_scalars.exchange(values)
        for values in (fields.is_heavy, fields.follows, fields.is_attached, fields.inverse):
            values[:] = 0  # in blocks that are not near a solid
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
        for part in self.parts:
            courant = part.solid.wave_speed * dt / plan.dx
            part.stiffness = plan.real.type(BETA * courant * courant)
            state.call(
                solid_nodes.set_cells, part.occupied_rows, self.neighbors,
                cells_of_patch(plan.real),
                plan.real.type(part.stiffness * part.solid.shear_part), fields,
            )  # fmt: skip
        stiffest = max(part.stiffness for part in self.parts)
        self.weights = np.array(sweep_weights(stiffest, self.error), plan.real)
        self.set_relative_response()

    def set_relative_response(self) -> None:
        """Set by what part light nodes move apart from their neighbors."""
        self.state.call(
            solid_nodes.set_relative_response, self.occupied_rows, self.ties[1], self.trace,
            self.fields,
        )  # fmt: skip

    def find_reached_rows(self) -> np.ndarray:
        """Return the blocks in or beside which solids are."""
        is_filled = self.fields.fill.reshape(-1, 64).max(1) > 0
        return np.flatnonzero(is_filled[self.neighbors.reshape(-1, 27)].any(1))

    def find_occupied_rows(self) -> None:
        """Find the blocks with nodes of solids, or nodes that follow some."""
        own, attached = (
            values[: 64 * len(self.rows)].reshape(-1, 64).any(1)
            for values in (self.fields.mass, self.fields.is_attached)
        )
        is_occupied = np.asarray(own | attached)
        self.occupied_rows = np.flatnonzero(is_occupied)
        for part in self.parts:
            part.occupied_rows = part.rows[is_occupied[part.rows]]
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
        self.set_relative_response()
        stiffness = np.zeros(len(self.rows) + 1, real)
        for part in self.parts:
            stiffness[part.rows] = part.stiffness
        return fields.inverse / (1 + np.repeat(stiffness, 64) * fields.inverse * fields.fill)

    def answer(self, impulses: np.ndarray) -> np.ndarray:
        """Return the changes of velocity by impulses, known around the nodes; see the protocol."""
        fields, exchange, state = self.fields, self.exchanges[1], self.state
        pushes, pulls = self.ties
        remainder, change, w = self.arrays
        rows, trace = self.occupied_rows, self.trace
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
        remainder = self.arrays.remainder
        if not np.any(self.state.walls.friction):
            return remainder[:0]
        fields = self.fields._replace(loose=np.ones_like(self.fields.loose))
        self.state.call(
            solid_sweeps.find_remainder, self.occupied_rows, self.neighbors, self.trace, impulses,
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


def join_solids(context: StartContext, solids: Sequence[ElasticPhase]) -> list[SolidSystem]:
    """Return the systems of solids: one of sands with drag, and one of all others.

    Args:
        context: What may change in a run.
        solids: The phases.
    """
    drags = [each.pore_drag for each in context.plan.features if each.pore_drag is not None]
    by_error: dict[float, list[ElasticPhase]] = {}
    for solid in solids:
        is_porous = any(drag.grain_volumes[solid.phase] > 0 for drag in drags)
        by_error.setdefault(MAX_PORE_ERROR if is_porous else MAX_ERROR, []).append(solid)
    return [SolidSystem(context, by_error[error], error) for error in sorted(by_error)]


def no_ties(real: np.dtype) -> Ties:
    """Return ties of no nodes."""
    none = np.zeros(0, np.int64)
    return Ties(none, np.zeros(1, np.int64), none, np.zeros(0, real))

"""Pinned parts of bodies in a step: their poses, their particles, and the nodes next to them.

The particles of a pinned part are not on the grid. A node of the body up to 1.5 cells inside or
outside of the part's surface takes the impulse m (V - v_s), where V is the velocity of the part at
its surface and v_s = v - D dv/dn that of the body there, D the distance of the node outside. It has
both signs and all directions, so the body is attached to the part. This is the rule of liquids that
stick (docs/explanation/contact.md) without the condition that something touches.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from vgmpi.features.active_feature import (
    ActiveFeature,
    FilledNodes,
    NodeState,
    StartContext,
)
from vgmpi.kernels.colliders.moving_colliders import MovingColliders
from vgmpi.kernels.colliders.sdf_sampling import (
    distance_from_collider,
    set_node_indices,
    surface_velocity,
    turn_gradient,
)
from vgmpi.kernels.colliders.surface_flow import REACH_CELLS, mean_gradient
from vgmpi.kernels.reaction_impulses import add_contact_reaction, set_block, set_node
from vgmpi.kernels.rigid.prescribed_motion import PrescribedSteps, turn_rates
from vgmpi.kernels.step_records import StepMaxima, StepSpan
from vgmpi.kernels.wall_boundary import stopped_axes
from vgmpi.parallel.block_ownership import BlockDirectory
from vgmpi.parallel.exchange_topology import GRADIENTS, ExchangeTopology
from vgmpi.planning.feature_plan import TIME_TOLERANCE
from vgmpi.runtime.jit import device_function, kernel

from .plan import CARRIER, PinnedPartsPlan


class PinnedTable(NamedTuple):
    """Pinned parts, and the blocks of a rank near them."""

    block: np.ndarray  # (n,) blocks near parts
    first: np.ndarray  # (n + 1,) start of each block's parts in `parts`
    parts: np.ndarray  # (k,) numbers of the parts near each block
    phase: np.ndarray  # (m,) phase of the body of each part
    body: np.ndarray  # (m,) number of the free rigid body that holds it, -1 for none
    row: np.ndarray  # (m,) row of its reactions, -1 for a free rigid body


class PinnedNodes(NamedTuple):
    """Nodes of bodies next to pinned parts."""

    part: np.ndarray  # (n,) number of the part
    block: np.ndarray  # (n,) block
    node_block: np.ndarray  # (n,) node block of the body's phase
    node: np.ndarray  # (n,) number in the block
    surface: np.ndarray  # (n, 4) outward normal of the part, and distance [m]


class PinnedFields(NamedTuple):
    """Nodal values that pinned parts need."""

    velocities: np.ndarray  # (node blocks, 256) velocities and masses (in/out)
    gradients: tuple  # the three fields of velocity gradients


def no_pinned_nodes(n: int) -> PinnedNodes:
    """Return an empty table with room for n rows."""
    part, block, node_block, node = np.zeros((4, n), np.int64)
    return PinnedNodes(part, block, node_block, node, np.zeros((n, 4)))


class PinnedCoupling(MovingColliders, ActiveFeature):
    """Pinned parts of the bodies of a scene; all ranks hold the same.

    A part has a signed distance as a collider, but acts on the phase of its own body alone. Its
    pose is that of what holds it. Calling it with blocks (n, 3) returns their rows.

    Attributes:
        motions: Displacement of the parts' particles in the present step, by part.
    """

    carrier = CARRIER
    couples_nodes = True

    def __init__(self, plan: PinnedPartsPlan, context: StartContext):
        """Sample the surfaces of the parts.

        Args:
            plan: Plan of the parts.
            context: What a feature may take when a run starts.
        """
        self.parts, self.movers = plan.pinned, context.movers
        regions = [part.region for part in self.parts]
        free = self.movers.free if self.movers is not None else None
        count = len(regions)
        # of each part: row of the free body that holds it, -1 for none
        self.holder = np.full(count, -1)
        for k, region in enumerate(regions):
            if region.is_free and free is not None:
                self.holder[k] = int(np.flatnonzero(free.rows == region.holder)[0])
                center = free.start[self.holder[k]]
                ends = np.abs(np.array(region.ends()) - center).max(0)
                radius = float(np.sqrt((ends**2).sum()))
                free.radius[self.holder[k]] = max(free.radius[self.holder[k]], radius)
        self.attaches_to_bodies = bool((self.holder >= 0).any())
        self.phase = np.array([part.phase for part in self.parts])
        self.phases = np.isin(np.arange(len(context.plan.phases)), self.phase)
        self.rows = np.array(plan.reaction_rows(context.first_reaction_row))
        objects = [part.object for part in self.parts]
        self.first_parts = [objects.index(k) for (k,), _ in plan.reaction_bodies()]
        self.thread_rows: list[np.ndarray] = []
        self.threads, self.count = context.threads, 0
        self.pinned = no_pinned_nodes(0)  # the nodes next to parts, `count` of them
        self.reserved_nodes = np.zeros((0, 64), np.uint8)  # 1 at these nodes, by node block
        self.tables: ExchangeTopology | None = None
        self.motions = PrescribedSteps(
            np.ones(count, bool), np.full(count, -1), np.zeros((count, 3)),
            np.zeros((count, 3, 3)), np.zeros((count, 3)),
        )  # fmt: skip
        super().__init__(regions, context.lattice, context.plan.real)
        self.is_fixed = not self.moving
        self.is_moving = (self.holder >= 0) | np.array([r.course is not None for r in regions])

    def row_of_group(self, group: int, phase: int) -> int:
        """Return the row of a group's motion in `motions`, -1 if it is at rest.

        Args:
            group: Number of the group.
            phase: Its phase, unused.
        """
        (k,) = (k for k, part in enumerate(self.parts) if group in part.groups)
        return k if self.is_moving[k] else -1

    def _blocks_near(self, m: int, block: np.ndarray) -> np.ndarray:
        """Return the rows of the blocks (n, 3) near part `m`; none after its release."""
        if self.parts[m].region.release_time <= self.now * TIME_TOLERANCE:
            return np.zeros(0, np.int64)
        return super()._blocks_near(m, block)

    def take(self, blocks: np.ndarray) -> None:
        """Find which parts are close to the blocks (n, 3) of this rank."""
        self.since = self.now
        close = [self._blocks_near(m, blocks) for m in range(len(self.parts))]
        rows, part = np.concatenate(close), np.repeat(np.arange(len(close)), [*map(len, close)])
        order = np.argsort(rows, kind="stable")
        block, first = np.unique(rows[order], return_index=True)
        self.close = PinnedTable(
            block, np.append(first, len(rows)), part[order], self.phase, self.holder, self.rows
        )

    def saved(self) -> dict:
        """Return the time at which the blocks near the parts were searched."""
        return {"sorted_time": self.since}

    def place_saved(self, attrs: dict, time: float) -> None:
        """Place the parts where they were at the last sort.

        Args:
            attrs: Attributes of the checkpoint.
            time: Time of the checkpoint [s].
        """
        self.place(attrs.get("sorted_time", time))

    def set_topology(self, tables: ExchangeTopology, census: BlockDirectory) -> None:
        """Set the node blocks of this rank.

        Args:
            tables: Topology of this rank.
            census: Segments of this rank and nearby ones.
        """
        self.tables = tables
        self.take(tables.coordinates)
        self.reserved_nodes = np.zeros((len(tables.phase), 64), np.uint8)
        self.thread_rows = []  # the nodes are found in the next step

    def place(self, time: float) -> None:
        """Place the parts where they are at a time [s]."""
        self.now, table = time, self.table
        table.rotation[self.moving], table.move[self.moving] = self.courses.poses(time)
        if self.movers is not None and self.movers.free is not None:
            free, parts = self.movers.free, np.flatnonzero(self.holder >= 0)
            rows = self.holder[parts]
            table.about[parts] = free.start[rows]
            rotation = free.rotations()[rows]
            table.rotation[parts] = table.rotation_end[parts] = rotation
            table.move[parts] = table.move_end[parts] = (free.x - free.start)[rows]

    def begin_step(self, span: StepSpan) -> None:
        """Place the parts at the beginning of a step."""
        self.place(span.start)
        table = self.table
        table.rotation_end[self.moving], table.move_end[self.moving] = self.courses.poses(span.end)
        if self.is_moving.any() or not self.thread_rows:
            self._find_nodes()

    @property
    def filled_nodes(self) -> Sequence[FilledNodes]:
        """Return what the particles of the parts fill that have not let go."""
        regions = [part.region for part in self.parts]
        return [
            FilledNodes(region.filled_nodes[0], region.filled_nodes[1], row)
            for region, row in zip(regions, self.rows.tolist(), strict=True)
            if region.release_time > self.now * TIME_TOLERANCE
        ]

    def _find_nodes(self) -> None:
        """Find the nodes of this rank next to the parts."""
        tables = self.tables
        assert tables is not None
        while True:
            self.count = find_pinned_nodes(
                self.close, self.table, tables.first, tables.phase, tables.coordinates, self.dx,
                self.reserved_nodes, self.pinned,
            )  # fmt: skip
            if self.count <= len(self.pinned.part):
                break
            self.pinned = no_pinned_nodes(2 * self.count)
        self.thread_rows = np.array_split(np.arange(self.count), self.threads)

    def push_particles(self, span: StepSpan) -> float:
        """Return the largest speed [m/s] of a point of a part."""
        return self.dx * self.travels(span.start, span.end) / span.dt

    def needs_sort(self, span: StepSpan, maxima: StepMaxima) -> bool:
        """Return whether the blocks near the parts have to be searched again."""
        return self.left_safe_range(span.end)

    def end_coupling(self, span: StepSpan) -> None:
        """Compute how the particles of the parts move in a step."""
        table, dt = self.table, span.dt
        if self.movers is not None and self.movers.free is not None:
            free, parts = self.movers.free, np.flatnonzero(self.holder >= 0)
            rows = self.holder[parts]
            table.rotation_end[parts] = free.rotations()[rows]
            table.move_end[parts] = (free.x - free.start)[rows]
        self.motions.turn[:] = turn_rates(table.rotation, table.rotation_end, dt)
        self.motions.about[:] = table.about + table.move
        self.motions.shift[:] = (table.move_end - table.move) / dt

    def reaction_points(self) -> np.ndarray:
        """Return the centers of bodies' first parts at the step's start, shape (rows, 3) [m]."""
        first, table = self.first_parts, self.table
        if not first:
            return np.zeros((0, 3))
        center = [self.parts[m].region.masses.center for m in first]
        about = table.about[first]
        arm = (table.rotation[first] * (np.array(center) - about)[:, None, :]).sum(axis=2)
        return about + table.move[first] + arm

    def find_contacts(self, nodes: NodeState, bodies: np.ndarray, counts, contacts) -> int:
        """Find the nodes of parts that free rigid bodies hold; return their number.

        Args:
            nodes: Nodes of the rank.
            bodies: Centers of the bodies, shape (m, 3) [m].
            counts: 1 at the nodes that this rank counts, shape (blocks, 64).
            contacts: NodeContacts (out).
        """
        return find_pinned_contacts(
            self.count, self.pinned, self.close, _fields(nodes), nodes.blocks, nodes.walls,
            bodies, counts, self.dx, contacts,
        )  # fmt: skip

    def couple_nodes(self, nodes: NodeState, span: StepSpan, gravity: np.ndarray) -> None:
        """Change the velocities of the nodes next to parts.

        Args:
            nodes: Nodes of the rank.
            span: The step.
            gravity: Acceleration, shape (3,) [m/s2].
        """
        self.hold_nodes(nodes, span)

    def hold_nodes(self, nodes: NodeState, span: StepSpan) -> None:
        """Change the velocities of the nodes next to parts; see `ActiveFeature.hold_nodes`."""
        nodes.each(self._couple, nodes, _fields(nodes), span.dt)

    def _couple(self, thread: int, nodes: NodeState, fields: PinnedFields, dt) -> None:
        nodes.call(
            apply_pins, self.thread_rows[thread], self.pinned, self.close, self.table, fields,
            nodes.blocks, nodes.walls, dt, self.dx, nodes.reactions[thread],
        )  # fmt: skip


def _fields(nodes: NodeState) -> PinnedFields:
    """Return the nodal values that the parts need."""
    gradients = tuple(nodes.fields[name].tables for name in GRADIENTS)
    return PinnedFields(nodes.velocities, gradients)


@device_function
def _closest_part(table, movers, row, p, x, sample, own, dx):
    """Return the part of a phase whose surface is closest to a point within reach, -1 for none.

    Args:
        table: PinnedTable.
        movers: Sampled distances of the parts.
        row: Row of the block in the table.
        p: Phase.
        x: Point, shape (3,) [m].
        sample: Outward normal and distance [m] (out), shape (4,).
        own: Scratch, shape (2, 4).
        dx: Cell size [m].
    """
    closest, reach = -1, REACH_CELLS * dx
    for q in range(table.first[row], table.first[row + 1]):
        m = table.parts[q]
        if table.phase[m] != p:
            continue
        d = distance_from_collider(movers, m, x, own[0], own[1])
        if abs(d) < reach and turn_gradient(movers, m, own[1], own[0]):
            closest, reach, sample[3] = m, abs(d), d
            for k in range(3):
                sample[k] = own[0, k]
    return closest


@device_function
def _set_place(ijk, x, corner, node, dx):
    """Store the indices and the position of a node.

    Args:
        ijk: Node indices in the domain (out), shape (3,).
        x: Position (out), shape (3,) [m].
        corner: Coordinates of the block, shape (3,).
        node: Number of the node in its block.
        dx: Cell size [m].
    """
    set_node_indices(ijk, corner, node)
    for c in range(3):
        x[c] = ijk[c] * dx


@kernel
def find_pinned_nodes(table, movers, first, phase, places, dx, marks, out):
    """Find the nodes of bodies next to their pinned parts; return their number.

    If they are more than `out` has rows, only the number is right.

    Args:
        table: PinnedTable.
        movers: Sampled distances and poses of the parts.
        first: First node block of each block, shape (blocks + 1,).
        phase: Phase of each node block, shape (node blocks,).
        places: Coordinates of the blocks, shape (blocks, 3).
        dx: Cell size [m].
        marks: 1 at each of these nodes (out), shape (node blocks, 64).
        out: PinnedNodes (out).
    """
    x, sample, own = np.zeros(3), np.zeros(4), np.zeros((2, 4))
    count, ijk = 0, np.zeros(3, np.int64)
    for row in range(len(table.block)):
        b = table.block[row]
        for nb in range(first[b], first[b + 1]):
            marks[nb] = 0
            for node in range(64):
                _set_place(ijk, x, places[b], node, dx)
                m = _closest_part(table, movers, row, phase[nb], x, sample, own, dx)
                if m < 0:
                    continue
                marks[nb, node] = 1
                if count < len(out.part):
                    out.part[count], out.block[count] = m, b
                    out.node_block[count], out.node[count] = nb, node
                    out.surface[count] = sample
                count += 1
    return count


@kernel
def apply_pins(rows, pinned, table, movers, fields, blocks, walls, dt, dx, reaction):
    """Attach the nodes of bodies to their pinned parts, except those that free bodies hold.

    Args:
        rows: Rows of `pinned`, shape (n,).
        pinned: PinnedNodes.
        table: PinnedTable.
        movers: Sampled distances and poses of the parts.
        fields: PinnedFields; the velocities are changed (in/out).
        blocks: Node blocks of the rank.
        walls: Walls of the domain.
        dt: Time step [s].
        dx: Cell size [m].
        reaction: Reaction sums of the thread (in/out), or None.
    """
    x, own, speed = np.zeros(3), np.zeros((2, 4)), np.zeros(3)
    slope, before, ijk = np.zeros(3), np.zeros(3), np.zeros(3, np.int64)
    for q in rows:
        m, b, nb, node = pinned.part[q], pinned.block[q], pinned.node_block[q], pinned.node[q]
        v, surface = fields.velocities[nb, 4 * node : 4 * node + 4], pinned.surface[q]
        if table.body[m] >= 0 or not v[3] > 0.0:
            continue
        _set_place(ijk, x, blocks.coordinates[b], node, dx)
        axes = stopped_axes(ijk, walls)
        if axes < 0:
            continue
        surface_velocity(movers, m, x, surface, dt, own, speed)
        mean_gradient(fields.gradients, 256 * nb + 4 * node, surface, slope)
        for c in range(3):
            before[c] = v[c]
            if not axes >> c & 1:
                v[c] = speed[c] + surface[3] / dx * slope[c]
        if reaction is not None:
            set_block(reaction, b)
            set_node(reaction, node, ijk[0], ijk[1], ijk[2])
            reaction.now[2] = table.row[m]
            for c in range(3):  # impulses act at nodes: angular momentum is exact
                reaction.surface_point[c] = reaction.node[c]
            add_contact_reaction(reaction, before, v, float(v[3]), speed, 0, 0)


@kernel
def find_pinned_contacts(rows, pinned, table, fields, blocks, walls, bodies, counts, dx, out):
    """Find the nodes of parts that free rigid bodies hold; return their number.

    If they are more than `out` has rows, only the number is right.

    Args:
        rows: Number of rows of `pinned`.
        pinned: PinnedNodes.
        table: PinnedTable.
        fields: PinnedFields.
        blocks: Node blocks of the rank.
        walls: Walls of the domain.
        bodies: Centers of the free bodies, shape (m, 3) [m].
        counts: 1 at the nodes that this rank counts, shape (blocks, 64).
        dx: Cell size [m].
        out: NodeContacts (out).
    """
    x, slope, count, ijk = np.zeros(3), np.zeros(3), 0, np.zeros(3, np.int64)
    for row in range(rows):
        b, nb, node = pinned.block[row], pinned.node_block[row], pinned.node[row]
        v, surface = fields.velocities[nb, 4 * node : 4 * node + 4], pinned.surface[row]
        k = table.body[pinned.part[row]]
        if k < 0 or not v[3] > 0.0:
            continue
        _set_place(ijk, x, blocks.coordinates[b], node, dx)
        if stopped_axes(ijk, walls) != 0:
            continue
        if count < len(out.mass):
            q, o = count, 256 * nb + 4 * node
            mean_gradient(fields.gradients, o, surface, slope)
            out.body[q], out.offset[q], out.counts[q] = k, o, counts[b, node]
            out.mass[q] = out.nodal_mass[q] = v[3]
            out.friction[q], out.stick[q], out.pressed[q] = -1.0, 1.0, 0.0
            for c in range(3):
                out.normal[q, c] = surface[c]
                out.arm[q, c] = x[c] - bodies[k, c]
                out.foot[q, c] = out.arm[q, c] - surface[3] * surface[c]
                out.velocity[q, c] = v[c] - surface[3] / dx * slope[c]
            if len(out.adhering) > 0:
                out.adhering[q] = 0.0
                out.drag[q] = 0.0
        count += 1
    return count

"""Pinned parts of bodies in a step: their poses, their particles, and the nodes next to them."""

import numpy as np

from vgmpi.kernels.rigid import pinned_nodes
from vgmpi.kernels.rigid.moving_colliders import MovingColliders
from vgmpi.kernels.rigid.prescribed_motion import PrescribedSteps, turn_rates
from vgmpi.parallel.block_lattice import BlockLattice
from vgmpi.parallel.exchange_topology import GRADIENTS, ExchangeTopology
from vgmpi.planning.plan import Plan

from .release import TIME_TOLERANCE


class PinnedParts(MovingColliders):
    """Pinned parts of the bodies of a scene; all ranks hold the same.

    A part has a signed distance as a collider, but acts on the phase of its own body alone. Its
    pose is that of what holds it. Calling it with blocks (n, 3) returns their rows.

    Attributes:
        ways: Displacement of the parts' particles in the present step, by part.
    """

    def __init__(
        self, plan: Plan, lattice: BlockLattice, movers: MovingColliders | None,
        collider_count: int, threads: int,
    ):  # fmt: skip
        """Sample the surfaces of the parts.

        Args:
            plan: Plan of the run; it has pinned parts.
            lattice: Lattice of the blocks.
            movers: Moving colliders, or None.
            collider_count: Number of colliders.
            threads: Threads that share the nodes.
        """
        self.pins, self.movers = plan.pins, movers
        regions = [part.region for part in plan.pins]
        free = movers.free if movers is not None else None
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
        self.phase = np.array([part.phase for part in plan.pins])
        self.rows = np.array(reaction_rows(plan, collider_count))
        self.shares: list[np.ndarray] = []
        self.threads, self.count = threads, 0
        self.pinned = pinned_nodes.no_pinned_nodes(0)  # the nodes next to parts, `count` of them
        self.marks = np.zeros((0, 64), np.uint8)  # 1 at these nodes, by node block
        self.tables: ExchangeTopology | None = None
        self.ways = PrescribedSteps(
            np.ones(count, bool), np.full(count, -1), np.zeros((count, 3)),
            np.zeros((count, 3, 3)), np.zeros((count, 3)),
        )  # fmt: skip
        super().__init__(regions, lattice, plan.real)
        self.is_moving = (self.holder >= 0) | np.array([r.course is not None for r in regions])

    def row_of_group(self, group: int, phase: int) -> int:
        """Return the row of a group's motion in `ways`, -1 if it is at rest.

        Args:
            group: Number of the group.
            phase: Its phase, unused.
        """
        (k,) = (k for k, part in enumerate(self.pins) if group in part.groups)
        return k if self.is_moving[k] else -1

    def _blocks_near(self, m: int, block: np.ndarray) -> np.ndarray:
        """Return the rows of the blocks (n, 3) near part `m`; none after its release."""
        if self.pins[m].region.release_time <= self.now * TIME_TOLERANCE:
            return np.zeros(0, np.int64)
        return super()._blocks_near(m, block)

    def take(self, blocks: np.ndarray) -> None:
        """Find which parts are close to the blocks (n, 3) of this rank."""
        self.since = self.now
        close = [self._blocks_near(m, blocks) for m in range(len(self.pins))]
        rows, part = np.concatenate(close), np.repeat(np.arange(len(close)), [*map(len, close)])
        order = np.argsort(rows, kind="stable")
        block, first = np.unique(rows[order], return_index=True)
        self.close = pinned_nodes.PinnedTable(
            block, np.append(first, len(rows)), part[order], self.phase, self.holder, self.rows
        )

    def set_tables(self, tables: ExchangeTopology) -> None:
        """Set the node blocks of this rank."""
        self.tables = tables
        self.take(tables.at)
        self.marks = np.zeros((len(tables.phase), 64), np.uint8)
        self.shares = []  # the nodes are found in the next step

    def stand(self, time: float) -> None:
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

    def begin_step(self, time: float, end: float, dt: float) -> None:
        """Place the parts at the beginning of a step.

        Args:
            time: Beginning of the step [s].
            end: End of the step [s].
            dt: Length of the step [s].
        """
        self.stand(time)
        table = self.table
        table.rotation_end[self.moving], table.move_end[self.moving] = self.courses.poses(end)
        if self.is_moving.any() or not self.shares:
            self._find_nodes()

    def _find_nodes(self) -> None:
        """Find the nodes of this rank next to the parts."""
        tables = self.tables
        assert tables is not None
        while True:
            self.count = pinned_nodes.find_pinned_nodes(
                self.close, self.table, tables.first, tables.phase, tables.at, self.dx, self.marks,
                self.pinned,
            )  # fmt: skip
            if self.count <= len(self.pinned.part):
                break
            self.pinned = pinned_nodes.no_pinned_nodes(2 * self.count)
        self.shares = np.array_split(np.arange(self.count), self.threads)

    def end_step(self, dt: float) -> None:
        """Compute how the particles of the parts move in a step of dt [s]."""
        table = self.table
        if self.movers is not None and self.movers.free is not None:
            free, parts = self.movers.free, np.flatnonzero(self.holder >= 0)
            rows = self.holder[parts]
            table.rotation_end[parts] = free.rotations()[rows]
            table.move_end[parts] = (free.x - free.start)[rows]
        self.ways.turn[:] = turn_rates(table.rotation, table.rotation_end, dt)
        self.ways.about[:] = table.about + table.move
        self.ways.shift[:] = (table.move_end - table.move) / dt

    def centers(self, objects: list[int]) -> np.ndarray:
        """Return the centers of the first parts of some objects at the step's start, (n, 3) [m]."""
        first = [[part.object for part in self.pins].index(k) for k in objects]
        table, center = self.table, [self.pins[m].region.masses.center for m in first]
        about = table.about[first]
        arm = (table.rotation[first] * (np.array(center) - about)[:, None, :]).sum(axis=2)
        return about + table.move[first] + arm

    def find_contacts(self, engine, bodies: np.ndarray, counts, contacts) -> int:
        """Find the nodes of parts that free rigid bodies hold; return their number.

        Args:
            engine: Engine.
            bodies: Centers of the bodies, shape (m, 3) [m].
            counts: 1 at the nodes that this rank counts, shape (blocks, 64).
            contacts: NodeContacts (out).
        """
        return pinned_nodes.find_pinned_contacts(
            self.count, self.pinned, self.close, self.fields(engine), engine.blocks, engine.walls,
            bodies, counts, self.dx, contacts,
        )  # fmt: skip

    def fields(self, engine) -> pinned_nodes.PinnedFields:
        """Return the nodal values of an engine that the parts need."""
        gradients = tuple(engine.layers[name].tables for name in GRADIENTS)
        return pinned_nodes.PinnedFields(engine.layers["momentum"].nodes, gradients)

    def apply(self, engine, dt: float) -> None:
        """Change the velocities of the nodes next to parts in a step.

        Args:
            engine: Engine.
            dt: Time step [s].
        """
        engine.each(self._apply, engine, self.fields(engine), dt)

    def _apply(self, thread: int, engine, fields: pinned_nodes.PinnedFields, dt: float) -> None:
        engine.call_if_rows(
            (), pinned_nodes.apply_pins, self.shares[thread], self.pinned, self.close, self.table,
            fields, engine.blocks, engine.walls, dt, self.dx, engine.room[thread].given,
        )  # fmt: skip


def reaction_rows(plan: Plan, collider_count: int) -> list[int]:
    """Return the row of the reactions of each pinned part, -1 for those that free bodies hold.

    Parts that a collider holds add to its row. Those of a body that the world holds share a row,
    after colliders and prescribed bodies.

    Args:
        plan: Plan of the run.
        collider_count: Number of colliders.
    """
    first = collider_count + len(plan.driven)
    bodies = pinned_bodies(plan)
    rows = []
    for part in plan.pins:
        row = part.region.holder if not part.region.is_free else -1
        rows.append(first + bodies.index(part.object) if part.region.holder < 0 else row)
    return rows


def pinned_bodies(plan: Plan) -> list[int]:
    """Return the rows of the bodies that the world holds, in the order of their parts."""
    return list(dict.fromkeys(part.object for part in plan.pins if part.region.holder < 0))


def make_pinned_parts(
    plan: Plan, lattice: BlockLattice, movers: MovingColliders | None, collider_count: int,
    threads: int,
) -> PinnedParts | None:  # fmt: skip
    """Return the pinned parts of a scene, or None if it has none.

    Args:
        plan: Plan of the run.
        lattice: Lattice of the blocks.
        movers: Moving colliders, or None.
        collider_count: Number of colliders.
        threads: Threads that share the nodes.
    """
    return PinnedParts(plan, lattice, movers, collider_count, threads) if plan.pins else None

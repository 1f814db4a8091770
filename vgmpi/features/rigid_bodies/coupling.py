"""Free rigid bodies in a step: what flows and the bodies are solved together, then the bodies meet.

The grid's velocities are final but for the bodies: rounds of sums over all ranks and small solves
find the bodies' velocities; then the nodes take their impulses, and the bodies the negative sums.
Contact of the bodies among each other, with colliders and with walls follows on every rank.
"""

from typing import Any

import numpy as np

from vgmpi.features.active_feature import (
    ActiveFeature,
    NodeState,
    StartContext,
    reserved_nodes,
)
from vgmpi.io.checkpoint import Checkpoint
from vgmpi.kernels.colliders.surface_flow import AdhesionLaw
from vgmpi.kernels.reproducible_sums import next_power_of_two
from vgmpi.kernels.rigid import body_contact, body_nodes, free_coupling
from vgmpi.kernels.rigid.contact_search import contact_search, find_pairs
from vgmpi.kernels.rigid.contact_sweeps import solve_contacts
from vgmpi.kernels.rigid.jointed_bodies import jointed_bodies
from vgmpi.kernels.rigid.surface_points import surface_points
from vgmpi.kernels.step_records import StepSpan
from vgmpi.parallel.block_ownership import BlockDirectory
from vgmpi.parallel.exchange_topology import NEAR_BODIES, ExchangeTopology, counting_owner

from .plan import RigidBodiesPlan

MAX_ROUNDS = 6  # of sums over the ranks in a step
HEADROOM = 16.0  # [-] factor on the mass that fills the domain, and on a cell per step
SUM_BITS, IMPULSE_BITS = 58, 61  # [bits] range of the whole numbers
POINTS_PER_BODY = 40  # points in contact for which a table has room
NO_NODES = np.zeros((0, 64), np.uint8)
WARM_NAMES = "body", "other", "place", "impulse"  # of the points whose impulses the next step takes


class RigidBodies(ActiveFeature):
    """Coupling of the free bodies among the moving colliders with the particles of a rank."""

    couples_nodes = True

    def __init__(self, own: RigidBodiesPlan, context: StartContext):
        """Set up the points of the bodies' surfaces and the range of the sums.

        Args:
            own: Plan of the bodies.
            context: What a feature may take when a run starts.
        """
        plan, movers = context.plan, context.movers
        self.features = context.features
        self.holders: list[Any] = [f for f in self.features.values() if f.attaches_to_bodies]
        self.plan, self.movers, self.ranks = plan, movers, context.ranks
        self.bodies, count = movers.free, len(movers.free.rows)
        self.joints = jointed_bodies(own.joints, movers)
        self.number_of = np.full(len(movers.colliders), -1)
        self.number_of[self.bodies.rows] = np.arange(count)
        rows = np.array(plan.friction)[len(plan.phases) :]
        self.friction = rows[np.minimum(self.bodies.rows, len(rows) - 1)]
        self.adhesion = self._adhesion_law()
        self.contacts = body_nodes.no_contacts(1024, len(self.adhesion.length) > 0)
        self.near, self.counts = np.zeros(0, np.int64), np.zeros((0, 64), np.uint8)
        self.points = body_contact.contact_points(POINTS_PER_BODY * count)
        self.points_before, self.touching = body_contact.contact_points(0), 0
        free = [movers.colliders[m] for m in self.bodies.rows]
        self.surface = surface_points(free, self.bodies.start, plan.dx)
        self.search = contact_search(self.surface, movers.table, plan.dx)
        size = np.array(plan.cells) * plan.dx
        self.arm = 2.0 * float(np.sqrt((size**2).sum()))
        volume = float(np.prod(size + plan.dx))
        self.most = HEADROOM * volume * max(phase.most for phase in plan.phases) / plan.dx**3

    def couple_nodes(self, nodes: NodeState, span: StepSpan, gravity: np.ndarray) -> None:
        """Advance the bodies by a step, and change the velocities of the nodes that touch them.

        Args:
            nodes: Nodes of the rank.
            span: The step.
            gravity: Acceleration, shape (3,) [m/s2].
        """
        bodies, dt = self.bodies, span.dt
        if self.joints is not None:
            self.joints.begin_step(self.movers.table, dt)
        bodies.momentum += dt * bodies.mass[:, None] * gravity
        bodies.set_velocities()
        self._couple(nodes, dt)
        self._collide(nodes, dt)
        bodies.move(dt)

    def set_topology(self, tables: ExchangeTopology, census: BlockDirectory) -> None:
        """Find the blocks near bodies, and the nodes that this rank counts.

        Args:
            tables: Topology of this rank.
            census: Segments of this rank and nearby ones.
        """
        self.near = np.flatnonzero(tables.solid >= 0)
        self.counts = counting_owner(tables, self.ranks.rank)

    def failure(self) -> str:
        """Return the name of the first body whose center has left the domain, or an empty text."""
        x, size = self.bodies.x, np.array(self.plan.cells) * self.plan.dx
        rows = np.flatnonzero(~((x >= 0.0) & (x <= size)).all(1))
        return self.movers.colliders[self.bodies.rows[rows[0]]].name if len(rows) else ""

    def conserved(self, time: float) -> dict[str, float]:
        """Return mass, momenta and energies of the bodies at a time [s]."""
        return self.bodies.conserved(self.plan.gravity_at(time))

    def saved(self) -> dict:
        """Return the bodies, and their points in contact."""
        rows = slice(self.touching)
        points = {name: getattr(self.points_before, name)[rows].tolist() for name in WARM_NAMES}
        joints = {} if self.joints is None else {"joints": self.joints.saved()}
        return {"bodies": {"bodies": self.bodies.saved(), "points": points} | joints}

    def restore(self, saved: Checkpoint) -> None:
        """Restore the bodies, their joints and the points in contact."""
        state: Any = saved.attrs["bodies"]
        self.bodies.restore(state["bodies"])
        if self.joints is not None:
            self.joints.restore(state["joints"])
        self.touching = len(state["points"]["body"])
        self.points_before = body_contact.contact_points(self.touching)
        for name, values in state["points"].items():
            target = getattr(self.points_before, name)
            target[:] = np.array(values, target.dtype).reshape(target.shape)

    def _couple(self, nodes: NodeState, dt: float) -> None:
        """Solve the bodies together with the nodes that touch them. Collective."""
        bodies = self.bodies
        count = self._find_contacts(nodes, dt)
        speed = self.plan.dx / dt * HEADROOM
        mass = float(next_power_of_two(self.most)) * 2.0**-SUM_BITS
        arm, fast = (float(next_power_of_two(v)) for v in (self.arm, speed))
        powers = [(a > 2) + (c > 2) for a in range(6) for c in range(a, 6)]
        quanta = np.array(
            [mass * arm**p for p in powers] + [mass * fast * arm**p for p in (0, 0, 0, 1, 1, 1)]
            + [1.0, mass]
        )  # fmt: skip
        before, inertia = bodies.v.copy(), bodies.turned_inertia()
        for k in range(MAX_ROUNDS):
            sums = np.zeros((len(bodies.rows), free_coupling.SUMS, 2), np.int64)
            free_coupling.sum_contacts(count, self.contacts, bodies.v, quanta, sums)
            sums = self.ranks.sum(sums)
            if k and not sums[:, 27, 0].any():
                break
            free_coupling.solve_velocities(sums, quanta, bodies.mass, inertia, before, bodies.v)
            if self.joints is not None:
                self.joints.constrain(sums, quanta, inertia)
        touching = max(float(sums[:, 28, 0].max() * mass), mass)
        unit = float(next_power_of_two(touching * speed)) * 2.0**-IMPULSE_BITS
        impulses = np.zeros((len(bodies.rows), 6, 2), np.int64)
        units = np.array([unit, unit * arm])
        free_coupling.apply_impulses(
            count, self.contacts, bodies.v, nodes.velocities, units, impulses
        )
        impulses = self.ranks.sum(impulses)
        total = impulses[..., 0] + impulses[..., 1] * free_coupling.REMAINDER
        total *= units[[0, 0, 0, 1, 1, 1]]
        bodies.momentum -= total[:, :3]
        bodies.spin -= total[:, 3:]
        if self.joints is not None:
            self.joints.add_impulses()
        bodies.set_velocities()

    def _adhesion_law(self) -> AdhesionLaw:
        """Return the adhesion of flows to the bodies, without rows if they slip freely."""
        laws = (feature.adhesion for feature in self.plan.features)
        law = next((each for each in laws if each is not None), None)
        if law is None:
            return AdhesionLaw(np.zeros((0, 0)), np.zeros(0))
        lengths = np.array(law.lengths)[self.bodies.rows]
        return AdhesionLaw(lengths, np.array(law.viscosities))

    def _find_contacts(self, nodes: NodeState, dt: float) -> int:
        """Find the nodes of this rank that touch bodies; return their number."""
        bodies = self.bodies
        fields = tuple(nodes.fields[name].tables for name in NEAR_BODIES)
        marks = reserved_nodes(self.features)
        coupled = body_nodes.CoupledBodies(self.number_of, bodies.x, self.friction, self.adhesion)
        near = body_nodes.NodesNearBodies(
            self.movers.table, self.near, self.movers.nodes, self.movers.whose, self.counts,
            nodes.velocities, nodes.fields["offsets"].nodes, fields,
            NO_NODES if marks is None else marks,
        )  # fmt: skip
        while True:
            count = 0
            for holder in self.holders:
                count = holder.find_contacts(nodes, bodies.x, self.counts, self.contacts)
            count = body_nodes.find_contacts(
                near, nodes.blocks, coupled, nodes.phases, nodes.walls, dt, self.plan.dx,
                self.contacts, count,
            )  # fmt: skip
            if count <= len(self.contacts.mass):
                return count
            self.contacts = body_nodes.no_contacts(2 * count, len(self.adhesion.length) > 0)

    def _collide(self, nodes: NodeState, dt: float) -> None:
        """Let the bodies meet each other, colliders and walls."""
        bodies, plan = self.bodies, self.plan
        table = body_contact.BodyTable(
            bodies.rows, bodies.x, bodies.rotations(), bodies.radius, bodies.friction,
            np.zeros((len(bodies.x), 0), bool) if self.joints is None else self.joints.ignored,
        )  # fmt: skip
        reach = max(body_contact.MARGIN_CELLS * plan.dx, dt * float(bodies.speeds().max()))
        size = np.array(plan.cells) * plan.dx
        pairs = find_pairs(self.search, table, self.movers.table, self.number_of, reach, plan.dx)
        while True:
            count = body_contact.find_wall_contacts(
                self.surface, self.search, table, size, nodes.walls, reach, plan.dx,
                self.points, 0,
            )  # fmt: skip
            count = body_contact.find_body_contacts(
                self.surface, self.search, pairs, table, self.movers.table, dt, self.number_of,
                reach, plan.dx, self.points, count,
            )  # fmt: skip
            if count <= len(self.points.gap):
                break
            self.points = body_contact.contact_points(2 * count)
        before, self.touching = self.touching, count
        if not count and self.joints is None:
            return
        inertia = bodies.turned_inertia()
        solve = solve_contacts if self.joints is None else self.joints.solve_contacts
        solve(
            count, self.points, before, self.points_before,
            body_contact.LEAST_SPACING_CELLS * plan.dx, bodies.x, bodies.v, bodies.mass, inertia,
            bodies.restitution, dt,
        )  # fmt: skip
        self.points, self.points_before = self.points_before, self.points
        bodies.momentum[:] = bodies.mass[:, None] * bodies.v[:, :3]
        bodies.spin[:] = (inertia * bodies.v[:, None, 3:]).sum(2)

"""Free rigid bodies in a step: what flows and the bodies are solved together, then the bodies meet.

The grid's velocities are final but for the bodies: rounds of sums over all ranks and small solves
find the bodies' velocities; then the nodes take their impulses, and the bodies the negative sums.
Contact of the bodies among each other, with colliders and with walls follows on every rank.
"""

from typing import Any, NamedTuple

import numpy as np

from vgmpi.features.active_feature import (
    ActiveFeature,
    AdheringNodes,
    NodeState,
    StartContext,
    reserved_nodes,
)
from vgmpi.io.checkpoint import Checkpoint
from vgmpi.kernels.colliders.sdf_sampling import SampledSdf, sample_surface, set_node_indices
from vgmpi.kernels.colliders.surface_flow import (
    FULL_WEIGHT_CELLS,
    PUSHED_DEPTH_CELLS,
    REACH_CELLS,
    AdhesionLaw,
    adhering_mass,
    depth_in_flow,
    flow_fraction,
    mean_gradient,
    shear_drag,
    tangential_part,
    touches_surface,
    traction_share,
)
from vgmpi.kernels.reproducible_sums import REMAINDER, next_power_of_two
from vgmpi.kernels.step_records import StepSpan
from vgmpi.kernels.wall_boundary import RELEASING, SEPARATE, SLIP, STICK
from vgmpi.parallel.block_ownership import BlockDirectory
from vgmpi.parallel.exchange_topology import NEAR_BODIES, ExchangeTopology, counting_owner
from vgmpi.runtime.jit import always_inline, array_function, device_function, kernel

from . import body_contact, free_coupling
from .contact_search import contact_search, find_pairs
from .contact_sweeps import solve_contacts
from .jointed_bodies import JointedPushedBodies, jointed_bodies
from .plan import RigidBodiesPlan
from .surface_points import surface_points

MAX_ROUNDS = 6  # of sums over the ranks in a step
HEADROOM = 16.0  # [-] factor on the mass that fills the domain, and on a cell per step
SUM_BITS, IMPULSE_BITS = 58, 61  # [bits] range of the whole numbers
POINTS_PER_BODY = 40  # points in contact for which a table has room
NO_NODES = np.zeros((0, 64), np.uint8)
WARM_NAMES = "body", "other", "place", "impulse"  # of the points whose impulses the next step takes
# A face this close to the plane of a wall, with a normal into the wall of this part, lies on it.
FLUSH_CELLS, FLUSH_ALIGNMENT = 0.25, 0.9
FLUSH_DEPTH_CELLS = 2.0  # [cells] in front of the wall, where such a face is not seen


class NodeContacts(NamedTuple):
    """Nodes and phases that may touch a free body in a step."""

    body: np.ndarray  # (n,) number of the body
    offset: np.ndarray  # (n,) offset of the velocity in the flat nodal values
    counts: np.ndarray  # (n,) 1 if this rank counts the node
    mass: np.ndarray  # (n,) [kg] nodal mass times the weight
    nodal_mass: np.ndarray  # (n,) [kg]
    friction: np.ndarray  # (n,) [-] Coulomb coefficient, -1: the body holds the node
    normal: np.ndarray  # (n, 3) outward normal
    arm: np.ndarray  # (n, 3) [m] from the body's center to the node
    foot: np.ndarray  # (n, 3) [m] from the body's center to the surface
    velocity: np.ndarray  # (n, 3) [m/s] of the phase at the surface
    pressed: np.ndarray  # (n,) [kg m/s] impulse of the pressure along the normal, farther outside
    stick: np.ndarray  # (n,) [-] fraction of the slip that friction removes, -1: does not touch
    adhering: np.ndarray  # (n,) [kg] nodal mass that takes the velocity of the surface, or no rows
    drag: np.ndarray  # (n, 3) [kg m/s] impulse of viscous stress, farther outside, or no rows


def no_contacts(n: int, adhering: bool) -> NodeContacts:
    """Return an empty table with room for n rows.

    Args:
        n: Number of rows.
        adhering: Whether liquids may stick to bodies.
    """
    return NodeContacts(
        np.zeros(n, np.int64), np.zeros(n, np.int64), np.zeros(n, np.int64), np.zeros(n),
        np.zeros(n), np.zeros(n), np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 3)),
        np.zeros((n, 3)), np.zeros(n), np.full(n, -1.0), np.zeros(n * adhering),
        np.zeros((n * adhering, 3)),
    )  # fmt: skip


class NodesNearBodies(NamedTuple):
    """Nodes of a rank near colliders."""

    colliders: SampledSdf
    block: np.ndarray  # (n,) blocks near colliders
    surfaces: np.ndarray  # (n, 64, 4) normal and distance [m] of the nearest collider
    collider_number: np.ndarray  # (n, 64) its number
    counts: np.ndarray  # (blocks, 64) 1 at the nodes that this rank counts
    velocities: np.ndarray  # (node blocks, 256) velocities and masses
    offsets: np.ndarray  # (node blocks, 256) values of the field of offsets, or without rows
    fields: tuple  # velocity gradients and pressure, four Sums
    reserved: np.ndarray  # (node blocks, 64) 1 at nodes that features attach, or without rows


class CoupledBodies(NamedTuple):
    """Free bodies in their coupling with nodes."""

    number_of: np.ndarray  # (colliders,) number of the free body of each, -1 if it is not free
    centers: np.ndarray  # (m, 3) [m] centers of mass
    friction: np.ndarray  # (m, phases) [-] Coulomb coefficients
    adhesion: AdhesionLaw  # of flows to the bodies, or without rows
    sticks: bool  # nothing but adhesion acts


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
        self.plan, self.movers, self.ranks = plan, movers, context.ranks
        self.bodies, count = movers.free, len(movers.free.rows)
        self.joints = jointed_bodies(own.joints, movers)
        self.number_of = np.full(len(movers.colliders), -1)
        self.number_of[self.bodies.rows] = np.arange(count)
        self.pushed_bodies: JointedPushedBodies = JointedPushedBodies(
            self.bodies, self.joints, self.number_of, self
        )
        rows = np.array(plan.contact.friction)[len(plan.phases) :]
        self.friction = rows[np.minimum(self.bodies.rows, len(rows) - 1)]
        self.adhesion = self._adhesion_law()
        self.contacts = no_contacts(1024, len(self.adhesion.length) > 0)
        self.near_rows, self.counts = np.zeros(0, np.int64), np.zeros((0, 64), np.uint8)
        self.points = body_contact.contact_points(POINTS_PER_BODY * count)
        self.points_before, self.touching = body_contact.contact_points(0), 0
        free = [movers.colliders[m] for m in self.bodies.rows]
        self.surface = surface_points(free, self.bodies.start, plan.dx)
        self.search = contact_search(self.surface, movers.table, plan.dx)
        size = np.array(plan.cells) * plan.dx
        self.arm = 2.0 * float(np.sqrt((size**2).sum()))
        volume = float(np.prod(size + plan.dx))
        self.max_mass = (
            HEADROOM * volume * max(phase.max_cell_mass for phase in plan.phases) / plan.dx**3
        )

    def begin_step(self, span: StepSpan) -> None:
        """Set the rows of the joints."""
        if self.joints is not None:
            self.joints.begin_step(self.movers.table, span.dt)

    def couple_nodes(self, nodes: NodeState, span: StepSpan, gravity: np.ndarray) -> None:
        """Advance the bodies by a step, and change the velocities of the nodes that touch them.

        Args:
            nodes: Nodes of the rank.
            span: The step.
            gravity: Acceleration, shape (3,) [m/s2].
        """
        bodies, dt = self.bodies, span.dt
        bodies.momentum += dt * bodies.mass[:, None] * gravity
        bodies.set_velocities()
        self._couple(nodes, dt)
        before = bodies.v.copy()
        self._collide(nodes, dt)
        self.pushed_bodies.note_contact(bodies.v - before, dt, gravity)
        bodies.move(dt)

    def set_topology(self, tables: ExchangeTopology, census: BlockDirectory) -> None:
        """Find the blocks near bodies, and the nodes that this rank counts.

        Args:
            tables: Topology of this rank.
            census: Segments of this rank and nearby ones.
        """
        self.near_rows = np.flatnonzero(tables.solid >= 0)
        self.counts = counting_owner(tables, self.ranks.rank)

    def failure(self) -> str:
        """Return the name of the first body whose center has left the domain, or an empty text."""
        x, size = self.bodies.x, np.array(self.plan.cells) * self.plan.dx
        rows = np.flatnonzero(~((x >= 0.0) & (x <= size)).all(1))
        return self.movers.colliders[self.bodies.rows[rows[0]]].name if len(rows) else ""

    def conserved(self, time: float) -> dict[str, float]:
        """Return mass, momenta and energies of the bodies at a time [s]."""
        return self.bodies.conserved(self.plan.gravity.vector_at(time))

    def saved(self) -> dict:
        """Return the bodies, and their points in contact."""
        rows = slice(self.touching)
        points = {name: getattr(self.points_before, name)[rows].tolist() for name in WARM_NAMES}
        joints = {} if self.joints is None else {"joints": self.joints.saved()}
        contact = {"contact": self.pushed_bodies.contact.tolist()}
        return {"bodies": {"bodies": self.bodies.saved(), "points": points} | joints | contact}

    def restore(self, saved: Checkpoint) -> None:
        """Restore the bodies, their joints and the points in contact."""
        state: Any = saved.attrs["bodies"]
        self.bodies.restore(state["bodies"])
        if self.joints is not None:
            self.joints.restore(state["joints"])
        self.pushed_bodies.contact[:] = np.array(state["contact"])
        self.touching = len(state["points"]["body"])
        self.points_before = body_contact.contact_points(self.touching)
        for name, values in state["points"].items():
            target = getattr(self.points_before, name)
            target[:] = np.array(values, target.dtype).reshape(target.shape)

    def _couple(self, nodes: NodeState, dt: float) -> None:
        """Solve the bodies together with the nodes that touch them. Collective."""
        bodies = self.bodies
        count, quanta = self._find_contacts(nodes, dt, False), self._quanta(dt)
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
        self._apply_impulses(nodes, dt, count, bodies.v, sums)
        if self.joints is not None:
            self.joints.add_impulses()
        bodies.set_velocities()

    def _quanta(self, dt: float) -> np.ndarray:
        """Return the quanta of the sums over touching nodes in a step of dt [s], shape (29,)."""
        mass = float(next_power_of_two(self.max_mass)) * 2.0**-SUM_BITS
        speed = self.plan.dx / dt * HEADROOM
        arm, fast = (float(next_power_of_two(v)) for v in (self.arm, speed))
        powers = [(a > 2) + (c > 2) for a in range(6) for c in range(a, 6)]
        return np.array(
            [mass * arm**p for p in powers] + [mass * fast * arm**p for p in (0, 0, 0, 1, 1, 1)]
            + [1.0, mass]
        )  # fmt: skip

    def _apply_impulses(
        self, nodes: NodeState, dt: float, count: int, v: np.ndarray, sums: np.ndarray
    ) -> None:
        """Give the touching nodes their impulses, and the bodies the reactions. Collective.

        Args:
            nodes: Nodes of the rank.
            dt: Time step [s].
            count: Number of rows of `contacts`.
            v: Velocities of the bodies, shape (m, 6).
            sums: Sums over these nodes of all ranks, see `free_coupling.sum_contacts`.
        """
        mass, arm = self._quanta(dt)[-1], float(next_power_of_two(self.arm))
        touching = max(float(sums[:, 28, 0].max() * mass), mass)
        speed = self.plan.dx / dt * HEADROOM
        unit = float(next_power_of_two(touching * speed)) * 2.0**-IMPULSE_BITS
        impulses = np.zeros((len(v), 6, 2), np.int64)
        units = np.array([unit, unit * arm])
        free_coupling.apply_impulses(count, self.contacts, v, nodes.velocities, units, impulses)
        impulses = self.ranks.sum(impulses)
        total = impulses[..., 0] + impulses[..., 1] * REMAINDER
        total *= units[[0, 0, 0, 1, 1, 1]]
        self.bodies.momentum -= total[:, :3]
        self.bodies.spin -= total[:, 3:]

    def sum_adhesion(self, nodes: NodeState, dt: float) -> AdheringNodes | None:
        """Return the nodes that stick to the bodies, see `PushedBodies`."""
        if not (self.adhesion.length < np.inf).any():
            return None
        count, m = self._find_contacts(nodes, dt, True), len(self.bodies.rows)
        sums, quanta = np.zeros((m, free_coupling.SUMS, 2), np.int64), self._quanta(dt)
        free_coupling.sum_contacts(count, self.contacts, self.bodies.v, quanta, sums)
        sums = self.ranks.sum(sums)
        adhering = AdheringNodes(np.zeros((6 * m, 6 * m)), np.zeros(6 * m), count, sums)
        free_coupling.read_sums(sums, quanta, adhering.matrix, adhering.momentum)
        return adhering

    def apply_adhesion(
        self, nodes: NodeState, dt: float, adhering: AdheringNodes, v: np.ndarray
    ) -> None:
        """Give the nodes that stick to the bodies their impulses, see `PushedBodies`.

        Args:
            nodes, dt, adhering, v: See `PushedBodies`.
        """
        self._apply_impulses(nodes, dt, adhering.number, v, adhering.sums)
        self.bodies.set_velocities()

    def _adhesion_law(self) -> AdhesionLaw:
        """Return the adhesion of flows to the bodies, without rows if they slip freely."""
        laws = (feature.adhesion for feature in self.plan.features)
        law = next((each for each in laws if each is not None), None)
        if law is None:
            return AdhesionLaw(np.zeros((0, 0)), np.zeros(0), REACH_CELLS)
        lengths = np.array(law.lengths)[self.bodies.rows]
        return AdhesionLaw(lengths, np.array(law.viscosities), REACH_CELLS)

    def _find_contacts(self, nodes: NodeState, dt: float, sticks: bool) -> int:
        """Find the nodes of this rank that touch bodies; return their number.

        Args:
            nodes: Nodes of the rank.
            dt: Time step [s].
            sticks: Whether those alone that stick to bodies, of which nothing else acts. Beside an
                implicit pressure nothing else finds these.
        """
        bodies, law = self.bodies, self.adhesion
        if sticks:
            law = law._replace(depth=PUSHED_DEPTH_CELLS)
        elif self.plan.has_separate_pressure:
            law = law._replace(length=np.full_like(law.length, np.inf))
        fields = tuple(nodes.fields[name].tables for name in NEAR_BODIES)
        marks = None if sticks else reserved_nodes(self.features)
        coupled = CoupledBodies(self.number_of, bodies.x, self.friction, law, sticks)
        near = NodesNearBodies(
            self.movers.table, self.near_rows, self.movers.nodes, self.movers.collider_number,
            self.counts,
            nodes.velocities, nodes.fields["offsets"].nodes, fields,
            NO_NODES if marks is None else marks,
        )  # fmt: skip
        holders: list[Any] = [
            f for f in self.features.values() if f.attaches_to_bodies and not sticks
        ]
        while True:
            count = 0
            for holder in holders:
                count = holder.find_contacts(nodes, bodies.x, self.counts, self.contacts)
            count = find_contacts(
                near, nodes.blocks, coupled, nodes.phases, nodes.walls, dt, self.plan.dx,
                self.contacts, count,
            )  # fmt: skip
            if count <= len(self.contacts.mass):
                return count
            self.contacts = no_contacts(2 * count, len(law.length) > 0)

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


@device_function
def _clears_wall(n, ijk, walls):
    """Remove from a normal what leads through walls at a node; return False at a stick wall."""
    for a in range(3):
        for side in range(2):
            kind, outward = walls.kinds[a, side], 2.0 * side - 1.0
            depth = outward * (ijk[a] - side * walls.cells[a])
            if depth == 0.0 and kind == STICK:
                return False
            if depth == 0.0 and kind == SLIP:
                n[a] = 0.0
            if depth >= 0.0 and kind in (SEPARATE, RELEASING) and outward * n[a] > 0.0:
                n[a] = 0.0
    return True


@always_inline
def _is_close_to_wall(ijk, cells):
    """Return whether a node lies in a wall of the domain, beyond it, or next to it."""
    for a in range(3):
        if ijk[a] <= 1 or ijk[a] >= cells[a] - 1:
            return True
    return False


@array_function
def _distance_without_flush_face(colliders, m, ijk, walls, n, d, dx):
    """Return the distance of a node from a body, without a face that lies on a wall [m].

    A slip or separating wall shows such a body as if it went on behind the wall. A node in the
    wall, or next to it, takes distance and normal of the point two cells in front of the wall,
    where the face is not the nearest part of the surface.

    Args:
        colliders: Sampled colliders.
        m: Number of the body's collider.
        ijk: Node, shape (3,).
        walls: Walls of the domain.
        n: Outward normal of the body (in/out), shape (3,).
        d: Distance of the node outside [m].
        dx: Cell size [m].
    """
    for a in range(3):
        for side in range(2):
            kind, outward = walls.kinds[a, side], 2.0 * side - 1.0
            height = outward * (side * walls.cells[a] - ijk[a])
            if kind not in (SLIP, SEPARATE, RELEASING) or height < 0.0 or height > 1.0:
                continue
            faces_wall = outward * n[a]
            if not faces_wall > 0.0:
                continue
            x, inner_normal = ijk * dx, np.zeros(3)
            x[a] = (side * walls.cells[a] - outward * FLUSH_DEPTH_CELLS) * dx
            inner = sample_surface(colliders, m, x, inner_normal)
            lies_on_face = abs(d + height * dx) < FLUSH_CELLS * dx and faces_wall > FLUSH_ALIGNMENT
            if lies_on_face or inner > d - 0.5 * faces_wall * dx:
                for c in range(3):
                    n[c] = inner_normal[c]
                d = inner
    return d


@always_inline
def _pressure_impulse(field, o, outside, dx):
    """Return the impulse of the pressure on a node some cells outside a surface [kg m/s].

    It is the part of the surface's traction that the moments of B-splines give such a node, as far
    as its cell is filled.
    """
    volume = field.nodes[o // 256, o % 256 + 3]
    if not volume > 0.0:
        return 0.0
    filled = min(dx * dx * dx / volume, 1.0)
    return max(field.nodes[o // 256, o % 256], 0.0) * filled * traction_share(outside)


@kernel
def find_contacts(nodes, tables, bodies, phases, walls, dt, dx, out, count):
    """Find the nodes that touch free bodies; return the number of rows.

    If they are more than `out` has rows, only the number is right.

    Args:
        nodes: NodesNearBodies.
        tables: Node blocks of the rank.
        bodies: CoupledBodies.
        phases: Constants of the phases.
        walls: Walls of the domain.
        dt: Time step [s].
        dx: Cell size [m].
        out: NodeContacts (out).
        count: Rows that are taken already.
    """
    n, slope, ijk = np.zeros(3), np.zeros(3), np.zeros(3, np.int64)
    if len(nodes.offsets) == 0:
        return count
    for row in range(len(nodes.block)):
        b = nodes.block[row]
        for node in range(64):
            d = float(nodes.surfaces[row, node, 3])
            if not abs(d) < REACH_CELLS * dx:
                continue
            k = bodies.number_of[nodes.collider_number[row, node]]
            if k < 0:
                continue
            set_node_indices(ijk, tables.coordinates[b], node)
            for c in range(3):
                n[c] = nodes.surfaces[row, node, c]
            if _is_close_to_wall(ijk, walls.cells):
                d = _distance_without_flush_face(
                    nodes.colliders, nodes.collider_number[row, node], ijk, walls, n, d, dx
                )
                if not abs(d) < REACH_CELLS * dx or not _clears_wall(n, ijk, walls):
                    continue
            for nb in range(tables.first[b], tables.first[b + 1]):
                p = tables.phase[nb]
                if bodies.sticks and not bodies.adhesion.length[k, p] < np.inf:
                    continue
                if len(nodes.reserved) > 0 and nodes.reserved[nb, node] != 0:
                    continue
                if not touches_surface(nodes, phases, p, nb, node, n, d, dx):
                    continue
                if count < len(out.mass):
                    flow = flow_fraction(
                        nodes.velocities[nb, 4 * node + 3], phases.min_cell_mass[p], d / dx
                    )
                    outside = max(d, -bodies.adhesion.depth * dx)
                    o = 256 * nb + 4 * node
                    _store_contact(out, count, nodes, o, n, d, outside, flow, dx, slope)
                    out.body[count], out.counts[count] = k, nodes.counts[b, node]
                    out.friction[count], out.stick[count] = bodies.friction[k, p], -1.0
                    if bodies.sticks:
                        out.mass[count] = out.pressed[count] = out.friction[count] = 0.0
                    if len(out.adhering) > 0:
                        _store_adhesion(out, count, nodes, bodies.adhesion, k, p, d, flow, dt, dx)
                    for c in range(3):
                        out.arm[count, c] = ijk[c] * dx - bodies.centers[k, c]
                        out.foot[count, c] = out.arm[count, c] - d * n[c]
                count += 1
    return count


@always_inline
def _store_contact(out, q, nodes, o, n, d, outside, flow, dx, slope):
    """Store what a phase at a node brings into contact.

    Args:
        out: NodeContacts (out).
        q: Row.
        nodes: NodesNearBodies.
        o: Offset of the phase's node in the flat nodal values.
        n, d: Outward normal of the body, and distance of the node [m].
        outside: Distance over which its velocity is continued to the surface [m].
        flow: Part of the velocity's change towards the surface that counts.
        dx: Cell size [m].
        slope: Scratch, shape (3,).
    """
    at_node = nodes.velocities[o // 256]
    mean_gradient(nodes.fields, o, n, slope)
    mass = float(at_node[o % 256 + 3])
    is_outside = d > FULL_WEIGHT_CELLS * dx
    out.offset[q], out.nodal_mass[q] = o, mass
    out.mass[q] = 0.0 if is_outside else mass
    out.pressed[q] = _pressure_impulse(nodes.fields[3], o, d / dx, dx) if is_outside else 0.0
    for c in range(3):
        out.velocity[q, c] = at_node[o % 256 + c] - flow * outside / dx * slope[c]
        out.normal[q, c] = n[c]


@device_function
def _store_adhesion(out, q, nodes, law, k, p, d, flow, dt, dx):
    """Store how a phase at a node sticks to a body.

    Args:
        out: NodeContacts (in/out), of which the row is stored but for this.
        q: Row.
        nodes: NodesNearBodies.
        law: AdhesionLaw of the bodies.
        k, p: Body and phase.
        d: Distance of the node outside [m].
        flow: Part of the velocity's change towards the surface that counts.
        dt: Time step [s].
        dx: Cell size [m].
    """
    length, viscosity, mass = law.length[k, p], law.viscosity[p], out.nodal_mass[q]
    n, slope = out.normal[q], out.drag[q]
    depth = depth_in_flow(nodes, out.offset[q], n, dx)
    out.adhering[q] = adhering_mass(length, viscosity, mass, d / dx, dt, dx)
    drag = flow * shear_drag(length, viscosity, mass, d / dx, depth, dt, dx)
    mean_gradient(nodes.fields, out.offset[q], n, slope)
    tangential_part(slope, n)
    for c in range(3):
        slope[c] *= -drag

"""Slip of viscous liquids on colliders and solids: what flows at a surface takes its velocity.

A node inside the surface, or up to half a cell outside, takes the tangential impulse m (V - v_s),
where V is the velocity of the surface and v_s = v - D dv/dn that of the liquid at the surface, D
the distance of the node outside. This continues the flow in a straight line through the surface. A
node that lies farther outside takes its part of the viscous stress on the surface, as the moments
of B-splines distribute it (kernels/colliders/surface_flow.py). Simple shear is exact wherever the
surface lies among the nodes. With a slip length b (Navier), the impulse of nodes up to a cell away
is that of the stress viscosity (V - v_s) / b on the node's part of the surface, at most m (V - v_s)
(docs/explanation/contact.md).

On a solid the rule is the same, for the velocity fields of a liquid and of a solid at a node. The
solid's surface is the resolved one, which contact uses, too. Both velocities are continued to it by
the gradients of their particles. The impulse acts on both fields at the same node, so that momentum
and angular momentum are exact: reduced masses take the place of the liquid's.

References:
    Happel, Brenner (1965): Low Reynolds number hydrodynamics, section 2-8 (slip).
"""

import math
from typing import Any, NamedTuple

import numpy as np

from vgmpi.features.active_feature import ActiveFeature, NodeState, StartContext
from vgmpi.kernels.colliders.sdf_sampling import set_node_indices
from vgmpi.kernels.colliders.surface_flow import (
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
)
from vgmpi.kernels.grid.contact_impulses import distance, normalize
from vgmpi.kernels.kernel_arguments import CONTACT_MASS_FLOOR, Sums
from vgmpi.kernels.reaction_impulses import (
    add_contact_reaction,
    add_prescribed_reaction,
    set_block,
    set_collider,
    set_node,
)
from vgmpi.kernels.step_records import StepSpan
from vgmpi.kernels.wall_boundary import stopped_axes
from vgmpi.parallel.exchange_topology import GRADIENTS, ExchangeTopology
from vgmpi.planning.feature_plan import Adhesion
from vgmpi.runtime.jit import device_function, kernel

from .plan import SurfaceSlipPlan


class NodesNearColliders(NamedTuple):
    """Nodes of a rank near colliders, and what slip needs of them."""

    surfaces: np.ndarray  # (n, 64, 4) normal and distance [m] of the nearest collider
    moves: np.ndarray  # (n, 64, 3) [m/s] its velocity, or without rows
    collider_number: np.ndarray  # (n, 64) its number, or without rows
    velocities: np.ndarray  # (node blocks, 256) velocities and masses (in/out)
    offsets: np.ndarray  # (node blocks, 256) values of the field of offsets
    fields: tuple[Sums, ...]  # the three fields of velocity gradients


@device_function
def _change_velocity(nodes, o, surface, speed, masses, axes, outside, slope):
    """Give a phase at a node its tangential impulse.

    Args:
        nodes: NodesNearColliders.
        o: Offset of the node in the flat nodal values of its phase.
        surface: Normal and distance of the collider, shape (4,).
        speed: Velocity of the collider's surface, shape (3,) [m/s].
        masses: Mass that takes the velocity of the surface, and drag of viscous stress [kg].
        axes: Bits of the axes along which a wall stops the node.
        outside: Distance to the surface by which the gradient continues the velocity [cells].
        slope: Scratch, shape (3,).
    """
    v, column = nodes.velocities[o // 256], o % 256
    mean_gradient(nodes.fields, o, surface, slope)
    for c in range(3):
        approach = speed[c] - (v[column + c] - outside * slope[c])
        slope[c] = masses[0] * approach - masses[1] * slope[c]
    tangential_part(slope, surface)
    for c in range(3):
        if not axes >> c & 1:
            v[column + c] += slope[c] / v[column + 3]


@kernel
def apply_collider_slip(rows, nodes, tables, law, phases, walls, dt, dx, reaction):
    """Apply the slip of viscous liquids on colliders at the nodes of some blocks.

    Args:
        rows: Blocks near colliders, shape (n,).
        nodes: NodesNearColliders; its velocities are changed (in/out).
        tables: Node blocks of the rank.
        law: AdhesionLaw of the colliders.
        phases: Constants of the phases.
        walls: Walls of the domain.
        dt: Time step [s].
        dx: Cell size [m].
        reaction: Reaction sums of the thread (in/out), or None.
    """
    slope, speed, before = np.zeros(3), np.zeros(3), np.zeros(3)
    ijk = np.zeros(3, np.int64)
    for b in rows:
        row = tables.solid[b]
        set_block(reaction, b)
        for node in range(64):
            surface = nodes.surfaces[row, node]
            d = float(surface[3])
            if not abs(d) < REACH_CELLS * dx:
                continue
            collider = nodes.collider_number[row, node] if len(nodes.collider_number) > 0 else 0
            set_node_indices(ijk, tables.coordinates[b], node)
            axes = stopped_axes(ijk, walls)
            if axes < 0:
                continue
            if len(nodes.moves) > 0:
                for c in range(3):
                    speed[c] = nodes.moves[row, node, c]
            for nb in range(tables.first[b], tables.first[b + 1]):
                p = tables.phase[nb]
                length = law.length[collider, p]
                if not (
                    length < math.inf
                    and touches_surface(nodes, phases, p, nb, node, surface, d, dx)
                ):
                    continue
                o = 256 * nb + 4 * node
                v = nodes.velocities[nb, 4 * node : 4 * node + 4]
                for c in range(3):
                    before[c] = v[c]
                mass = float(v[3])
                flow = flow_fraction(mass, phases.min_cell_mass[p], d / dx)
                eta, depth = law.viscosity[p], depth_in_flow(nodes, o, surface, dx)
                masses = (
                    adhering_mass(length, eta, mass, d / dx, dt, dx),
                    flow * shear_drag(length, eta, mass, d / dx, depth, dt, dx),
                )
                outside = flow * max(d / dx, -law.depth)
                _change_velocity(nodes, o, surface, speed, masses, axes, outside, slope)
                if reaction is not None:
                    set_node(reaction, node, ijk[0], ijk[1], ijk[2])
                    set_collider(reaction, collider, surface)
                    for c in range(3):  # impulses act at nodes: angular momentum is exact
                        reaction.surface_point[c] = reaction.node[c]
                    add_contact_reaction(reaction, before, v, mass, speed, 0, 0)


class SolidSlipLaw(NamedTuple):
    """Slip of phases on each other, and which of them move as prescribed."""

    adhesion: AdhesionLaw  # its lengths: (phases, phases) [m], infinite: free slip
    driven: np.ndarray  # (phases,) bool: its velocity is prescribed
    rows: np.ndarray  # (phases,) rows of prescribed bodies in the reactions, or -1


class NodesOfPhases(NamedTuple):
    """Nodes of a rank at which phases may meet, and what slip needs of them."""

    velocities: np.ndarray  # (node blocks, 256) velocities and masses (in/out)
    offsets: np.ndarray  # (node blocks, 256) values of the field of offsets
    fields: tuple[Sums, ...]  # the three fields of velocity gradients


class SlipScratch(NamedTuple):
    """Vectors of one node, shape (3,) each."""

    normal: np.ndarray  # outward normal of the solid
    slope: np.ndarray  # change of the liquid's velocity per cell along it
    slope_of_solid: np.ndarray
    impulse: np.ndarray  # [kg m/s]
    before: np.ndarray  # velocity of the liquid before [m/s]
    speed: np.ndarray  # velocity of the solid [m/s]


@device_function
def _find_surface(nodes, phases, p, nb, node, normal, dx):
    """Store the normal of a solid's surface at a node; return its distance [cells], or infinity."""
    mass = float(nodes.velocities[nb, 4 * node + 3])
    if not mass > CONTACT_MASS_FLOOR * phases.min_cell_mass[p]:
        return math.inf
    side = nodes.offsets[nb, 4 * node : 4 * node + 4]
    for c in range(3):
        normal[c] = side[c]
    return distance(normal, 1.0, side, mass, True, dx) if normalize(normal, 0.0) else math.inf


@device_function
def _store_impulse(nodes, law, phases, pair, flat, outside, dt, dx, scratch):
    """Store the tangential impulse of a solid on a liquid at a node.

    Args:
        nodes: NodesOfPhases.
        law: SolidSlipLaw.
        phases: Constants of the phases.
        pair: Phases of the liquid and of the solid.
        flat: Offsets of both in the flat nodal values.
        outside: Distance of the node outside the solid [cells].
        dt, dx: Time step [s] and cell size [m].
        scratch: SlipScratch (in/out).
    """
    liquid, solid = nodes.velocities[flat[0] // 256], nodes.velocities[flat[1] // 256]
    k, q = flat[0] % 256, flat[1] % 256
    mass, other = float(liquid[k + 3]), float(solid[q + 3])
    reduced = mass * other / (mass + other)
    length, eta = law.adhesion.length[pair[1], pair[0]], law.adhesion.viscosity[pair[0]]
    if law.driven[pair[1]]:
        reduced = mass
    flow = flow_fraction(mass, phases.min_cell_mass[pair[0]], outside)
    depth = depth_in_flow(nodes, flat[0], scratch.normal, dx)
    adhering = adhering_mass(length, eta, reduced, outside, dt, dx)
    drag = flow * shear_drag(length, eta, reduced, outside, depth, dt, dx)
    mean_gradient(nodes.fields, flat[0], scratch.normal, scratch.slope)
    mean_gradient(nodes.fields, flat[1], scratch.normal, scratch.slope_of_solid)
    for c in range(3):
        scratch.speed[c] = solid[q + c]
        approach = solid[q + c] - outside * scratch.slope_of_solid[c]
        approach -= liquid[k + c] - flow * outside * scratch.slope[c]
        scratch.impulse[c] = adhering * approach - drag * scratch.slope[c]
    tangential_part(scratch.impulse, scratch.normal)


@device_function
def _apply_impulse(nodes, is_driven, flat, axes, scratch):
    """Add an impulse to the velocity of a liquid, and its reaction to that of a solid.

    Args:
        nodes: NodesOfPhases (in/out).
        is_driven: Whether the motion of the solid is prescribed.
        flat: Offsets of liquid and solid in the flat nodal values.
        axes: Bits of the axes along which a wall stops the node.
        scratch: SlipScratch (in/out).
    """
    liquid, solid = nodes.velocities[flat[0] // 256], nodes.velocities[flat[1] // 256]
    k, q = flat[0] % 256, flat[1] % 256
    for c in range(3):
        scratch.before[c] = liquid[k + c]
        if not axes >> c & 1:
            liquid[k + c] += scratch.impulse[c] / liquid[k + 3]
            if not is_driven:
                solid[q + c] -= scratch.impulse[c] / solid[q + 3]


@kernel
def apply_solid_slip(rows, nodes, tables, law, phases, walls, dt, dx, reaction):
    """Apply the slip of viscous liquids on solids at the nodes of some blocks.

    Args:
        rows: Blocks in which several phases meet, shape (n,).
        nodes: NodesOfPhases; its velocities are changed (in/out).
        tables: Node blocks of the rank.
        law: SolidSlipLaw.
        phases: Constants of the phases.
        walls: Walls of the domain.
        dt: Time step [s].
        dx: Cell size [m].
        reaction: Reaction sums of the thread (in/out), or None.
    """
    ijk = np.zeros(3, np.int64)
    scratch = SlipScratch(
        np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)
    )
    for b in rows:
        set_block(reaction, b)
        for node in range(64):
            set_node_indices(ijk, tables.coordinates[b], node)
            axes = stopped_axes(ijk, walls)
            if axes < 0:
                continue
            for sb in range(tables.first[b], tables.first[b + 1]):
                solid = tables.phase[sb]
                if not phases.surface[solid]:
                    continue
                outside = _find_surface(nodes, phases, solid, sb, node, scratch.normal, dx)
                if not abs(outside) < REACH_CELLS:
                    continue
                for nb in range(tables.first[b], tables.first[b + 1]):
                    p = tables.phase[nb]
                    if not (
                        law.adhesion.length[solid, p] < math.inf
                        and not phases.surface[p]
                        and touches_surface(
                            nodes, phases, p, nb, node, scratch.normal, outside * dx, dx
                        )
                    ):
                        continue
                    pair, flat = (p, solid), (256 * nb + 4 * node, 256 * sb + 4 * node)
                    _store_impulse(nodes, law, phases, pair, flat, outside, dt, dx, scratch)
                    _apply_impulse(nodes, law.driven[solid], flat, axes, scratch)
                    if reaction is not None:
                        set_node(reaction, node, ijk[0], ijk[1], ijk[2])
                        liquid = nodes.velocities[nb, 4 * node : 4 * node + 4]
                        add_prescribed_reaction(
                            reaction, law.rows[solid], scratch.before, liquid, float(liquid[3]),
                            scratch.speed, 0, 0,
                        )  # fmt: skip


class SlipOnSurfaces:
    """Slip of viscous liquids on surfaces of a kind at the nodes of a rank."""

    kernel: Any  # applies it at the nodes of some blocks

    def __init__(self, context: StartContext, law: AdhesionLaw | SolidSlipLaw):
        """Take what the slip depends on.

        Args:
            context: What a feature may take when a run starts.
            law: Slip of the phases.
        """
        self.plan, self.law, self.threads = context.plan, law, context.threads
        self.tables: ExchangeTopology | None = None
        self.rows: list[np.ndarray] = []  # blocks of each thread

    def blocks_of(self, tables: ExchangeTopology) -> np.ndarray:
        """Return which blocks have such surfaces, shape (blocks,) bool."""
        raise NotImplementedError

    def nodes_of(self, *fields):
        """Return the nodes as the kernel takes them.

        Args:
            fields: Velocities, offsets, and the three fields of velocity gradients.
        """
        raise NotImplementedError

    def couple(self, nodes: NodeState, dt: float) -> None:
        """Change the velocities of the nodes next to such surfaces in a step of dt [s]."""
        if self.tables is not nodes.tables:
            self.tables = nodes.tables
            rows = np.flatnonzero(self.blocks_of(nodes.tables))
            self.rows = np.array_split(rows, self.threads)
        near = self.nodes_of(
            nodes.velocities, nodes.fields["offsets"].nodes,
            tuple(nodes.fields[name].tables for name in GRADIENTS),
        )  # fmt: skip
        nodes.each(self._couple, nodes, near, dt)

    def _couple(self, thread: int, nodes: NodeState, near, dt: float) -> None:
        nodes.call(
            self.kernel, self.rows[thread], near, nodes.blocks, self.law, nodes.phases,
            nodes.walls, dt, self.plan.dx, nodes.reactions[thread],
        )  # fmt: skip


class ColliderSlip(SlipOnSurfaces):
    """Slip of viscous liquids on colliders."""

    kernel = staticmethod(apply_collider_slip)

    def __init__(self, context: StartContext, slip: Adhesion):
        """Take the slip lengths on the colliders."""
        solids = context.collider_nodes
        lengths, viscosities = np.array(slip.lengths), np.array(slip.viscosities)
        if len(is_free := getattr(solids, "is_free", ())):
            lengths[is_free] = np.inf  # free bodies couple by themselves
        depth = PUSHED_DEPTH_CELLS if context.plan.has_separate_pressure else REACH_CELLS
        super().__init__(context, AdhesionLaw(lengths, viscosities, depth))
        self.solids = solids

    def blocks_of(self, tables: ExchangeTopology) -> np.ndarray:
        """Return which blocks are near colliders, shape (blocks,) bool."""
        return tables.solid >= 0

    def nodes_of(self, *fields) -> NodesNearColliders:
        """Return the nodes near colliders; fields: see `SlipOnSurfaces.nodes_of`."""
        solids = self.solids
        return NodesNearColliders(solids.nodes, solids.moves, solids.collider_number, *fields)


class SolidSlip(SlipOnSurfaces):
    """Slip of viscous liquids on deformable bodies."""

    kernel = staticmethod(apply_solid_slip)

    def __init__(self, context: StartContext, slip: Adhesion):
        """Take the slip lengths of phases on each other."""
        plan, prescribed = context.plan, context.prescribed
        phases = len(plan.phases)
        driven = np.array([phase.driven for phase in plan.phases])
        rows = np.full(phases, -1) if prescribed is None else prescribed.motions.row
        law = AdhesionLaw(np.array(slip.lengths), np.array(slip.viscosities), REACH_CELLS)
        super().__init__(context, SolidSlipLaw(law, driven, rows))

    def blocks_of(self, tables: ExchangeTopology) -> np.ndarray:
        """Return in which blocks several phases meet, shape (blocks,) bool."""
        return tables.may_touch & (np.diff(tables.first) > 1)

    def nodes_of(self, *fields) -> NodesOfPhases:
        """Return the nodes; fields: see `SlipOnSurfaces.nodes_of`."""
        return NodesOfPhases(*fields)


class SurfaceSlip(ActiveFeature):
    """Slip of viscous liquids of a run, on colliders and then on solids."""

    couples_nodes = True

    def __init__(self, surfaces: list[SlipOnSurfaces]):
        """Take the slip on each kind of surfaces."""
        self.surfaces = surfaces

    def couple_nodes(self, nodes: NodeState, span: StepSpan, gravity: np.ndarray) -> None:
        """Change the velocities of the nodes next to colliders and solids.

        Args:
            nodes: Nodes of the rank.
            span: The step.
            gravity: Acceleration, shape (3,) [m/s2].
        """
        for each in self.surfaces:
            each.couple(nodes, span.dt)


def start(plan: SurfaceSlipPlan, context: StartContext) -> SurfaceSlip | None:
    """Return the slip of a run's liquids, or None if they slip freely on all that it has.

    Args:
        plan: Plan of the slip.
        context: See `FeaturePlan.start`.
    """
    surfaces: list[SlipOnSurfaces] = []
    if plan.on_colliders is not None and context.collider_nodes is not None:
        surfaces.append(ColliderSlip(context, plan.on_colliders))
    if plan.on_solids is not None:
        surfaces.append(SolidSlip(context, plan.on_solids))
    return SurfaceSlip(surfaces) if surfaces else None

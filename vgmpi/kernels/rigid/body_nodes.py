"""Nodes that touch free rigid bodies, and what each brings into free_coupling.py."""

from typing import NamedTuple

import numpy as np

from vgmpi.kernels.colliders.sdf_sampling import SampledSdf, sample_surface, set_node_indices
from vgmpi.kernels.colliders.surface_flow import (
    FULL_WEIGHT_CELLS,
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
from vgmpi.kernels.wall_boundary import SEPARATE, SLIP, STICK
from vgmpi.runtime.jit import always_inline, array_function, device_function, kernel

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
    whose: np.ndarray  # (n, 64) its number
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
            if depth >= 0.0 and kind == SEPARATE and outward * n[a] > 0.0:
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
            if not (kind == SLIP or kind == SEPARATE) or height < 0.0 or height > 1.0:
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
            k = bodies.number_of[nodes.whose[row, node]]
            if k < 0:
                continue
            set_node_indices(ijk, tables.at[b], node)
            for c in range(3):
                n[c] = nodes.surfaces[row, node, c]
            if _is_close_to_wall(ijk, walls.cells):
                d = _distance_without_flush_face(
                    nodes.colliders, nodes.whose[row, node], ijk, walls, n, d, dx
                )
                if not abs(d) < REACH_CELLS * dx or not _clears_wall(n, ijk, walls):
                    continue
            for nb in range(tables.first[b], tables.first[b + 1]):
                p = tables.phase[nb]
                if len(nodes.reserved) > 0 and nodes.reserved[nb, node] != 0:
                    continue
                if not touches_surface(nodes, phases, p, nb, node, n, d, dx):
                    continue
                if count < len(out.mass):
                    flow = flow_fraction(
                        nodes.velocities[nb, 4 * node + 3], phases.least[p], d / dx
                    )
                    _store_contact(out, count, nodes, 256 * nb + 4 * node, n, d, flow, dx, slope)
                    out.body[count], out.counts[count] = k, nodes.counts[b, node]
                    out.friction[count], out.stick[count] = bodies.friction[k, p], -1.0
                    if len(out.adhering) > 0:
                        _store_adhesion(out, count, nodes, bodies.adhesion, k, p, d, flow, dt, dx)
                    for c in range(3):
                        out.arm[count, c] = ijk[c] * dx - bodies.centers[k, c]
                        out.foot[count, c] = out.arm[count, c] - d * n[c]
                count += 1
    return count


@always_inline
def _store_contact(out, q, nodes, o, n, d, flow, dx, slope):
    """Store what a phase at a node brings into contact.

    Args:
        out: NodeContacts (out).
        q: Row.
        nodes: NodesNearBodies.
        o: Offset of the phase's node in the flat nodal values.
        n, d: Outward normal of the body, and distance of the node [m].
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
        out.velocity[q, c] = at_node[o % 256 + c] - flow * d / dx * slope[c]
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

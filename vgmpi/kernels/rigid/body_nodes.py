"""Nodes that touch free rigid bodies, and what each brings into free_coupling.py."""

from typing import NamedTuple

import numpy as np

from vgmpi.kernels.grid.contact_impulses import (
    GAP_RESOLVED,
    GAP_UNRESOLVED,
    distance,
    half_space_fraction,
)
from vgmpi.kernels.reproducible_sums import blocks_at, finalize_node_block, sums_at
from vgmpi.kernels.step_limits import CONTACT_MASS_FLOOR
from vgmpi.kernels.wall_boundary import SEPARATE, SLIP, STICK
from vgmpi.runtime.jit import device_function, kernel

REACH_CELLS = 1.5  # [cells] distance from a surface, both ways, up to which nodes take impulses
# [cells] distance outside up to which impulses act against approach
FULL_WEIGHT_CELLS = 0.5
SPRAY_FILL, FLOW_FILL = 0.25, 0.5  # [-] fill of a node in spray, and in a flow, at its distance


class NodeContacts(NamedTuple):
    """Nodes and phases that may touch a free body in a step."""

    body: np.ndarray  # (n,) number of the body
    offset: np.ndarray  # (n,) offset of the velocity in the flat nodal values
    counts: np.ndarray  # (n,) 1 if this rank counts the node
    mass: np.ndarray  # (n,) [kg] nodal mass times the weight
    nodal_mass: np.ndarray  # (n,) [kg]
    friction: np.ndarray  # (n,) [-] Coulomb coefficient
    normal: np.ndarray  # (n, 3) outward normal
    arm: np.ndarray  # (n, 3) [m] from the body's center to the node
    foot: np.ndarray  # (n, 3) [m] from the body's center to the surface
    velocity: np.ndarray  # (n, 3) [m/s] of the phase at the surface
    pressed: np.ndarray  # (n,) [kg m/s] impulse of the pressure along the normal, farther outside
    stick: np.ndarray  # (n,) [-] fraction of the slip that friction removes, -1: does not touch


def no_contacts(n: int) -> NodeContacts:
    """Return an empty table with room for n rows."""
    return NodeContacts(
        np.zeros(n, np.int64), np.zeros(n, np.int64), np.zeros(n, np.int64), np.zeros(n),
        np.zeros(n), np.zeros(n), np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 3)),
        np.zeros((n, 3)), np.zeros(n), np.full(n, -1.0),
    )  # fmt: skip


class NodesNearBodies(NamedTuple):
    """Nodes of a rank near colliders."""

    block: np.ndarray  # (n,) blocks near colliders
    surfaces: np.ndarray  # (n, 64, 4) normal and distance [m] of the nearest collider
    whose: np.ndarray  # (n, 64) its number
    counts: np.ndarray  # (blocks, 64) 1 at the nodes that this rank counts
    velocities: np.ndarray  # (node blocks, 256) velocities and masses
    offsets: np.ndarray  # (node blocks, 256) values of the field of offsets, or without rows
    fields: tuple  # velocity gradients and pressure, four Sums


class CoupledBodies(NamedTuple):
    """Free bodies in their coupling with nodes."""

    number_of: np.ndarray  # (colliders,) number of the free body of each, -1 if it is not free
    centers: np.ndarray  # (m, 3) [m] centers of mass
    friction: np.ndarray  # (m, phases) [-] Coulomb coefficients


@kernel
def finalize_fields(tables, fields, numbers, report):
    """Convert the sums of velocity gradients and pressure at all node blocks of a rank.

    Args:
        tables: Node blocks of the rank, NodeBlocks.
        fields: The four fields, Sums (in/out).
        numbers: Numbers of the fields in the report, shape (4,).
        report: Overflows by field (in/out).
    """
    rows = blocks_at(tables)
    # pointers of a field are made once: it takes as long as a node block
    x, y, z = sums_at(fields[0]), sums_at(fields[1]), sums_at(fields[2])
    pressure = sums_at(fields[3])
    for nb in range(len(tables.phase)):
        finalize_node_block(nb, rows, x, report, numbers[0])
        finalize_node_block(nb, rows, y, report, numbers[1])
        finalize_node_block(nb, rows, z, report, numbers[2])
        finalize_node_block(nb, rows, pressure, report, numbers[3])


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


@device_function
def _pressure_impulse(field, o, outside, dx):
    """Return the impulse of the pressure on a node some cells outside a surface [kg m/s].

    It is the part of the surface's traction that the moments of B-splines give such a node, as far
    as its cell is filled.
    """
    volume = field.nodes[o // 256, o % 256 + 3]
    if not volume > 0.0:
        return 0.0
    a = REACH_CELLS - outside
    share = a * a * a * (1.0 - 0.5 * a)
    filled = min(dx * dx * dx / volume, 1.0)
    return max(field.nodes[o // 256, o % 256], 0.0) * filled * share


@device_function
def _mean_gradient(gradients, o, n, out):
    """Store the change of a phase's velocity per cell along n at a node, 0 without particles."""
    for c in range(3):
        out[c] = 0.0
    for a in range(3):
        g = gradients[a].nodes
        mass = g[o // 256, o % 256 + 3]
        if mass > 0.0:
            for c in range(3):
                out[c] += n[a] * g[o // 256, o % 256 + c] / mass


@kernel
def find_contacts(nodes, tables, bodies, phases, walls, dx, out):
    """Find the nodes that touch free bodies; return their number.

    If they are more than `out` has rows, only the number is right.

    Args:
        nodes: NodesNearBodies.
        tables: Node blocks of the rank.
        bodies: CoupledBodies.
        phases: Constants of the phases.
        walls: Walls of the domain.
        dx: Cell size [m].
        out: NodeContacts (out).
    """
    count, n, ijk = 0, np.zeros(3), np.zeros(3, np.int64)
    if len(nodes.offsets) == 0:
        return 0
    for row in range(len(nodes.block)):
        b = nodes.block[row]
        for node in range(64):
            d = float(nodes.surfaces[row, node, 3])
            if not abs(d) < REACH_CELLS * dx:
                continue
            k = bodies.number_of[nodes.whose[row, node]]
            if k < 0:
                continue
            ijk[0] = 4 * tables.at[b, 0] - 1 + node // 16
            ijk[1] = 4 * tables.at[b, 1] - 1 + node // 4 % 4
            ijk[2] = 4 * tables.at[b, 2] - 1 + node % 4
            for c in range(3):
                n[c] = nodes.surfaces[row, node, c]
            if not _clears_wall(n, ijk, walls):
                continue
            for nb in range(tables.first[b], tables.first[b + 1]):
                p = tables.phase[nb]
                if not _touches(nodes, phases, p, nb, node, n, d, dx):
                    continue
                if count < len(out.mass):
                    flow = _flow_fraction(
                        nodes.velocities[nb, 4 * node + 3], phases.least[p], d / dx
                    )
                    _store_contact(out, count, nodes, 256 * nb + 4 * node, n, d, flow, dx)
                    out.body[count], out.counts[count] = k, nodes.counts[b, node]
                    out.friction[count], out.stick[count] = bodies.friction[k, p], -1.0
                    for c in range(3):
                        out.arm[count, c] = ijk[c] * dx - bodies.centers[k, c]
                        out.foot[count, c] = out.arm[count, c] - d * n[c]
                count += 1
    return count


@device_function
def _touches(nodes, phases, p, nb, node, n, d, dx):
    """Return whether a phase at a node touches the body near it.

    Args:
        nodes: NodesNearBodies.
        phases: Constants of the phases.
        p, nb, node: Phase, its node block, number of the node in its block.
        n, d: Outward normal of the body, and distance of the node [m].
        dx: Cell size [m].
    """
    mass, is_resolved = float(nodes.velocities[nb, 4 * node + 3]), phases.surface[p]
    side = nodes.offsets[nb, 4 * node : 4 * node + 4]
    if not (mass > CONTACT_MASS_FLOOR * phases.least[p] and _has_surface(side, is_resolved)):
        return False
    gap = d / dx + distance(n, -1.0, side, mass, is_resolved, dx)
    return gap <= (GAP_RESOLVED if is_resolved else GAP_UNRESOLVED)


@device_function
def _flow_fraction(mass, full, outside):
    """Return 1 where a node is as full as in a flow that reaches the surface, 0 in spray.

    The gradient of a lone particle says nothing about a flow: left alone, it would grow.

    Args:
        mass: Nodal mass [kg].
        full: Mass of a full cell [kg].
        outside: Distance of the node outside the body [cells].
    """
    fill = mass / (full * max(half_space_fraction(-outside), 1e-6))
    return min(max((fill - SPRAY_FILL) / (FLOW_FILL - SPRAY_FILL), 0.0), 1.0)


@device_function
def _store_contact(out, q, nodes, o, n, d, flow, dx):
    """Store what a phase at a node brings into contact.

    Args:
        out: NodeContacts (out).
        q: Row.
        nodes: NodesNearBodies.
        o: Offset of the phase's node in the flat nodal values.
        n, d: Outward normal of the body, and distance of the node [m].
        flow: Part of the velocity's change towards the surface that counts.
        dx: Cell size [m].
    """
    slope, at_node = np.zeros(3), nodes.velocities[o // 256]
    _mean_gradient(nodes.fields, o, n, slope)
    mass = float(at_node[o % 256 + 3])
    is_outside = d > FULL_WEIGHT_CELLS * dx
    out.offset[q], out.nodal_mass[q] = o, mass
    out.mass[q] = 0.0 if is_outside else mass
    out.pressed[q] = _pressure_impulse(nodes.fields[3], o, d / dx, dx) if is_outside else 0.0
    for c in range(3):
        out.velocity[q, c] = at_node[o % 256 + c] - flow * d / dx * slope[c]
        out.normal[q, c] = n[c]


@device_function
def _has_surface(side, is_resolved):
    """Return whether a phase has a surface at a node, by its field of offsets, shape (4,)."""
    if is_resolved:
        return side[0] != 0.0 or side[1] != 0.0 or side[2] != 0.0
    return side[3] > 0.0

"""Slip of viscous liquids on colliders: what flows at a surface takes its velocity.

A node inside the surface, or up to half a cell outside, takes the tangential impulse m (V - v_s),
where V is the velocity of the surface and v_s = v - D dv/dn that of the liquid at the surface, D
the distance of the node outside. This continues the flow in a straight line through the surface. A
node that lies farther outside takes its part of the viscous stress on the surface, as the moments
of B-splines distribute it (body_nodes.py). Simple shear is exact wherever the surface lies among
the nodes. With a slip length b (Navier), the impulse of nodes up to a cell away is that of the
stress viscosity (V - v_s) / b on the node's part of the surface, at most m (V - v_s)
(docs/explanation/contact.md).

References:
    Happel, Brenner (1965): Low Reynolds number hydrodynamics, section 2-8 (slip).
"""

import math
from typing import NamedTuple

import numpy as np

from vgmpi.kernels.kernel_arguments import Sums
from vgmpi.kernels.reaction_impulses import (
    add_contact_reaction,
    set_block,
    set_collider,
    set_node,
)
from vgmpi.kernels.rigid.body_nodes import (
    REACH_CELLS,
    adhering_mass,
    depth_in_flow,
    flow_fraction,
    mean_gradient,
    shear_drag,
    tangential_part,
    touches_surface,
)
from vgmpi.kernels.rigid.sdf_sampling import set_node_indices
from vgmpi.kernels.wall_boundary import SLIP, STICK
from vgmpi.runtime.jit import device_function, kernel


class NodesNearColliders(NamedTuple):
    """Nodes of a rank near colliders, and what slip needs of them."""

    surfaces: np.ndarray  # (n, 64, 4) normal and distance [m] of the nearest collider
    moves: np.ndarray  # (n, 64, 3) [m/s] its velocity, or without rows
    whose: np.ndarray  # (n, 64) its number, or without rows
    velocities: np.ndarray  # (node blocks, 256) velocities and masses (in/out)
    offsets: np.ndarray  # (node blocks, 256) values of the field of offsets
    fields: tuple[Sums, ...]  # the three fields of velocity gradients


@device_function
def stopped_axes(ijk, walls):
    """Return a bit for each axis along which a wall stops a node, -1 at a stick wall."""
    axes = 0
    for a in range(3):
        for side in range(2):
            if ijk[a] == side * walls.cells[a]:
                if walls.kinds[a, side] == STICK:
                    return -1
                if walls.kinds[a, side] == SLIP:
                    axes |= 1 << a
    return axes


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
def apply_slip(rows, nodes, tables, law, phases, walls, dt, dx, reaction):
    """Apply the slip of viscous liquids on colliders at the nodes of some blocks.

    Args:
        rows: Blocks near colliders, shape (n,).
        nodes: NodesNearColliders; its velocities are changed (in/out).
        tables: Node blocks of the rank.
        law: SlipLaw.
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
            collider = nodes.whose[row, node] if len(nodes.whose) > 0 else 0
            set_node_indices(ijk, tables.at[b], node)
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
                flow = flow_fraction(mass, phases.least[p], d / dx)
                eta, depth = law.viscosity[p], depth_in_flow(nodes, o, surface, dx)
                masses = (
                    adhering_mass(length, eta, mass, d / dx, dt, dx),
                    flow * shear_drag(length, eta, mass, d / dx, depth, dt, dx),
                )
                _change_velocity(nodes, o, surface, speed, masses, axes, flow * d / dx, slope)
                if reaction is not None:
                    set_node(reaction, node, ijk[0], ijk[1], ijk[2])
                    set_collider(reaction, collider, surface)
                    for c in range(3):  # impulses act at nodes: angular momentum is exact
                        reaction.at[c] = reaction.node[c]
                    add_contact_reaction(reaction, before, v, mass, speed, 0, 0)

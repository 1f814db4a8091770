"""Nodes next to pinned parts of bodies: the body's surface takes the velocity of what holds it.

The particles of a pinned part are not on the grid. A node of the body up to 1.5 cells inside or
outside of the part's surface takes the impulse m (V - v_s), where V is the velocity of the part at
its surface and v_s = v - D dv/dn that of the body there, D the distance of the node outside. It has
both signs and all directions, so the body is attached to the part. This is the rule of liquids that
stick (surface_slip.py) without the condition that something touches.
"""

from typing import NamedTuple

import numpy as np

from vgmpi.kernels.reaction_impulses import add_contact_reaction, set_block, set_node
from vgmpi.runtime.jit import device_function, kernel

from .body_nodes import REACH_CELLS, mean_gradient
from .sdf_sampling import (
    distance_from_collider,
    set_node_indices,
    surface_velocity,
    turn_gradient,
)  # fmt: skip
from .surface_slip import stopped_axes


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
        _set_place(ijk, x, blocks.at[b], node, dx)
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
                reaction.at[c] = reaction.node[c]
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
        _set_place(ijk, x, blocks.at[b], node, dx)
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

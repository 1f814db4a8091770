"""Walls do not hold back what a collider or a body with prescribed motion pushes along them.

Walls act after contact. Where something rigid pushes a phase that flows, the friction of a wall, or
a wall without slip, would take away a part of that push, and the phase would enter what pushes it:
at the edge where a pushing plate meets the floor, for example. What pushes then gives back what the
wall took, along the walls.
"""

from typing import Any, NamedTuple

import numpy as np

from vgmpi.kernels.kernel_arguments import CONTACT_MASS_FLOOR
from vgmpi.kernels.reaction_impulses import (
    add_contact_reaction,
    add_prescribed_reaction,
    set_collider,
)
from vgmpi.runtime.jit import always_inline, device_function

from .contact_impulses import FULL_CONTACT_DISTANCE, NO_CONTACT_DISTANCE
from .divided_nodes import face_of_phase

# [-] squared length of the normal along the walls below which the push is not made longer: a wedge
# between wall and collider that is flatter than 30 degrees is squeezed out more slowly
MIN_SQUARED_LENGTH = 0.25


class PushedPhase(NamedTuple):
    """Phase of a block that flows and that walls hold back, and what may push it.

    What pushes has a number: n0 - 1 is the nearest collider, n0 to n1 - 1 are the node blocks of
    phases, of which those with prescribed motion push.
    """

    row: int  # row of the block among those near colliders, or -1
    phase: int
    first: int  # first number of what may push
    last: int  # number after the last one; not above `first` where nothing pushes
    of_block: int  # n0, the first number of a phase
    phase_of: Any  # (node blocks,) phase of each node block
    offsets: Any  # (256 node blocks,) values of the field of offsets
    dx: float  # [m] cell size
    normal: Any  # (4,) scratch


@device_function
def pushed_phase(block, row, nb, phase_of, phases, solids, offsets, dx, normal):
    """Return the phase of a node block as walls hold it back.

    Args:
        block, row: Context of the block; its row in solids, or -1.
        nb, phase_of: Node block, and the phase of each.
        phases, solids: Constants of the phases, and rigid boundaries.
        offsets: Values of the field of offsets, flat.
        dx: Cell size [m].
        normal: Scratch, shape (4,).
    """
    flows = not phases.surface[phase_of[nb]]
    moves = row >= 0 and len(solids.moves) > 0
    first = block.n0 - 1 if flows and moves else block.n0
    last = block.n1 if flows and len(solids.motions.driven) > 0 else block.n0
    return PushedPhase(row, phase_of[nb], first, last, block.n0, phase_of, offsets, dx, normal)


@device_function
def lost_push(pushed, solids, phases, source, node, before, nodes, v):
    """Return how much faster a phase approaches what pushes it since a wall acted [m/s], or 0.

    The outward normal of what pushes, and the distance from it, are stored in the scratch.

    Args:
        pushed: Phase and what may push it.
        solids, phases: Rigid boundaries, and constants of the phases.
        source: Number of what pushes.
        node: Number of the node in its block.
        before: Velocity before the wall acted, three numbers [m/s].
        nodes: Nodal velocities and masses; the velocity now is nodes[v:v + 3].
        v: Position of the velocity.
    """
    if source < pushed.of_block:
        is_close = _find_collider(pushed, solids, phases, node)
    else:
        is_close = _find_body(pushed, solids, phases, source, node, nodes)
    if not (is_close and nodes[v + 3] > 0.0):
        return 0.0
    n, nearing, nearing_before = pushed.normal, 0.0, 0.0
    speed = _speed(pushed, solids, source, node, nodes)
    for c in range(3):
        nearing += (speed[c] - nodes[v + c]) * n[c]
        nearing_before += (speed[c] - before[c]) * n[c]
    width = NO_CONTACT_DISTANCE - FULL_CONTACT_DISTANCE
    fraction = min(max((NO_CONTACT_DISTANCE - n[3] / pushed.dx) / width, 0.0), 1.0)
    return fraction * max(nearing - max(nearing_before, 0.0), 0.0)


@always_inline
def _find_collider(pushed, solids, phases, node):
    """Store normal and distance of the nearest collider; return False if it is not close."""
    n = pushed.normal
    distance = solids.nodes[pushed.row, node, 3]
    if not distance < NO_CONTACT_DISTANCE * pushed.dx:
        return False
    if len(solids.free) > 0 and solids.free[solids.collider_number[pushed.row, node]]:
        return False  # a free body couples after the walls
    for c in range(3):
        n[c] = solids.nodes[pushed.row, node, c]
    n[3] = face_of_phase(phases, pushed.phase, pushed.row, node, pushed.dx, n, distance)
    return True


@always_inline
def _find_body(pushed, solids, phases, nb, node, nodes):
    """Store normal and distance of a body with prescribed motion; return False without one."""
    n, p = pushed.normal, pushed.phase_of[nb]
    o = 256 * nb + 4 * node
    mass = nodes[o + 3]
    if not (solids.motions.driven[p] and phases.surface[p]):
        return False
    if not mass > CONTACT_MASS_FLOOR * phases.min_cell_mass[p]:
        return False
    x, y, z = pushed.offsets[o], pushed.offsets[o + 1], pushed.offsets[o + 2]
    size = np.sqrt(x * x + y * y + z * z)
    if not size > 0.0:
        return False
    n[0], n[1], n[2], n[3] = x / size, y / size, z / size, pushed.offsets[o + 3] / mass
    return True


@always_inline
def _speed(pushed, solids, source, node, nodes):
    """Return the velocity of what pushes at a node, three numbers [m/s]."""
    if source >= pushed.of_block:
        o = 256 * source + 4 * node
        return np.float64(nodes[o]), np.float64(nodes[o + 1]), np.float64(nodes[o + 2])
    moves = solids.moves[pushed.row, node]
    return np.float64(moves[0]), np.float64(moves[1]), np.float64(moves[2])


@device_function
def give_back_push(pushed, solids, source, node, push, along, nodes, v, reaction):
    """Give a phase the velocity along the walls that keeps it ahead of what pushes it.

    Args:
        pushed: Phase and what pushes it, of which the scratch holds the normal.
        solids, source: Rigid boundaries, and the number of what pushes.
        node: Number of the node in its block.
        push: Result of `lost_push` [m/s].
        along: Part of the normal along the walls, three numbers.
        nodes: Nodal velocities (in/out) and masses; that of the phase is nodes[v:v + 4].
        v: Position of the velocity.
        reaction: Reaction sums (in/out) at this node, or None.
    """
    size2 = along[0] * along[0] + along[1] * along[1] + along[2] * along[2]
    factor = push / max(size2, MIN_SQUARED_LENGTH)
    before = nodes[v], nodes[v + 1], nodes[v + 2]
    for c in range(3):
        nodes[v + c] += factor * along[c]
    if reaction is not None:
        after, mass = (nodes[v], nodes[v + 1], nodes[v + 2]), nodes[v + 3]
        speed = _speed(pushed, solids, source, node, nodes)
        if source < pushed.of_block:
            number = (
                solids.collider_number[pushed.row, node] if len(solids.collider_number) > 0 else 0
            )
            set_collider(reaction, number, pushed.normal)
            add_contact_reaction(reaction, before, after, mass, speed, 0, 0)
        else:
            row = solids.motions.row[pushed.phase_of[source]]
            add_prescribed_reaction(reaction, row, before, after, mass, speed, 0, 0)

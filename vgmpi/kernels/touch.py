"""Contact at the 64 nodes of a block: which pairs of phases touch where, and what keeps them apart.

The rule for one pair and the impulses of all pairs of a node are in contact.py.
"""

from typing import NamedTuple

import numpy as np

from ..couplings.base import CONTACT
from ..device.jit import inline
from ..device.limits import TOUCHING
from .contact import distance, resolve, surface_normal, touching
from .walls import SEPARATE, tangential


class Room(NamedTuple):
    """Scratch of one thread for the contact of n phases, a collider and walls at one node; m
    pairs."""

    v: np.ndarray  # (n, 3) velocities
    mass: np.ndarray  # (n,)
    here: np.ndarray  # (n,) node block of each phase that is there
    normals: np.ndarray  # (m, 7) normal, and scratch of `resolve`
    impulse: np.ndarray  # (m, 4)
    friction: np.ndarray  # (m,)
    master: np.ndarray  # (m,)
    other: np.ndarray  # (m,)
    touches: np.ndarray  # (n,) pairs that touch each phase


def room(n: int) -> Room:
    """Scratch for n phases."""
    m = n * (n + 1) // 2 + 3 * n
    return Room(
        v=np.zeros((n, 3)), mass=np.zeros(n), here=np.zeros(n, np.int64),
        normals=np.zeros((m, 7)), impulse=np.zeros((m, 4)), friction=np.zeros(m),
        master=np.zeros(m, np.int64), other=np.zeros(m, np.int64), touches=np.zeros(n, np.int64),
    )  # fmt: skip


@inline
def touch(here, tables, solid, velocities, offsets, solids, walls, phases, rules, dx, room):
    """Contact in a block. here: couple.Here; solid: the collider's row in solids, or -1; velocities
    with masses, and offsets: (node blocks, 256)."""
    pushes = here.at_wall and _may_push(walls)
    for node in range(64):
        active = _active(here, node, velocities, tables.phase, phases.least, room.here)
        i, j, k = here.low_x + node // 16, here.low_y + node // 4 % 4, here.low_z + node % 4
        planes = _planes(i, j, k, walls) if pushes else 0
        if active == 0 or active + (solid >= 0) + planes < 2:
            continue
        for q in range(active):
            nb = room.here[q]
            tangential(offsets[nb, 4 * node :], i, j, k, walls.cells, walls.kinds)
            for c in range(3):
                room.v[q, c] = velocities[nb, 4 * node + c]
            room.mass[q] = velocities[nb, 4 * node + 3]
        alone = active + (solid >= 0) + planes == 2
        pairs = _pairs(
            active, node, tables.phase, offsets, solid, solids, phases, rules, dx, alone, room
        )
        if planes:
            at = i, j, k
            pairs = _on_walls(
                pairs, active, node, tables.phase, offsets, at, walls, phases, dx, alone, room
            )
        if pairs == 0:
            continue
        share = room.touches[:active].max()
        resolve(
            room.v, room.mass, active, room.normals, room.friction, room.master, room.other, pairs,
            share, room.impulse,
        )  # fmt: skip
        for q in range(active):
            for c in range(3):
                velocities[room.here[q], 4 * node + c] = room.v[q, c]


@inline
def _active(here, node, velocities, phase, least, found):
    """The node blocks whose phases are at a node, into found; returns how many. Lighter ones know
    too few digits of where their particles are."""
    active = 0
    for nb in range(here.n0, here.n1):
        if velocities[nb, 4 * node + 3] > TOUCHING * least[phase[nb]]:
            found[active] = nb
            active += 1
    return active


@inline
def _pairs(active, node, phase, offsets, solid, solids, phases, rules, dx, alone, room):
    """The touching pairs of a node, in phase order: masters, normals and friction. Returns how
    many. A pair that is `alone` at its node and parts is left out: nothing acts on it.
    """
    pairs = 0
    room.touches[:active] = 0
    for q in range(active):
        ph, mine = phase[room.here[q]], offsets[room.here[q], 4 * node :]
        known = phases.surface[ph]
        if solid >= 0 and _there(mine, known):
            surface = solids[solid, node]
            far = surface[3] / dx
            if _on_rigid(alone, room.v[q], surface, far, mine, room.mass[q], known, dx):
                friction = phases.friction[len(phases.mastery), ph]
                _note(room, pairs, -1, q, surface, friction)
                pairs += 1
        for r in range(q + 1, active):
            other = phase[room.here[r]]
            if rules is not None:
                if rules.pair[ph, other] != CONTACT:
                    continue
            a, b = (q, r) if phases.mastery[ph] < phases.mastery[other] else (r, q)
            if _on_each_other(alone, a, b, node, phase, offsets, phases, dx, room, pairs):
                _note(room, pairs, a, b, room.normals[pairs], phases.friction[ph, other])
                room.touches[a] += 1
                pairs += 1
    return pairs


@inline
def _note(room, k, master, other, normal, friction):
    """Write down pair k."""
    for c in range(3):
        room.normals[k, c] = normal[c]
    room.master[k], room.other[k], room.friction[k] = master, other, friction
    room.touches[other] += 1


@inline
def _there(side, known):
    """Whether a phase has any surface at a node. side: (4,) of the layer of offsets."""
    if known:
        return side[0] != 0.0 or side[1] != 0.0 or side[2] != 0.0
    return side[3] > 0.0


@inline
def _on_rigid(alone, v, normal, far, mine, mass, known, dx):
    """Whether a phase touches what does not move, whose normal is given and its distance `far`
    [cells] from the node."""
    parts = v[0] * normal[0] + v[1] * normal[1] + v[2] * normal[2] >= 0
    if alone and parts:
        return False
    return touching(far, distance(normal, -1.0, mine, mass, known, dx), known)


@inline
def _on_each_other(alone, a, b, node, phase, offsets, phases, dx, room, k):
    """Whether two phases touch; the first one's normal out into room.normals[k]."""
    xa, xb = offsets[room.here[a], 4 * node :], offsets[room.here[b], 4 * node :]
    known_a, known_b = phases.surface[phase[room.here[a]]], phases.surface[phase[room.here[b]]]
    if not (_there(xa, known_a) and _there(xb, known_b)):
        return False
    ma, mb, n = room.mass[a], room.mass[b], room.normals[k]
    if not surface_normal(n, xa, xb, ma, mb, known_a, known_b, dx):
        return False
    nearing = 0.0
    for c in range(3):
        nearing += (room.v[a, c] - room.v[b, c]) * n[c]
    if alone and nearing <= 0:
        return False
    one, other = distance(n, 1.0, xa, ma, known_a, dx), distance(n, -1.0, xb, mb, known_b, dx)
    return touching(one, other, known_a and known_b)


@inline
def _may_push(walls):
    """Whether any wall lets go of what touches it."""
    for a in range(3):
        for side in range(2):
            if walls.kinds[a, side] == SEPARATE:
                return True
    return False


@inline
def _plane(walls, a, side, node):
    """Whether a node, by its number along axis a, lies on a wall that only pushes."""
    return walls.kinds[a, side] == SEPARATE and node == side * walls.cells[a]


@inline
def _planes(i, j, k, walls):
    """On how many walls that only push a node lies."""
    count = 0
    for side in range(2):
        count += _plane(walls, 0, side, i) + _plane(walls, 1, side, j) + _plane(walls, 2, side, k)
    return count


@inline
def _on_walls(pairs, active, node, phase, offsets, at, walls, phases, dx, alone, room):
    """Add the pairs of walls and the surfaces that touch them."""
    for a in range(3):
        for side in range(2):
            if not _plane(walls, a, side, at[a]):
                continue
            for q in range(active):
                known = phases.surface[phase[room.here[q]]]
                mine, normal = offsets[room.here[q], 4 * node :], room.normals[pairs]
                if not (known and _there(mine, known)):
                    continue
                normal[0] = normal[1] = normal[2] = 0.0
                normal[a] = 1.0 - 2.0 * side
                if _on_rigid(alone, room.v[q], normal, 0.0, mine, room.mass[q], known, dx):
                    _note(room, pairs, -1, q, normal, walls.friction[a, side])
                    pairs += 1
    return pairs

"""Contact at the 64 nodes of a block: which pairs of phases touch where, and what keeps them apart.

The rule for one pair and the impulses of all pairs of a node are in contact.py.
"""

from typing import NamedTuple

import numpy as np

from ..couplings.base import CONTACT
from ..device.jit import inline
from ..device.limits import TOUCHING
from .contact import TOUCH, collider_gap, gap, resolve, surface_normal
from .walls import tangential


class Room(NamedTuple):
    """Scratch of one thread for the contact of n phases and a collider at one node; m pairs."""

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
    m = n * (n + 1) // 2
    return Room(
        v=np.zeros((n, 3)), mass=np.zeros(n), here=np.zeros(n, np.int64),
        normals=np.zeros((m, 7)), impulse=np.zeros((m, 4)), friction=np.zeros(m),
        master=np.zeros(m, np.int64), other=np.zeros(m, np.int64), touches=np.zeros(n, np.int64),
    )  # fmt: skip


@inline
def touch(here, tables, solid, velocities, offsets, solids, walls, phases, rules, dx, room):
    """Contact in a block. here: couple.Here; solid: the collider's row in solids, or -1; velocities
    with masses, and offsets: (node blocks, 256)."""
    for node in range(64):
        active = _active(here, node, velocities, tables.phase, phases.least, room.here)
        if active == 0 or (active == 1 and solid < 0):
            continue
        i, j, k = here.low_x + node // 16, here.low_y + node // 4 % 4, here.low_z + node % 4
        for q in range(active):
            nb = room.here[q]
            tangential(offsets[nb, 4 * node :], i, j, k, walls.cells, walls.kinds)
            for c in range(3):
                room.v[q, c] = velocities[nb, 4 * node + c]
            room.mass[q] = velocities[nb, 4 * node + 3]
        pairs = _pairs(active, node, tables.phase, offsets, solid, solids, phases, rules, dx, room)
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
def _pairs(active, node, phase, offsets, solid, solids, phases, rules, dx, room):
    """The touching pairs of a node, in phase order: masters, normals and friction. Returns how
    many. A pair that is alone at its node and parts is left out: nothing acts on it.
    """
    alone = active + (solid >= 0) == 2
    pairs = 0
    room.touches[:active] = 0
    for q in range(active):
        ph, mine = phase[room.here[q]], offsets[room.here[q], 4 * node :]
        if solid >= 0 and mine[3] > 0:
            surface = solids[solid, node]
            if _on_collider(alone, room.v[q], surface, mine, dx):
                for c in range(3):
                    room.normals[pairs, c] = surface[c]
                friction = phases.friction[len(phases.mastery), ph]
                room.master[pairs], room.other[pairs], room.friction[pairs] = -1, q, friction
                room.touches[q] += 1
                pairs += 1
        for r in range(q + 1, active):
            other = phase[room.here[r]]
            if rules is not None:
                if rules.pair[ph, other] != CONTACT:
                    continue
            a, b = (q, r) if phases.mastery[ph] < phases.mastery[other] else (r, q)
            xa, xb = offsets[room.here[a], 4 * node :], offsets[room.here[b], 4 * node :]
            if _on_each_other(alone, room.v[a], room.v[b], xa, xb, room.normals[pairs], dx):
                friction = phases.friction[ph, other]
                room.master[pairs], room.other[pairs], room.friction[pairs] = a, b, friction
                room.touches[a] += 1
                room.touches[b] += 1
                pairs += 1
    return pairs


@inline
def _on_collider(alone, v, surface, mine, dx):
    """Whether a phase touches the collider, whose normal and distance are `surface`."""
    parts = v[0] * surface[0] + v[1] * surface[1] + v[2] * surface[2] >= 0
    if alone and parts:
        return False
    return collider_gap(surface, surface[3], mine, dx) <= TOUCH


@inline
def _on_each_other(alone, va, vb, xa, xb, n, dx):
    """Whether two phases touch; n (7,): the first one's normal out."""
    if not (xa[3] > 0 and xb[3] > 0):
        return False
    if not surface_normal(n, xa, xb, dx):
        return False
    nearing = 0.0
    for c in range(3):
        nearing += (va[c] - vb[c]) * n[c]
    if alone and nearing <= 0:
        return False
    return gap(n, xa, xb, dx) <= TOUCH

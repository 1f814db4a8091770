"""Contact at the 64 nodes of a block: which pairs of phases touch where, and what keeps them apart.

The rule for one pair and the impulses of all pairs of a node are in contact.py.
"""

from typing import NamedTuple

import numpy as np

from ..couplings.base import CONTACT
from ..device.jit import inline
from ..device.limits import TOUCHING
from ..domain.driven import HEAVY
from ..domain.solids import REACH
from ..lanes.team import each, meet
from .contact import (
    GOES,
    RESTS,
    Meeting,
    distance,
    press,
    resolve,
    share_of,
    sure,
    surface_normal,
    touching,
)
from .given import Given, at_node, by_collider, by_wall, drove, pressed, resolved
from .walls import tangential


class Room(NamedTuple):
    """Scratch of one thread for the contact of n phases, a collider and walls at one node; m
    pairs."""

    v: np.ndarray  # (n + 2, 3) velocities, the last two of the collider and of walls
    mass: np.ndarray  # (n,)
    heavy: np.ndarray  # (n,) the same, beyond all measure of what is driven
    here: np.ndarray  # (n,) node block of each phase that is there
    slope: np.ndarray  # (n, 3) of the velocity per cell along a known surface's normal
    change: np.ndarray  # (n, 3) of the velocities, by elastic layers
    normals: np.ndarray  # (m, 7) normal, and scratch of `resolve`
    impulse: np.ndarray  # (m, 4)
    friction: np.ndarray  # (m,)
    master: np.ndarray  # (m,)
    other: np.ndarray  # (m,)
    touches: np.ndarray  # (n,) pairs that touch each phase
    plane: np.ndarray  # (4,) a wall's normal, and 0
    row: np.ndarray  # (n,) its friction
    given: Given | None = None  # what rigid things give, where somebody asks for it


class There(NamedTuple):
    """A node."""

    active: int  # phases
    node: int  # number in its block
    alone: bool  # two meet there, and no third


def room(n: int) -> Room:
    """Scratch for n phases."""
    m = n * (n + 1) // 2 + 3 * n
    return Room(
        v=np.zeros((n + 2, 3)), slope=np.zeros((n, 3)), change=np.zeros((n, 3)), mass=np.zeros(n),
        heavy=np.zeros(n), here=np.zeros(n, np.int64),
        normals=np.zeros((m, 7)), impulse=np.zeros((m, 4)), friction=np.zeros(m),
        master=np.zeros(m, np.int64), other=np.zeros(m, np.int64), touches=np.zeros(n, np.int64),
        plane=np.zeros(4), row=np.zeros(n),
    )  # fmt: skip


@inline
def touch(
    here, tables, solid, velocities, offsets, shear, solids, walls, phases, rules, step, room
):  # fmt: skip
    """Contact in a block. here: couple.Here; solid: its row in solids (grid.Rigid), or -1;
    velocities, offsets: (256 node blocks,); shear: sums.SumsAt, or None."""
    ways, pushes = solids.ways, here.at_wall and _may_push(walls)
    meet()
    for node in each(64):
        active = _active(here, node, velocities, tables.phase, phases.least, room.here)
        at = here.low_x + node // 16, here.low_y + node // 4 % 4, here.low_z + node % 4
        planes = _planes(at, walls) if pushes else 0
        rigid = solid >= 0 and solids.nodes[solid, node, 3] < REACH * step.dx
        if active == 0 or active + rigid + planes < 2:
            continue
        for q in range(active):
            nb = room.here[q]
            of = 256 * nb + 4 * node
            tangential(offsets, of, at[0], at[1], at[2], walls.cells, walls.kinds)
            for c in range(3):
                room.v[q, c] = velocities[of + c]
                room.change[q, c] = 0
            room.mass[q] = room.heavy[q] = velocities[of + 3]
            if _driven(ways, tables.phase[nb]):
                room.heavy[q] *= HEAVY
            if shear is not None:
                for c in range(3):
                    room.slope[q, c] = shear.nodes[of + c] / room.mass[q]
            room.touches[q] = 0
        there = There(active, node, active + rigid + planes == 2)
        at_node(room.given, node, at[0], at[1], at[2])
        pairs = _pairs(there, tables.phase, offsets, phases, rules, ways, step, room)
        if rigid:
            surface = solids.nodes[solid, node]
            number = solids.whose[solid, node] if len(solids.whose) > 0 else 0
            by_collider(room.given, number, surface)
            rows = phases.friction[len(phases.mastery) :]
            row = rows[min(number, len(rows) - 1)]  # of all, or its own
            if len(solids.moves) > 0:
                for c in range(3):
                    room.v[GOES, c] = solids.moves[solid, node, c]
            pairs = _on_rigid(
                pairs, there, tables.phase, offsets, surface, row, GOES, phases, ways, step, room
            )
        if planes:
            pairs = _on_walls(
                pairs, there, tables.phase, offsets, at, walls, phases, ways, step, room
            )
        for q in range(active):
            for c in range(3):
                room.v[q, c] += room.change[q, c]
        if pairs > 0:
            resolve(
                room.v, room.heavy, active, room.normals, room.friction, room.master, room.other,
                pairs, _most(room.touches, active), room.impulse,
            )  # fmt: skip
            resolved(room.given, pairs, room)
        for q in range(active):
            for c in range(3):
                velocities[256 * room.here[q] + 4 * node + c] = room.v[q, c]
    meet()


@inline
def _most(touches, active):
    """Pairs that touch the phase with most."""
    found = touches[0]
    for q in range(1, active):
        found = max(found, touches[q])
    return found


@inline
def _side(offsets, nb, node):
    """What the layer of offsets says of a phase at a node: four numbers."""
    at = 256 * nb + 4 * node
    return offsets[at], offsets[at + 1], offsets[at + 2], offsets[at + 3]


@inline
def _driven(ways, phase):
    """Whether a phase is driven."""
    return len(ways.driven) > 0 and ways.driven[phase]


@inline
def _active(here, node, velocities, phase, least, found):
    """The node blocks whose phases are at a node, into found; returns how many. Lighter ones know
    too few digits of where their particles are."""
    active = 0
    for nb in range(here.n0, here.n1):
        if velocities[256 * nb + 4 * node + 3] > TOUCHING * least[phase[nb]]:
            found[active] = nb
            active += 1
    return active


@inline
def _pairs(there, phase, offsets, phases, rules, ways, step, room):
    """The phases that touch each other, in their order: those that meet by an elastic layer into
    room.change, the others as pairs: masters, normals and friction. Returns how many pairs."""
    pairs = 0
    for q in range(there.active):
        ph = phase[room.here[q]]
        for r in range(q + 1, there.active):
            other = phase[room.here[r]]
            if rules is not None:
                if rules.pair[ph, other] != CONTACT:
                    continue
            if _driven(ways, ph) and _driven(ways, other):
                continue
            a, b = (q, r) if phases.mastery[ph] < phases.mastery[other] else (r, q)
            pairs = _on_each_other(pairs, there, a, b, phase, offsets, phases, ways, step, room)
    return pairs


@inline
def _on_each_other(pairs, there, a, b, phase, offsets, phases, ways, step, room):
    """Take up what two phases do to each other."""
    pa, pb = phase[room.here[a]], phase[room.here[b]]
    xa, xb = _side(offsets, room.here[a], there.node), _side(offsets, room.here[b], there.node)
    ka, kb = phases.surface[pa], phases.surface[pb]
    if not (_has(xa, ka) and _has(xb, kb)):
        return pairs
    ma, mb, n = room.mass[a], room.mass[b], room.normals[pairs]
    if not surface_normal(n, xa, xb, ma, mb, ka, kb, step.dx):
        return pairs
    known = ka and kb
    one = distance(n, 1.0, xa, ma, ka, step.dx)
    other = distance(n, -1.0, xb, mb, kb, step.dx)
    certain, share, stiff = False, 0.0, 0.0
    if known:
        certain = sure(xa, ma) and sure(xb, mb)
    elif ka:
        certain = sure(xa, ma)
    elif kb:
        certain = sure(xb, mb)
    if certain:
        share = min(share_of(ma, phases.least[pa], one), share_of(mb, phases.least[pb], other))
        stiff = phases.stiff[pa] * phases.stiff[pb] / (phases.stiff[pa] + phases.stiff[pb])
    friction = phases.friction[pa, pb]
    meeting = Meeting(a, b, one, other, known, certain, share, stiff, friction)
    by, on = (a, b) if _driven(ways, pa) else (b, a)
    change, was = room.change[on], pairs
    before = change[0], change[1], change[2]
    pairs = _take_up(pairs, there, meeting, n, step, room)
    row = ways.row[phase[room.here[by]]] if len(ways.row) > 0 else -1
    drove(room.given, row, before, change, room.mass[on], room.v[by], was, pairs)
    return pairs


@inline
def _on_rigid(pairs, there, phase, offsets, surface, friction, a, phases, ways, step, room):
    """Take up what something rigid does to phases. surface: (4,) its normal, and its distance [m];
    friction: (phases,); a: GOES, a collider's, or RESTS, a wall's, which meets those alone whose
    surfaces are known."""
    for q in range(there.active):
        ph, mine = phase[room.here[q]], _side(offsets, room.here[q], there.node)
        known, mass, n = phases.surface[ph], room.mass[q], room.normals[pairs]
        if not ((a == GOES or known) and _has(mine, known)):
            continue
        if _driven(ways, ph):
            continue
        for c in range(3):
            n[c] = surface[c]
        other = distance(n, -1.0, mine, mass, known, step.dx)
        certain = known and sure(mine, mass)
        share = share_of(mass, phases.least[ph], other) if certain else 0.0
        far = surface[3] / step.dx
        meeting = Meeting(
            a, q, far, other, known, certain, share, phases.stiff[ph], friction[ph]
        )  # fmt: skip
        change, was = room.change[q], pairs
        before = change[0], change[1], change[2]
        pairs = _take_up(pairs, there, meeting, n, step, room)
        pressed(room.given, before, change, mass, room.v[a], was, pairs)
    return pairs


@inline
def _take_up(pairs, there, meeting, n, step, room):
    """Let a Meeting act, n (3,): what it does at once into room.change, and where nothing may
    approach as one pair more. A pair that is alone at its node and parts is left out: nothing acts
    on it."""
    if meeting.sure:
        press(room.change, room.v, room.slope, room.heavy, meeting, n, step.dt, step.dx)
    if not touching(meeting) or (there.alone and _parts(room.v, meeting, n)):
        return pairs
    room.master[pairs], room.other[pairs] = meeting.a, meeting.b
    room.friction[pairs] = meeting.friction
    room.touches[meeting.b] += 1
    if meeting.a >= 0:
        room.touches[meeting.a] += 1
    return pairs + 1


@inline
def _parts(v, meeting, n):
    """Whether two phases part along n."""
    nearing = 0.0
    for c in range(3):
        nearing -= v[meeting.b, c] * n[c]
        nearing += v[meeting.a, c] * n[c]
    return nearing <= 0.0


@inline
def _has(side, known):
    """Whether a phase has any surface at a node. side: (4,) of the layer of offsets."""
    if known:
        return side[0] != 0.0 or side[1] != 0.0 or side[2] != 0.0
    return side[3] > 0.0


@inline
def _may_push(walls):
    """Whether any wall pushes known surfaces."""
    for a in range(3):
        for side in range(2):
            if walls.met[a, side] == 0:
                return True
    return False


@inline
def _planes(at, walls):
    """On how many walls that push known surfaces a node lies."""
    count = 0
    for a in range(3):
        for side in range(2):
            count += walls.met[a, side] == 0 and at[a] == side * walls.cells[a]
    return count


@inline
def _on_walls(pairs, there, phase, offsets, at, walls, phases, ways, step, room):
    """Take up what walls do that push known surfaces."""
    surface, row = room.plane, room.row
    for a in range(3):
        for side in range(2):
            if walls.met[a, side] != 0 or at[a] != side * walls.cells[a]:
                continue
            surface[0] = surface[1] = surface[2] = 0.0
            surface[a] = 1.0 - 2.0 * side
            by_wall(room.given, a, side)
            for k in range(len(row)):
                row[k] = walls.friction[a, side]
            pairs = _on_rigid(
                pairs, there, phase, offsets, surface, row, RESTS, phases, ways, step, room
            )
    return pairs

"""The grid's part of a step: settle the sums of each node block, turn momentum into velocity,
contact, walls.

A node block is 4^3 nodes of one phase; block b holds base nodes 4 b - 1 .. 4 b + 2 of the domain.
"""

from typing import NamedTuple

import numpy as np

from ..couplings.base import CONTACT
from ..device.jit import inline, kernel
from ..device.limits import ROUNDING
from ..device.select import select
from ..domain.driven import Ways
from ..lanes.lanes import load, place, store
from ..lanes.nodes import fourth_of, velocity, with_fourth
from ..lanes.rows import repeat, spread
from ..lanes.team import each, flat, meet
from .couple import Fields, Here, couple_block, note_flux
from .driven import prescribe
from .given import at_block
from .members import places
from .sums import blocks_at, sums_at, take_up
from .tables import Sums
from .touch import touch
from .walls import constrain, tangential

TOUCHES = True  # whether anything may touch in a scene: a program for a card knows


class Rigid(NamedTuple):
    """What nothing turns aside: colliders, at the nodes of the blocks they are near, and what is
    driven."""

    nodes: np.ndarray  # (n, 64, 4) outward normal and distance [m] of the nearest
    moves: np.ndarray  # (n, 64, 3) its velocity [m/s]; (0, 64, 3) where all are at rest
    whose: np.ndarray  # (n, 64) number of it; (0, 64) where all have the same friction
    ways: Ways  # of no phases where nothing is driven


class Summed(NamedTuple):
    """What every scene has."""

    momentum: Sums
    offsets: Sums


class Apart(NamedTuple):
    """Where the stress's impulses are kept apart from momentum."""

    impulses: Sums  # [kg m/s], and volumes [m3]
    # (node blocks, 256) what particles gather besides velocity; any array where there is none
    flux: np.ndarray  # of volume [m/s]
    drift: np.ndarray  # [m/s]
    change: np.ndarray  # of velocity [m/s]
    noted: int  # whether the change is asked for (FLIP)
    room: tuple  # members.Room of the calling thread
    tables: tuple  # members.Tables


@kernel
def update(blocks, tables, summed, shear, apart, rules, walls, phases, solids, room, step, report):
    """Velocities [m/s] at the nodes of some blocks, in place of momentum.

    blocks: (n,) the blocks to do; tables: NodeBlocks; summed: Summed; shear: Sums, or None; apart:
    an Apart, or None; rules: how phases share space (couple.Rules), or None; walls, phases, step:
    see kernels/tables.py; solids: Rigid; room:
    touch.Room of the calling thread; report: (layers,) see sums.take_up: momentum, offsets,
    impulses, shear.
    """
    momentum, offsets = summed.momentum, summed.offsets
    rows, moved, spaced = blocks_at(tables), sums_at(momentum), sums_at(offsets)
    nodes, last, least_of = moved.nodes, place(walls.cells), place(phases.least)
    sheared = None if shear is None else sums_at(shear)
    if apart is not None:
        pushed = sums_at(apart.impulses)
        fields = _fields(rows, least_of, last, nodes, pushed.nodes, spaced.nodes, apart)
        if rules is not None:
            of, pairs = places(apart.room, apart.tables)
    first, phase_of = place(tables.first), rows.phase
    push = repeat(step.fall, 0)
    for b in blocks:
        n0, n1, kept_apart = first[b], first[b + 1], False
        at_block(room.given, b)
        for nb in range(n0, n1):
            take_up(nb, rows, moved, report, 0)
            take_up(nb, rows, spaced, report, 1)
            if apart is not None:
                take_up(nb, rows, pushed, report, 2)
                kept_apart |= pushed.asked[nb] != 0
            if shear is not None:
                take_up(nb, rows, sheared, report, 2 if apart is None else 3)
            fall(nb, nodes, push, ROUNDING * least_of[phase_of[nb]])
        here = _here(b, n0, n1, tables, last)
        prescribe(here, nodes, phase_of, solids.ways, step.dx)
        if apart is not None:
            noted = kept_apart and apart.noted
            if noted:
                _note_before(here, fields, push)
            if kept_apart and rules is None:
                _push(here, fields)
            if rules is not None:
                if noted:
                    _push_others(here, fields, pairs)
                if kept_apart:
                    if here.at_wall and here.meets:
                        _along_walls(spaced.nodes, here, walls)
                    couple_block(here, fields, of, pairs, step.dt, step.dx)
        rigid = tables.solid[b] >= 0 or here.at_wall
        if TOUCHES and here.meets and _may_touch(n0, n1, phase_of, rigid, rules):
            touch(here, tables, tables.solid[b], nodes, spaced.nodes, sheared, solids, walls,
                  phases, rules, step, room)  # fmt: skip
        if here.at_wall:
            _stop_at_walls(here, nodes, walls, phase_of, phases, solids, room.given)
        if apart is not None:
            if rules is not None:
                if kept_apart:
                    note_flux(here, fields, of, pairs, step.dx)
            if noted:
                _note_change(here, fields)


@inline
def _fields(rows, least, cells, grid, forces, offsets, apart):
    """What coupling needs of nodes. rows: sums.BlocksAt; arrays by their places."""
    return Fields(
        rows.phase, least, cells, grid, forces, offsets,
        flat(apart.flux), flat(apart.drift), flat(apart.change),
    )  # fmt: skip


@inline
def _stop_at_walls(here, velocities, walls, phase, phases, solids, given):
    """What the walls leave of the velocities (256 node blocks,) of a block. phase: (node blocks,);
    solids: Rigid; given: given.Given, or None."""
    low = here.low_x, here.low_y, here.low_z
    meet()
    for nb in range(here.n0, here.n1):
        if len(solids.ways.driven) > 0 and solids.ways.driven[phase[nb]]:
            continue  # it goes where it is sent
        kinds = walls.met if phases.surface[phase[nb]] else walls.kinds
        constrain(velocities, 256 * nb, low, walls.cells, kinds, walls.friction, given)


@inline
def _may_touch(n0, n1, phase, rigid, rules):
    """Whether contact acts between any two phases of a block, or one and what does not move."""
    if rules is None or rigid:
        return True
    if rules is not None:
        for a in range(n0, n1):
            for b in range(n0, a):
                if rules.pair[phase[a], phase[b]] == CONTACT:
                    return True
    return False


@inline
def fall(nb, nodes, push, tiny):
    """Momentum to velocity after `push`, at the nodes of a node block that are not lighter than
    tiny."""
    for c in range(256 * nb, 256 * (nb + 1), 16):
        store(nodes, c, velocity(load(nodes, c), push, spread(nodes, tiny)))


@inline
def _note_change(here, fields):
    """The change of velocity since `_note_before`."""
    for c in range(256 * here.n0, 256 * here.n1, 16):
        store(fields.change, c, load(fields.grid, c) - load(fields.change, c))


@inline
def _note_before(here, fields, push):
    """The velocities of a block before gravity's `push` and impulses that were kept apart."""
    for c in range(256 * here.n0, 256 * here.n1, 16):
        store(fields.change, c, load(fields.grid, c) - push)


@inline
def _push(here, fields):
    """Add impulses that were kept apart to the velocities of a block."""
    for nb in range(here.n0, here.n1):
        _push_one(nb, fields)


@inline
def _push_one(nb, fields):
    tiny = spread(fields.grid, ROUNDING * fields.least[fields.phase[nb]])
    for c in range(256 * nb, 256 * (nb + 1), 16):
        row = load(fields.grid, c)
        m = fourth_of(row)
        change = select(m > tiny, load(fields.forces, c) / m, 0.0)
        store(fields.grid, c, with_fourth(row + change, row))


@inline
def _push_others(here, fields, rules):
    """As `_push`, of all phases of a block but the fluids that share space, whose pressure acts on
    others too (couple.py). rules: members.Tables by places."""
    for nb in range(here.n0, here.n1):
        p = fields.phase[nb]
        if rules.together[p] < 0 or rules.fluid[p] == 0:
            _push_one(nb, fields)
            for c in range(256 * nb, 256 * (nb + 1), 16):  # no more of it is to act
                row = load(fields.forces, c)
                store(fields.forces, c, with_fourth(0.0 * row, row))


@inline
def _along_walls(offsets, here, walls):
    """Drop the part across walls of a block's offsets (256 node blocks,)."""
    for nb in range(here.n0, here.n1):
        for node in each(64):
            i, j, k = here.low_x + node // 16, here.low_y + node // 4 % 4, here.low_z + node % 4
            tangential(offsets, 256 * nb + 4 * node, i, j, k, walls.cells, walls.kinds)
    meet()


@inline
def _here(b, n0, n1, tables, last):
    """What block b is; last: cells of the domain."""
    low = 4 * tables.at[b, 0] - 1, 4 * tables.at[b, 1] - 1, 4 * tables.at[b, 2] - 1
    return Here(n0, n1, tables.meets[b], _at_wall(low, last), low[0], low[1], low[2])


@inline
def _at_wall(low, cells):
    """Whether a block whose first node is `low` holds a node on or beyond a wall."""
    for a in range(3):
        if low[a] <= 0 or low[a] + 3 >= cells[a]:
            return True
    return False

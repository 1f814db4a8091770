"""The grid's part of a step: sum the patches of each node block, turn momentum into velocity,
contact, walls.

A node block is 4^3 nodes of one phase; block b holds base nodes 4 b - 1 .. 4 b + 2 of the domain.
Its sum runs over the patches that touch it in the order of their keys, whoever owns them: that
order, and not the ranks, decides the bits.
"""

from typing import NamedTuple

import numpy as np

from ..couplings.base import CONTACT
from ..device.jit import inline, kernel
from ..device.select import select
from ..lanes.lanes import load, place, store
from ..lanes.nodes import fourth_of, velocity, with_fourth
from ..lanes.rows import repeat, spread
from .contact import TOUCH, collider_gap, gap, resolve, surface_normal
from .couple import couple_block, note_flux
from .members import places
from .patches import pull
from .walls import constrain, tangential


class Apart(NamedTuple):
    """Where the stress's impulses are kept apart from momentum."""

    slots: np.ndarray  # (patches,) where each patch of impulses is kept, or -1
    patches: np.ndarray  # (slots, 2048) impulses [kg m/s]
    forces: np.ndarray  # (node blocks, 256) their sums
    forced: np.ndarray  # (node blocks,) whether any patch of impulses touches it
    flux: np.ndarray  # (node blocks, 64, 4) what particles gather besides velocity
    drift: np.ndarray  # (node blocks, 64, 4) drifts [m/s]; any array where there are none
    room: tuple  # members.Room of the calling thread
    tables: tuple  # members.Tables


@kernel
def update(
    blocks, first, phase, block_at, meets, solid_of, summed, pull_first, pull_patch, pull_code,
    slots, patches, offset_slots, offset_patches, offsets, apart, rules, grid, solids, room, cells,
    wall_kinds, wall_friction, gravity, least, rank_of, friction, dt, dx,
):  # fmt: skip
    """Velocities [m/s] at the nodes of some blocks, in place of momentum.

    blocks: (n,) the blocks to do; first: (blocks + 1,) node blocks of each block, one per phase
    that touches it; phase: (node blocks,); meets: (blocks,) whether two phases, or a phase and a
    collider, may touch here; solid_of: (blocks,) row of `solids` or -1; solids: (n, 64, 4) outward
    normal and distance [m] of the collider; patches, offset_patches: (slots, 2048); offsets: (node
    blocks, 64, 4) sums of the latter; apart: an Apart, or None; rules: how phases share space
    (couple.Rules), or None; with apart and no rules the change of velocity is noted, which FLIP
    asks for; least: (phases,) mass [kg] of one full cell; rank_of: (phases,) order of mastery,
    lowest first; friction: (phases + 1, phases), the last row for the collider.
    """
    patch_of, code_of = place(pull_patch), place(pull_code)
    slot_of, sources, nodes = place(slots), place(patches), place(grid)
    offset_slot_of, offset_sources, offset_nodes = (
        place(offset_slots), place(offset_patches), place(offsets)
    )  # fmt: skip
    last, phase_of, least_of = place(cells), place(phase), place(least)
    if apart is not None:
        forces, flux = place(apart.forces), place(apart.flux)
        force_slot_of, force_sources = place(apart.slots), place(apart.patches)
        if rules is not None:
            of, tables = places(apart.room, apart.tables)
    fall = room[0]
    for a in range(3):
        fall[a] = dt * gravity[a]
    for b in blocks:
        n0, n1 = first[b], first[b + 1]
        for nb in range(n0, n1):
            q0, q1 = pull_first[nb], pull_first[nb + 1]
            if not summed[nb]:
                pull(nodes, nb, q0, q1, patch_of, code_of, slot_of, sources)
                if meets[b]:
                    pull(
                        offset_nodes, nb, q0, q1, patch_of, code_of, offset_slot_of, offset_sources
                    )
            # a node lighter than this holds rounding alone
            tiny, push = spread(nodes, 1e-20 * least[phase[nb]]), repeat(fall, 0)
            for c in range(256 * nb, 256 * (nb + 1), 16):
                store(nodes, c, velocity(load(nodes, c), push, tiny))
        low = 4 * block_at[b, 0] - 1, 4 * block_at[b, 1] - 1, 4 * block_at[b, 2] - 1
        at_wall = _at_wall(low, last)
        kept_apart = False
        if apart is not None:
            kept_apart = apart.forced[n0:n1].any()
            for nb in range(n0, n1):
                if apart.forced[nb] and not summed[nb]:
                    q0, q1 = pull_first[nb], pull_first[nb + 1]
                    pull(forces, nb, q0, q1, patch_of, code_of, force_slot_of, force_sources)
            if kept_apart and rules is None:
                _push(n0, n1, nodes, forces, flux, phase_of, least_of, fall)
            if rules is not None:
                if kept_apart:
                    if at_wall and meets[b]:
                        _along_walls(offsets[n0:n1], low, cells, wall_kinds)
                    couple_block(
                        n0, n1, phase_of, nodes, forces, offset_nodes, meets[b], at_wall, low, last,
                        least_of, of, tables, dt, dx, place(apart.drift),
                    )  # fmt: skip
        if meets[b] and _may_touch(n0, n1, phase, solid_of[b], rules):
            solid = solids[max(solid_of[b], 0)]
            _touch(
                grid[n0:n1], phase[n0:n1], offsets[n0:n1], solid, solid_of[b] >= 0, low, cells,
                wall_kinds, least, rank_of, friction, rules, dx, room,
            )  # fmt: skip
        if at_wall:
            for nb in range(n0, n1):
                constrain(grid[nb], low, cells, wall_kinds, wall_friction)
        if apart is not None:
            if kept_apart and rules is None:
                for c in range(256 * n0, 256 * n1, 16):
                    store(flux, c, load(nodes, c) - load(flux, c))
            if rules is not None:
                if kept_apart:
                    note_flux(
                        n0, n1, phase_of, nodes, forces, at_wall, low, last, least_of, of, tables,
                        dx, flux, place(apart.drift),
                    )  # fmt: skip


@inline
def _may_touch(n0, n1, phase, solid, rules):
    """Whether contact acts between any two phases of a block, or one and the collider."""
    if rules is None or solid >= 0:
        return True
    if rules is not None:
        for a in range(n0, n1):
            for b in range(n0, a):
                if rules.pair[phase[a], phase[b]] == CONTACT:
                    return True
    return False


@inline
def _push(n0, n1, nodes, forces, flux, phase, least, fall):
    """Add impulses that were kept apart to the velocities of a block, and note in flux those
    before gravity and these, of which FLIP asks for the change. All arrays by their places."""
    push = repeat(fall, 0)
    for nb in range(n0, n1):
        tiny = 1e-20 * least[phase[nb]]
        for c in range(256 * nb, 256 * (nb + 1), 16):
            row = load(nodes, c)
            m = fourth_of(row)
            store(flux, c, row - push)
            change = select(m > tiny, load(forces, c) / m, 0.0)
            store(nodes, c, with_fourth(row + change, row))


@inline
def _along_walls(offsets, low, cells, wall_kinds):
    """Drop the part across walls of a block's offsets (phases here, 64, 4)."""
    for q in range(len(offsets)):
        for node in range(64):
            i, j, k = low[0] + node // 16, low[1] + node // 4 % 4, low[2] + node % 4
            tangential(offsets[q, node], i, j, k, cells, wall_kinds)


@inline
def _at_wall(low, cells):
    """Whether a block whose first node is `low` holds a node on or beyond a wall."""
    for a in range(3):
        if low[a] <= 0 or low[a] + 3 >= cells[a]:
            return True
    return False


def room(count: int, real: np.dtype) -> tuple[np.ndarray, ...]:
    """Scratch of one thread: a row for gravity, and what the contact of up to `count` phases and a
    collider at one node takes."""
    most = count * (count + 1) // 2
    return (
        np.zeros(4, real),
        np.zeros((count, 3)),  # velocities
        np.zeros(count),  # masses
        np.zeros(count, np.int64),  # which phases are there
        np.zeros((most, 7)),  # per pair: normal, and scratch of `resolve`
        np.zeros((most, 4)),
        np.zeros(most),  # friction
        np.zeros(most, np.int64),  # master
        np.zeros(most, np.int64),  # other
        np.zeros(count, np.int64),  # pairs that touch each phase
    )


@inline
def _touch(
    grid, phase, offsets, solid, has_solid, low, cells, wall_kinds, least, rank_of, friction, rules,
    dx, room,
):  # fmt: skip
    """Contact at the 64 nodes of a block. grid and offsets: (phases here, 64, 4)."""
    _, v, m, here, normals, impulse, mu, pair_a, pair_b, touches = room
    for node in range(64):
        active = 0
        for nb in range(len(grid)):
            if grid[nb, node, 3] > 1e-9 * least[phase[nb]]:
                here[active] = nb
                active += 1
        if active == 0 or (active == 1 and not has_solid):
            continue
        i, j, k = low[0] + node // 16, low[1] + node // 4 % 4, low[2] + node % 4
        for q in range(active):
            tangential(offsets[here[q], node], i, j, k, cells, wall_kinds)
            for c in range(3):
                v[q, c] = grid[here[q], node, c]
            m[q] = grid[here[q], node, 3]
        pairs = _pairs(
            active, here, node, phase, v, offsets, solid, has_solid, rank_of, friction, rules, dx,
            normals, mu, pair_a, pair_b, touches,
        )  # fmt: skip
        if pairs == 0:
            continue
        share = touches[:active].max()
        resolve(v, m, active, normals, mu, pair_a, pair_b, pairs, share, impulse)
        for q in range(active):
            for c in range(3):
                grid[here[q], node, c] = v[q, c]


@inline
def _pairs(
    active, here, node, phase, v, offsets, solid, has_solid, rank_of, friction, rules, dx, normals,
    mu, pair_a, pair_b, touches,
):  # fmt: skip
    """The touching pairs of a node, in phase order: masters, normals and friction. Returns how
    many. A pair that is alone at its node and parts is left out: nothing acts on it.
    """
    alone = active + has_solid == 2
    pairs = 0
    touches[:active] = 0
    for q in range(active):
        mine, ph = offsets[here[q], node], phase[here[q]]
        if has_solid and mine[3] > 0:
            n = solid[node]
            if alone and v[q, 0] * n[0] + v[q, 1] * n[1] + v[q, 2] * n[2] >= 0:
                continue
            if collider_gap(solid[node], solid[node, 3], mine, dx) <= TOUCH:
                for c in range(3):
                    normals[pairs, c] = solid[node, c]
                pair_a[pairs], pair_b[pairs], mu[pairs] = -1, q, friction[len(rank_of), ph]
                touches[q] += 1
                pairs += 1
        for r in range(q + 1, active):
            other = phase[here[r]]
            if rules is not None:
                if rules.pair[ph, other] != CONTACT:
                    continue
            a, b = (q, r) if rank_of[ph] < rank_of[other] else (r, q)
            xa, xb = offsets[here[a], node], offsets[here[b], node]
            if not (xa[3] > 0 and xb[3] > 0):
                continue
            n = normals[pairs]
            if not surface_normal(n, xa, xb, dx):
                continue
            nearing = 0.0
            for c in range(3):
                nearing += (v[a, c] - v[b, c]) * n[c]
            if alone and nearing <= 0:
                continue
            if gap(n, xa, xb, dx) <= TOUCH:
                pair_a[pairs], pair_b[pairs], mu[pairs] = a, b, friction[ph, other]
                touches[a] += 1
                touches[b] += 1
                pairs += 1
    return pairs

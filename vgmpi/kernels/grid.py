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
from .contact import TOUCH, collider_gap, gap, resolve, surface_normal
from .couple import couple_block, note_flux
from .lanes import load, store
from .nodes import fourth_of, velocity, with_fourth
from .patches import pull
from .rows import repeat, spread
from .walls import constrain, tangential


class Apart(NamedTuple):
    """Where the stress's impulses are kept apart from momentum."""

    slots: np.ndarray  # (patches,) where each patch of impulses is kept, or -1
    patches: np.ndarray  # (slots, 2048) impulses [kg m/s]
    forces: np.ndarray  # (node blocks, 256) their sums
    forced: np.ndarray  # (node blocks,) whether any patch of impulses touches it
    flux: np.ndarray  # (node blocks, 64, 4) what particles gather besides velocity
    room: tuple  # couple.Room of the calling thread


@kernel
def update(
    blocks, first, phase, block_at, meets, solid_of, summed, pull_first, pull_patch, pull_code,
    slots, patches, offset_slots, offsets, apart, rules, grid, solids, scratch, room, cells,
    wall_kinds, wall_friction, gravity, least, rank_of, friction, dt, dx,
):  # fmt: skip
    """Velocities [m/s] at the nodes of some blocks, in place of momentum.

    blocks: (n,) the blocks to do; first: (blocks + 1,) node blocks of each block, one per phase
    that touches it; phase: (node blocks,); meets: (blocks,) whether two phases, or a phase and a
    collider, may touch here; solid_of: (blocks,) row of `solids` or -1; solids: (n, 64, 4) outward
    normal and distance [m] of the collider; patches, offsets: (slots, 2048); apart: an Apart, or
    None; rules: how phases share space (couple.Rules), or None; with apart and no rules the change
    of velocity is noted, which FLIP asks for; scratch: (phases, 64, 4); least: (phases,) mass [kg]
    of one full cell; rank_of: (phases,) order of mastery, lowest first; friction: (phases + 1,
    phases), the last row for the collider.
    """
    flat_grid = grid.reshape((len(grid), 256))
    flat_scratch = scratch.reshape((len(scratch), 256))
    fall = room[0]
    for a in range(3):
        fall[a] = dt * gravity[a]
    for b in blocks:
        n0, n1 = first[b], first[b + 1]
        for nb in range(n0, n1):
            q0, q1 = pull_first[nb], pull_first[nb + 1]
            nodes = flat_grid[nb]
            if not summed[nb]:
                pull(nodes, q0, q1, pull_patch, pull_code, slots, patches)
            # a node lighter than this holds rounding alone
            tiny, push = spread(nodes, 1e-20 * least[phase[nb]]), repeat(fall, 0)
            for c in range(0, 256, 16):
                store(nodes, c, velocity(load(nodes, c), push, tiny))
            if meets[b]:
                into = flat_scratch[nb - n0]
                pull(into, q0, q1, pull_patch, pull_code, offset_slots, offsets)
        low = 4 * block_at[b, 0] - 1, 4 * block_at[b, 1] - 1, 4 * block_at[b, 2] - 1
        at_wall = _at_wall(low, cells)
        if apart is not None:
            _apart(
                n0, n1, flat_grid, phase, summed, pull_first, pull_patch, pull_code, apart,
                flat_scratch, meets[b], at_wall, low, cells, wall_kinds, least, rules, fall, dt, dx,
            )  # fmt: skip
        if meets[b] and _may_touch(n0, n1, phase, solid_of[b], rules):
            solid = solids[max(solid_of[b], 0)]
            _touch(
                grid[n0:n1], phase[n0:n1], scratch, solid, solid_of[b] >= 0, low, cells, wall_kinds,
                least, rank_of, friction, rules, dx, room,
            )  # fmt: skip
        if at_wall:
            for nb in range(n0, n1):
                constrain(grid[nb], low, cells, wall_kinds, wall_friction)
        if apart is not None:
            _changes(
                n0, n1, flat_grid, phase, apart, at_wall, low, cells, least, rules, dx,
            )  # fmt: skip


@inline
def _may_touch(n0, n1, phase, solid, rules):
    """Whether contact acts between any two phases of a block, or one and the collider."""
    if rules is None or solid >= 0:
        return True
    if rules is not None:
        for a in range(n0, n1):
            for b in range(a):
                if b >= n0 and rules.pair[phase[a], phase[b]] == CONTACT:
                    return True
    return False


@inline
def _apart(
    n0, n1, grid, phase, summed, pull_first, pull_patch, pull_code, apart, offsets, meets, at_wall,
    low, cells, wall_kinds, least, rules, fall, dt, dx,
):  # fmt: skip
    """Add impulses that were kept apart to the velocities of a block: to phases that share space as
    their coupling says; for FLIP note the velocities before."""
    if not apart.forced[n0:n1].any():
        return
    forces = apart.forces
    flux = apart.flux.reshape((len(apart.flux), 256))
    for nb in range(n0, n1):
        if apart.forced[nb] and not summed[nb]:
            pull(
                forces[nb], pull_first[nb], pull_first[nb + 1], pull_patch, pull_code, apart.slots,
                apart.patches,
            )  # fmt: skip
    if rules is None:
        for nb in range(n0, n1):
            tiny, push = spread(grid, 1e-20 * least[phase[nb]]), repeat(fall, 0)
            for c in range(0, 256, 16):
                row = load(grid[nb], c)
                m = fourth_of(row)
                store(flux[nb], c, row - push)
                change = select(m > tiny, load(forces[nb], c) / m, 0.0)
                store(grid[nb], c, with_fourth(row + change, row))
    else:
        couple_block(
            n0, n1, phase, grid.reshape(grid.size), forces.reshape(forces.size),
            offsets.reshape(offsets.size), meets, at_wall, low, cells, wall_kinds, least,
            rules, dt, dx, apart.room,
        )  # fmt: skip


@inline
def _changes(n0, n1, grid, phase, apart, at_wall, low, cells, least, rules, dx):
    """What particles gather besides velocity: the flux of volume, or the change of velocity."""
    if not apart.forced[n0:n1].any():
        return
    flux = apart.flux.reshape((len(apart.flux), 256))
    if rules is None:
        for nb in range(n0, n1):
            for c in range(0, 256, 16):
                store(flux[nb], c, load(grid[nb], c) - load(flux[nb], c))
    else:
        note_flux(
            n0, n1, phase, grid.reshape(grid.size), apart.forces.reshape(apart.forces.size),
            at_wall, low, cells, least, rules, dx, apart.room, flux.reshape(flux.size),
        )  # fmt: skip


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

"""Phases that share space: fluids that mix, sand that fluids flow through; four nodes at a time.

At each node their pressure acts on all of them by their share of the space, fluids drift to where
there is less of them, and their relative motion is slowed implicitly; after contact and walls the
flux of volume is noted, by which fluids change their density. What phases gain from each other sums
to zero. Formulas and sources: docs/theory.md.

A row of four nodes is a vector xyzm xyzm xyzm xyzm. Numbers of a node stand in all its lanes.
"""

from typing import NamedTuple

import numpy as np

from ..device.jit import inline
from ..device.select import select
from .lanes import load, store
from .nodes import fourth_of, squared, with_fourth
from .rows import spread
from .walls import tangential

LEAST_PART = 1e-3  # of a node's fluid volume, below which a drift is not followed
LEAST_PORES = 0.05  # share of space that a fluid keeps where sand is
ROW = 16


class Room(NamedTuple):
    """Scratch of one thread, and what it must know of the members of one set, for up to n phases.

    Kernels take these arrays apart once per block: to fetch one from a tuple costs as much as the
    arithmetic of a row.
    """

    who: np.ndarray  # (3, n) of each member: node block, whether it is a fluid, mixing group
    known: np.ndarray  # (2 + 2 n, n): grains' volume per mass, porosity, drag, whether as printed
    M: np.ndarray  # (16 n,) [kg], a row of four nodes per member
    V: np.ndarray  # (16 n + 16,) [m3], and the space of each node
    U: np.ndarray  # (16 n,) drift [m/s]
    K: np.ndarray  # (16 n n,) exchange [kg]
    S: np.ndarray  # (16 n,) of the elimination
    R: np.ndarray  # (16 n,) of the elimination


def room(n: int, real: np.dtype, aligned) -> Room:
    """Scratch for n phases. aligned: makes an array of a shape and type."""
    M, U, S, R = (aligned((ROW * n,), real) for _ in range(4))
    V, K = aligned((ROW * n + ROW,), real), aligned((ROW * n * n,), real)
    return Room(np.zeros((3, n), np.int64), np.zeros((2 + 2 * n, n)), M, V, U, K, S, R)


@inline
def couple_block(
    n0, n1, phase, grid, forces, offsets, has_offsets, at_wall, low, cells, wall_kinds, least,
    rules, dt, dx, room,
):  # fmt: skip
    """The stress's impulses, and what phases that share space do to each other, at the 64 nodes of
    a block.

    grid: (256 node blocks,) velocity and mass, of which n0 .. n1 are this block's; forces: the same
    of impulses kept apart [kg m/s] and volume [m3]; offsets: (256 phases,) offsets [m4] and volume
    of the phases here, where the block has_offsets.
    """
    who, known, M, V, U, K, S, R = room
    diffusion, slip, printed = rules.diffusion, rules.slip_time, rules.printed_mix
    if at_wall and has_offsets:
        for nb in range(n0, n1):
            _along_walls(offsets[256 * (nb - n0) : 256 * (nb - n0 + 1)], low, cells, wall_kinds)
    for one in range(rules.sets):
        count = members(one, n0, n1, phase, rules, who, known)
        if count == 1:
            _alone(phase, grid, forces, least, who)
        for c in range(0, 256 if count > 1 else 0, ROW):
            spaces(count, c, at_wall, low, cells, dx, V)
            _weigh(count, c, phase, grid, least, who, M)
            fluid, grains, share = volumes(count, c, forces, who, known, M, V)
            for g in range(rules.mixes):
                if printed[g]:
                    _mix(g, count, c, n0, grid, offsets, has_offsets, who, M, V, U, diffusion[g],
                         0.0, -1.0, dt, dx)  # fmt: skip
            _pressure(count, c, grid, forces, fluid, grains, share, who, M, V)
            for g in range(rules.mixes):
                if not printed[g]:
                    _mix(g, count, c, n0, grid, offsets, has_offsets, who, M, V, U, diffusion[g],
                         1.0 / (1.0 + dt / slip[g]), 1.0, dt, dx)  # fmt: skip
            if rules.drags:
                _drag(count, c, grid, fluid, grains, who, known, M, V, K, dt)
                relax(count, c, grid, who, M, K, S, R)


@inline
def _alone(phase, grid, forces, least, who):
    """The impulses of a phase that no other shares space with in its block."""
    nb = who[0, 0]
    tiny = 1e-20 * least[phase[nb]]
    for c in range(256 * nb, 256 * (nb + 1), ROW):
        row = load(grid, c)
        m = fourth_of(row)
        dv = select(m > tiny, load(forces, c) / m, 0.0)
        store(grid, c, with_fourth(row + dv, row))


@inline
def _along_walls(offsets, low, cells, wall_kinds):
    """Drop the part across walls of a block's offsets (256,)."""
    nodes = offsets.reshape((64, 4))
    for node in range(64):
        i, j, k = low[0] + node // 16, low[1] + node // 4 % 4, low[2] + node % 4
        tangential(nodes[node], i, j, k, cells, wall_kinds)


@inline
def members(one, n0, n1, phase, rules, who, known):
    """The node blocks n0 .. n1 that belong to set `one`, and what to know of them, into who and
    known; returns how many."""
    count = 0
    for nb in range(n0, n1):
        if rules.together[phase[nb]] == one:
            who[0, count], who[1, count] = nb, rules.fluid[phase[nb]]
            who[2, count] = rules.mix[phase[nb]]
            known[0, count], known[1, count] = rules.volume[phase[nb]], rules.porosity[phase[nb]]
            count += 1
    for a in range(count):
        for b in range(count):
            one_, other = phase[who[0, a]], phase[who[0, b]]
            known[2 + 2 * a, b] = rules.drag[one_, other]
            known[3 + 2 * a, b] = rules.printed_drag[one_, other]
    return count


@inline
def spaces(count, c, at_wall, low, cells, dx, V):
    """Volume [m3] of the domain that belongs to the nodes of row c, behind the volumes of the
    members: half of a cell's on a wall."""
    volume, at = dx * dx * dx, ROW * count
    if not at_wall:
        store(V, at, spread(V, volume))
        return
    i, j = low[0] + c // 64, low[1] + c // 16 % 4
    if i == 0 or i == cells[0]:
        volume *= 0.5
    if j == 0 or j == cells[1]:
        volume *= 0.5
    for node in range(4):
        k = low[2] + node
        for a in range(4):
            V[at + 4 * node + a] = 0.5 * volume if k == 0 or k == cells[2] else volume


@inline
def _weigh(count, c, phase, grid, least, who, M):
    """Masses of a row's phases into M; a node lighter than `tiny` holds rounding alone."""
    for q in range(count):
        nb = who[0, q]
        m = fourth_of(load(grid, 256 * nb + c))
        tiny = 1e-20 * least[phase[nb]]
        store(M, ROW * q, select(m > tiny, m, 0.0))


@inline
def volumes(count, c, forces, who, known, M, V):
    """Volumes of a row's phases into V; returns those of all fluids, of all grains, and the fluids'
    share of the space.

    The share is of the pores where there is air too: 1 - grains / max(all, space).
    """
    fluid = grains = spread(V, 0.0)
    for q in range(count):
        if who[1, q]:
            own = np.maximum(fourth_of(load(forces, 256 * who[0, q] + c)), 0.0)
            fluid = fluid + own
        else:
            own = known[0, q] * load(M, ROW * q)
            grains = grains + own
        store(V, ROW * q, own)
    both = (fluid > 0.0) & (grains > 0.0)
    share = 1.0 - grains / np.maximum(grains + fluid, load(V, ROW * count))
    return fluid, grains, select(both, np.maximum(share, LEAST_PORES), 1.0)


@inline
def _pressure(count, c, grid, forces, fluid, grains, share, who, M, V):
    """All fluids' impulses, to each phase by its share of the space."""
    total = spread(V, 0.0)
    for q in range(count):
        if who[1, q]:
            total = total + load(forces, 256 * who[0, q] + c)
    of_fluid, of_grains = share * total / fluid, (1.0 - share) * total / grains
    for q in range(count):
        nb = who[0, q]
        m, own, row = load(M, ROW * q), load(V, ROW * q), load(grid, 256 * nb + c)
        dv = (own / m) * (of_fluid if who[1, q] else of_grains)
        dv = select((m > 0.0) & (own > 0.0), dv, 0.0)
        store(grid, 256 * nb + c, with_fourth(row + dv, row))


@inline
def _mix(g, count, c, n0, grid, offsets, has_offsets, who, M, V, U, diffusion, keep, sign, dt, dx):
    """Fluids of mixing group g drift (Ren 2014) and keep the share `keep` of what else differs in
    their velocities: 1 / (1 + dt / slip time), which holds for times of 0 and infinity.

    As printed all move with the mean velocity before the pressure acts, and drift the other way
    (sign -1).
    """
    here = 0
    mass = momentum = spread(V, 0.0)
    for q in range(count):
        if who[2, q] == g:
            m = load(M, ROW * q)
            mass = mass + m
            momentum = momentum + m * load(grid, 256 * who[0, q] + c)
            here += 1
    if here < 2:
        return
    some = mass > 0.0
    mean = select(some, momentum / mass, 0.0)
    drifts = diffusion > 0.0 and has_offsets
    if drifts:
        strength = -sign * diffusion * 4.0 / (dx * dx)
        _drift(g, count, c, n0, mass, offsets, who, M, V, U, strength, dx / (2.0 * dt))
    for q in range(count):
        if who[2, q] == g:
            row = load(grid, 256 * who[0, q] + c)
            u = load(U, ROW * q) if drifts else 0.0 * mass
            moved = mean + keep * (row - u - mean) + u
            store(grid, 256 * who[0, q] + c, with_fourth(select(some, moved, row), row))


@inline
def _drift(g, count, c, n0, mass, offsets, who, M, V, U, strength, most):
    """Drift velocities into U, none faster than `most`; their momenta sum to zero.

    u_k = -D (grad a_k / a_k - sum_l c_l grad a_l / a_l), a: share of volume, c: of mass; strength
    is -4 D / dx^2, since grad V = 4 X / dx^2 for offsets X (the quadratic B-spline's second
    moment).
    """
    volume = slope = mean = again = spread(V, 0.0)
    for q in range(count):
        if who[2, q] == g:
            volume = volume + load(V, ROW * q)
            slope = slope + load(offsets, 256 * (who[0, q] - n0) + c)
    for q in range(count):
        if who[2, q] == g:
            part, m = load(V, ROW * q) / volume, load(M, ROW * q)
            change = (load(offsets, 256 * (who[0, q] - n0) + c) - part * slope) / volume
            u = strength * change / np.maximum(part, LEAST_PART)
            u = select((volume > 0.0) & (m > 0.0), u, 0.0)
            mean = mean + m * u
            store(U, ROW * q, u)
    mean = select(mass > 0.0, mean / mass, 0.0)
    for q in range(count):
        if who[2, q] == g:
            u = load(U, ROW * q) - mean
            size = np.sqrt(squared(u))
            u = u * select(size > most, most / size, 1.0)
            again = again + load(M, ROW * q) * u
            store(U, ROW * q, u)
    again = select(mass > 0.0, again / mass, 0.0)
    for q in range(count):
        if who[2, q] == g:
            store(U, ROW * q, load(U, ROW * q) - again)


@inline
def _drag(count, c, grid, fluid, grains, who, known, M, V, K, dt):
    """Exchange [kg] between sands and fluids into K: dt times the coefficient of drag times the
    bulk volume that both fill."""
    for a in range(count):
        for b in range(a):
            strength = known[2 + 2 * a, b]
            exchange = 0.0 * fluid
            if strength > 0.0:
                sand, water = (b, a) if who[1, a] else (a, b)
                Vs, Vw, n = load(V, ROW * sand), load(V, ROW * water), known[1, sand]
                bulk = Vs / (1.0 - n) * (Vw / fluid)
                wet = Vw / n * (Vs / grains)
                exchange = dt * strength * np.minimum(bulk, wet)
                if known[3 + 2 * a, b]:
                    ma, mb = load(M, ROW * a), load(M, ROW * b)
                    exchange = strength * (ma * (mb / (ma + mb)))
                exchange = select((Vs > 0.0) & (Vw > 0.0), exchange, 0.0)
            store(K, ROW * (a * count + b), exchange)
            store(K, ROW * (b * count + a), exchange)


@inline
def relax(count, c, grid, who, M, K, S, R):
    """v <- (diag(m) + L(K))^-1 m v, L the graph Laplacian of the exchanges K [kg].

    Elimination without a subtraction: each phase hands its momentum on to the others in proportion
    to what it exchanges with them, so that any K from 0 on keeps total momentum and no velocity
    leaves the range of the old ones.
    """
    for k in range(count):
        m = load(M, ROW * k)
        store(S, ROW * k, m)
        store(R, ROW * k, select(m > 0.0, m * load(grid, 256 * who[0, k] + c), 0.0))
    for k in range(count - 1, 0, -1):
        s, r = load(S, ROW * k), load(R, ROW * k)
        pivot = s
        for j in range(k):
            pivot = pivot + load(K, ROW * (k * count + j))
        store(K, ROW * (k * count + k), pivot)
        for i in range(k):
            part = load(K, ROW * (i * count + k))
            part = select(pivot > 0.0, part / pivot, 0.0)
            store(S, ROW * i, load(S, ROW * i) + part * s)
            store(R, ROW * i, load(R, ROW * i) + part * r)
            for j in range(k):
                if j != i:
                    at = ROW * (i * count + j)
                    store(K, at, load(K, at) + part * load(K, ROW * (k * count + j)))
    for k in range(count):
        total, pivot = load(R, ROW * k), load(S, ROW * k)
        if k > 0:
            pivot = load(K, ROW * (k * count + k))
        for j in range(k):
            total = total + load(K, ROW * (k * count + j)) * load(R, ROW * j)
        row = load(grid, 256 * who[0, k] + c)
        v = select(pivot > 0.0, total / pivot, row)
        store(R, ROW * k, v)  # from here on the new velocity
        store(grid, 256 * who[0, k] + c, with_fourth(v, row))


@inline
def note_flux(n0, n1, phase, grid, forces, at_wall, low, cells, least, rules, dx, room, flux):
    """Flux of volume [m/s] and fluids' share of space at the nodes of a block, into flux (256 node
    blocks,); how full the space is into the fourth number of grid, in place of mass, where sand
    may be in it."""
    who, known, M, V, _, _, _, _ = room
    drags = 1.0 if rules.drags else 0.0
    for one in range(rules.sets):
        count = members(one, n0, n1, phase, rules, who, known)
        for c in range(0, 256 if count > 0 else 0, ROW):
            spaces(count, c, at_wall, low, cells, dx, V)
            _weigh(count, c, phase, grid, least, who, M)
            fluid, grains, share = volumes(count, c, forces, who, known, M, V)
            of_fluid, of_grains = share / fluid, (1.0 - share) / grains
            total = spread(V, 0.0)
            for q in range(count):
                own = load(V, ROW * q)
                part = own * (of_fluid if who[1, q] else of_grains)
                total = total + select(own > 0.0, part * load(grid, 256 * who[0, q] + c), 0.0)
            full = drags * (fluid + grains) / load(V, ROW * count)
            for q in range(count):
                row = load(grid, 256 * who[0, q] + c)
                store(
                    flux, 256 * who[0, q] + c, with_fourth(select(fluid > 0.0, total, row), share)
                )
                store(grid, 256 * who[0, q] + c, with_fourth(row, full))

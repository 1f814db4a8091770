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
from ..device.limits import ROUNDING
from ..device.select import select
from ..lanes.lanes import load, store
from ..lanes.nodes import fourth_of, squared, with_fourth
from ..lanes.rows import largest, spread
from .members import ROW, members

LEAST_PART = 1e-3  # of a node's fluid volume, below which a drift is not followed
LEAST_PORES = 0.05  # share of space that a fluid keeps where sand is


class Here(NamedTuple):
    """A block: its node blocks are n0 .. n1; its first node is `low`."""

    n0: int
    n1: int
    meets: bool  # phases may touch here, so that there are offsets
    at_wall: bool  # some of its nodes are on or beyond a wall
    low_x: int
    low_y: int
    low_z: int


class Fields(NamedTuple):
    """Numbers of node blocks, by the places of their arrays (lanes.place)."""

    phase: np.ndarray  # (node blocks,)
    least: np.ndarray  # (phases,) [kg] of a full cell
    cells: np.ndarray  # (3,) of the domain
    grid: np.ndarray  # (256 node blocks,) velocity [m/s] and mass [kg]
    forces: np.ndarray  # as long: impulses kept apart [kg m/s] and volume [m3]
    offsets: np.ndarray  # as long: offsets [m4] and volume, where the block `meets`
    flux: np.ndarray  # as long: what particles gather besides velocity
    drift: np.ndarray  # as long: drifts [m/s]
    change: np.ndarray  # as long: of velocity [m/s]


@inline
def couple_block(block, fields, of, rules, dt, dx):
    """The stress's impulses, and what phases that share space do to each other, at the 64 nodes of
    a block. block: Here; of, rules: see members.places."""
    n0, n1, grid, forces = block.n0, block.n1, fields.grid, fields.forces
    for at in range(256 * n0, 256 * n1 if rules.drifts else 0, ROW):
        store(fields.drift, at, spread(of.V, 0.0))
    for one in range(rules.sets):
        count = members(one, n0, n1, fields.phase, rules, of)
        for c in range(0, 256 if count > 0 else 0, ROW):
            here = _weigh(count, c, fields, of)
            if largest(here) < 2.0:
                _alone(count, c, grid, forces, of)
                continue
            shared = here > 1.0
            spaces(count, c, block, fields.cells, dx, of)
            fluid, grains, share = volumes(count, c, forces, of)
            for g in range(rules.mixes):
                if rules.printed_mix[g] > 0.0:
                    D = rules.diffusion[g] if block.meets else 0.0
                    _mix(g, count, c, shared, fields, of, D, 0.0, -1.0, dt, dx, 0)
            _pressure(count, c, shared, grid, forces, fluid, grains, share, of)
            for g in range(rules.mixes):
                if rules.printed_mix[g] == 0.0:
                    D = rules.diffusion[g] if block.meets else 0.0
                    keep = 1.0 / (1.0 + dt / rules.slip_time[g])
                    _mix(g, count, c, shared, fields, of, D, keep, 1.0, dt, dx, rules.drifts)
            if rules.drags:
                _drag(count, c, fluid, grains, of, dt)
                relax(count, c, shared, grid, of)


@inline
def _alone(count, c, grid, forces, of):
    """The impulses where no other phase is at any of the nodes.

    Other ranks may see phases at nodes of the row that this one has no use for, so that what is
    done at a node must not depend on its neighbours: the same bits as `_pressure`.
    """
    for q in range(count):
        at, m = 256 * of.block[q] + c, load(of.M, ROW * q)
        row = load(grid, at)
        dv = select(m > 0.0, load(forces, at) / m, 0.0)
        store(grid, at, with_fourth(row + dv, row))


@inline
def spaces(count, c, block, cells, dx, of):
    """Volume [m3] of the domain that belongs to the nodes of row c, behind the volumes of the
    members: half of a cell's on a wall."""
    volume, at = dx * dx * dx, ROW * count
    if not block.at_wall:
        store(of.V, at, spread(of.V, volume))
        return
    i, j = block.low_x + c // 64, block.low_y + c // 16 % 4
    if i == 0 or i == cells[0]:
        volume *= 0.5
    if j == 0 or j == cells[1]:
        volume *= 0.5
    for node in range(4):
        k = block.low_z + node
        for a in range(4):
            of.V[at + 4 * node + a] = 0.5 * volume if k == 0 or k == cells[2] else volume


@inline
def _weigh(count, c, fields, of):
    """Masses of a row's phases into M; a node lighter than `tiny` holds rounding alone. Returns
    how many phases are at each."""
    here = spread(of.M, 0.0)
    for q in range(count):
        nb = of.block[q]
        m = fourth_of(load(fields.grid, 256 * nb + c))
        tiny = spread(of.M, ROUNDING * fields.least[fields.phase[nb]])
        m = select(m > tiny, m, 0.0)
        store(of.M, ROW * q, m)
        here = here + select(m > 0.0, 1.0, 0.0 * m)
    return here


@inline
def volumes(count, c, forces, of):
    """Volumes of a row's phases into V; returns those of all fluids, of all grains, and the fluids'
    share of the space.

    The share is of the pores where there is air too: 1 - grains / max(all, space).
    """
    fluid = grains = spread(of.V, 0.0)
    for q in range(count):
        if of.wet[q]:
            own = np.maximum(fourth_of(load(forces, 256 * of.block[q] + c)), 0.0)
            fluid = fluid + own
        else:
            own = spread(of.V, of.grains[q]) * load(of.M, ROW * q)
            grains = grains + own
        store(of.V, ROW * q, own)
    both = (fluid > 0.0) & (grains > 0.0)
    share = 1.0 - grains / np.maximum(grains + fluid, load(of.V, ROW * count))
    return fluid, grains, select(both, np.maximum(share, LEAST_PORES), 1.0)


@inline
def _pressure(count, c, shared, grid, forces, fluid, grains, share, of):
    """All fluids' impulses, to each phase by its share of the space."""
    total = spread(of.V, 0.0)
    for q in range(count):
        if of.wet[q]:
            total = total + load(forces, 256 * of.block[q] + c)
    of_fluid, of_grains = share * total / fluid, (1.0 - share) * total / grains
    for q in range(count):
        nb = of.block[q]
        m, own, row = load(of.M, ROW * q), load(of.V, ROW * q), load(grid, 256 * nb + c)
        dv = (own / m) * (of_fluid if of.wet[q] else of_grains)
        dv = select((m > 0.0) & (own > 0.0), dv, 0.0)
        dv = select(shared | (m <= 0.0), dv, load(forces, 256 * nb + c) / m)
        store(grid, 256 * nb + c, with_fourth(row + dv, row))


@inline
def _mix(g, count, c, shared, fields, of, diffusion, keep, sign, dt, dx, noted):
    """Fluids of mixing group g drift (Ren 2014) and keep the share `keep` of what else differs in
    their velocities: 1 / (1 + dt / slip time), which holds for times of 0 and infinity. Particles
    come without the drift of the step before; that of this one is `noted` in drift.

    As printed all move with the mean velocity before the pressure acts, and drift the other way
    (sign -1).
    """
    here, grid = 0, fields.grid
    mass = momentum = spread(of.V, 0.0)
    for q in range(count):
        if of.group[q] == g:
            m = load(of.M, ROW * q)
            mass = mass + m
            momentum = momentum + m * load(grid, 256 * of.block[q] + c)
            here += 1
    if here < 2:
        return
    some = (mass > 0.0) & shared
    mean = select(some, momentum / mass, 0.0)
    drifts = diffusion > 0.0
    if drifts:
        strength = -sign * diffusion * 4.0 / (dx * dx)
        _drift(g, count, c, mass, fields.offsets, of, strength, dx / (2.0 * dt))
    for q in range(count):
        if of.group[q] == g:
            row = load(grid, 256 * of.block[q] + c)
            u = load(of.U, ROW * q) if drifts else 0.0 * mass
            moved = mean + spread(of.V, keep) * (row - mean) + u
            if noted:
                store(fields.drift, 256 * of.block[q] + c, select(some, u, 0.0 * u))
            store(grid, 256 * of.block[q] + c, with_fourth(select(some, moved, row), row))


@inline
def _drift(g, count, c, mass, offsets, of, strength, most):
    """Drift velocities into U, none faster than `most`; their momenta sum to zero.

    u_k = -D (grad a_k / a_k - sum_l c_l grad a_l / a_l), a: share of volume, c: of mass; strength
    is -4 D / dx^2, since grad V = 4 X / dx^2 for offsets X (the quadratic B-spline's second
    moment).
    """
    volume = slope = mean = again = spread(of.V, 0.0)
    for q in range(count):
        if of.group[q] == g:
            volume = volume + load(of.V, ROW * q)
            slope = slope + load(offsets, 256 * of.block[q] + c)
    for q in range(count):
        if of.group[q] == g:
            part, m = load(of.V, ROW * q) / volume, load(of.M, ROW * q)
            change = (load(offsets, 256 * of.block[q] + c) - part * slope) / volume
            u = spread(of.V, strength) * change / np.maximum(part, LEAST_PART)
            u = select((volume > 0.0) & (m > 0.0), u, 0.0)
            mean = mean + m * u
            store(of.U, ROW * q, u)
    mean, fastest = select(mass > 0.0, mean / mass, 0.0), spread(of.V, most)
    for q in range(count):
        if of.group[q] == g:
            u = load(of.U, ROW * q) - mean
            size = np.sqrt(squared(u))
            u = u * select(size > fastest, fastest / size, 1.0)
            again = again + load(of.M, ROW * q) * u
            store(of.U, ROW * q, u)
    again = select(mass > 0.0, again / mass, 0.0)
    for q in range(count):
        if of.group[q] == g:
            store(of.U, ROW * q, load(of.U, ROW * q) - again)


@inline
def _drag(count, c, fluid, grains, of, dt):
    """Exchange [kg] between sands and fluids into K: dt times the coefficient of drag times the
    bulk volume that both fill."""
    for a in range(count):
        for b in range(a):
            strength = of.drag[a * count + b]
            exchange = 0.0 * fluid
            if strength > 0.0:
                sand, water = (b, a) if of.wet[a] else (a, b)
                Vs, Vw, n = load(of.V, ROW * sand), load(of.V, ROW * water), of.pores[sand]
                bulk = Vs / spread(of.V, 1.0 - n) * (Vw / fluid)
                wet = Vw / spread(of.V, n) * (Vs / grains)
                exchange = spread(of.V, dt * strength) * np.minimum(bulk, wet)
                if of.printed[a * count + b] > 0.0:
                    ma, mb = load(of.M, ROW * a), load(of.M, ROW * b)
                    exchange = spread(of.V, strength) * (ma * (mb / (ma + mb)))
                exchange = select((Vs > 0.0) & (Vw > 0.0), exchange, 0.0)
            store(of.K, ROW * (a * count + b), exchange)
            store(of.K, ROW * (b * count + a), exchange)


@inline
def relax(count, c, shared, grid, of):
    """v <- (diag(m) + L(K))^-1 m v, L the graph Laplacian of the exchanges K [kg].

    Elimination without a subtraction: each phase hands its momentum on to the others in proportion
    to what it exchanges with them, so that any K from 0 on keeps total momentum and no velocity
    leaves the range of the old ones.
    """
    for k in range(count):
        m = load(of.M, ROW * k)
        store(of.S, ROW * k, m)
        store(of.R, ROW * k, select(m > 0.0, m * load(grid, 256 * of.block[k] + c), 0.0))
    for k in range(count - 1, 0, -1):
        s, r = load(of.S, ROW * k), load(of.R, ROW * k)
        pivot = s
        for j in range(k):
            pivot = pivot + load(of.K, ROW * (k * count + j))
        store(of.K, ROW * (k * count + k), pivot)
        for i in range(k):
            part = load(of.K, ROW * (i * count + k))
            part = select(pivot > 0.0, part / pivot, 0.0)
            store(of.S, ROW * i, load(of.S, ROW * i) + part * s)
            store(of.R, ROW * i, load(of.R, ROW * i) + part * r)
            for j in range(k):
                if j != i:
                    at = ROW * (i * count + j)
                    store(of.K, at, load(of.K, at) + part * load(of.K, ROW * (k * count + j)))
    for k in range(count):
        total, pivot = load(of.R, ROW * k), load(of.S, ROW * k)
        if k > 0:
            pivot = load(of.K, ROW * (k * count + k))
        for j in range(k):
            total = total + load(of.K, ROW * (k * count + j)) * load(of.R, ROW * j)
        row = load(grid, 256 * of.block[k] + c)
        v = select((pivot > 0.0) & shared, total / pivot, row)
        store(of.R, ROW * k, v)  # from here on the new velocity
        store(grid, 256 * of.block[k] + c, with_fourth(v, row))


@inline
def note_flux(block, fields, of, rules, dx):
    """Flux of volume [m/s] and fluids' share of space at the nodes of a block, into flux; how full
    the space is into the fourth number of grid, in place of mass, where sand may be in it; the rest
    of grid becomes the velocity without the drift: the drifts' momenta are zero together at a node,
    but would no longer be after each fluid's particles had carried theirs elsewhere. Arguments as
    of `couple_block`."""
    drags = 1.0 if rules.drags else 0.0
    grid, forces = fields.grid, fields.forces
    for one in range(rules.sets):
        count = members(one, block.n0, block.n1, fields.phase, rules, of)
        for c in range(0, 256 if count > 0 else 0, ROW):
            here = _weigh(count, c, fields, of)
            spaces(count, c, block, fields.cells, dx, of)
            fluid, grains, share = volumes(count, c, forces, of)
            full = drags * (fluid + grains) / load(of.V, ROW * count)
            total = (
                _flux(count, c, grid, fluid, grains, share, of) if largest(here) > 1.0 else fluid
            )
            for q in range(count):
                at = 256 * of.block[q] + c
                row = load(grid, at)
                through = select((fluid > 0.0) & (here > 1.0), total, row)
                store(fields.flux, at, with_fourth(through, share))
                if rules.drifts:
                    row = row - load(fields.drift, at)
                store(grid, at, with_fourth(row, full))


@inline
def _flux(count, c, grid, fluid, grains, share, of):
    """Velocities of a row's phases, each by its share of the space."""
    of_fluid, of_grains = share / fluid, (1.0 - share) / grains
    total = spread(of.V, 0.0)
    for q in range(count):
        own = load(of.V, ROW * q)
        part = own * (of_fluid if of.wet[q] else of_grains)
        total = total + select(own > 0.0, part * load(grid, 256 * of.block[q] + c), 0.0)
    return total

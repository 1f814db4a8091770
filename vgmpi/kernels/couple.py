"""Phases that share space at one node: fluids that mix, sand that fluids flow through.

Their pressure acts on all of them by their share of the space, their relative motion is slowed
implicitly, fluids drift to where there is less of them; then the flux of volume is noted, by which
fluids change their density. What phases gain from each other sums to zero. Formulas and sources:
docs/theory.md.
"""

from typing import NamedTuple

import numpy as np

from ..device.jit import inline
from .g2p import LEAST_PORES
from .walls import tangential

LEAST_PART = 1e-3  # of a node's fluid volume, below which a drift is not followed


class Room(NamedTuple):
    """Scratch of one thread, for up to as many phases as there are."""

    at: np.ndarray  # (n,) which phases of the block are here
    m: np.ndarray  # (n,) [kg]
    v: np.ndarray  # (n, 3) [m/s]
    f: np.ndarray  # (n, 3) impulses [kg m/s]
    V: np.ndarray  # (n,) [m3]
    X: np.ndarray  # (n, 3) [m4]
    u: np.ndarray  # (n, 3) drift
    K: np.ndarray  # (n, n) exchange [kg]
    s: np.ndarray  # (n,) of the elimination
    r: np.ndarray  # (n, 3) of the elimination


def room(n: int) -> Room:
    """Scratch for n phases."""
    one, three = (np.zeros(n) for _ in range(3)), (np.zeros((n, 3)) for _ in range(5))
    v, f, X, u, r = three
    m, V, s = one
    return Room(np.zeros(n, np.int64), m, v, f, V, X, u, np.zeros((n, n)), s, r)


@inline
def couple_block(grid, phase, offsets, impulses, meets, low, cells, wall_kinds, least, rules, dt,
                 dx, room):  # fmt: skip
    """The stress's impulses, and what phases that share space do to each other, at the 64 nodes of
    a block.

    grid: (phases here, 64, 4) velocity and mass; offsets: the same of volumes and offsets, where
    `meets`; impulses: the same of impulses that were kept apart.
    """
    for node in range(64):
        if not meets:
            for nb in range(len(grid)):
                push(grid[nb, node], impulses[nb, node], least[phase[nb]])
            continue
        i, j, k = low[0] + node // 16, low[1] + node // 4 % 4, low[2] + node % 4
        for one in range(rules.sets):
            count = _members(one, node, grid, phase, offsets, impulses, least, rules, room)
            for q in range(count):
                tangential(offsets[room.at[q], node], i, j, k, cells, wall_kinds)
                for c in range(3):
                    room.X[q, c] = offsets[room.at[q], node, c]
            exchange(count, phase, rules, space(i, j, k, cells, dx), dt, dx, room)
            for q in range(count):
                for c in range(3):
                    grid[room.at[q], node, c] = room.v[q, c]


@inline
def push(node, impulse, least):
    """Add an impulse to a node's velocity."""
    if node[3] > 1e-20 * least:
        for c in range(3):
            node[c] += impulse[c] / node[3]


@inline
def space(i, j, k, cells, dx):
    """Volume [m3] of the domain that belongs to a node: half of a cell's on a wall."""
    volume = dx * dx * dx
    if i == 0 or i == cells[0]:
        volume *= 0.5
    if j == 0 or j == cells[1]:
        volume *= 0.5
    if k == 0 or k == cells[2]:
        volume *= 0.5
    return volume


@inline
def _members(one, node, grid, phase, offsets, impulses, least, rules, room):
    """Gather the phases of set `one` at a node into the room; returns how many."""
    count = 0
    for nb in range(len(grid)):
        ph = phase[nb]
        if rules.together[ph] != one:
            continue
        if not (grid[nb, node, 3] > 1e-20 * least[ph] and offsets[nb, node, 3] > 0):
            continue
        room.at[count] = nb
        room.m[count] = grid[nb, node, 3]
        room.V[count] = offsets[nb, node, 3]
        for c in range(3):
            room.v[count, c] = grid[nb, node, c]
            room.f[count, c] = impulses[nb, node, c]
        count += 1
    return count


@inline
def shares(count, phase, rules, cell, room):
    """(fluid volume, grain volume, fluids' share of the space) at a node.

    The share is of the pores where there is air too: 1 - grains / max(all, space).
    """
    fluid = grains = 0.0
    for q in range(count):
        if rules.fluid[phase[room.at[q]]]:
            fluid += room.V[q]
        else:
            grains += room.V[q]
    share = 1.0
    if grains > 0 and fluid > 0:
        share = max(LEAST_PORES, 1.0 - grains / max(grains + fluid, cell))
    return fluid, grains, share


@inline
def exchange(count, phase, rules, cell, dt, dx, room):
    """Velocities of the phases of one set at a node after pressure, mixing and drag, in room.v."""
    fluid, grains, share = shares(count, phase, rules, cell, room)
    if fluid > 0:
        for group in range(rules.mixes):
            if rules.printed_mix[group]:
                _mix(group, count, phase, rules, dt, dx, room)
        _pressure(count, phase, rules, fluid, grains, share, room)
        for group in range(rules.mixes):
            if not rules.printed_mix[group]:
                _mix(group, count, phase, rules, dt, dx, room)
    if fluid > 0 and grains > 0:
        _drag(count, phase, rules, fluid, grains, dt, room)


@inline
def _pressure(count, phase, rules, fluid, grains, share, room):
    """All fluids' impulses, to each phase by its share of the space."""
    for c in range(3):
        total = 0.0
        for q in range(count):
            if rules.fluid[phase[room.at[q]]]:
                total += room.f[q, c]
        for q in range(count):
            if rules.fluid[phase[room.at[q]]]:
                room.v[q, c] += share * (room.V[q] / fluid) * total / room.m[q]
            elif share < 1.0:
                room.v[q, c] += (1.0 - share) * (room.V[q] / grains) * total / room.m[q]


@inline
def _mix(group, count, phase, rules, dt, dx, room):
    """Fluids of one mixing group drift (Ren 2014) and come to move alike within the slip time.

    u_k = -D (grad a_k / a_k - sum_l c_l grad a_l / a_l), a: share of volume, c: of mass. As printed
    the sign is plus and all move with the mean velocity before the pressure acts.
    """
    volume = mass = 0.0
    here = 0
    for q in range(count):
        if rules.mix[phase[room.at[q]]] == group:
            volume += room.V[q]
            mass += room.m[q]
            here += 1
    if here < 2:
        return
    sign = 1.0 if rules.printed_mix[group] else -1.0
    strength = sign * rules.diffusion[group] * 4.0 / (dx * dx)
    slip = rules.slip_time[group]
    keep = slip / (slip + dt)
    if rules.printed_mix[group]:
        keep = 0.0
    if strength != 0.0:
        _drift(group, count, phase, rules, volume, mass, strength, dx / (2.0 * dt), room)
    for c in range(3):
        mean = 0.0
        for q in range(count):
            if rules.mix[phase[room.at[q]]] == group:
                mean += room.m[q] * room.v[q, c]
        mean /= mass
        for q in range(count):
            if rules.mix[phase[room.at[q]]] == group:
                u = room.u[q, c] if strength != 0.0 else 0.0
                room.v[q, c] = mean + keep * (room.v[q, c] - u - mean) + u


@inline
def _drift(group, count, phase, rules, volume, mass, strength, most, room):
    """Drift velocities into room.u; their momenta sum to zero."""
    for c in range(3):
        slope = 0.0
        for q in range(count):
            if rules.mix[phase[room.at[q]]] == group:
                slope += room.X[q, c]
        for q in range(count):
            if rules.mix[phase[room.at[q]]] == group:
                part = room.V[q] / volume
                change = (room.X[q, c] - part * slope) / volume
                room.u[q, c] = strength * change / max(part, LEAST_PART)
        _without_mean(group, count, phase, rules, mass, c, room)
    for q in range(count):
        if rules.mix[phase[room.at[q]]] == group:
            u = room.u[q]
            size = np.sqrt(u[0] * u[0] + u[1] * u[1] + u[2] * u[2])
            if size > most:
                for c in range(3):
                    u[c] *= most / size
    for c in range(3):
        _without_mean(group, count, phase, rules, mass, c, room)


@inline
def _without_mean(group, count, phase, rules, mass, c, room):
    """Subtract the mass mean of component c of the group's drift."""
    mean = 0.0
    for q in range(count):
        if rules.mix[phase[room.at[q]]] == group:
            mean += room.m[q] * room.u[q, c]
    mean /= mass
    for q in range(count):
        if rules.mix[phase[room.at[q]]] == group:
            room.u[q, c] -= mean


@inline
def _drag(count, phase, rules, fluid, grains, dt, room):
    """Drag between sands and fluids, implicit: exact momentum, no gain of energy."""
    K = room.K
    for a in range(count):
        for b in range(count):
            K[a, b] = 0.0
    for a in range(count):
        sand = phase[room.at[a]]
        if rules.fluid[sand]:
            continue
        n = rules.porosity[sand]
        for b in range(count):
            water = phase[room.at[b]]
            c = rules.drag[sand, water]
            if not rules.fluid[water] or c == 0.0:
                continue
            # bulk volume that both fill
            bulk = room.V[a] / (1.0 - n) * (room.V[b] / fluid)
            wet = room.V[b] / n * (room.V[a] / grains)
            K[a, b] = dt * c * min(bulk, wet)
            if rules.printed_drag[sand, water]:
                K[a, b] = c * room.m[a] * room.m[b] / (room.m[a] + room.m[b])
            K[b, a] = K[a, b]
    relax(count, room)


@inline
def relax(count, room):
    """v <- (diag(m) + L(K))^-1 m v, L the graph Laplacian of the exchanges K [kg].

    Elimination without a subtraction: each phase hands its momentum on to the others in proportion
    to what it exchanges with them, so that any K from 0 to infinity keeps total momentum and no
    velocity leaves the range of the old ones.
    """
    m, v, K, s, r = room.m, room.v, room.K, room.s, room.r
    for k in range(count):
        s[k] = m[k]
        for c in range(3):
            r[k, c] = m[k] * v[k, c]
    for k in range(count - 1, 0, -1):
        pivot = s[k]
        for j in range(k):
            pivot += K[k, j]
        K[k, k] = pivot
        if not pivot > 0:
            continue
        for i in range(k):
            part = K[i, k] / pivot
            if part == 0:
                continue
            s[i] += part * s[k]
            for c in range(3):
                r[i, c] += part * r[k, c]
            for j in range(k):
                if j != i:
                    K[i, j] += part * K[k, j]
    for c in range(3):
        if s[0] > 0:
            v[0, c] = r[0, c] / s[0]
        for k in range(1, count):
            total = r[k, c]
            for j in range(k):
                total += K[k, j] * v[j, c]
            if K[k, k] > 0:
                v[k, c] = total / K[k, k]


@inline
def note_flux(grid, phase, offsets, meets, low, cells, rules, dx, room, flux):
    """Flux of volume [m/s] and fluids' share of space at the nodes of a block, into flux (phases
    here, 64, 4); how full the space is into grid[..., 3], where sand may be in it."""
    for nb in range(len(grid)):
        if rules.together[phase[nb]] < 0:
            continue
        for node in range(64):
            for c in range(3):
                flux[nb, node, c] = grid[nb, node, c]
            flux[nb, node, 3] = 1.0
    if not meets:
        for nb in range(len(grid)):
            if rules.together[phase[nb]] >= 0:
                for node in range(64):
                    grid[nb, node, 3] = 0.0
        return
    for node in range(64):
        i, j, k = low[0] + node // 16, low[1] + node // 4 % 4, low[2] + node % 4
        cell = space(i, j, k, cells, dx)
        for one in range(rules.sets):
            _node_flux(one, node, grid, phase, offsets, cell, rules, room, flux)


@inline
def _node_flux(one, node, grid, phase, offsets, cell, rules, room, flux):
    """As `note_flux`, one set of phases at one node."""
    count = 0
    for nb in range(len(grid)):
        if rules.together[phase[nb]] == one:
            grid[nb, node, 3] = 0.0
            if offsets[nb, node, 3] > 0:
                room.at[count], room.V[count] = nb, offsets[nb, node, 3]
                count += 1
    fluid, grains, share = shares(count, phase, rules, cell, room)
    if not fluid > 0:
        return
    for c in range(3):
        total = 0.0
        for q in range(count):
            if rules.fluid[phase[room.at[q]]]:
                total += share * (room.V[q] / fluid) * grid[room.at[q], node, c]
            elif share < 1.0:
                total += (1.0 - share) * (room.V[q] / grains) * grid[room.at[q], node, c]
        for q in range(count):
            flux[room.at[q], node, c] = total
    for q in range(count):
        flux[room.at[q], node, 3] = share
        grid[room.at[q], node, 3] = (fluid + grains) / cell

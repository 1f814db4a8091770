"""Phases that share space: mixing fluids, and sand with fluids in its pores; four nodes at a time.

At each node their pressure acts on all of them in proportion to their volume fraction, fluids drift
down their concentration gradient, and their relative motion is damped implicitly. The momenta that
phases exchange sum to zero. Formulas and sources: docs/explanation/mixtures.md.

Volume flux and filled fraction, as the particles gather them, are stored after contact and walls.
Fluids change their density by the volume flux of all phases at a node; the filled fraction tells
pores that are overfilled, and spray.

A row of four nodes is a vector xyzm xyzm xyzm xyzm. Scalars of a node stand in all of its lanes.
"""

from typing import NamedTuple

import numpy as np

from vgmpi.kernels.grid.node_stages import after_stress, after_walls, before_stress
from vgmpi.kernels.kernel_arguments import NODE_MASS_FLOOR, NodalFields
from vgmpi.kernels.simd.cooperative import flat_pointer, strided_range, sync_threads
from vgmpi.kernels.simd.row_ops import broadcast, fourth_of, horizontal_max, squared, with_fourth
from vgmpi.kernels.simd.vector16 import load, store
from vgmpi.kernels.wall_boundary import project_tangential
from vgmpi.materials.tensor_math.select import select
from vgmpi.runtime.jit import device_function

from .workspace import ROW, collect_members, to_pointers

MIN_VOLUME_FRACTION = 1e-3  # [-] fraction of a node's fluid volume below which the drift is bounded
MIN_POROSITY = 0.05  # [-] least volume fraction of a fluid in the presence of sand


class MixtureStage(NamedTuple):
    """Stage of phases that share space."""

    flux: np.ndarray  # (node blocks, 256) volume flux [m/s] and fluid fraction (out), or no rows
    drift: np.ndarray  # (node blocks, 256) [m/s] drift (out); any array if none is kept apart
    tables: tuple  # MixtureTables


class MixtureFields(NamedTuple):
    """Nodal arrays of a block's mixtures, as pointers to their data."""

    nodes: NodalFields
    flux: np.ndarray  # (256 node blocks,) volume flux [m/s] and fluid fraction, which is gathered
    drift: np.ndarray  # same shape: drifts [m/s]


@device_function
def _with_mixtures(kind, fields):
    """Return the nodal arrays with those of the mixtures."""
    return MixtureFields(fields, flat_pointer(kind.flux), flat_pointer(kind.drift))


@before_stress.register(MixtureStage)
def _(kind, block, fields, push):
    pass


@after_stress.register(MixtureStage)
def _(kind, block, fields, scratch, walls, phases, step):
    if block.at_wall and block.may_touch:
        _project_offsets(fields.offsets, block, walls, phases, fields.phase)
    work, rules = to_pointers(scratch, kind.tables)
    couple_block(block, _with_mixtures(kind, fields), work, rules, step.dt, step.dx)


@after_walls.register(MixtureStage)
def _(kind, block, has_impulses, fields, scratch, dx):
    if len(kind.flux) == 0:
        return  # the nodes keep their masses, with which an implicit pressure is found
    work, rules = to_pointers(scratch, kind.tables)
    store_mixture_values(block, has_impulses, _with_mixtures(kind, fields), work, rules, dx)


@device_function
def _project_offsets(offsets, block, walls, phases, phase_of):
    """Remove the component across walls from the offsets (256 node blocks,) of a block."""
    for nb in range(block.n0, block.n1):
        kinds = walls.kinds if phases.liquid[phase_of[nb]] else walls.kinds_for_solids
        for node in strided_range(64):
            i, j, k = block.low_x + node // 16, block.low_y + node // 4 % 4, block.low_z + node % 4
            project_tangential(offsets, 256 * nb + 4 * node, i, j, k, walls.cells, kinds)
    sync_threads()


@device_function
def couple_block(block, fields, work, rules, dt, dx):
    """Apply the stress impulses and the interaction of phases that share space.

    The function handles the 64 nodes of one block.

    Args:
        block: Context of the block.
        fields: Nodal arrays (in/out).
        work: Scratch of the calling thread, see workspace.to_pointers.
        rules: Interaction rules as tables, see workspace.to_pointers.
        dt: Time step [s].
        dx: Cell size [m].
    """
    n0, n1, grid, forces = block.n0, block.n1, fields.nodes.grid, fields.nodes.forces
    for offset in range(256 * n0, 256 * n1 if rules.drifts else 0, ROW):
        store(fields.drift, offset, broadcast(work.V, 0.0))
    for set_index in range(rules.sets):
        count = collect_members(set_index, n0, n1, fields.nodes.phase, rules, work)
        for c in range(0, 256 if count > 0 else 0, ROW):
            phase_count = load_masses(count, c, fields, work)
            if horizontal_max(phase_count) < 2.0:
                _alone(count, c, grid, forces, work)
                continue
            shared = phase_count > 1.0
            available_volume(count, c, block, fields.nodes.cells, dx, work)
            fluid, grains, share = volumes(count, c, forces, work)
            for g in range(rules.mixing_group_count):
                if rules.printed_mix[g] > 0.0:
                    D = rules.diffusion[g] if block.may_touch else 0.0
                    _relax_slip(g, count, c, shared, fields, work, D, 0.0, -1.0, dt, dx, 0)
            _pressure(count, c, shared, grid, forces, fluid, grains, share, work)
            for g in range(rules.mixing_group_count):
                if rules.printed_mix[g] == 0.0:
                    D = rules.diffusion[g] if block.may_touch else 0.0
                    slip_factor = 1.0 / (1.0 + dt / rules.slip_relaxation_time[g])
                    _relax_slip(
                        g, count, c, shared, fields, work, D, slip_factor, 1.0, dt, dx, rules.drifts
                    )
            if rules.has_drag:
                _drag_coefficients(count, c, fluid, grains, work, dt)
                solve_drag_exchange(count, c, shared, grid, work)


@device_function
def _alone(count, c, grid, forces, work):
    """Apply the stress impulses where no other phase is at any of the four nodes.

    Other ranks may see phases at nodes of the row that this rank does not need, so the result of a
    node must not depend on its neighbors: the bits equal those of `_pressure`.
    """
    for q in range(count):
        offset, m = 256 * work.block[q] + c, load(work.M, ROW * q)
        row = load(grid, offset)
        dv = select(m > 0.0, load(forces, offset) / m, 0.0)
        store(grid, offset, with_fourth(row + dv, row))


@device_function
def available_volume(count, c, block, cells, dx, work):
    """Store the volume [m3] of the domain that belongs to the nodes of row c.

    It stands behind the volumes of the members; on a wall it is half that of a cell.

    Args:
        count, c: Number of members; first number of the row in its node block.
        block: Context of the block.
        cells: Cells of the domain, shape (3,).
        dx: Cell size [m].
        work: Scratch (in/out).
    """
    volume, offset = dx * dx * dx, ROW * count
    if not block.at_wall:
        store(work.V, offset, broadcast(work.V, volume))
        return
    i, j = block.low_x + c // 64, block.low_y + c // 16 % 4
    if i == 0 or i == cells[0]:
        volume *= 0.5
    if j == 0 or j == cells[1]:
        volume *= 0.5
    for node in range(4):
        k = block.low_z + node
        for a in range(4):
            work.V[offset + 4 * node + a] = 0.5 * volume if k == 0 or k == cells[2] else volume


@device_function
def load_masses(count, c, fields, work):
    """Store the nodal masses of a row in M and return the number of phases per node.

    A node lighter than `tiny` holds rounding errors only and counts as empty.

    Args:
        count, c: Number of members; first number of the row in its node block.
        fields: Nodal arrays.
        work: Scratch (in/out).
    """
    phase_count = broadcast(work.M, 0.0)
    for q in range(count):
        nb = work.block[q]
        m = fourth_of(load(fields.nodes.grid, 256 * nb + c))
        tiny = broadcast(
            work.M, NODE_MASS_FLOOR * fields.nodes.min_cell_mass[fields.nodes.phase[nb]]
        )
        m = select(m > tiny, m, 0.0)
        store(work.M, ROW * q, m)
        phase_count = phase_count + select(m > 0.0, 1.0, 0.0 * m)
    return phase_count


@device_function
def volumes(count, c, forces, work):
    """Store the phase volumes of a row in V and return the totals.

    Args:
        count, c: Number of members; first number of the row in its node block.
        forces: Stress impulses and volumes.
        work: Scratch (in/out).

    Returns:
        Volumes of all fluids and of all grains [m3], and the volume fraction of the fluids. The
        fraction is that of the pores, also where they hold air: 1 - grains / max(all, space).
    """
    fluid = grains = broadcast(work.V, 0.0)
    for q in range(count):
        if work.wet[q]:
            own = np.maximum(fourth_of(load(forces, 256 * work.block[q] + c)), 0.0)
            fluid = fluid + own
        else:
            own = broadcast(work.V, work.grains[q]) * load(work.M, ROW * q)
            grains = grains + own
        store(work.V, ROW * q, own)
    both = (fluid > 0.0) & (grains > 0.0)
    fluid_fraction = 1.0 - grains / np.maximum(grains + fluid, load(work.V, ROW * count))
    return fluid, grains, select(both, np.maximum(fluid_fraction, MIN_POROSITY), 1.0)


@device_function
def _pressure(count, c, shared, grid, forces, fluid, grains, fluid_fraction, work):
    """Distribute the impulses of all fluids to the phases by volume fraction."""
    total = broadcast(work.V, 0.0)
    for q in range(count):
        if work.wet[q]:
            total = total + load(forces, 256 * work.block[q] + c)
    of_fluid, of_grains = fluid_fraction * total / fluid, (1.0 - fluid_fraction) * total / grains
    for q in range(count):
        nb = work.block[q]
        m, own, row = load(work.M, ROW * q), load(work.V, ROW * q), load(grid, 256 * nb + c)
        dv = (own / m) * (of_fluid if work.wet[q] else of_grains)
        dv = select((m > 0.0) & (own > 0.0), dv, 0.0)
        dv = select(shared | (m <= 0.0), dv, load(forces, 256 * nb + c) / m)
        store(grid, 256 * nb + c, with_fourth(row + dv, row))


@device_function
def _relax_slip(g, count, c, shared, fields, work, diffusion, slip_factor, sign, dt, dx, noted):
    """Let the fluids of mixing group g drift and damp the rest of their slip velocity.

    The slip is multiplied by `slip_factor` = 1 / (1 + dt / slip time), which also holds for times
    of 0 and infinity. Particles carry no drift from the previous step; the drift of this step is
    stored if `noted` is set. As published, all fluids move with the mean velocity before the
    pressure acts, and drift the other way (sign -1).

    References:
        Ren et al. 2014 (mixture model).
    """
    fluid_count, grid = 0, fields.nodes.grid
    mass = momentum = broadcast(work.V, 0.0)
    for q in range(count):
        if work.group[q] == g:
            m = load(work.M, ROW * q)
            mass = mass + m
            momentum = momentum + m * load(grid, 256 * work.block[q] + c)
            fluid_count += 1
    if fluid_count < 2:
        return
    present = (mass > 0.0) & shared
    mean = select(present, momentum / mass, 0.0)
    drifts = diffusion > 0.0
    if drifts:
        strength = -sign * diffusion * 4.0 / (dx * dx)
        _diffusive_drift(g, count, c, mass, fields.nodes.offsets, work, strength, dx / (2.0 * dt))
    for q in range(count):
        if work.group[q] == g:
            row = load(grid, 256 * work.block[q] + c)
            u = load(work.U, ROW * q) if drifts else 0.0 * mass
            moved = mean + broadcast(work.V, slip_factor) * (row - mean) + u
            if noted:
                store(fields.drift, 256 * work.block[q] + c, select(present, u, 0.0 * u))
            store(grid, 256 * work.block[q] + c, with_fourth(select(present, moved, row), row))


@device_function
def _diffusive_drift(g, count, c, mass, offsets, work, strength, max_speed):
    """Store drift velocities in U, none faster than `max_speed`; their momenta sum to zero.

    u_k = -D (grad a_k / a_k - sum_l c_l grad a_l / a_l) with volume fractions a and mass fractions
    c. The strength is -4 D / dx^2, since grad V = 4 X / dx^2 for offsets X (second moment of the
    quadratic B-spline).
    """
    volume = slope = mean = residual = broadcast(work.V, 0.0)
    for q in range(count):
        if work.group[q] == g:
            volume = volume + load(work.V, ROW * q)
            slope = slope + load(offsets, 256 * work.block[q] + c)
    for q in range(count):
        if work.group[q] == g:
            fraction, m = load(work.V, ROW * q) / volume, load(work.M, ROW * q)
            change = (load(offsets, 256 * work.block[q] + c) - fraction * slope) / volume
            u = broadcast(work.V, strength) * change / np.maximum(fraction, MIN_VOLUME_FRACTION)
            u = select((volume > 0.0) & (m > 0.0), u, 0.0)
            mean = mean + m * u
            store(work.U, ROW * q, u)
    mean, fastest = select(mass > 0.0, mean / mass, 0.0), broadcast(work.V, max_speed)
    for q in range(count):
        if work.group[q] == g:
            u = load(work.U, ROW * q) - mean
            size = np.sqrt(squared(u))
            u = u * select(size > fastest, fastest / size, 1.0)
            residual = residual + load(work.M, ROW * q) * u
            store(work.U, ROW * q, u)
    residual = select(mass > 0.0, residual / mass, 0.0)
    for q in range(count):
        if work.group[q] == g:
            store(work.U, ROW * q, load(work.U, ROW * q) - residual)


@device_function
def _drag_coefficients(count, c, fluid, grains, work, dt):
    """Store the exchange [kg] between sands and fluids in K.

    It is dt times the drag coefficient times the bulk volume that both fill.
    """
    for a in range(count):
        for b in range(a):
            strength = work.drag[a * count + b]
            exchange = 0.0 * fluid
            if strength > 0.0:
                sand, water = (b, a) if work.wet[a] else (a, b)
                Vs, Vw, n = load(work.V, ROW * sand), load(work.V, ROW * water), work.porosity[sand]
                bulk = Vs / broadcast(work.V, 1.0 - n) * (Vw / fluid)
                wet = Vw / broadcast(work.V, n) * (Vs / grains)
                exchange = broadcast(work.V, dt * strength) * np.minimum(bulk, wet)
                if work.printed[a * count + b] > 0.0:
                    ma, mb = load(work.M, ROW * a), load(work.M, ROW * b)
                    exchange = broadcast(work.V, strength) * (ma * (mb / (ma + mb)))
                exchange = select((Vs > 0.0) & (Vw > 0.0), exchange, 0.0)
            store(work.K, ROW * (a * count + b), exchange)
            store(work.K, ROW * (b * count + a), exchange)


@device_function
def solve_drag_exchange(count, c, shared, grid, work):
    """Solve the implicit drag exchange: v <- (diag(m) + L(K))^-1 m v.

    L is the graph Laplacian of the exchanges K [kg]. The elimination has no subtraction: each phase
    passes its momentum on to the others in proportion to the exchange with them, so for any K >= 0
    the total momentum is conserved and no velocity leaves the range of the old ones.

    Args:
        count, c: Number of members; first number of the row in its node block.
        shared: Lanes of nodes with more than one phase.
        grid: Nodal velocities (in/out) [m/s].
        work: Scratch with masses M and exchanges K (in/out).
    """
    for k in range(count):
        m = load(work.M, ROW * k)
        store(work.S, ROW * k, m)
        store(work.R, ROW * k, select(m > 0.0, m * load(grid, 256 * work.block[k] + c), 0.0))
    for k in range(count - 1, 0, -1):
        s, r = load(work.S, ROW * k), load(work.R, ROW * k)
        pivot = s
        for j in range(k):
            pivot = pivot + load(work.K, ROW * (k * count + j))
        store(work.K, ROW * (k * count + k), pivot)
        for i in range(k):
            fraction = load(work.K, ROW * (i * count + k))
            fraction = select(pivot > 0.0, fraction / pivot, 0.0)
            store(work.S, ROW * i, load(work.S, ROW * i) + fraction * s)
            store(work.R, ROW * i, load(work.R, ROW * i) + fraction * r)
            for j in range(k):
                if j != i:
                    offset = ROW * (i * count + j)
                    store(
                        work.K,
                        offset,
                        load(work.K, offset) + fraction * load(work.K, ROW * (k * count + j)),
                    )
    for k in range(count):
        total, pivot = load(work.R, ROW * k), load(work.S, ROW * k)
        if k > 0:
            pivot = load(work.K, ROW * (k * count + k))
        for j in range(k):
            total = total + load(work.K, ROW * (k * count + j)) * load(work.R, ROW * j)
        row = load(grid, 256 * work.block[k] + c)
        v = select((pivot > 0.0) & shared, total / pivot, row)
        store(work.R, ROW * k, v)  # R now holds the new velocity
        store(grid, 256 * work.block[k] + c, with_fourth(v, row))


@device_function
def store_mixture_values(block, has_impulses, fields, work, rules, dx):
    """Store what particles of phases that share space gather besides velocity.

    The filled fraction of space replaces mass as the fourth number of grid.

    Args:
        block: Context of the block.
        has_impulses: Whether stress impulses, and with them volumes, are counted in the block.
        fields: Nodal arrays (in/out).
        work: Scratch of the calling thread.
        rules: Interaction rules as tables.
        dx: Cell size [m].
    """
    if has_impulses:
        _store_volume_flux(block, fields, work, rules, dx)
    else:
        _store_filled_fraction(block, fields, work, rules, dx)


@device_function
def _store_volume_flux(block, fields, work, rules, dx):
    """Store the volume flux [m/s] and the fluids' volume fraction at the nodes of a block.

    Grid becomes the velocity without the drift: the momenta of the drifts sum to zero at a node,
    but would no longer do so after each fluid's particles had carried theirs elsewhere. Arguments
    as of `store_mixture_values`.
    """
    grid, forces = fields.nodes.grid, fields.nodes.forces
    for set_index in range(rules.sets):
        count = collect_members(set_index, block.n0, block.n1, fields.nodes.phase, rules, work)
        for c in range(0, 256 if count > 0 else 0, ROW):
            phase_count = load_masses(count, c, fields, work)
            available_volume(count, c, block, fields.nodes.cells, dx, work)
            fluid, grains, fluid_fraction = volumes(count, c, forces, work)
            all_volume = fluid + grains
            total = (
                _flux(count, c, grid, fluid, grains, fluid_fraction, work)
                if horizontal_max(phase_count) > 1.0
                else fluid
            )
            for q in range(count):
                offset = 256 * work.block[q] + c
                row = load(grid, offset)
                through = select((fluid > 0.0) & (phase_count > 1.0), total, row)
                store(fields.flux, offset, with_fourth(through, fluid_fraction))
                full = _filled_fraction(count, q, row, all_volume, fields, work, dx)
                if rules.drifts:
                    row = row - load(fields.drift, offset)
                store(grid, offset, with_fourth(row, full))


@device_function
def _store_filled_fraction(block, fields, work, rules, dx):
    """Store the filled fraction of fluids where all stress impulses are part of the momentum.

    Arguments as of `store_mixture_values`.
    """
    full = broadcast(work.V, 1.0)
    for nb in range(block.n0, block.n1):
        p = fields.nodes.phase[nb]
        if rules.mixture_set[p] < 0 or rules.fluid[p] == 0:
            continue
        per_mass = broadcast(work.V, 1.0 / fields.nodes.min_cell_mass[p])
        for c in range(0, 256, ROW):
            row = load(fields.nodes.grid, 256 * nb + c)
            own = per_mass * fourth_of(row)
            if block.at_wall:
                available_volume(0, c, block, fields.nodes.cells, dx, work)
                own = own * (broadcast(work.V, dx * dx * dx) / load(work.V, 0))
            store(fields.nodes.grid, 256 * nb + c, with_fourth(row, np.minimum(own, full)))


@device_function
def _filled_fraction(count, q, row, all_volume, fields, work, dx):
    """Return the filled fraction of the space around the nodes of a row.

    Volumes are counted where phases may meet only. Elsewhere the mass of the phase tells the
    fraction, up to 1, so that a liquid under pressure does not count as overfilled.

    Args:
        count, q: Number of members; number of this one.
        row: Velocities and masses of its nodes.
        all_volume: Volume of all members that is counted [m3].
        fields: Nodal arrays.
        work: Scratch with the available volumes.
        dx: Cell size [m].
    """
    phase = fields.nodes.phase[work.block[q]]
    volume_per_mass = dx * dx * dx / fields.nodes.min_cell_mass[phase]
    space = load(work.V, ROW * count)
    own = np.minimum(broadcast(work.V, volume_per_mass) * fourth_of(row), space)
    return np.maximum(all_volume, own) / space


@device_function
def _flux(count, c, grid, fluid, grains, fluid_fraction, work):
    """Return the mean velocity of the phases of a row, weighted by volume fraction."""
    of_fluid, of_grains = fluid_fraction / fluid, (1.0 - fluid_fraction) / grains
    total = broadcast(work.V, 0.0)
    for q in range(count):
        own = load(work.V, ROW * q)
        fraction = own * (of_fluid if work.wet[q] else of_grains)
        total = total + select(own > 0.0, fraction * load(grid, 256 * work.block[q] + c), 0.0)
    return total

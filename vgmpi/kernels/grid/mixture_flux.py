"""Volume flux and filled fraction of phases that share space, as their particles gather them.

They are stored after contact and walls. Fluids change their density by the volume flux of all
phases at a node; the filled fraction tells pores that are overfilled, and spray
(docs/explanation/mixtures.md). Rows of four nodes are vectors, as in mixture_coupling.py.
"""

import numpy as np

from vgmpi.kernels.simd.node_row_ops import fourth_of, with_fourth
from vgmpi.kernels.simd.row_ops import broadcast, horizontal_max
from vgmpi.kernels.simd.vector16 import load, store
from vgmpi.materials.tensor_math.select import select
from vgmpi.runtime.jit import device_function

from .mixture_coupling import ROW, available_volume, load_masses, volumes
from .mixture_workspace import collect_members


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
    grid, forces = fields.grid, fields.forces
    for set_index in range(rules.sets):
        count = collect_members(set_index, block.n0, block.n1, fields.phase, rules, work)
        for c in range(0, 256 if count > 0 else 0, ROW):
            phase_count = load_masses(count, c, fields, work)
            available_volume(count, c, block, fields.cells, dx, work)
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
        p = fields.phase[nb]
        if rules.mixture_set[p] < 0 or rules.fluid[p] == 0:
            continue
        per_mass = broadcast(work.V, 1.0 / fields.least[p])
        for c in range(0, 256, ROW):
            row = load(fields.grid, 256 * nb + c)
            own = per_mass * fourth_of(row)
            if block.at_wall:
                available_volume(0, c, block, fields.cells, dx, work)
                own = own * (broadcast(work.V, dx * dx * dx) / load(work.V, 0))
            store(fields.grid, 256 * nb + c, with_fourth(row, np.minimum(own, full)))


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
    phase = fields.phase[work.block[q]]
    volume_per_mass = dx * dx * dx / fields.least[phase]
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

"""Transfer correction: motion that the transfers dissipated is returned to the particles.

The motion passes through the grid in a step of zero duration; its loss is what each transfer of the
last steps has taken. A feature may take part in such a step by kinds of its own: it sets the fourth
number of the nodes, and changes particles by what they gather of it (`CorrectionKinds`).
"""

from typing import Any, NamedTuple

from vgmpi.kernels.grid.divided_nodes import average_phases
from vgmpi.kernels.grid.update import momentum_to_velocity
from vgmpi.kernels.kernel_arguments import NODE_MASS_FLOOR
from vgmpi.kernels.nodal_fields.carried_values import mean_over_set
from vgmpi.kernels.particle_records import (
    AFFINE,
    BATCH,
    PATCH,
    box_of,
    compute_weights,
    load_patch,
    node_range_with_walls,
    patch_of,
    prefetch_patch,
    split_scratch,
    zero_padding,
)
from vgmpi.kernels.reaction_impulses import momentum_mirror_fraction
from vgmpi.kernels.reproducible_sums import blocks_at, finalize_node_block, sums_at
from vgmpi.kernels.simd.row_ops import tile
from vgmpi.kernels.simd.static_dispatch import static_dispatch
from vgmpi.kernels.simd.vector16 import load, pointer, store
from vgmpi.kernels.stencil_sums import gather_affine, gather_gradient
from vgmpi.kernels.wall_boundary import complete_wall_mass, fill_ghost_velocity
from vgmpi.runtime.jit import borrowing_kernel, device_function, kernel

from .g2p import unpack_gathered


class CorrectionKinds(NamedTuple):
    """Kinds by which a feature takes part in a step of no time."""

    nodes: Any  # kind of `set_fourth_number`
    particles: Any  # kind of `store_excess`, `relax_state` and `move_particles`
    groups: frozenset[int]  # groups whose particles it changes

    def kind_of(self, group: int) -> Any:
        """Return the kind for the particles of a group, or None."""
        return self.particles if group in self.groups else None


@static_dispatch
def set_fourth_number(kind, b, tables, nodes, numbers, phases, dx):
    """Set the fourth number of the nodes of a block, in place of the mass.

    Args:
        kind: Kind of the feature.
        b: The block.
        tables: Node blocks of the rank.
        nodes: Velocity and mass of the nodes, flat (in/out).
        numbers: Nodal field of steps of no time, flat; `nodes` without one.
        phases: Constants of the phases.
        dx: Cell size [m].
    """


@static_dispatch
def store_excess(kind, patch, excess, box):
    """Store what moves particles in another patch; return whether there is any.

    Args:
        kind: Kind of the feature.
        patch: Patch of the nodes.
        excess: Patch (out), by whose fourth number particles move.
        box: Node range of the segment.
    """


@static_dispatch
def excess_of(kind, number):
    """Return what `store_excess` stores for the fourth number of a node."""


@static_dispatch
def relax_state(kind, f, p, cap, records, offset):
    """Change the channels of 16 particles.

    Args:
        kind: Kind of the feature.
        f: Particle channels, flat (in/out).
        p: Index of the first particle.
        cap: Stride of channels.
        records: Gathered records of the nodes.
        offset: Offset of the first record.
    """


@static_dispatch
def move_particles(kind, f, xi, p, cap, records, offset, limit):
    """Move 16 particles.

    Args:
        kind: Kind of the feature.
        f: Particle channels; they supply the precision.
        xi: Fixed-point positions, flat (in/out).
        p: Index of the first particle.
        cap: Stride of channels.
        records: Records with the excess as fourth number, and its gradient as slopes.
        offset: Offset of the first record.
        limit: Range of positions inside the domain, shape (3, 2) [cells from the block center].
    """


@borrowing_kernel
def momentum_to_velocity_only(
    blocks, tables, momentum, as_one, phases, kind, extra, extra_field, step, report
):  # fmt: skip
    """Compute the velocities [m/s] at the nodes of some blocks, from momentum alone.

    Gravity, contact and walls do not act; see kernels/grid/update.py.

    Args:
        blocks, tables: Blocks to process, shape (n,), and node blocks of the rank.
        momentum: Momentum sums (in/out).
        as_one: (phases,) phases of one number share one velocity; -1: each has its own.
        phases, step: See kernels/kernel_arguments.py.
        kind: Kind of a feature that takes part (`set_fourth_number`), or None.
        extra: Sums of its field (in/out), or None if it has none.
        extra_field: Number of that field in the report.
        report: Accumulator overflows (in/out), see kernels/reproducible_sums.py.
    """
    rows, moved = blocks_at(tables), sums_at(momentum)
    first, phase_of, cell_mass = pointer(tables.first), rows.phase, pointer(phases.min_cell_mass)
    push, nodes = tile(step.gravity_increment, 0), moved.nodes
    for b in blocks:
        n0, n1 = first[b], first[b + 1]
        for nb in range(n0, n1):
            finalize_node_block(nb, rows, moved, report, 0)
        for nb in range(n0, n1):
            group = as_one[phase_of[nb]]
            is_done = False
            for other in range(n0, nb):
                is_done = is_done or as_one[phase_of[other]] == group
            if group < 0:
                momentum_to_velocity(nb, nodes, push, NODE_MASS_FLOOR * cell_mass[phase_of[nb]])
            elif not is_done:
                mean_over_set(nb, n1, group, phase_of, as_one, nodes)
        average_phases(phases, n0, n1, tables.solid[b], phase_of, nodes, step.dx)
        numbers = nodes
        if extra is not None:
            numbers = sums_at(extra).nodes
            for nb in range(n0, n1):
                finalize_node_block(nb, rows, sums_at(extra), report, extra_field)
        if kind is not None:
            set_fourth_number(kind, b, tables, nodes, numbers, phases, step.dx)


@kernel
def apply_transfer_correction(
    rows, times, segments, particles, velocity, scratch, dx, kind, ghosts
):  # fmt: skip
    """Add to each particle `times` the loss of its velocity and gradient in a transfer.

    Args:
        rows: Segments to process, shape (n,).
        times: Number of transfers to correct.
        segments, particles: Segment table and particle arrays (in/out) of the group, see
        kernels/kernel_arguments.py.
        velocity: Grid velocities, shape (node blocks, 256) [m/s].
        scratch: Scratch of the calling thread.
        dx: Cell size [m].
        kind: Kind of a feature that changes these particles, see `CorrectionKinds`, or None.
        ghosts: Ghost-node bookkeeping for reaction forces, or None.
    """
    cap = particles.f.shape[1]
    f, xi = particles.f.reshape(particles.f.size), particles.xi.reshape(particles.xi.size)
    start, count, table, mirror = segments.start, segments.count, segments.table, segments.mirror
    limit = segments.limit
    weights, records, patch, _ = split_scratch(scratch.real)
    patch[PATCH:] = 0
    base, box = scratch.integers, box_of(scratch.integers)
    flat = pointer(velocity.reshape(velocity.size))
    mirror_fraction = momentum_mirror_fraction(ghosts)
    for q in range(len(rows)):
        s = rows[q]
        if q + 1 < len(rows):
            prefetch_patch(flat, table[rows[q + 1]])
        node_range_with_walls(count[s], start[s], cap, xi, f, mirror[s], box)
        load_patch(patch, velocity, table[s], box)
        fill_ghost_velocity(patch, mirror[s], ghosts, mirror_fraction, s)
        if kind is not None:
            complete_wall_mass(patch, mirror[s])
            excess = patch_of(scratch.real, 0)
            moves = store_excess(kind, patch, excess, box)
        for first in range(0, count[s], BATCH):
            n = min(BATCH, count[s] - first)
            offset = start[s] + first
            compute_weights(n, offset, cap, xi, f, base, weights)
            gather_affine(n, records, weights, base, patch)
            zero_padding(n, records)
            for m in range(0, n, 16):
                correct_vector(f, offset + m, cap, times, records, 16 * m, dx)
            if kind is not None:
                for m in range(0, n, 16):
                    relax_state(kind, f, offset + m, cap, records, 16 * m)
                if moves:
                    gather_gradient(n, records, weights, base, excess)
                    zero_padding(n, records)
                    for m in range(0, n, 16):
                        move_particles(kind, f, xi, offset + m, cap, records, 16 * m, limit[s])


@device_function
def correct_vector(f, p, cap, times, records, offset, dx):
    """Correct the velocity and its gradient of 16 particles.

    Args:
        f: Particle channels, flat (in/out).
        p: Index of the first particle.
        cap: Stride of channels.
        times: Number of transfers to correct.
        records: Gathered records.
        offset: Offset of the first record.
        dx: Cell size [m].
    """
    v0, v1, v2, _, L = unpack_gathered(records, offset, 4.0 / dx)
    q = p + AFFINE * cap
    _correct_channel(f, p, times, v0)
    _correct_channel(f, p + cap, times, v1)
    _correct_channel(f, p + 2 * cap, times, v2)
    _correct_channel(f, q, times, L[0])
    _correct_channel(f, q + cap, times, L[1])
    _correct_channel(f, q + 2 * cap, times, L[2])
    _correct_channel(f, q + 3 * cap, times, L[3])
    _correct_channel(f, q + 4 * cap, times, L[4])
    _correct_channel(f, q + 5 * cap, times, L[5])
    _correct_channel(f, q + 6 * cap, times, L[6])
    _correct_channel(f, q + 7 * cap, times, L[7])
    _correct_channel(f, q + 8 * cap, times, L[8])


@device_function
def _correct_channel(f, p, times, remainder):
    """Correct one number of 16 particles, of which a transfer leaves `remainder`."""
    own = load(f, p)
    store(f, p, own + times * (own - remainder))

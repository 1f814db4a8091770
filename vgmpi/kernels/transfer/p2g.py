"""Particle-to-grid transfer (P2G) on one private patch per segment.

The transfer uses quadratic B-splines, APIC and the MLS force, and handles 16 particles or one row
of nodes at a time.

A segment is the particles of one group (one phase, one material) whose base node lay in one 4^3
block when they were last sorted. Its patch holds the 8^3 nodes -1..6 of that block, so that a
particle may stray one cell before the next sort. A patch is filled by one thread in particle order;
nothing else touches it. Positions are integers, 2^-bits of a cell, relative to the middle of the
block: slow motion in single precision then loses nothing.

What a particle brings is in kernels/nodal_fields: mass, momentum and stress in momentum.py.

Both directions, this and g2p.py, go through records (kernels/particle_records.py). Batches of 128
begin at the segment's start; the batch is part of the numerical definition, since a run of
particles with one base node is summed before it is added to the patch.
"""

from vgmpi.kernels.nodal_fields import (  # noqa: F401  (contributions)
    carried_values,
    momentum,
    stress_impulse,
    surface_distance,
    velocity_gradient,
)
from vgmpi.kernels.nodal_fields.field_protocol import (
    MIRROR_NONE,
    accumulate,
    particle_contribution,
)
from vgmpi.kernels.particle_records import (
    BATCH,
    box_of,
    clear,
    compute_weights,
    node_range,
    node_range_with_walls,
    split_scratch,
)
from vgmpi.kernels.reproducible_sums import accumulate_patch
from vgmpi.kernels.simd.vector16 import pointer
from vgmpi.kernels.wall_boundary import fold_ghost_momentum
from vgmpi.runtime.jit import kernel

from . import liquid_volume  # noqa: F401  (contributions)


@kernel
def particles_to_grid(rows, kind, law, segments, particles, sums, scratch, dt, ghosts):
    """Accumulate the particles' contributions to one nodal field.

    Each segment is summed into its patch, and the patch is added to the reproducible sums.

    Args:
        rows: Segments to process, shape (n,).
        kind: Contribution kind of the field, see nodal_fields/field_protocol.py.
        law: Material parameters of the group.
        segments, particles: Segment table and particle arrays of the group, see
        kernels/kernel_arguments.py.
        sums: Accumulators (in/out), shape (rows, words, 256).
        scratch: Scratch of the calling thread.
        dt: Time step [s].
        ghosts: Ghost-node bookkeeping for reaction forces, or None.
    """
    cap = particles.f.shape[1]
    f, xi = particles.f.reshape(particles.f.size), particles.xi.reshape(particles.xi.size)
    totals = pointer(sums.reshape(sums.size))
    weights, records, patch, extra = split_scratch(scratch.real)
    peak = pointer(scratch.peak)
    base, box = scratch.integers, box_of(scratch.integers)
    start, count, into, mirror = (
        segments.start,
        segments.count,
        segments.accumulator_rows,
        segments.mirror,
    )
    for s in rows:
        if kind.mirror != MIRROR_NONE:
            node_range_with_walls(count[s], start[s], cap, xi, f, mirror[s], box)
        else:
            node_range(count[s], start[s], cap, xi, f, box)
        clear(patch, box)
        for first in range(0, count[s], BATCH):
            n = min(BATCH, count[s] - first)
            offset = start[s] + first
            compute_weights(n, offset, cap, xi, f, base, weights)
            particle_contribution(kind, law, n, offset, cap, f, extra, peak, records, dt)
            accumulate(kind, n, records, weights, base, patch)
        if kind.mirror != MIRROR_NONE:
            fold_ghost_momentum(patch, mirror[s], kind.mirror, ghosts, s)
        accumulate_patch(patch, totals, into[s], box)

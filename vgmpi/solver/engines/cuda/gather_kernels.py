"""GPU loops of the transfers from nodes to particles, around the functions of kernels/.

A block of threads processes a segment, a thread a particle.
"""

import numpy as np
from numba import cuda

from vgmpi.kernels import reaction_impulses
from vgmpi.kernels.particle_records import PATCH, compute_weights
from vgmpi.kernels.rigid.prescribed_transfer import advect_prescribed as carry
from vgmpi.kernels.simd.material_dispatch import is_liquid
from vgmpi.kernels.stencil_sums import gather_affine, gather_gradient, gather_value
from vgmpi.kernels.transfer import transfer_correction
from vgmpi.kernels.transfer.auxiliary_gather import gather_batch, load_patches
from vgmpi.kernels.transfer.g2p import ParticlePointers, _update_particles, update_deformation_lanes
from vgmpi.kernels.transfer.transfer_correction import excess_of, move_particles, relax_state
from vgmpi.kernels.wall_boundary import complete_wall_mass, fill_ghost_velocity

from .grid_kernels import own_ghosts
from .particle_intrinsics import gather
from .thread_block import each, meet, number, rank

TEAM = 16
REAL = None
SPLINES = False
BESIDE = PATCH


def _begin(real, s, segments, velocity, ghosts):
    """Load a segment's patch of velocities, reflected at walls, into real."""
    gather(real, velocity, segments.table[s], 0)
    fill_ghost_velocity(
        real, segments.mirror[s], ghosts, reaction_impulses.momentum_mirror_fraction(ghosts), s
    )
    meet()


def g2p(
    rows, law, segments, particles, velocity, auxiliary, numbers, motion, maxima, worst, ghosts
):
    """Transfer velocities to particles and advect them: kernels/transfer/g2p.py.

    Args:
        rows: Segments to process.
        law: Material law.
        segments, particles: Tables of the group; particles (in/out).
        velocity, auxiliary: Nodal velocities, and kind of the auxiliary gather.
        numbers, motion: Constants of the group and of the step.
        maxima (in/out): Shape (6,), see particle_intrinsics.record_maxima.
        worst (in/out): Lowest failed id times 8 plus reason, shape (1,).
        ghosts: Ghost nodes for reactions, or None.
    """
    now, point = cuda.local.array(3, np.int64), cuda.local.array(6, np.float64)
    own = own_ghosts(ghosts, now, point)
    real, s = cuda.shared.array(BESIDE, REAL), rows[number()]
    _begin(real, s, segments, velocity, own)
    if is_liquid(law) and numbers.completes > 0.0:
        complete_wall_mass(real, segments.mirror[s])
    split = segments.split[s]
    if split:
        load_patches(auxiliary, segments.table[s], 0, segments.mirror[s], real, own, s)
    meet()
    cap = particles.ids.size
    f, xi = particles.f, particles.xi
    cloud = ParticlePointers(f, xi, particles.ids, cap)
    weights = cuda.local.array(16, REAL)
    record = cuda.local.array(16, REAL)
    extra = cuda.local.array(8, REAL)
    base = cuda.local.array(1, np.int32)
    local_maxima = cuda.local.array(6, REAL)
    lowest = cuda.local.array(1, np.int64)
    for c in range(6):
        local_maxima[c] = 0
    lowest[0] = worst[0]
    for n in each(segments.count[s]):
        p = segments.start[s] + n
        compute_weights(1, p, cap, xi, f, base, weights)
        if split:
            gather_batch(auxiliary, 1, weights, record, base, real, extra)
        if SPLINES:
            gather_gradient(1, record, weights, base, real)
        else:
            gather_affine(1, record, weights, base, real)
        _update_particles(law, 1, p, cloud, record, auxiliary, split, extra, numbers,
        segments.limit[s], motion,
              (local_maxima, lowest))  # fmt: skip
    _unite(local_maxima, lowest, maxima, worst)


def _unite(local_maxima, lowest, maxima, worst):
    """Merge the maxima of a block into those of all blocks."""
    table = cuda.shared.array((6, TEAM), REAL)
    t, n = rank(), TEAM // 2
    for c in range(6):
        table[c, t] = local_maxima[c]
    meet()
    while n > 0:
        if t < n:
            for c in range(6):
                table[c, t] = max(table[c, t], table[c, t + n])
        meet()
        n //= 2
    if t < 6:
        cuda.atomic.max(maxima, t, table[t, 0])
    if lowest[0] < worst[0]:
        cuda.atomic.min(worst, 0, lowest[0])


def give_back(rows, times, segments, particles, velocity, dx, kind, ghosts):
    """Compensate the motion lost in transfers: kernels/transfer/transfer_correction.py.

    Args:
        rows, times: Segments to process, and factor of the loss.
        segments, particles: Tables of the group; particles (in/out).
        velocity, dx: Nodal velocities of a step of no time, and cell size [m].
        kind, ghosts: Kind of a feature, and ghost nodes for reactions; each may be None.
    """
    now, point = cuda.local.array(3, np.int64), cuda.local.array(6, np.float64)
    own = own_ghosts(ghosts, now, point)
    real, s = cuda.shared.array(BESIDE, REAL), rows[number()]
    _begin(real, s, segments, velocity, own)
    if kind is not None:
        meet()
        complete_wall_mass(real, segments.mirror[s])
        meet()
    cap = particles.ids.size
    f, xi = particles.f, particles.xi
    weights = cuda.local.array(16, REAL)
    record = cuda.local.array(16, REAL)
    base = cuda.local.array(1, np.int32)
    for n in each(segments.count[s]):
        p = segments.start[s] + n
        compute_weights(1, p, cap, xi, f, base, weights)
        gather_affine(1, record, weights, base, real)
        transfer_correction.correct_vector(f, p, cap, times, record, 0, dx)
        if kind is not None:
            relax_state(kind, f, p, cap, record, 0)
    if kind is not None:
        meet()
        for k in each(PATCH // 4):
            real[4 * k + 3] = excess_of(kind, real[4 * k + 3])
        meet()
        for n in each(segments.count[s]):
            p = segments.start[s] + n
            compute_weights(1, p, cap, xi, f, base, weights)
            gather_gradient(1, record, weights, base, real)
            move_particles(kind, f, xi, p, cap, record, 0, segments.limit[s])


def take(rows, channel, segments, particles, nodes):
    """Transfer values to particles: kernels/nodal_fields/carried_values.py.

    Args:
        rows: Segments to process.
        channel: First channel of the values.
        segments, particles: Tables of the group; particles (in/out).
        nodes: Nodal values.
    """
    real = cuda.shared.array(BESIDE, REAL)
    s = rows[number()]
    gather(real, nodes, segments.table[s], 0)
    cap = particles.ids.size
    f, xi = particles.f, particles.xi
    weights = cuda.local.array(16, REAL)
    record = cuda.local.array(16, REAL)
    base = cuda.local.array(1, np.int32)
    for n in each(segments.count[s]):
        p = segments.start[s] + n
        compute_weights(1, p, cap, xi, f, base, weights)
        gather_value(1, record, weights, base, real)
        for c in range(3):
            f[(channel + c) * cap + p] = record[c]


def follow(rows, segments, particles, first, dt):
    """Update deformation gradients that laws do not have: kernels/transfer/g2p.py.

    Args:
        rows: Segments to process.
        segments, particles: Tables of the group; particles (in/out).
        first: First channel of F.
        dt: Length of the step [s].
    """
    s, cap, f = rows[number()], particles.ids.size, particles.f
    for n in each(segments.count[s]):
        update_deformation_lanes(f, segments.start[s] + n, cap, first, dt)


def advect_prescribed(
    rows, segments, block, particles, phase, motions, turned, dx, dt, motion, maxima, worst
):
    """Advect particles with prescribed motion: kernels/rigid/prescribed_transfer.py.

    Args:
        rows: Segments to process.
        segments, block: Segment table of the group, and blocks of its segments.
        particles (in/out): Particle arrays.
        phase, motions: Velocity field of the group, and motions.
        turned: Channels that rotate with the body.
        dx, dt: Cell size [m] and length of the step [s].
        motion: Constants of the step.
        maxima (in/out): Maxima, shape (6,) float64.
        worst (in/out): Lowest failed id times 8 plus reason, shape (1,).
    """
    lowest = cuda.local.array(1, np.int64)
    lowest[0] = worst[0]
    q = number()
    carry(rows[q : q + 1], segments, block, particles, phase, motions, turned, dx, dt, motion,
          (maxima, lowest))  # fmt: skip
    if lowest[0] < worst[0]:
        cuda.atomic.min(worst, 0, lowest[0])

"""GPU loops of the transfers between particles and nodes, around the functions of kernels/.

Particles to grid: a team of 16 threads processes a segment. Each thread is a particle that writes
its record, then one number of the four nodes of each row, for which it sums runs of records as the
CPU does. Every number of a patch belongs to one thread (node along z modulo 4, number in the node),
so that rows need no synchronization. Grid to particles: a block processes a segment, a thread a
particle.
"""

import math

import numpy as np
from numba import cuda

from vgmpi.kernels import particle_records, reaction_impulses, stencil_sums
from vgmpi.kernels.nodal_fields.field_protocol import (
    MIRROR_MOMENT,
    MIRROR_NONE,
    particle_contribution,
)
from vgmpi.kernels.particle_records import PATCH, compute_weights
from vgmpi.kernels.rigid.prescribed_transfer import advect_prescribed as carry
from vgmpi.kernels.stencil_sums import gather_affine, gather_gradient, gather_value
from vgmpi.kernels.transfer import transfer_correction
from vgmpi.kernels.transfer.auxiliary_gather import gather_batch, load_patches, prepare_patch
from vgmpi.kernels.transfer.deformation_gradient import update_deformation_lanes
from vgmpi.kernels.transfer.g2p import ParticlePointers, _update_particles
from vgmpi.kernels.transfer.particle_shifting import TOLERATED_FILL, relax_volume, shift_positions
from vgmpi.kernels.wall_boundary import (
    complete_wall_mass,
    fill_ghost_velocity,
    fold_ghost_momentum,
)

from .grid_kernels import own_ghosts
from .particle_intrinsics import gather
from .thread_block import each, meet, number, rank
from .translation_types import SIMULATED

RUN = particle_records.BATCH  # records after which a run always ends
ROW, PLANE = particle_records.ROW, particle_records.PLANE
PITCH = 17  # numbers between records in shared memory, against bank conflicts
ROOM = PATCH + 16
BLOCK = 256
TIES = 1.0 + 2.0**-52  # kernels/reproducible_sums.py
TEAM = TEAMS = 16
REAL = None
WORDS = 1
SPLINES = False
BESIDE = PATCH


def fill(rows, kind, law, segments, particles, sums, bias, phase, peaks, dt, along, ghosts):
    """Add the contributions of segments to a nodal field, kernels/transfer/p2g.py.

    Args:
        rows: Segments to process.
        kind, law: Kind of the contribution, and material law.
        segments, particles: Tables of the group.
        sums (in/out): Sums, shape (256 words rows,).
        bias, phase: Bias, shape (phases, words, 16), and phase of the group.
        peaks (in/out): Largest stress over density.
        dt: Length of the step [s].
        along: Whether the field uses B-spline gradients.
        ghosts: Ghost nodes for reactions, or None.
    """
    patches = cuda.shared.array((TEAMS, ROOM), REAL)
    words = cuda.shared.array((TEAMS, 2 * 16 * PITCH), REAL)
    bases = cuda.shared.array((TEAMS, 16), np.int32)
    q = number()
    if q < len(rows):
        s, team = rows[q], cuda.threadIdx.x // TEAM
        patch = patches[team]
        for k in each(ROOM):
            patch[k] = 0
        meet()
        peak = _sums(s, kind, law, segments, particles, patch, words[team], bases[team], dt,
                     along)  # fmt: skip
        cuda.atomic.max(peaks, 0, peak)
        meet()
        if kind.mirror != MIRROR_NONE:
            now, point = cuda.local.array(3, np.int64), cuda.local.array(6, np.float64)
            own = own_ghosts(ghosts, now, point)
            fold_ghost_momentum(patch, segments.mirror[s], kind.mirror == MIRROR_MOMENT, own, s)
            meet()
        _push(patch, segments.accumulator_rows[s], sums, bias[phase])


def _sums(s, kind, law, segments, particles, patch, words, bases, dt, along):
    """Sum the contributions of a segment into its patch; return the thread's peak (Scratch)."""
    cap, lane = particles.ids.size, rank()
    f, xi = particles.f, particles.xi
    extra = cuda.local.array(8, REAL)
    peak = cuda.local.array(1, REAL)
    peak[0] = 0
    own = words[lane * PITCH : lane * PITCH + 16]
    record = words[(16 + lane) * PITCH : (16 + lane) * PITCH + 16]
    weights, written = words[: 16 * PITCH], words[16 * PITCH :]
    last, sums = -1, nothing()
    for first in range(0, segments.count[s], 16):
        n = min(16, segments.count[s] - first)
        if lane < n:
            p = segments.start[s] + first + lane
            compute_weights(1, p, cap, xi, f, bases[lane : lane + 1], own)
            particle_contribution(kind, law, 1, p, cap, f, extra, peak, record, dt)
        meet()
        for m in range(n):
            base = bases[m]
            if SPLINES and along:
                _along_slopes(written, weights, m, patch, base)
                meet()
            else:
                if base != last or (first + m) % RUN == 0:
                    _flush(patch, last, sums)
                    last, sums = base, nothing()
                sums = _accumulate_record(sums, written, weights, PITCH * m, _node(base))
        meet()
    _flush(patch, last, sums)
    return peak[0]


def nothing():
    """Return zero sums of nine rows."""
    zero = REAL(0.0)
    return zero, zero, zero, zero, zero, zero, zero, zero, zero


def _node(base):
    """Return the node of a row that is this thread's, in a run with that base row.

    Its place along z equals the thread's own, modulo 4.
    """
    return ((rank() >> 2) - (base >> 2)) & 3


def _accumulate_record(sums, written, weights, m, node):
    """Return the sums with one more record (stencil_sums._runs_whole)."""
    k, w = REAL(node), weights[m + 8 + node]
    a, b, c, da, db, dc = row_terms(written, weights, m, k, w)
    r0, r1, r2, r3, r4, r5, r6, r7, r8 = sums
    u = weights[m]
    r0, r1, r2 = r0 + u * a, r1 + u * b, r2 + u * c
    a, b, c = a + da, b + db, c + dc
    u = weights[m + 1]
    r3, r4, r5 = r3 + u * a, r4 + u * b, r5 + u * c
    a, b, c = a + da, b + db, c + dc
    u = weights[m + 2]
    return r0, r1, r2, r3, r4, r5, r6 + u * a, r7 + u * b, r8 + u * c


def _along_slopes(written, weights, m, patch, base):
    """Add a record with the gradients of the B-splines."""
    node, o = rank() >> 2, base + (rank() & 3)
    if node == 0:
        slopes_0(m, m + 1, written, weights, patch, o)
    elif node == 1:
        slopes_1(m, m + 1, written, weights, patch, o)
    elif node == 2:
        slopes_2(m, m + 1, written, weights, patch, o)


def _flush(patch, base, sums):
    """Add the sums of a run to its nine rows; base: base row, -1 before the first run."""
    if base >= 0 and _node(base) < 3:
        o = base + 4 * _node(base) + (rank() & 3)
        for i in range(3):
            for j in range(3):
                patch[o + i * PLANE + j * ROW] += sums[3 * i + j]


def _push(patch, blocks, sums, bias):
    """Add the nodes of a patch to the sums of the 27 node blocks around it.

    Each term is a multiple of its quantum, so that any order gives the same sums.
    """
    for q in each(PATCH):
        x = np.float64(patch[q])
        if x != 0.0:
            i, j, k = (q >> 8) + 3, ((q >> 5) & 7) + 3, ((q >> 2) & 7) + 3
            nb = blocks[(i >> 2) * 9 + (j >> 2) * 3 + (k >> 2)]
            index = (i & 3) * 64 + (j & 3) * 16 + (k & 3) * 4 + (q & 3)
            for w in range(WORDS):
                r = bias[w, index & 15]
                term = _rounded(x, r)
                cuda.atomic.add(sums, BLOCK * (WORDS * nb + w) + index, term)
                x = x - term


def _rounded(x, r):
    """Return x as a multiple of the quantum of a sum with bias r.

    Terms in single precision have so few digits that rounding the product changes nothing.
    """
    if WORDS == 1:
        return (x * np.float64(TIES) + r) - r
    return fused(x, np.float64(TIES), r) - r


def _fma(x, y, z):
    """Return x y + z, rounded once."""
    return cuda.fma(x, y, z)


def _exact(x, y, z):
    """Return x y + z for y = TIES, rounded once; for the simulator."""
    return np.float64(math.fsum((x, x * (y - 1.0), z)))


fused = _exact if SIMULATED else _fma


# ---- from the nodes -----------------------------------------------------------------------------


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
        maxima (in/out): Shape (6,), see particle.record_maxima.
        worst (in/out): Lowest failed id times 8 plus reason, shape (1,).
        ghosts: Ghost nodes for reactions, or None.
    """
    now, point = cuda.local.array(3, np.int64), cuda.local.array(6, np.float64)
    own = own_ghosts(ghosts, now, point)
    real, s = cuda.shared.array(BESIDE, REAL), rows[number()]
    _begin(real, s, segments, velocity, own)
    prepare_patch(auxiliary, real, segments.mirror[s])
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


def give_back(rows, times, segments, particles, velocity, dx, shift, ghosts):
    """Compensate the motion lost in transfers: kernels/transfer/transfer_correction.py.

    Args:
        rows, times: Segments to process, and factor of the loss.
        segments, particles: Tables of the group; particles (in/out).
        velocity, dx: Nodal velocities of a step of no time, and cell size [m].
        shift, ghosts: Constants of a shift, and ghost nodes for reactions; each may be None.
    """
    now, point = cuda.local.array(3, np.int64), cuda.local.array(6, np.float64)
    own = own_ghosts(ghosts, now, point)
    real, s = cuda.shared.array(BESIDE, REAL), rows[number()]
    _begin(real, s, segments, velocity, own)
    if shift is not None:
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
        if shift is not None:
            relax_volume(f, p, cap, record, 0, shift)
    if shift is not None:
        meet()
        for k in each(PATCH // 4):
            real[4 * k + 3] = max(real[4 * k + 3] - REAL(TOLERATED_FILL), REAL(0))
        meet()
        for n in each(segments.count[s]):
            p = segments.start[s] + n
            compute_weights(1, p, cap, xi, f, base, weights)
            gather_gradient(1, record, weights, base, real)
            shift_positions(f, xi, p, cap, record, 0, segments.limit[s], shift)


def take(rows, channel, segments, particles, nodes):
    """Transfer colors to particles: kernels/nodal_fields/color.py.

    Args:
        rows: Segments to process.
        channel: First channel of the color.
        segments, particles: Tables of the group; particles (in/out).
        nodes: Nodal colors.
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
    """Update deformation gradients that laws do not have: kernels/transfer/deformation_gradient.py.

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


row_terms = stencil_sums._row_terms
slopes_0, slopes_1, slopes_2 = (stencil_sums._scatter_slopes(node, 1) for node in range(3))

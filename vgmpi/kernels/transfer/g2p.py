"""Grid-to-particle transfer (G2P) and the particle update.

Every particle gathers the velocity and its gradient; from them follow the state of its law, its new
position and the bounds on the next step. See p2g.py.

A law with plasticity keeps the elastic part of its deformation, a fluid its volume. Where a body's
Gaussians are to follow the whole deformation, the total deformation gradient is stored besides the
law's state, and nothing else reads it.
"""

from typing import NamedTuple

import numpy as np

from vgmpi.kernels.kernel_arguments import (
    J_MAX,
    J_MIN,
    MAX_VOLUME_STRAIN_PER_STEP,
)
from vgmpi.kernels.particle_records import (
    AFFINE,
    BATCH,
    PATCH,
    STATE,
    box_of,
    compute_weights,
    load_patch,
    load_tensor,
    node_range_with_walls,
    prefetch_channels,
    prefetch_patch,
    split_scratch,
    zero_padding,
)
from vgmpi.kernels.reaction_impulses import momentum_mirror_fraction
from vgmpi.kernels.simd.material_dispatch import (
    advance,
    is_liquid,
    load_state_vector,
    store_state_vector,
    volume_ratio,
    wave_speed2,
)
from vgmpi.kernels.simd.row_ops import (
    add_fixed_point,
    broadcast,
    horizontal_max,
    load_records,
    max_ignore_nan,
)
from vgmpi.kernels.simd.vector16 import ALL_LANES, SIMD_WIDTH, in_range_mask, masked, pointer, store
from vgmpi.kernels.stencil_sums import gather_affine, gather_gradient
from vgmpi.kernels.step_records import FAILED_ID, FAILURE, GRADIENT2, RATE, SPEED, STRAY
from vgmpi.kernels.wall_boundary import complete_wall_mass, fill_ghost_velocity
from vgmpi.materials.tensor_math.tensor import update_deformation_gradient
from vgmpi.runtime.jit import borrowing_kernel, device_function, kernel

from .auxiliary_gather import (
    advection_velocity,
    bounded_volume_rate,
    displacement,
    gather_batch,
    load_patches,
    max_velocity,
    particle_velocity,
    velocity_gradient,
    wave_speed_squared,
)
from .liquid_volume import reduce_spray_divergence

MAX_STRAY_CELLS = (
    3  # [cells] distance from the block center within which a base node lies in its patch
)
INVALID_VOLUME, OUT_OF_DOMAIN, CFL_EXCEEDED, NOT_FINITE = 1, 2, 3, 4  # failure codes of a particle
FASTEST_WAVE = 1e15  # [m/s] its square is below the largest single-precision number


class GroupConstants(NamedTuple):
    """Constants of a group, in the working precision."""

    splines: float  # 1: strains by the gradients of the B-splines, 0: by moments
    dx: float  # [m] cell size
    space: float  # filled fraction per fourth nodal number of a liquid that softens its spray, or 0
    completes: float  # 1: the masses of a liquid at the nodes of walls are completed


class StepConstants(NamedTuple):
    """Constants of a step.

    The dither is added before positions are rounded down; it is the same for all particles.
    """

    dt: float  # [s] time step, in the working precision
    cfl: float  # [-] CFL number
    max_cells: float  # [cells] largest displacement of a particle, in double precision
    units_per_cell: float  # units of the fixed-point positions per cell, 2^bits
    dither_x: float  # [position units]
    dither_y: float
    dither_z: float


class ParticlePointers(NamedTuple):
    """Particle arrays as pointers to their data (vector16.pointer)."""

    f: np.ndarray  # channels
    xi: np.ndarray  # fixed-point positions
    ids: np.ndarray
    cap: int  # stride of channels


@kernel
def grid_to_particles(
    rows, law, segments, particles, velocity, auxiliary, scratch, numbers, motion, report, ghosts
):  # fmt: skip
    """Transfer grid velocities to particles, update their state and advect them.

    Args:
        rows: Segments to process, shape (n,).
        law: Material parameters; their type selects the constitutive update.
        segments, particles: Segment table and particle arrays (in/out) of the group, see
        kernels/kernel_arguments.py.
        velocity: Grid velocities, shape (node blocks, 256) [m/s].
        auxiliary: Kind of the quantities gathered besides velocity, see auxiliary_gather.py.
        scratch: Scratch of the calling thread.
        numbers, motion: Constants of the group and of the step.
        report: Running maxima (in/out), shape (6,): rate 1/dt [1/s], distance from the block center
            [cells], id + 1 of a failed particle and the reason, speed along an axis [cells/s],
            squared norm of the velocity gradient [1/s2].
        ghosts: Ghost-node bookkeeping for reaction forces, or None.
    """
    cap = particles.f.shape[1]
    f, xi = particles.f.reshape(particles.f.size), particles.xi.reshape(particles.xi.size)
    cloud = ParticlePointers(pointer(f), pointer(xi), pointer(particles.ids), cap)
    start, count, table = segments.start, segments.count, segments.table
    split, limit, mirror = segments.split, segments.limit, segments.mirror
    weights, records, patch, extra = split_scratch(scratch.real)
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
        if is_liquid(law) and numbers.completes > 0.0:
            complete_wall_mass(patch, mirror[s])
        if split[s]:
            load_patches(auxiliary, table[s], box, mirror[s], scratch.real, ghosts, s)
        for first in range(0, count[s], BATCH):
            n = min(BATCH, count[s] - first)
            offset = start[s] + first
            compute_weights(n, offset, cap, xi, f, base, weights)
            prefetch_channels(cloud.f, particles.f.shape[0], cap, offset + BATCH)
            prefetch_channels(cloud.xi, 3, cap, offset + BATCH)
            if split[s]:
                gather_batch(auxiliary, n, weights, records, base, scratch.real, extra)
            if numbers.splines > 0.0:
                gather_gradient(n, records, weights, base, patch)
            else:
                gather_affine(n, records, weights, base, patch)
            zero_padding(n, records)
            _update_particles(
                law, n, offset, cloud, records, auxiliary, split[s], extra, numbers, limit[s],
                motion, report,
            )  # fmt: skip


@device_function
def _update_particles(
    law, count, offset, cloud, records, auxiliary, split, extra, numbers, limit, motion, report
):  # fmt: skip
    """Update v, C, state and position of a batch from its gathered records.

    The function also records the quantities that bound the next step.
    """
    f, cap = cloud.f, cloud.cap
    dx, dt = numbers.dx, motion.dt
    k = 4.0 / dx
    fastest = distance = stretching = quick = carried = turning = broadcast(f, 0.0)
    shortest, wave_bound = broadcast(f, -1.0), broadcast(f, FASTEST_WAVE**2)
    min_volume, max_volume, single = broadcast(f, J_MIN), broadcast(f, J_MAX), broadcast(f, 1.0)
    for n in range(0, count, 16):
        p = offset + n
        remaining = count - n
        v0, v1, v2, fill, L = unpack_gathered(records, 16 * n, k)
        slope = mass_slope(records, 16 * n)
        particle_velocity(auxiliary, f, p, cap, extra, n, (v0, v1, v2))
        _store_gradient(f, p, cap, L)
        v0, v1, v2 = advection_velocity(auxiliary, split, extra, n, (v0, v1, v2))
        volume_rate, turns = bounded_volume_rate(auxiliary, L[0] + L[4] + L[8]), squared_norm(L)
        L = velocity_gradient(auxiliary, split, f, p, cap, extra, n, L, fill, slope, numbers)
        if is_liquid(law) and numbers.space > 0.0:
            L = reduce_spray_divergence(L, numbers.space * fill)
        state = advance(law, load_state_vector(law, f, p + STATE * cap, cap), L, dt)
        store_state_vector(f, p + STATE * cap, cap, state)
        J = volume_ratio(law, state)
        wave2 = wave_speed_squared(auxiliary, f, p, cap, wave_speed2(law, state))
        m0, m1, m2 = (dt / dx) * v0, (dt / dx) * v1, (dt / dx) * v2
        longest = max_ignore_nan(abs(m0), max_ignore_nan(abs(m1), abs(m2)))
        # a number that is not finite lies between no bounds
        is_slow = in_range_mask(longest + 0.0 * (m0 + m1 + m2), shortest, single, remaining)
        is_valid = in_range_mask(J, min_volume, max_volume, remaining)
        is_finite = in_range_mask(wave2, shortest, wave_bound, remaining)
        succeeded = is_slow & is_valid & is_finite
        m0, m1, m2 = displacement(auxiliary, extra, n, (m0, m1, m2))
        x, y, z = _advect(
            cloud, p, (masked(succeeded, m0), masked(succeeded, m1), masked(succeeded, m2)), motion
        )
        speed = np.sqrt(v0 * v0 + v1 * v1 + v2 * v2)
        carried = max_ignore_nan(
            masked(succeeded, max_velocity(auxiliary, f, p, cap, longest, dt / dx)), carried
        )
        turning = max_ignore_nan(masked(succeeded, max_ignore_nan(turns, squared_norm(L))), turning)
        fastest = max_ignore_nan(masked(succeeded, np.sqrt(wave2) + speed), fastest)
        quick = max_ignore_nan(masked(succeeded, speed), quick)
        stretching = max_ignore_nan(masked(succeeded, abs(volume_rate)), stretching)
        distance = max_ignore_nan(max_ignore_nan(abs(x), max_ignore_nan(abs(y), abs(z))), distance)
        inside = _inside(f, x, y, z, limit, remaining)
        full = ALL_LANES if remaining >= 16 else (1 << remaining) - 1
        if succeeded & inside != full:
            _record_failure(
                cloud.ids, p, min(16, remaining), is_valid, is_finite, is_slow, inside, report
            )
    record_step_bounds(report, fastest, distance, quick, stretching, carried, turning, motion, dx)


@device_function
def record_step_bounds(report, fastest, distance, quick, stretching, carried, turning, motion, dx):
    """Record the quantities that bound the next step.

    Args:
        report: Running maxima (in/out), see `g2p`.
        fastest: Wave speed plus particle speed [m/s].
        distance: Distance from the block center [cells].
        quick: Particle speed [m/s].
        stretching: Absolute trace of the velocity gradient [1/s].
        carried: Displacement along an axis [cells].
        turning: Squared norm of the velocity gradient [1/s2].
        motion: Constants of the step.
        dx: Cell size [m].
    """
    rate = horizontal_max(fastest) / (motion.cfl * dx)
    rate = max(
        rate,
        horizontal_max(quick) / (motion.max_cells * dx),
        horizontal_max(stretching) / MAX_VOLUME_STRAIN_PER_STEP,
    )
    report[RATE] = max(report[RATE], rate)
    report[STRAY] = max(report[STRAY], horizontal_max(distance))
    report[SPEED] = max(report[SPEED], horizontal_max(carried) / motion.dt)
    report[GRADIENT2] = max(report[GRADIENT2], horizontal_max(turning))


@device_function
def unpack_gathered(records, offset, k):
    """Unpack 16 records: velocity, the fourth number and the velocity gradient."""
    r = load_records(records, offset)
    x, y, z = (k * r[4], k * r[5], k * r[6]), (k * r[8], k * r[9], k * r[10]), (
        k * r[12], k * r[13], k * r[14]
    )  # fmt: skip
    return r[0], r[1], r[2], r[3], (x[0], y[0], z[0], x[1], y[1], z[1], x[2], y[2], z[2])


@device_function
def mass_slope(records, offset):
    """Unpack from 16 records a quarter of the slope per cell of the fourth number."""
    r = load_records(records, offset)
    return r[7], r[11], r[15]


@device_function
def squared_norm(C):
    """Return the sum of the squares of nine entries."""
    first = C[0] * C[0] + C[1] * C[1] + C[2] * C[2]
    second = C[3] * C[3] + C[4] * C[4] + C[5] * C[5]
    return first + second + (C[6] * C[6] + C[7] * C[7] + C[8] * C[8])


@device_function
def _advect(cloud, p, moves, motion):
    """Advect 16 particles and return their positions [cells from the block center].

    Args:
        cloud: Particle pointers (in/out).
        p: Index of the first of the 16 particles.
        moves: Displacement, three components [cells].
        motion: Constants of the step.
    """
    cell_units, cap = motion.units_per_cell, cloud.cap
    x = add_fixed_point(cloud.xi, p, cell_units * moves[0] + motion.dither_x)
    y = add_fixed_point(cloud.xi, p + cap, cell_units * moves[1] + motion.dither_y)
    z = add_fixed_point(cloud.xi, p + 2 * cap, cell_units * moves[2] + motion.dither_z)
    return x, y, z


@device_function
def _inside(f, x, y, z, limit, remaining):
    """Return the mask of the particles inside the domain; f supplies their precision."""
    inside = in_range_mask(x, broadcast(f, limit[0, 0]), broadcast(f, limit[0, 1]), remaining)
    inside &= in_range_mask(y, broadcast(f, limit[1, 0]), broadcast(f, limit[1, 1]), remaining)
    return inside & in_range_mask(
        z, broadcast(f, limit[2, 0]), broadcast(f, limit[2, 1]), remaining
    )


@device_function
def _store_gradient(f, p, cap, C):
    """Store the velocity gradients of 16 particles."""
    q = p + AFFINE * cap
    store(f, q, C[0])
    store(f, q + cap, C[1])
    store(f, q + 2 * cap, C[2])
    store(f, q + 3 * cap, C[3])
    store(f, q + 4 * cap, C[4])
    store(f, q + 5 * cap, C[5])
    store(f, q + 6 * cap, C[6])
    store(f, q + 7 * cap, C[7])
    store(f, q + 8 * cap, C[8])


@device_function
def _record_failure(ids, p, count, is_valid, is_finite, is_slow, inside, report):
    """Record which of 16 particles failed, and why; the masks mark those that did not."""
    for lane in range(count):
        bit = 1 << lane
        if is_valid & bit == 0:
            keep_lowest_id(report, ids[p + lane], INVALID_VOLUME)
        elif is_finite & bit == 0:
            keep_lowest_id(report, ids[p + lane], NOT_FINITE)
        elif is_slow & bit == 0:
            keep_lowest_id(report, ids[p + lane], CFL_EXCEEDED)
        elif inside & bit == 0:
            keep_lowest_id(report, ids[p + lane], OUT_OF_DOMAIN)


@device_function
def keep_lowest_id(report, number, reason):
    """Record the lowest id of the failed particles, and the reason.

    Args:
        report: Running maxima (in/out), see `g2p`.
        number: Particle id.
        reason: Failure code of this module.
    """
    if report[FAILED_ID] == 0.0 or number + 1.0 < report[FAILED_ID]:
        report[FAILED_ID] = number + 1.0
        report[FAILURE] = reason


@borrowing_kernel
def update_total_deformation(segments, start, count, f, first, dt):
    """Update F <- (I + dt C) F with C as just gathered, stored as F - I.

    Unused particle slots have C = 0.

    Args:
        segments: Segments to process, shape (n,).
        start: First particle of each segment.
        count: Number of particles of each segment.
        f: Particle channels (in/out), shape (channels, cap).
        first: First of the nine channels of F - I.
        dt: Time step [s].
    """
    cap = f.shape[1]
    flat = f.reshape(f.size)
    for s in segments:
        for p in range(start[s], start[s] + count[s], SIMD_WIDTH):
            update_deformation_lanes(flat, p, cap, first, dt)


@device_function
def update_deformation_lanes(f, p, cap, first, dt):
    """Update F of 16 particles.

    Args:
        f: Particle channels, flat (in/out).
        p: Index of the first particle.
        cap: Stride of channels.
        first: First of the nine channels of F - I.
        dt: Time step [s].
    """
    q, h = p + AFFINE * cap, p + first * cap
    c, old = load_tensor(f, q, cap), load_tensor(f, h, cap)
    h0, h1, h2, h3, h4, h5, h6, h7, h8 = update_deformation_gradient(old, c, dt)
    store(f, h, h0)
    store(f, h + cap, h1)
    store(f, h + 2 * cap, h2)
    store(f, h + 3 * cap, h3)
    store(f, h + 4 * cap, h4)
    store(f, h + 5 * cap, h5)
    store(f, h + 6 * cap, h6)
    store(f, h + 7 * cap, h7)
    store(f, h + 8 * cap, h8)

"""Particles to grid and back, on one private patch per segment (quadratic B-splines, APIC, MLS
force), 16 particles or one row of nodes at a time.

A segment is the particles of one group (one phase, one material) whose base node lay in one 4^3
block when they were last sorted. Its patch holds the 8^3 nodes -1..6 of that block, so that a
particle may stray one cell before the next sort. A patch is filled by one thread in particle order;
nothing else touches it. Positions are integers, 2^-bits of a cell, relative to the middle of the
block: slow motion in single precision then loses nothing.

Both directions go through records, 16 numbers per particle in a scratch that stays in the first
level cache: what the formulas say of 16 particles at once is transposed into records, and each
record then meets its nine rows of nodes. Batches of 128 begin at the segment's start; the batch is
part of the numerical definition, since a run of particles with one base node is summed before it is
added to the patch.

Channels of a group's float array: velocity 0-2 [m/s], APIC matrix C 3-11 [1/s], rest volume 12
[m3], the law's state 13-.
"""

import numpy as np

from ..device.jit import inline, kernel
from .lanes import load, store
from .laws import advance, lane_state, store_state, stress, volume_ratio, wave_speed2
from .patches import gather
from .rows import (
    SOUND_ALL,
    cell_offset,
    fraction,
    largest,
    load_records,
    move,
    only,
    repeat,
    sound,
    spread,
    steps,
    store_records,
    store_sum,
    store_whole,
    stretch,
)
from .walls import SIDE, fold, reflect

AFFINE, VOLUME, STATE = 3, 12, 13
REACH = 3  # cells from the block's middle within which a particle's base node lies in its patch
BATCH = 128
ROW = SIDE * 4  # numbers of a patch from one (i, j) to (i, j + 1)
PLANE = SIDE * ROW
PATCH = SIDE * PLANE
SCRATCH = BATCH * 16  # numbers a batch of records takes
CRUSHED, OUTSIDE, TOO_FAST, LOST = 1, 2, 3, 4  # what can go wrong with a particle
FASTEST_WAVE = 1e15  # [m/s], squared below the largest single


@inline
def _weigh(count, at, cap, xi, like, base, weights):
    """Weights and base rows of `count` particles from `at`: records of weights, base (count,).

    A record holds per axis the three weights and the base node minus the particle [cells]:
    x 0-3, y 4-7, z 8-10 and 12.
    """
    zero = spread(like, 0.0)
    for n in range(0, count, 16):
        p = at + n
        x, y, z = fraction(xi, p), fraction(xi, cap + p), fraction(xi, 2 * cap + p)
        row = cell_offset(xi, p, PLANE) + cell_offset(xi, cap + p, ROW)
        store_whole(base, n, row + cell_offset(xi, 2 * cap + p, 4))
        ax, ay, az = 1.0 - x, 1.0 - y, 1.0 - z
        cx, cy, cz = x - 0.5, y - 0.5, z - 0.5
        store_records(
            weights,
            16 * n,
            (
                0.5 * ax * ax, 0.75 - cx * cx, 0.5 * x * x, -0.5 - x,
                0.5 * ay * ay, 0.75 - cy * cy, 0.5 * y * y, -0.5 - y,
                0.5 * az * az, 0.75 - cz * cz, 0.5 * z * z, zero,
                -0.5 - z, zero, zero, zero,
            ),
        )  # fmt: skip


@inline
def _momenta(law, count, at, cap, f, records, density, dx, dt):
    """Records of momentum and mass: value at the particle 0-3, its slope per cell along x 4-7, y
    8-11, z 12-15. The stress's impulse over dt is part of the slopes (MLS, Hu 2018)."""
    zero = spread(f, 0.0)
    four = dt * 4.0 / (dx * dx)
    for n in range(0, count, 16):
        p = at + n
        q = p + AFFINE * cap
        c0, c1, c2 = load(f, q), load(f, q + cap), load(f, q + 2 * cap)
        c3, c4, c5 = load(f, q + 3 * cap), load(f, q + 4 * cap), load(f, q + 5 * cap)
        c6, c7, c8 = load(f, q + 6 * cap), load(f, q + 7 * cap), load(f, q + 8 * cap)
        L = (c0, c1, c2, c3, c4, c5, c6, c7, c8)
        t00, t11, t22, t01, t02, t12 = stress(law, lane_state(law, f, p + STATE * cap, cap), L)
        volume = load(f, p + VOLUME * cap)
        mass = density * volume
        k, m = dx * four * volume, dx * mass
        store_records(
            records,
            16 * n,
            (
                mass * load(f, p), mass * load(f, p + cap), mass * load(f, p + 2 * cap), mass,
                m * c0 - k * t00, m * c3 - k * t01, m * c6 - k * t02, zero,
                m * c1 - k * t01, m * c4 - k * t11, m * c7 - k * t12, zero,
                m * c2 - k * t02, m * c5 - k * t12, m * c8 - k * t22, zero,
            ),
        )  # fmt: skip


@inline
def _offsets(count, at, cap, f, records, dx):
    """Records of sum V0 (x_p - x_i) and V0, in the form of `_momenta`: contact asks for them."""
    zero = spread(f, 0.0)
    for n in range(0, count, 16):
        volume = load(f, at + n + VOLUME * cap)
        d = -dx * volume
        store_records(
            records,
            16 * n,
            (
                zero, zero, zero, volume,
                d, zero, zero, zero,
                zero, d, zero, zero,
                zero, zero, d, zero,
            ),
        )  # fmt: skip


@inline
def _scatter(count, records, weights, base, patch):
    """Add records to the patch, nine rows each; particles with one base row are summed first."""
    k = steps(patch)
    zero = spread(patch, 0.0)
    r0, r1, r2, r3, r4, r5, r6, r7, r8 = zero, zero, zero, zero, zero, zero, zero, zero, zero
    here = base[0]
    for n in range(count + 1):
        if n == count or base[n] != here:
            o = np.int64(here)
            store(patch, o, load(patch, o) + r0)
            store(patch, o + ROW, load(patch, o + ROW) + r1)
            store(patch, o + 2 * ROW, load(patch, o + 2 * ROW) + r2)
            o += PLANE
            store(patch, o, load(patch, o) + r3)
            store(patch, o + ROW, load(patch, o + ROW) + r4)
            store(patch, o + 2 * ROW, load(patch, o + 2 * ROW) + r5)
            o += PLANE
            store(patch, o, load(patch, o) + r6)
            store(patch, o + ROW, load(patch, o + ROW) + r7)
            store(patch, o + 2 * ROW, load(patch, o + 2 * ROW) + r8)
            r0, r1, r2, r3, r4, r5, r6, r7, r8 = (
                zero,
                zero,
                zero,
                zero,
                zero,
                zero,
                zero,
                zero,
                zero,
            )
            if n == count:
                break
            here = base[n]
        m = 16 * n
        w = stretch(weights, m + 8)
        along_x, along_y, along_z = (
            repeat(records, m + 4),
            repeat(records, m + 8),
            repeat(records, m + 12),
        )
        a = repeat(records, m) + weights[m + 3] * along_x + weights[m + 7] * along_y
        a = (a + (k + weights[m + 12]) * along_z) * w
        along_x, along_y = w * along_x, w * along_y
        b = a + along_y
        c = b + along_y
        w0, w1, w2 = weights[m + 4], weights[m + 5], weights[m + 6]
        a, b, c = w0 * a, w1 * b, w2 * c
        da, db, dc = w0 * along_x, w1 * along_x, w2 * along_x
        u = weights[m]
        r0, r1, r2 = r0 + u * a, r1 + u * b, r2 + u * c
        a, b, c = a + da, b + db, c + dc
        u = weights[m + 1]
        r3, r4, r5 = r3 + u * a, r4 + u * b, r5 + u * c
        a, b, c = a + da, b + db, c + dc
        u = weights[m + 2]
        r6, r7, r8 = r6 + u * a, r7 + u * b, r8 + u * c


@kernel
def p2g(
    law, segments, start, count, slot, offset_slot, mirror, xi, f, patches, offsets, scratch, base,
    density, dx, dt,
):  # fmt: skip
    """Mass and momentum (with the stress's impulse over dt) of each segment into its patch.

    segments: (n,) the segments to do; slot: (segments,) patch of each; offset_slot: the same for
    the volume-and-offset patch that contact asks for, -1 where it does not; mirror: (segments, 3,
    2) wall codes (walls.py); xi: (3, cap) fixed-point positions; f: (channels, cap); patches:
    (slots, 2048) momentum [kg m/s] and mass [kg] of 8^3 nodes; offsets: (slots, 2048) sum V0 w
    (x_p - x_i) [m4] and sum V0 w [m3]. scratch (2 SCRATCH + PATCH + 16,) and base (BATCH + 16,
    int32) belong to the calling thread.
    """
    cap = f.shape[1]
    flat, flat_xi = f.reshape(f.size), xi.reshape(xi.size)
    weights, records = scratch[:SCRATCH], scratch[SCRATCH : 2 * SCRATCH]
    patch = scratch[2 * SCRATCH :]
    nodes = patch[:PATCH].reshape((SIDE, SIDE, SIDE, 4))
    for s in segments:
        for wanted in range(2):
            if wanted == 1 and offset_slot[s] < 0:
                break
            patch[:] = 0
            for first in range(0, count[s], BATCH):
                n = min(BATCH, count[s] - first)
                at = start[s] + first
                _weigh(n, at, cap, flat_xi, flat, base, weights)
                if wanted == 0:
                    _momenta(law, n, at, cap, flat, records, density, dx, dt)
                else:
                    _offsets(n, at, cap, flat, records, dx)
                _scatter(n, records, weights, base, patch)
            fold(nodes, mirror[s], wanted == 1)
            into = patches[slot[s]] if wanted == 0 else offsets[offset_slot[s]]
            for c in range(PATCH):
                into[c] = patch[c]


@inline
def _gather(count, records, weights, base, patch):
    """Records of velocity 0-2 and of its moments with the offset along x 4-6, y 8-10, z 12-14."""
    k = steps(patch)
    for n in range(count):
        m = 16 * n
        o = np.int64(base[n])
        w0, w1, w2 = weights[m + 4], weights[m + 5], weights[m + 6]
        last = w2 * load(patch, o + 2 * ROW)
        y = w1 * load(patch, o + ROW) + last
        t = w0 * load(patch, o) + y
        y = y + last
        u = weights[m]
        total, total_y = u * t, u * y
        o += PLANE
        last = w2 * load(patch, o + 2 * ROW)
        y = w1 * load(patch, o + ROW) + last
        t = w0 * load(patch, o) + y
        y = y + last
        u = weights[m + 1]
        total_x = u * t
        total, total_y = total + total_x, total_y + u * y
        o += PLANE
        last = w2 * load(patch, o + 2 * ROW)
        y = w1 * load(patch, o + ROW) + last
        t = w0 * load(patch, o) + y
        y = y + last
        u = weights[m + 2]
        far = u * t
        total, total_x, total_y = total + far, total_x + far + far, total_y + u * y
        w = stretch(weights, m + 8)
        total = total * w
        store_sum(records, m, total)
        store_sum(records, m + 4, total_x * w + weights[m + 3] * total)
        store_sum(records, m + 8, total_y * w + weights[m + 7] * total)
        store_sum(records, m + 12, total * (k + weights[m + 12]))
    for m in range(16 * count, 16 * ((count + 15) & ~15)):
        records[m] = 0  # unused places stay at rest


@kernel
def g2p(
    law, segments, start, count, table, limit, mirror, xi, f, ids, grid, scratch, base, bits,
    dither, dx, dt, cfl, report,
):  # fmt: skip
    """Velocity and its gradient from the grid to each particle; moves it and advances its state.

    table: (segments, 27) the node blocks around each segment's block; limit: (segments, 3, 2) range
    of positions [cells from the block's middle]; mirror: (segments, 3, 2) wall codes (walls.py);
    grid: (blocks, 64, 4) velocities [m/s]; scratch and base: see p2g; dither: (3,) added before
    rounding down, the same for all particles of a step; report: (4,) running maxima: rate 1/dt
    [1/s], distance from the block's middle [cells]; then id + 1 of a particle that went wrong and
    the reason.
    """
    cap = f.shape[1]
    flat, flat_xi = f.reshape(f.size), xi.reshape(xi.size)
    flat_grid = grid.reshape((len(grid), 256))
    weights, records = scratch[:SCRATCH], scratch[SCRATCH : 2 * SCRATCH]
    patch = scratch[2 * SCRATCH :]
    nodes = patch[:PATCH].reshape((SIDE, SIDE, SIDE, 4))
    patch[PATCH:] = 0
    for s in segments:
        gather(patch, flat_grid, table[s])
        reflect(nodes, mirror[s])
        for first in range(0, count[s], BATCH):
            n = min(BATCH, count[s] - first)
            at = start[s] + first
            _weigh(n, at, cap, flat_xi, flat, base, weights)
            _gather(n, records, weights, base, patch)
            _move(
                law, n, at, cap, flat_xi, flat, ids, records, limit[s], 2.0**bits, dither, dx, dt,
                cfl, report,
            )  # fmt: skip


@inline
def _move(law, count, at, cap, xi, f, ids, records, limit, one, dither, dx, dt, cfl, report):
    """Take up the gathered records: v, C, state, position; note what bounds the step."""
    k = 4.0 / dx
    fastest = far = stretching = quick = spread(f, 0.0)
    shortest, never = spread(f, -1.0), spread(f, FASTEST_WAVE**2)
    least, most, single = spread(f, 0.1), spread(f, 5.0), spread(f, 1.0)
    for n in range(0, count, 16):
        p = at + n
        left = count - n
        v0, v1, v2, _, c0, c3, c6, _, c1, c4, c7, _, c2, c5, c8, _ = load_records(records, 16 * n)
        c0, c1, c2 = k * c0, k * c1, k * c2
        c3, c4, c5 = k * c3, k * c4, k * c5
        c6, c7, c8 = k * c6, k * c7, k * c8
        store(f, p, v0)
        store(f, p + cap, v1)
        store(f, p + 2 * cap, v2)
        q = p + AFFINE * cap
        store(f, q, c0)
        store(f, q + cap, c1)
        store(f, q + 2 * cap, c2)
        store(f, q + 3 * cap, c3)
        store(f, q + 4 * cap, c4)
        store(f, q + 5 * cap, c5)
        store(f, q + 6 * cap, c6)
        store(f, q + 7 * cap, c7)
        store(f, q + 8 * cap, c8)
        L = (c0, c1, c2, c3, c4, c5, c6, c7, c8)
        state = advance(law, lane_state(law, f, p + STATE * cap, cap), L, dt)
        store_state(f, p + STATE * cap, cap, state)
        J = volume_ratio(law, state)
        wave2 = wave_speed2(law, state)
        m0, m1, m2 = (dt / dx) * v0, (dt / dx) * v1, (dt / dx) * v2
        longest = np.maximum(abs(m0), np.maximum(abs(m1), abs(m2)))
        # not a number lies between no bounds
        slow = sound(longest + 0.0 * (m0 + m1 + m2), shortest, single, left)
        whole = sound(J, least, most, left)
        tame = sound(wave2, shortest, never, left)
        good = slow & whole & tame
        m0, m1, m2 = only(good, m0), only(good, m1), only(good, m2)
        x = move(xi, p, one * m0 + dither[0])
        y = move(xi, p + cap, one * m1 + dither[1])
        z = move(xi, p + 2 * cap, one * m2 + dither[2])
        speed = np.sqrt(v0 * v0 + v1 * v1 + v2 * v2)
        fastest = np.maximum(fastest, only(good, np.sqrt(wave2) + speed))
        quick = np.maximum(quick, only(good, speed))
        stretching = np.maximum(stretching, only(good, abs(c0 + c4 + c8)))
        far = np.maximum(far, np.maximum(abs(x), np.maximum(abs(y), abs(z))))
        inside = sound(x, spread(f, limit[0, 0]), spread(f, limit[0, 1]), left)
        inside &= sound(y, spread(f, limit[1, 0]), spread(f, limit[1, 1]), left)
        inside &= sound(z, spread(f, limit[2, 0]), spread(f, limit[2, 1]), left)
        full = SOUND_ALL if left >= 16 else (1 << left) - 1
        if good & inside != full:
            for lane in range(min(16, left)):
                bit = 1 << lane
                if whole & bit == 0:
                    _note(report, ids[p + lane], CRUSHED)
                elif tame & bit == 0:
                    _note(report, ids[p + lane], LOST)
                elif slow & bit == 0:
                    _note(report, ids[p + lane], TOO_FAST)
                elif inside & bit == 0:
                    _note(report, ids[p + lane], OUTSIDE)
    rate = largest(fastest) / (cfl * dx)
    report[0] = max(report[0], rate, largest(quick) / (0.3 * dx), largest(stretching) / 0.1)
    report[1] = max(report[1], largest(far))


@inline
def _note(report, number, reason):
    """Keep the lowest id of the particles that went wrong, and why."""
    if report[2] == 0.0 or number + 1.0 < report[2]:
        report[2] = number + 1.0
        report[3] = reason

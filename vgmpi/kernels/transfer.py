"""Particles to grid and back, on one private patch per segment (quadratic B-splines, APIC, MLS
force), 16 particles or one row of nodes at a time.

A segment is the particles of one group (one phase, one material) whose base node lay in one 4^3
block when they were last sorted. Its patch holds the 8^3 nodes -1..6 of that block, so that a
particle may stray one cell before the next sort. A patch is filled by one thread in particle order;
nothing else touches it. Positions are integers, 2^-bits of a cell, relative to the middle of the
block: slow motion in single precision then loses nothing.

Both directions go through records (records.py). Batches of 128 begin at the segment's start; the
batch is part of the numerical definition, since a run of particles with one base node is summed
before it is added to the patch.
"""

import numpy as np

from ..device.jit import inline, kernel
from .lanes import load, store
from .laws import advance, lane_state, store_state, volume_ratio, wave_speed2
from .patches import clear, gather, push
from .records import (
    AFFINE,
    BATCH,
    PATCH,
    PLANE,
    ROW,
    SCRATCH,
    STATE,
    momenta,
    offsets,
    reach,
    weigh,
)
from .rows import (
    SOUND_ALL,
    largest,
    load_records,
    move,
    only,
    repeat,
    sound,
    spread,
    steps,
    store_sum,
    stretch,
)
from .walls import SIDE, fold, reflect

REACH = 3  # cells from the block's middle within which a particle's base node lies in its patch
CRUSHED, OUTSIDE, TOO_FAST, LOST = 1, 2, 3, 4  # what can go wrong with a particle
FASTEST_WAVE = 1e15  # [m/s], squared below the largest single


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
    law, segments, border, sent, start, count, slot, offset_slot, into, mirror, xi, f, patches,
    volumes, grid, scratch, base, density, dx, dt,
):  # fmt: skip
    """Mass and momentum (with the stress's impulse over dt) of each segment into its patch, and
    that to the grid.

    segments: (n,) the segments to do; sent: (segments,) whose patches other ranks need: with
    `border` these are filled and kept, later they are only added to the grid in their turn; slot:
    (segments,) where to keep the patch for others to sum, -1 for nowhere; offset_slot: the same for
    the volume-and-offset patch that contact asks for; into: (segments, 27) node blocks around each
    to add the patch to, -1 where it is not this thread's to add; mirror: (segments, 3, 2) wall
    codes (walls.py); xi: (3, cap) fixed-point positions; f: (channels, cap); patches: (slots, 2048)
    momentum [kg m/s] and mass [kg] of 8^3 nodes; volumes: (slots, 2048) sum V0 w (x_p - x_i) [m4]
    and sum V0 w [m3]; grid: (blocks, 256). scratch (2 SCRATCH + PATCH + 16,) and base (BATCH + 22,
    int32) belong to the calling thread.
    """
    cap = f.shape[1]
    flat, flat_xi = f.reshape(f.size), xi.reshape(xi.size)
    weights, records = scratch[:SCRATCH], scratch[SCRATCH : 2 * SCRATCH]
    patch = scratch[2 * SCRATCH :]
    nodes = patch[:PATCH].reshape((SIDE, SIDE, SIDE, 4))
    box = base[BATCH + 16 :]
    for s in segments:
        _box(count[s], start[s], cap, flat_xi, flat, mirror[s], box)
        if sent[s] and not border:
            push(patches[slot[s]], grid, into[s], box)
            continue
        for wanted in range(2):
            if wanted == 1 and offset_slot[s] < 0:
                break
            kept = slot[s] if wanted == 0 else offset_slot[s]
            if kept >= 0:
                patch[:] = 0
            else:
                clear(patch, box)
            for first in range(0, count[s], BATCH):
                n = min(BATCH, count[s] - first)
                at = start[s] + first
                weigh(n, at, cap, flat_xi, flat, base, weights)
                if wanted == 0:
                    momenta(law, n, at, cap, flat, records, density, dx, dt)
                else:
                    offsets(n, at, cap, flat, records, dx)
                _scatter(n, records, weights, base, patch)
            fold(nodes, mirror[s], wanted == 1)
            if kept >= 0:
                keep = patches[kept] if wanted == 0 else volumes[kept]
                for c in range(PATCH):
                    keep[c] = patch[c]
            if wanted == 0 and not border:
                push(patch, grid, into[s], box)


@inline
def _box(count, at, cap, xi, like, mirror, box):
    """Nodes of its patch that a segment touches (see records.reach); all of them at a wall."""
    for a in range(3):
        box[2 * a], box[2 * a + 1] = 0, SIDE
    if not mirror.any():
        reach(count, at, cap, xi, like, box)


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
    box = base[BATCH + 16 :]
    for s in segments:
        _box(count[s], start[s], cap, flat_xi, flat, mirror[s], box)
        gather(patch, flat_grid, table[s], box)
        reflect(nodes, mirror[s])
        for first in range(0, count[s], BATCH):
            n = min(BATCH, count[s] - first)
            at = start[s] + first
            weigh(n, at, cap, flat_xi, flat, base, weights)
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

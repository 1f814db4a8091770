"""Particles to grid and back, on one private patch per segment (quadratic B-splines, APIC, MLS
force).

A segment is the particles of one group (one phase, one material) whose base node lay in one 4^3
block when they were last sorted. Its patch holds the 8^3 nodes -1..6 of that block, so that a
particle may stray one cell before the next sort. A patch is filled by one thread in particle order;
nothing else touches it. Positions are integers, 2^-bits of a cell, relative to the middle of the
block: slow motion in single precision then loses nothing.

Channels of a group's float array: velocity 0-2 [m/s], APIC matrix C 3-11 [1/s], rest volume 12
[m3], the law's state 13-.
"""

import numpy as np

from ..device.jit import inline, kernel
from .laws import advance, load_state, stress, volume_ratio, wave_speed2
from .walls import SIDE, fold, reflect

VELOCITY, AFFINE, VOLUME, STATE = 0, 3, 12, 13
REACH = 3  # cells from the block's middle within which a particle's base node lies in its patch

CRUSHED, OUTSIDE, TOO_FAST, LOST = 1, 2, 3, 4  # what can go wrong with a particle


@inline
def _weights(w, a, r, one, half, third):
    """The three weights of axis a at fraction r of the base cell."""
    b = one - r
    c = r - half
    w[a, 0] = half * b * b
    w[a, 1] = third - c * c
    w[a, 2] = half * r * r


@kernel
def p2g(
    law,
    segments,
    start,
    count,
    slot,
    offset_slot,
    mirror,
    xi,
    f,
    patches,
    offsets,
    bits,
    density,
    dx,
    dt,
):
    """Mass and momentum (with the stress's impulse over dt) of each segment into its patch.

    segments: (n,) the segments to do; slot: (segments,) patch of each; offset_slot: the same for
    the volume-and-offset patch that contact asks for, -1 where it does not; mirror: (segments, 3,
    2) wall codes (walls.py); xi: (3, cap) fixed-point positions; f: (channels, cap); patches:
    (slots, 8, 8, 8, 4) momentum [kg m/s] and mass [kg]; offsets: (slots, 8, 8, 8, 4) sum V0 w (x_p
    - x_i) [m4] and sum V0 w [m3].
    """
    real = f.dtype.type
    one, half, third, zero = real(1.0), real(0.5), real(0.75), real(0.0)
    scale = real(2.0**-bits)
    mask = (1 << bits) - 1
    four = real(4.0) / (dx * dx)
    w = np.empty((3, 3), f.dtype)
    for s in segments:
        patch = patches[slot[s]]
        patch[:] = zero
        wants_offset = offset_slot[s] >= 0
        offset = offsets[max(offset_slot[s], 0)]
        if wants_offset:
            offset[:] = zero
        for p in range(start[s], start[s] + count[s]):
            L = (f[3, p], f[4, p], f[5, p], f[6, p], f[7, p], f[8, p], f[9, p], f[10, p], f[11, p])
            t = stress(law, load_state(law, f, STATE, p), L)
            volume = f[VOLUME, p]
            mass = density * volume
            k = dt * volume * four
            t00, t11, t22 = k * real(t[0]), k * real(t[1]), k * real(t[2])
            t01, t02, t12 = k * real(t[3]), k * real(t[4]), k * real(t[5])
            qx0, qx1, qx2 = (
                dx * (mass * L[0] - t00),
                dx * (mass * L[3] - t01),
                dx * (mass * L[6] - t02),
            )
            qy0, qy1, qy2 = (
                dx * (mass * L[1] - t01),
                dx * (mass * L[4] - t11),
                dx * (mass * L[7] - t12),
            )
            qz0, qz1, qz2 = (
                dx * (mass * L[2] - t02),
                dx * (mass * L[5] - t12),
                dx * (mass * L[8] - t22),
            )
            bi, bj, bk = (xi[0, p] >> bits) + 3, (xi[1, p] >> bits) + 3, (xi[2, p] >> bits) + 3
            rx, ry, rz = (
                real(xi[0, p] & mask) * scale,
                real(xi[1, p] & mask) * scale,
                real(xi[2, p] & mask) * scale,
            )
            _weights(w, 0, rx, one, half, third)
            _weights(w, 1, ry, one, half, third)
            _weights(w, 2, rz, one, half, third)
            # node minus particle, in cells, at the base node
            ex, ey, ez = -half - rx, -half - ry, -half - rz
            w0, w1, w2 = w[2, 0], w[2, 1], w[2, 2]
            p0 = mass * f[0, p] + ex * qx0 + ey * qy0 + ez * qz0
            p1 = mass * f[1, p] + ex * qx1 + ey * qy1 + ez * qz1
            p2 = mass * f[2, p] + ex * qx2 + ey * qy2 + ez * qz2
            for i in range(3):
                a0, a1, a2 = p0, p1, p2
                for j in range(3):
                    wij = w[0, i] * w[1, j]
                    row = patch[bi + i, bj + j]
                    u = wij * w0
                    row[bk, 0] += u * a0
                    row[bk, 1] += u * a1
                    row[bk, 2] += u * a2
                    row[bk, 3] += u * mass
                    b0, b1, b2 = a0 + qz0, a1 + qz1, a2 + qz2
                    u = wij * w1
                    row[bk + 1, 0] += u * b0
                    row[bk + 1, 1] += u * b1
                    row[bk + 1, 2] += u * b2
                    row[bk + 1, 3] += u * mass
                    b0, b1, b2 = b0 + qz0, b1 + qz1, b2 + qz2
                    u = wij * w2
                    row[bk + 2, 0] += u * b0
                    row[bk + 2, 1] += u * b1
                    row[bk + 2, 2] += u * b2
                    row[bk + 2, 3] += u * mass
                    a0, a1, a2 = a0 + qy0, a1 + qy1, a2 + qy2
                p0, p1, p2 = p0 + qx0, p1 + qx1, p2 + qx2
            if wants_offset:
                for i in range(3):
                    ox = -(ex + real(i)) * dx
                    for j in range(3):
                        oy = -(ey + real(j)) * dx
                        wij = w[0, i] * w[1, j] * volume
                        row = offset[bi + i, bj + j]
                        for c in range(3):
                            u = wij * w[2, c]
                            row[bk + c, 0] += u * ox
                            row[bk + c, 1] += u * oy
                            row[bk + c, 2] += u * (-(ez + real(c)) * dx)
                            row[bk + c, 3] += u
        fold(patch, mirror[s], False)
        if wants_offset:
            fold(offset, mirror[s], True)


@kernel
def g2p(
    law,
    segments,
    start,
    count,
    table,
    limit,
    mirror,
    xi,
    f,
    ids,
    grid,
    patch,
    bits,
    dither,
    dx,
    dt,
    cfl,
    report,
):
    """Velocity and its gradient from the grid to each particle; moves it and advances its state by
    dt.

    table: (segments, 27) the node blocks around each segment's block; limit: (segments, 3, 2)
    fixed-point range a position may take; mirror: (segments, 3, 2) wall codes (walls.py); grid:
    (blocks, 64, 4) velocities [m/s]; patch: scratch (8, 8, 8, 4); dither: (3,) added before
    rounding down, the same for all particles of a step; report: (4,) running maxima: rate 1/dt
    [1/s], distance from the block's middle [cells]; then id + 1 of a particle that went wrong and
    the reason.
    """
    real = f.dtype.type
    one, half, third, zero = real(1.0), real(0.5), real(0.75), real(0.0)
    scale = real(2.0**-bits)
    mask = (1 << bits) - 1
    four = real(4.0) / dx
    step = dt / dx
    fixed = real(2.0**bits)
    d0, d1, d2 = real(dither[0]), real(dither[1]), real(dither[2])
    w = np.empty((3, 3), f.dtype)
    rate, far = report[0], report[1]
    flat, flat_grid = patch.reshape(SIDE**3 * 4), grid.reshape((len(grid), 256))
    for s in segments:
        gather(flat, flat_grid, table[s])
        reflect(patch, mirror[s])
        for p in range(start[s], start[s] + count[s]):
            bi, bj, bk = (xi[0, p] >> bits) + 3, (xi[1, p] >> bits) + 3, (xi[2, p] >> bits) + 3
            rx, ry, rz = (
                real(xi[0, p] & mask) * scale,
                real(xi[1, p] & mask) * scale,
                real(xi[2, p] & mask) * scale,
            )
            _weights(w, 0, rx, one, half, third)
            _weights(w, 1, ry, one, half, third)
            _weights(w, 2, rz, one, half, third)
            w0, w1, w2 = w[2, 0], w[2, 1], w[2, 2]
            ex, ey, ez = -half - rx, -half - ry, -half - rz
            z0, z1, z2 = ez * w0, (ez + one) * w1, (ez + one + one) * w2
            v0 = v1 = v2 = zero
            c0 = c1 = c2 = c3 = c4 = c5 = c6 = c7 = c8 = zero
            for i in range(3):
                y0 = y1 = y2 = zero  # sums over j and k
                g0 = g1 = g2 = zero  # the same, weighted with the offset along y
                h0 = h1 = h2 = zero  # ... along z
                for j in range(3):
                    row = patch[bi + i, bj + j]
                    wj = w[1, j]
                    gj = wj * (ey + real(j))
                    a0 = w0 * row[bk, 0] + w1 * row[bk + 1, 0] + w2 * row[bk + 2, 0]
                    a1 = w0 * row[bk, 1] + w1 * row[bk + 1, 1] + w2 * row[bk + 2, 1]
                    a2 = w0 * row[bk, 2] + w1 * row[bk + 1, 2] + w2 * row[bk + 2, 2]
                    y0 += wj * a0
                    y1 += wj * a1
                    y2 += wj * a2
                    g0 += gj * a0
                    g1 += gj * a1
                    g2 += gj * a2
                    h0 += wj * (z0 * row[bk, 0] + z1 * row[bk + 1, 0] + z2 * row[bk + 2, 0])
                    h1 += wj * (z0 * row[bk, 1] + z1 * row[bk + 1, 1] + z2 * row[bk + 2, 1])
                    h2 += wj * (z0 * row[bk, 2] + z1 * row[bk + 1, 2] + z2 * row[bk + 2, 2])
                wi = w[0, i]
                xi_ = wi * (ex + real(i))
                v0 += wi * y0
                v1 += wi * y1
                v2 += wi * y2
                c0 += xi_ * y0
                c3 += xi_ * y1
                c6 += xi_ * y2
                c1 += wi * g0
                c4 += wi * g1
                c7 += wi * g2
                c2 += wi * h0
                c5 += wi * h1
                c8 += wi * h2
            L = (
                four * c0,
                four * c1,
                four * c2,
                four * c3,
                four * c4,
                four * c5,
                four * c6,
                four * c7,
                four * c8,
            )
            f[0, p], f[1, p], f[2, p] = v0, v1, v2
            for c in range(9):
                f[AFFINE + c, p] = L[c]
            state = advance(law, load_state(law, f, STATE, p), L, dt)
            for c in range(len(state)):
                f[STATE + c, p] = state[c]
            J = volume_ratio(law, state)
            m0, m1, m2 = step * v0, step * v1, step * v2
            largest = max(abs(m0), abs(m1), abs(m2))
            speed = np.sqrt(v0 * v0 + v1 * v1 + v2 * v2)
            wave = np.sqrt(wave_speed2(law, state))
            # a comparison with nan is false: `not` catches it, and infinity
            if not (largest < one and J > 0.1 and J < 5.0 and wave < 1e30):
                reason = LOST
                if J <= 0.1 or J >= 5.0:
                    reason = CRUSHED
                elif largest >= one:
                    reason = TOO_FAST
                _note(report, ids[p], reason)
                continue
            rate = max(
                rate, (wave + speed) / (cfl * dx), speed / (0.3 * dx), abs(L[0] + L[4] + L[8]) / 0.1
            )
            for a in range(3):
                move = m0 if a == 0 else (m1 if a == 1 else m2)
                dith = d0 if a == 0 else (d1 if a == 1 else d2)
                x = xi[a, p] + int(np.floor(move * fixed + dith))
                xi[a, p] = x
                far = max(far, abs(real(x) * scale))
                if x < limit[s, a, 0] or x >= limit[s, a, 1]:
                    _note(report, ids[p], OUTSIDE)
    report[0], report[1] = rate, far


@inline
def _note(report, number, reason):
    """Keep the lowest id of the particles that went wrong, and why."""
    if report[2] == 0.0 or number + 1.0 < report[2]:
        report[2] = number + 1.0
        report[3] = reason


@inline
def gather(patch, grid, blocks):
    """The 8^3 nodes -1..6 of a block, patch flat (2048,), from the 27 node blocks around it.

    grid: (node blocks, 256). Rows along z are copied in pieces of fixed length, which compiles to a
    few vector moves.
    """
    for i in range(SIDE):
        gi = i + 3
        for j in range(SIDE):
            gj = j + 3
            row = (gi >> 2) * 9 + (gj >> 2) * 3
            at = ((gi & 3) * 16 + (gj & 3) * 4) * 4
            to = (i * SIDE + j) * SIDE * 4
            below, here, above = grid[blocks[row]], grid[blocks[row + 1]], grid[blocks[row + 2]]
            for c in range(4):
                patch[to + c] = below[at + 12 + c]
            for c in range(16):
                patch[to + 4 + c] = here[at + c]
            for c in range(12):
                patch[to + 20 + c] = above[at + c]

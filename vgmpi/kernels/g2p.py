"""Grid to particles: the velocity and its gradient each particle gathers, and what follows from
them: the law's state, the new position, what bounds the next step. See p2g.py.
"""

import numpy as np

from ..device.jit import inline, kernel
from ..lanes.lanes import load, store
from ..lanes.laws import advance, lane_state, store_state, volume_ratio, wave_speed2
from ..lanes.rows import (
    SOUND_ALL,
    largest,
    load_records,
    move,
    only,
    sound,
    spread,
)
from .couple import LEAST_PORES
from .patches import gather
from .records import AFFINE, BATCH, PATCH, ROOM, STATE, parts, touched, weigh
from .rowsums import gather as gather_rows
from .rowsums import gather_slopes, values
from .walls import SIDE, reflect

REACH = 3  # cells from the block's middle within which a particle's base node lies in its patch
CRUSHED, OUTSIDE, TOO_FAST, LOST = 1, 2, 3, 4  # what can go wrong with a particle
FASTEST_WAVE = 1e15  # [m/s], squared below the largest single


@inline
def rest(count, records):
    """Nothing in the records behind the last one, up to a whole vector: unused places stay so."""
    for m in range(16 * count, 16 * ((count + 15) & ~15)):
        records[m] = 0


@inline
def columns(count, records, out, first, stride):
    """The first three numbers of each record into rows of out, `stride` numbers apart."""
    for n in range(count):
        for c in range(3):
            out[first + c * stride + n] = records[16 * n + c]


@kernel
def g2p(
    law, segments, start, count, table, limit, mirror, xi, f, ids, grid, flux, drift, flip, split,
    scratch, base, numbers, bits, dither, dt, cfl, report,
):  # fmt: skip
    """Velocity and its gradient from the grid to each particle; moves it and advances its state.

    table: (segments, 27) the node blocks around each segment's block; limit: (segments, 3, 2) range
    of positions [cells from the block's middle]; mirror: (segments, 3, 2) wall codes (walls.py);
    grid: (blocks, 64, 4) velocities [m/s]; flux: None, or (blocks, 64, 4) what else the particles
    gather: with flip None the flux of volume [m/s] and the fluids' share of space, else the change
    of velocity [m/s], of which FLIP adds the share `flip`; drift: None, or (blocks, 64, 4) the
    part of the velocities [m/s] that moves particles but is no momentum of theirs; split:
    (segments,) not negative where a segment shares space with another phase; scratch, base and
    numbers: see p2g; dither: (3,) added before rounding down, the same for all particles of a
    step; report: (4,) running maxima: rate 1/dt [1/s], distance from the block's middle [cells];
    then id + 1 of a particle that went wrong and the reason.
    """
    cap = f.shape[1]
    flat, flat_xi = f.reshape(f.size), xi.reshape(xi.size)
    flat_grid = grid.reshape((len(grid), 256))
    weights, records, patch, extra = parts(scratch)
    nodes = patch[:PATCH].reshape((SIDE, SIDE, SIDE, 4))
    patch[PATCH:] = 0
    box = base[BATCH + 16 :]
    for s in segments:
        touched(count[s], start[s], cap, flat_xi, flat, mirror[s], box)
        gather(patch, flat_grid, table[s], box)
        reflect(nodes, mirror[s])
        apart = split[s] >= 0
        if drift is not None and apart:
            third = scratch[ROOM + PATCH + 16 :]
            gather(third, drift.reshape((len(drift), 256)), table[s], box)
            reflect(third[:PATCH].reshape((SIDE, SIDE, SIDE, 4)), mirror[s])
        if flux is not None and apart:
            second = scratch[ROOM:]
            gather(second, flux.reshape((len(flux), 256)), table[s], box)
            reflect(second[:PATCH].reshape((SIDE, SIDE, SIDE, 4)), mirror[s])
        for first in range(0, count[s], BATCH):
            n = min(BATCH, count[s] - first)
            at = start[s] + first
            weigh(n, at, cap, flat_xi, flat, base, weights)
            if flux is not None and apart:
                gather_rows(n, records, weights, base, scratch[ROOM:])
                _set_aside(n, records, extra, flip)
                if drift is not None:
                    values(n, records, weights, base, scratch[ROOM + PATCH + 16 :])
                    columns(n, records, extra, 2 * BATCH, BATCH)
            if numbers.splines > 0.0:
                gather_slopes(n, records, weights, base, patch)
            else:
                gather_rows(n, records, weights, base, patch)
            rest(n, records)
            _move(
                law, n, at, cap, flat_xi, flat, ids, records, flux, drift, flip, apart, extra,
                numbers, limit[s], 2.0**bits, dither, dt, cfl, report,
            )  # fmt: skip


@inline
def _set_aside(count, records, extra, flip):
    """Of what else was gathered, keep per particle: divergence [cells/s] and share of space, or the
    change of velocity."""
    if flip is None:
        for n in range(count):
            m = 16 * n
            extra[n] = 4.0 * (records[m + 4] + records[m + 9] + records[m + 14])
            extra[BATCH + n] = records[m + 3]
    else:
        columns(count, records, extra, 0, BATCH)


@inline
def _move(
    law, count, at, cap, xi, f, ids, records, flux, drift, flip, apart, extra, numbers, limit, one,
    dither, dt, cfl, report,
):  # fmt: skip
    """Take up the gathered records: v, C, state, position; note what bounds the step."""
    dx = numbers.dx
    k = 4.0 / dx
    fastest = far = stretching = quick = spread(f, 0.0)
    shortest, never = spread(f, -1.0), spread(f, FASTEST_WAVE**2)
    least, most, single = spread(f, 0.1), spread(f, 5.0), spread(f, 1.0)
    for n in range(0, count, 16):
        p = at + n
        left = count - n
        v0, v1, v2, fill, c0, c3, c6, _, c1, c4, c7, _, c2, c5, c8, _ = load_records(
            records, 16 * n
        )
        c0, c1, c2 = k * c0, k * c1, k * c2
        c3, c4, c5 = k * c3, k * c4, k * c5
        c6, c7, c8 = k * c6, k * c7, k * c8
        L = (c0, c1, c2, c3, c4, c5, c6, c7, c8)
        if flip is not None:
            _blend(f, p, cap, extra, n, flip, (v0, v1, v2))
            _take_gradient(f, p, cap, L)
        else:
            store(f, p, v0)
            store(f, p + cap, v1)
            store(f, p + 2 * cap, v2)
            _take_gradient(f, p, cap, L)
        if drift is not None:
            if apart:  # moves the particle, but is no momentum of its
                v0 = v0 + load(extra, 2 * BATCH + n)
                v1 = v1 + load(extra, 3 * BATCH + n)
                v2 = v2 + load(extra, 4 * BATCH + n)
        if flux is not None:
            if flip is None:
                L = _of_all(L, f, p, cap, apart, extra, n, fill, numbers)
        state = advance(law, lane_state(law, f, p + STATE * cap, cap), L, dt)
        store_state(f, p + STATE * cap, cap, state)
        J = volume_ratio(law, state)
        wave2 = wave_speed2(law, state)
        if flux is not None:
            if np.int64(numbers.porosity) >= 0:
                share = load(f, p + np.int64(numbers.porosity) * cap)
                wave2 = wave2 * (1.0 + (1.0 / share - 1.0) * numbers.dense) + numbers.stiff
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
def _take_gradient(f, p, cap, C):
    """The gradients of velocity of 16 particles."""
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


@inline
def _blend(f, p, cap, extra, n, flip, v):
    """FLIP: a particle's own velocity and the grid's change of it, blended with the grid's
    velocity v (Zhu & Bridson 2005)."""
    for c in range(3):
        own = load(f, p + c * cap) + load(extra, c * BATCH + n)
        store(f, p + c * cap, v[c] + flip * (own - v[c]))


@inline
def _of_all(L, f, p, cap, apart, extra, n, fill, numbers):
    """A fluid's velocity gradient with the volume's rate of all that share its space.

    Where sand is, its pores' share of space is noted at the particle; where more volume than space
    was gathered (fill > 1), the volume ratio relaxes. Returns L.
    """
    if not apart:
        if np.int64(numbers.porosity) >= 0:
            store(f, p + np.int64(numbers.porosity) * cap, spread(f, 1.0))
        return L
    rate = load(extra, n) / numbers.dx
    if np.int64(numbers.porosity) >= 0:
        share = np.minimum(np.maximum(load(extra, BATCH + n), LEAST_PORES), 1.0)
        store(f, p + np.int64(numbers.porosity) * cap, share)
        rate = rate / share - numbers.relax * np.maximum(fill - 1.0, 0.0)
    c0, c1, c2, c3, c4, c5, c6, c7, c8 = L
    more = (rate - (c0 + c4 + c8)) * (1.0 / 3.0)
    return (c0 + more, c1, c2, c3, c4 + more, c5, c6, c7, c8 + more)


@inline
def _note(report, number, reason):
    """Keep the lowest id of the particles that went wrong, and why."""
    if report[2] == 0.0 or number + 1.0 < report[2]:
        report[2] = number + 1.0
        report[3] = reason

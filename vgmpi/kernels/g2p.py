"""Grid to particles: the velocity and its gradient each particle gathers, and what follows from
them: the law's state, the new position, what bounds the next step. See p2g.py.
"""

from typing import NamedTuple

import numpy as np

from ..device.jit import inline, kernel
from ..device.limits import FARTHEST, LEAST_J, MOST_J, STRETCH
from ..lanes.lanes import place, store
from ..lanes.laws import advance, lane_state, store_state, volume_ratio, wave_speed2
from ..lanes.rows import SOUND_ALL, higher, largest, load_records, move, only, sound, spread
from .beside import complete, fetch, keep, kept, moving, set_aside, strain, waves
from .given import share_of
from .patches import expect, gather, nodes_of
from .records import AFFINE, BATCH, PATCH, STATE, box_of, parts, rest, touched, weigh
from .rowsums import moments, slopes
from .walls import reflect

REACH = 3  # cells from the block's middle within which a particle's base node lies in its patch
CRUSHED, OUTSIDE, TOO_FAST, LOST = 1, 2, 3, 4  # what can go wrong with a particle
FASTEST_WAVE = 1e15  # [m/s], squared below the largest single


class Numbers(NamedTuple):
    """What is told of a group, in the precision of the run."""

    splines: float  # 1: strains by the gradients of the B-splines, 0: by moments
    stiff: float  # [m2/s2] squared speed of waves that sand in the same space adds
    dense: float  # density relative to that sand's grains, at least 1
    slips: float  # squared speed of waves where a fluid slips through others, relative to its own
    relax: float  # [1/s] rate at which a fluid gives way where there is more volume than space
    porosity: float  # channel of the fluid's share of space, or -1
    dx: float  # [m]


class Motion(NamedTuple):
    """What is told of a step. The dither is added before positions are rounded down, and is the
    same for all particles."""

    dt: float  # [s], in the precision of the run
    cfl: float
    one: float  # a cell in units of positions, 2^bits
    dither_x: float
    dither_y: float
    dither_z: float


class Cloud(NamedTuple):
    """Particles by the places of their arrays (lanes.place)."""

    f: np.ndarray
    xi: np.ndarray
    ids: np.ndarray
    cap: int


@kernel
def g2p(
    rows, law, segments, particles, velocity, beside, scratch, numbers, motion, report, ghosts
):  # fmt: skip
    """Velocity and its gradient from the grid to each particle; moves it and advances its state.

    rows: (n,) segments to do; velocity: (node blocks, 256) [m/s]; beside: a kind of beside.py;
    ghosts: given.Ghosts, or None;
    report: (6,) running maxima: rate 1/dt [1/s], distance from the block's middle [cells]; then
    id + 1 of a particle that went wrong and the reason; then maxima again: speed along an axis
    [cells/s], squared size of the velocity gradient [1/s2].
    """
    cap = particles.f.shape[1]
    f, xi = particles.f.reshape(particles.f.size), particles.xi.reshape(particles.xi.size)
    cloud = Cloud(place(f), place(xi), place(particles.ids), cap)
    start, count, table = segments.start, segments.count, segments.table
    split, limit, mirror = segments.split, segments.limit, segments.mirror
    weights, records, patch, extra = parts(scratch.real)
    nodes = nodes_of(patch)
    patch[PATCH:] = 0
    base, box = scratch.whole, box_of(scratch.whole)
    flat = place(velocity.reshape(velocity.size))
    share = share_of(ghosts)
    for q in range(len(rows)):
        s = rows[q]
        if q + 1 < len(rows):
            expect(flat, table[rows[q + 1]])
        touched(count[s], start[s], cap, xi, f, mirror[s], box)
        gather(patch, velocity, table[s], box)
        reflect(nodes, mirror[s], ghosts, share, s)
        complete(beside, nodes, mirror[s])
        if split[s]:
            fetch(beside, table[s], box, mirror[s], scratch.real, ghosts, s)
        for first in range(0, count[s], BATCH):
            n = min(BATCH, count[s] - first)
            at = start[s] + first
            weigh(n, at, cap, xi, f, base, weights)
            if split[s]:
                set_aside(beside, n, weights, records, base, scratch.real, extra)
            if numbers.splines > 0.0:
                slopes(n, records, weights, base, patch)
            else:
                moments(n, records, weights, base, patch)
            rest(n, records)
            _move(
                law, n, at, cloud, records, beside, split[s], extra, numbers, limit[s], motion,
                report,
            )  # fmt: skip


@inline
def _move(
    law, count, at, cloud, records, beside, split, extra, numbers, limit, motion, report
):  # fmt: skip
    """Take up the gathered records: v, C, state, position; note what bounds the step."""
    f, cap = cloud.f, cloud.cap
    dx, dt = numbers.dx, motion.dt
    k = 4.0 / dx
    fastest = far = stretching = quick = carried = turning = spread(f, 0.0)
    shortest, never = spread(f, -1.0), spread(f, FASTEST_WAVE**2)
    least, most, single = spread(f, LEAST_J), spread(f, MOST_J), spread(f, 1.0)
    for n in range(0, count, 16):
        p = at + n
        left = count - n
        v0, v1, v2, fill, L = gathered(records, 16 * n, k)
        slope = rises(records, 16 * n)
        keep(beside, f, p, cap, extra, n, (v0, v1, v2))
        _take_gradient(f, p, cap, L)
        v0, v1, v2 = moving(beside, split, extra, n, (v0, v1, v2))
        trace, turns = L[0] + L[4] + L[8], _squared(L)
        L = strain(beside, split, f, p, cap, extra, n, L, fill, slope, numbers)
        state = advance(law, lane_state(law, f, p + STATE * cap, cap), L, dt)
        store_state(f, p + STATE * cap, cap, state)
        J = volume_ratio(law, state)
        wave2 = waves(beside, f, p, cap, numbers, wave_speed2(law, state))
        m0, m1, m2 = (dt / dx) * v0, (dt / dx) * v1, (dt / dx) * v2
        longest = higher(abs(m0), higher(abs(m1), abs(m2)))
        # not a number lies between no bounds
        slow = sound(longest + 0.0 * (m0 + m1 + m2), shortest, single, left)
        whole = sound(J, least, most, left)
        tame = sound(wave2, shortest, never, left)
        good = slow & whole & tame
        x, y, z = _go(cloud, p, (only(good, m0), only(good, m1), only(good, m2)), motion)
        speed = np.sqrt(v0 * v0 + v1 * v1 + v2 * v2)
        carried = higher(only(good, kept(beside, f, p, cap, longest, dt / dx)), carried)
        turning = higher(only(good, higher(turns, _squared(L))), turning)
        fastest = higher(only(good, np.sqrt(wave2) + speed), fastest)
        quick = higher(only(good, speed), quick)
        stretching = higher(only(good, abs(trace)), stretching)
        far = higher(higher(abs(x), higher(abs(y), abs(z))), far)
        inside = _inside(f, x, y, z, limit, left)
        full = SOUND_ALL if left >= 16 else (1 << left) - 1
        if good & inside != full:
            _blame(cloud.ids, p, min(16, left), whole, tame, slow, inside, report)
    tell(report, fastest, far, quick, stretching, carried, turning, motion, dx)


@inline
def tell(report, fastest, far, quick, stretching, carried, turning, motion, dx):
    """Take up what bounds the next step: vectors of maxima."""
    rate = largest(fastest) / (motion.cfl * dx)
    rate = max(rate, largest(quick) / (FARTHEST * dx), largest(stretching) / STRETCH)
    report[0] = max(report[0], rate)
    report[1] = max(report[1], largest(far))
    report[4] = max(report[4], largest(carried) / motion.dt)
    report[5] = max(report[5], largest(turning))


@inline
def gathered(records, at, k):
    """Of 16 records: velocity, the fourth number, the velocity's gradient."""
    r = load_records(records, at)
    x, y, z = (k * r[4], k * r[5], k * r[6]), (k * r[8], k * r[9], k * r[10]), (
        k * r[12], k * r[13], k * r[14]
    )  # fmt: skip
    return r[0], r[1], r[2], r[3], (x[0], y[0], z[0], x[1], y[1], z[1], x[2], y[2], z[2])


@inline
def rises(records, at):
    """Of 16 records: a quarter of the fourth number's slope per cell."""
    r = load_records(records, at)
    return r[7], r[11], r[15]


@inline
def _squared(C):
    """Sum of the squares of nine entries."""
    one = C[0] * C[0] + C[1] * C[1] + C[2] * C[2]
    other = C[3] * C[3] + C[4] * C[4] + C[5] * C[5]
    return one + other + (C[6] * C[6] + C[7] * C[7] + C[8] * C[8])


@inline
def _go(cloud, p, way, motion):
    """Move 16 particles by a way [cells]; returns their new places [cells from the block's
    middle]."""
    one, cap = motion.one, cloud.cap
    x = move(cloud.xi, p, one * way[0] + motion.dither_x)
    y = move(cloud.xi, p + cap, one * way[1] + motion.dither_y)
    z = move(cloud.xi, p + 2 * cap, one * way[2] + motion.dither_z)
    return x, y, z


@inline
def _inside(f, x, y, z, limit, left):
    """Mask of the particles that are in the domain. f: of their precision."""
    inside = sound(x, spread(f, limit[0, 0]), spread(f, limit[0, 1]), left)
    inside &= sound(y, spread(f, limit[1, 0]), spread(f, limit[1, 1]), left)
    return inside & sound(z, spread(f, limit[2, 0]), spread(f, limit[2, 1]), left)


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
def _blame(ids, p, count, whole, tame, slow, inside, report):
    """Note which of 16 particles went wrong, and why. The masks: of those that did not."""
    for lane in range(count):
        bit = 1 << lane
        if whole & bit == 0:
            note(report, ids[p + lane], CRUSHED)
        elif tame & bit == 0:
            note(report, ids[p + lane], LOST)
        elif slow & bit == 0:
            note(report, ids[p + lane], TOO_FAST)
        elif inside & bit == 0:
            note(report, ids[p + lane], OUTSIDE)


@inline
def note(report, number, reason):
    """Keep the lowest id of the particles that went wrong, and why."""
    if report[2] == 0.0 or number + 1.0 < report[2]:
        report[2] = number + 1.0
        report[3] = reason

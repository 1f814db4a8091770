"""Kernels between particles and nodes: the loops of a card around what kernels/ say.

To the nodes a team of 16 threads does a segment: each is a particle that makes its record, then one
number of the four nodes of each row, which sums run after run of records as the processor does. Of
a patch every number belongs to one thread (its node along z modulo 4, its place among the four), so
that rows need no waiting. From the nodes a block does a segment, a thread a particle.
"""

import math

import numpy as np
from numba import cuda

from ...kernels import given, records, restore, rowsums
from ...kernels.beside import complete, fetch, set_aside
from ...kernels.driven import carry
from ...kernels.g2p import Cloud, _move
from ...kernels.gradient import turn
from ...kernels.layers.base import OFFSET, UNSEEN, contribute
from ...kernels.records import PATCH, weigh
from ...kernels.rowsums import moments, slopes, values
from ...kernels.walls import fold, reflect
from .nodes import own_ghosts
from .particle import gather
from .team import each, meet, number, rank
from .words import SIMULATED

RUN = records.BATCH  # records after which a run ends in any case
ROW, PLANE = records.ROW, records.PLANE
PITCH = 17  # numbers from one record in shared memory to the next, so that banks do not meet
ROOM = PATCH + 16
BLOCK = 256
TIES = 1.0 + 2.0**-52  # kernels/sums.py
TEAM = TEAMS = 16
REAL = None
WORDS = 1
SPLINES = False
BESIDE = PATCH


def fill(rows, kind, law, segments, particles, sums, rest, phase, peaks, dt, along, ghosts):
    """Contributions of segments to a layer, kernels/p2g.py. sums: (256 words rows,); rest: of the
    phase, (words, 16); along: whether this layer goes along the slopes of splines."""
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
        if kind.mirror != UNSEEN:
            now, at = cuda.local.array(3, np.int64), cuda.local.array(6, np.float64)
            mine = own_ghosts(ghosts, now, at)
            fold(patch, segments.mirror[s], kind.mirror == OFFSET, mine, s)
            meet()
        _push(patch, segments.into[s], sums, rest[phase])


def _sums(s, kind, law, segments, particles, patch, words, bases, dt, along):
    """What a segment's particles contribute, into its patch; returns the thread's peak (records.
    Scratch)."""
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
            weigh(1, p, cap, xi, f, bases[lane : lane + 1], own)
            contribute(kind, law, 1, p, cap, f, extra, peak, record, dt)
        meet()
        for m in range(n):
            here = bases[m]
            if SPLINES and along:
                _along_slopes(written, weights, m, patch, here)
                meet()
            else:
                if here != last or (first + m) % RUN == 0:
                    _flush(patch, last, sums)
                    last, sums = here, nothing()
                sums = _grown(sums, written, weights, PITCH * m, _node(here))
        meet()
    _flush(patch, last, sums)
    return peak[0]


def nothing():
    """Sums of nine rows."""
    zero = REAL(0.0)
    return zero, zero, zero, zero, zero, zero, zero, zero, zero


def _node(here):
    """Which of a row's nodes is this thread's, of a run with that base row: the one whose place
    along z is its own, modulo 4."""
    return ((rank() >> 2) - (here >> 2)) & 3


def _grown(sums, written, weights, m, node):
    """Sums and one record more (rowsums._runs_whole)."""
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


def _along_slopes(written, weights, m, patch, here):
    """Add a record along the slopes of the B-splines."""
    node, o = rank() >> 2, here + (rank() & 3)
    if node == 0:
        slopes_0(m, m + 1, written, weights, patch, o)
    elif node == 1:
        slopes_1(m, m + 1, written, weights, patch, o)
    elif node == 2:
        slopes_2(m, m + 1, written, weights, patch, o)


def _flush(patch, here, sums):
    """Add the sums of a run to its nine rows. here: base row, -1 before the first run."""
    if here >= 0 and _node(here) < 3:
        o = here + 4 * _node(here) + (rank() & 3)
        for i in range(3):
            for j in range(3):
                patch[o + i * PLANE + j * ROW] += sums[3 * i + j]


def _push(patch, blocks, sums, rest):
    """Add the nodes of a patch to the sums of the 27 node blocks around it (kernels/sums.py): each
    term as a multiple of its quantum, so that any order gives the same."""
    for q in each(PATCH):
        x = np.float64(patch[q])
        if x != 0.0:
            i, j, k = (q >> 8) + 3, ((q >> 5) & 7) + 3, ((q >> 2) & 7) + 3
            nb = blocks[(i >> 2) * 9 + (j >> 2) * 3 + (k >> 2)]
            at = (i & 3) * 64 + (j & 3) * 16 + (k & 3) * 4 + (q & 3)
            for w in range(WORDS):
                r = rest[w, at & 15]
                term = _rounded(x, r)
                cuda.atomic.add(sums, BLOCK * (WORDS * nb + w) + at, term)
                x = x - term


def _rounded(x, r):
    """x as a multiple of the quantum of a sum that rests at r. Terms in single precision have so
    few digits that rounding the product changes nothing."""
    if WORDS == 1:
        return (x * np.float64(TIES) + r) - r
    return fused(x, np.float64(TIES), r) - r


def _fma(x, y, z):
    """x y + z, rounded once."""
    return cuda.fma(x, y, z)


def _exact(x, y, z):
    """The same of y = TIES for the simulator, whose product would be rounded."""
    return np.float64(math.fsum((x, x * (y - 1.0), z)))


fused = _exact if SIMULATED else _fma


# ---- from the nodes -----------------------------------------------------------------------------


def _begin(real, s, segments, velocity, ghosts):
    """A segment's patch of velocities, reflected at walls, into real."""
    gather(real, velocity, segments.table[s], 0)
    reflect(real, segments.mirror[s], ghosts, given.share_of(ghosts), s)
    meet()


def g2p(rows, law, segments, particles, velocity, beside, numbers, motion, maxima, worst, ghosts):
    """Velocities to particles, which move: kernels/g2p.py. maxima: (6,) see particle.tell; worst:
    (1,) lowest id that went wrong, times 8, and why."""
    now, at = cuda.local.array(3, np.int64), cuda.local.array(6, np.float64)
    mine = own_ghosts(ghosts, now, at)
    real, s = cuda.shared.array(BESIDE, REAL), rows[number()]
    _begin(real, s, segments, velocity, mine)
    complete(beside, real, segments.mirror[s])
    split = segments.split[s]
    if split:
        fetch(beside, segments.table[s], 0, segments.mirror[s], real, mine, s)
    meet()
    cap = particles.ids.size
    f, xi = particles.f, particles.xi
    cloud = Cloud(f, xi, particles.ids, cap)
    weights = cuda.local.array(16, REAL)
    record = cuda.local.array(16, REAL)
    extra = cuda.local.array(8, REAL)
    base = cuda.local.array(1, np.int32)
    most = cuda.local.array(6, REAL)
    lowest = cuda.local.array(1, np.int64)
    for c in range(6):
        most[c] = 0
    lowest[0] = worst[0]
    for n in each(segments.count[s]):
        p = segments.start[s] + n
        weigh(1, p, cap, xi, f, base, weights)
        if split:
            set_aside(beside, 1, weights, record, base, real, extra)
        if SPLINES:
            slopes(1, record, weights, base, real)
        else:
            moments(1, record, weights, base, real)
        _move(law, 1, p, cloud, record, beside, split, extra, numbers, segments.limit[s], motion,
              (most, lowest))  # fmt: skip
    _unite(most, lowest, maxima, worst)


def _unite(most, lowest, maxima, worst):
    """The maxima of a block into those of all."""
    table = cuda.shared.array((6, TEAM), REAL)
    t, n = rank(), TEAM // 2
    for c in range(6):
        table[c, t] = most[c]
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


def give_back(rows, times, segments, particles, velocity, dx, ghosts):
    """What transfers took: kernels/restore.py."""
    now, at = cuda.local.array(3, np.int64), cuda.local.array(6, np.float64)
    mine = own_ghosts(ghosts, now, at)
    real, s = cuda.shared.array(BESIDE, REAL), rows[number()]
    _begin(real, s, segments, velocity, mine)
    cap = particles.ids.size
    f, xi = particles.f, particles.xi
    weights = cuda.local.array(16, REAL)
    record = cuda.local.array(16, REAL)
    base = cuda.local.array(1, np.int32)
    for n in each(segments.count[s]):
        p = segments.start[s] + n
        weigh(1, p, cap, xi, f, base, weights)
        moments(1, record, weights, base, real)
        restore.give(f, p, cap, times, record, 0, dx)


def take(rows, channel, segments, particles, nodes):
    """Colours to particles: kernels/layers/colour.py."""
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
        weigh(1, p, cap, xi, f, base, weights)
        values(1, record, weights, base, real)
        for c in range(3):
            f[(channel + c) * cap + p] = record[c]


def follow(rows, segments, particles, first, dt):
    """Deformations that laws do not know: kernels/gradient.py."""
    s, cap, f = rows[number()], particles.ids.size, particles.f
    for n in each(segments.count[s]):
        turn(f, segments.start[s] + n, cap, first, dt)


def carried(rows, segments, block, particles, phase, ways, turned, dx, dt, motion, most, worst):
    """What is driven: kernels/driven.py. most: (6,) doubles."""
    lowest = cuda.local.array(1, np.int64)
    lowest[0] = worst[0]
    q = number()
    carry(rows[q : q + 1], segments, block, particles, phase, ways, turned, dx, dt, motion,
          (most, lowest))  # fmt: skip
    if lowest[0] < worst[0]:
        cuda.atomic.min(worst, 0, lowest[0])


row_terms = rowsums._row_terms
slopes_0, slopes_1, slopes_2 = (rowsums._scatter_slopes(node, 1) for node in range(3))

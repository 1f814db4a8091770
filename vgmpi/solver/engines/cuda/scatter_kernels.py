"""GPU loops of the transfer from particles to nodes, around the functions of kernels/.

A team of 16 threads processes a segment. Each thread is a particle that writes its record, then one
number of the four nodes of each row, for which it sums runs of records as the CPU does. Every
number of a patch belongs to one thread (node along z modulo 4, number in the node), so that rows
need no synchronization.
"""

import math

import numpy as np
from numba import cuda

from vgmpi.kernels import particle_records, stencil_sums
from vgmpi.kernels.cell_stencil_sums import scatter_by_cells
from vgmpi.kernels.nodal_fields.field_protocol import (
    MIRROR_NONE,
    particle_contribution,
)
from vgmpi.kernels.particle_records import PATCH, compute_weights
from vgmpi.kernels.transfer.liquid_volume import CellPressure
from vgmpi.kernels.wall_boundary import fold_ghost_momentum

from .grid_kernels import own_ghosts
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
SPLINES = CELLS = False
BY_SLOPES, BY_CELLS = 1, 2  # gradients along which records are added


def added_along(kind: tuple) -> int:
    """Return the gradients along which a contribution may be added, 0: by moments alone."""
    if isinstance(kind, CellPressure):
        return BY_CELLS
    return BY_SLOPES if hasattr(kind, "splines") else 0


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
        along: BY_SLOPES, BY_CELLS or 0: gradients by which records may be added.
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
            fold_ghost_momentum(patch, segments.mirror[s], kind.mirror, own, s)
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
            if CELLS and along == BY_CELLS:
                _along_cells(written, weights, m, patch, base)
                meet()
            elif SPLINES and along == BY_SLOPES:
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


def _by_node(make_part):
    """Make the sum of a record into the rows of this thread's node.

    Args:
        make_part: Function of a node and a number of nodes, as of stencil_sums.
    """
    first, second, third = (make_part(node, 1) for node in range(3))

    def _sum(written, weights, m, patch, base):
        node, o = rank() >> 2, base + (rank() & 3)
        if node == 0:
            first(m, m + 1, written, weights, patch, o)
        elif node == 1:
            second(m, m + 1, written, weights, patch, o)
        elif node == 2:
            third(m, m + 1, written, weights, patch, o)

    return _sum


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


row_terms = stencil_sums._row_terms
_along_slopes = _by_node(stencil_sums._scatter_slopes)  # by the gradients of the B-splines
_along_cells = _by_node(scatter_by_cells)

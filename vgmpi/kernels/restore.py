"""What transfers took from the particles' motion, given back: it passes through the grid in a step
of no time, and what it loses by that is what each transfer of the last steps took.
"""

from ..device.jit import inline, kernel
from ..device.limits import ROUNDING
from ..lanes.lanes import load, place, store
from ..lanes.rows import repeat
from .g2p import gathered
from .given import share_of
from .grid import fall
from .layers.colour import mean
from .patches import expect, gather, nodes_of
from .records import AFFINE, BATCH, PATCH, box_of, parts, rest, touched, weigh
from .rowsums import moments
from .sums import blocks_at, sums_at, take_up
from .walls import reflect


@kernel
def settle(blocks, tables, momentum, as_one, phases, step, report):
    """Velocities [m/s] at the nodes of some blocks in place of momentum, and no more: no gravity,
    contact or walls. See grid.update. as_one: (phases,) those of one number have one velocity,
    -1: each its own."""
    rows, moved = blocks_at(tables), sums_at(momentum)
    first, phase_of, least_of = place(tables.first), rows.phase, place(phases.least)
    push, nodes = repeat(step.fall, 0), moved.nodes
    for b in blocks:
        n0, n1 = first[b], first[b + 1]
        for nb in range(n0, n1):
            take_up(nb, rows, moved, report, 0)
        for nb in range(n0, n1):
            group = as_one[phase_of[nb]]
            met = False
            for other in range(n0, nb):
                met = met or as_one[phase_of[other]] == group
            if group < 0:
                fall(nb, nodes, push, ROUNDING * least_of[phase_of[nb]])
            elif not met:
                mean(nb, n1, group, phase_of, as_one, nodes)


@kernel
def give_back(rows, times, segments, particles, velocity, scratch, dx, ghosts):
    """To each particle `times` what its velocity and its velocity's gradient lose by the way to the
    grid and back.

    rows: (n,) segments to do; velocity: (node blocks, 256) [m/s]; ghosts: given.Ghosts,
    or None.
    """
    cap = particles.f.shape[1]
    f, xi = particles.f.reshape(particles.f.size), particles.xi.reshape(particles.xi.size)
    start, count, table, mirror = segments.start, segments.count, segments.table, segments.mirror
    weights, records, patch, _ = parts(scratch.real)
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
        for first in range(0, count[s], BATCH):
            n = min(BATCH, count[s] - first)
            at = start[s] + first
            weigh(n, at, cap, xi, f, base, weights)
            moments(n, records, weights, base, patch)
            rest(n, records)
            for m in range(0, n, 16):
                give(f, at + m, cap, times, records, 16 * m, dx)


@inline
def give(f, p, cap, times, records, at, dx):
    """To 16 particles from p, of what was gathered from records[at] on."""
    v0, v1, v2, _, L = gathered(records, at, 4.0 / dx)
    q = p + AFFINE * cap
    _give(f, p, times, v0)
    _give(f, p + cap, times, v1)
    _give(f, p + 2 * cap, times, v2)
    _give(f, q, times, L[0])
    _give(f, q + cap, times, L[1])
    _give(f, q + 2 * cap, times, L[2])
    _give(f, q + 3 * cap, times, L[3])
    _give(f, q + 4 * cap, times, L[4])
    _give(f, q + 5 * cap, times, L[5])
    _give(f, q + 6 * cap, times, L[6])
    _give(f, q + 7 * cap, times, L[7])
    _give(f, q + 8 * cap, times, L[8])


@inline
def _give(f, p, times, left):
    """A number of 16 particles, of which a transfer leaves `left`."""
    own = load(f, p)
    store(f, p, own + times * (own - left))

"""Particles to grid, on one private patch per segment (quadratic B-splines, APIC, MLS force), 16
particles or one row of nodes at a time.

A segment is the particles of one group (one phase, one material) whose base node lay in one 4^3
block when they were last sorted. Its patch holds the 8^3 nodes -1..6 of that block, so that a
particle may stray one cell before the next sort. A patch is filled by one thread in particle order;
nothing else touches it. Positions are integers, 2^-bits of a cell, relative to the middle of the
block: slow motion in single precision then loses nothing.

Both directions, this and g2p.py, go through records (records.py). Batches of 128 begin at the
segment's start; the batch is part of the numerical definition, since a run of particles with one
base node is summed before it is added to the patch.
"""

from ..device.jit import kernel
from ..lanes.lanes import place
from .layers import colour, impulses, momentum, offsets, shear  # noqa: F401  (what they give)
from .layers.base import OFFSET, UNSEEN, add, contribute
from .patches import clear, nodes_of
from .records import BATCH, box_of, parts, reach, touched, weigh
from .sums import push
from .walls import fold


@kernel
def fill(rows, kind, law, segments, particles, sums, scratch, dt, ghosts):
    """What particles contribute to a layer: of each segment into its patch, and that to the sums.

    rows: (n,) the segments to do; kind: the layer's (layers.base); law: the group's; segments,
    particles: see kernels/tables.py; sums: (rows, words, 256); scratch: the calling thread's; dt
    [s]; ghosts: given.Ghosts, or None.
    """
    cap = particles.f.shape[1]
    f, xi = particles.f.reshape(particles.f.size), particles.xi.reshape(particles.xi.size)
    totals = place(sums.reshape(sums.size))
    weights, records, patch, extra = parts(scratch.real)
    peak = place(scratch.peak)
    nodes = nodes_of(patch)
    base, box = scratch.whole, box_of(scratch.whole)
    start, count, into, mirror = segments.start, segments.count, segments.into, segments.mirror
    for s in rows:
        if kind.mirror != UNSEEN:
            touched(count[s], start[s], cap, xi, f, mirror[s], box)
        else:
            reach(count[s], start[s], cap, xi, f, box)
        clear(patch, box)
        for first in range(0, count[s], BATCH):
            n = min(BATCH, count[s] - first)
            at = start[s] + first
            weigh(n, at, cap, xi, f, base, weights)
            contribute(kind, law, n, at, cap, f, extra, peak, records, dt)
            add(kind, n, records, weights, base, patch)
        if kind.mirror != UNSEEN:
            fold(nodes, mirror[s], kind.mirror == OFFSET, ghosts, s)
        push(patch, totals, into[s], box)

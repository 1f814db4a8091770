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

import numpy as np

from ..device.jit import inline, kernel
from ..lanes.lanes import load, store
from ..lanes.rows import repeat, slope_change, slope_middle, spread, steps, stretch
from .patches import clear, push
from .records import (
    BATCH,
    PATCH,
    PLANE,
    ROW,
    VOLUME,
    impulses,
    inertia,
    momenta,
    offsets,
    parts,
    present,
    touched,
    weigh,
)
from .walls import SIDE, fold


@inline
def scatter(count, records, weights, base, patch):
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


@inline
def _scatter_slopes(count, records, weights, base, patch):
    """As `scatter`, with the gradients of the B-splines in place of weight times offset."""
    middle, change = slope_middle(patch), slope_change(patch)
    for n in range(count):
        m = 16 * n
        o = np.int64(base[n])
        w = stretch(weights, m + 8)
        a = repeat(records, m) * w + repeat(records, m + 12) * (middle + change * weights[m + 12])
        bx, by = repeat(records, m + 4) * w, repeat(records, m + 8) * w
        x, y = weights[m + 3], weights[m + 7]
        y0, y1, y2 = -0.25 * (1.5 + y), 0.5 * (1.0 + y), -0.25 * (0.5 + y)
        w0, w1, w2 = weights[m + 4], weights[m + 5], weights[m + 6]
        a0, a1, a2 = w0 * a + y0 * by, w1 * a + y1 * by, w2 * a + y2 * by
        b0, b1, b2 = w0 * bx, w1 * bx, w2 * bx
        for i in range(3):
            u = weights[m + i]
            g = -0.25 * (1.5 + x) if i == 0 else (0.5 * (1.0 + x) if i == 1 else -0.25 * (0.5 + x))
            store(patch, o, load(patch, o) + u * a0 + g * b0)
            store(patch, o + ROW, load(patch, o + ROW) + u * a1 + g * b1)
            store(patch, o + 2 * ROW, load(patch, o + 2 * ROW) + u * a2 + g * b2)
            o += PLANE


@kernel
def p2g(
    law, segments, border, sent, start, count, slots, into, mirror, xi, f, patches, volumes, apart,
    grid, scratch, base, numbers, dt,
):  # fmt: skip
    """Mass and momentum (with the stress's impulse over dt) of each segment into its patch, and
    that to the grid.

    segments: (n,) the segments to do; sent: (segments,) whose patches other ranks need: with
    `border` these are filled and kept, later they are only added to the grid in their turn; slots:
    (3, segments) where to keep its patches for others to sum, -1 for nowhere; not negative where
    contact and couplings ask for a patch of volumes and offsets; not negative where the stress's
    impulses are kept apart, in a patch of their own; into: (segments, 27) node
    blocks around each to add the patch to, -1 where it is not this thread's to add; mirror:
    (segments, 3, 2) wall codes (walls.py); xi: (3, cap) fixed-point positions; f: (channels, cap);
    patches: (slots, 2048) momentum [kg m/s] and mass [kg] of 8^3 nodes; volumes: the same
    two as patches and grid of sum V w (x_p - x_i) [m4] and sum V w [m3]; apart: None, or those of
    the stress's impulses [kg m/s]; grid: (blocks, 256). numbers: see Numbers. scratch
    (ROOM,) and base (BATCH + 22, int32) belong to the calling thread.
    """
    cap = f.shape[1]
    flat, flat_xi = f.reshape(f.size), xi.reshape(xi.size)
    weights, records, patch, extra = parts(scratch)
    nodes = patch[:PATCH].reshape((SIDE, SIDE, SIDE, 4))
    box = base[BATCH + 16 :]
    for s in segments:
        touched(count[s], start[s], cap, flat_xi, flat, mirror[s], box)
        if sent[s] and not border:
            push(patches[slots[0, s]], grid, into[s], box)
            if slots[1, s] >= 0:
                push(volumes[0][slots[0, s]], volumes[1], into[s], box)
            if apart is not None:
                if slots[2, s] >= 0:
                    push(apart[0][slots[0, s]], apart[1], into[s], box)
            continue
        for wanted in range(3):
            if wanted > 0 and slots[wanted, s] < 0:
                continue
            kept = slots[0, s]
            if kept >= 0:
                patch[:] = 0
            else:
                clear(patch, box)
            for first in range(0, count[s], BATCH):
                n = min(BATCH, count[s] - first)
                at = start[s] + first
                weigh(n, at, cap, flat_xi, flat, base, weights)
                if wanted == 1:
                    _offsets(law, n, at, cap, flat, apart, extra, records, numbers)
                else:
                    _momenta(
                        law, n, at, cap, flat, wanted, slots[2, s], apart, records, numbers, dt
                    )
                if numbers.splines > 0.0 and wanted != 1:
                    _scatter_slopes(n, records, weights, base, patch)
                else:
                    scatter(n, records, weights, base, patch)
            fold(nodes, mirror[s], wanted == 1)
            if kept >= 0:
                _keep(patch, wanted, kept, patches, volumes, apart)
            if wanted == 0 and not border:
                push(patch, grid, into[s], box)
            if wanted == 1 and not border:
                push(patch, volumes[1], into[s], box)
            if apart is not None:
                if wanted == 2 and not border:
                    push(patch, apart[1], into[s], box)


@inline
def _momenta(law, n, at, cap, f, wanted, split, apart, records, numbers, dt):
    """Records of momentum (wanted 0), with the stress's impulses where these are not kept apart, or
    of the impulses (2)."""
    if apart is not None:
        if wanted == 2:
            impulses(law, n, at, cap, f, numbers, records, dt)
            return
        if split >= 0:
            inertia(n, at, cap, f, records, numbers.density, numbers.affine, numbers.dx)
            return
    momenta(law, n, at, cap, f, records, numbers.density, numbers.affine, numbers.dx, dt)


@inline
def _offsets(law, n, at, cap, f, apart, extra, records, numbers):
    """Records of volumes and offsets: present volumes where the stress is kept apart, since it is
    the couplings that ask for them."""
    if apart is None:
        offsets(n, f, at + VOLUME * cap, numbers.share, records, numbers.dx)
    else:
        present(law, n, at, cap, f, extra)
        offsets(n, extra, 0, numbers.share, records, numbers.dx)


@inline
def _keep(patch, wanted, slot, patches, volumes, apart):
    """Put a patch where `wanted` patches are kept."""
    keep = patches[slot] if wanted == 0 else volumes[0][slot]
    if apart is not None:
        if wanted == 2:
            keep = apart[0][slot]
    for c in range(PATCH):
        keep[c] = patch[c]

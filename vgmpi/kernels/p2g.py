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

from ..device.jit import inline, kernel
from .patches import clear, push
from .records import (
    BATCH,
    PATCH,
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
from .rowsums import scatter, scatter_slopes
from .walls import SIDE, fold


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
                    scatter_slopes(n, records, weights, base, patch)
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

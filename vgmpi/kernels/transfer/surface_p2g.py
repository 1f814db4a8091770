"""P2G of the nodal fields that are read at the nodes next to surfaces alone.

In every step, the nodes next to surfaces are flagged, 64 bits per block. Of each batch of a segment
(kernels/transfer/p2g.py), the particles from the first to the last whose 27 nodes include such a
node contribute; so do complete runs of particles with one base node. Sums at flagged nodes
therefore have the same bits as if all particles contributed. Other nodes have partial sums.
"""

from typing import NamedTuple

import numpy as np

from vgmpi.kernels.nodal_fields import body_fields, surface_distance  # noqa: F401  (contributions)
from vgmpi.kernels.nodal_fields.field_protocol import accumulate, particle_contribution
from vgmpi.kernels.particle_records import (
    BATCH,
    clear,
    compute_base_rows,
    compute_weights,
    node_range,
    patch_of,
    split_scratch,
)
from vgmpi.kernels.reproducible_sums import accumulate_patch_at
from vgmpi.kernels.simd.vector16 import SIMD_WIDTH, pointer
from vgmpi.kernels.stencil_sums import scatter_values
from vgmpi.runtime.jit import borrowing_kernel, device_function, kernel


class SurfaceStencils(NamedTuple):
    """Segments with particles next to surfaces, and what of them contributes in a step."""

    number: np.ndarray  # (segments,) row of each segment in the other tables
    neighbors: np.ndarray  # (n, 27) rows of the blocks around among those near colliders, or -1
    batch: np.ndarray  # (n + 1,) first batch of each
    interval: np.ndarray  # (batches, 2) first particle of a batch that contributes, last one + 1
    box: np.ndarray  # (n, 6) nodes that they touch, see particle_records.node_range
    target: np.ndarray  # (n,) bit k: block k of the 27 around has nodes next to a surface


@borrowing_kernel
def flag_nodes(nodes, collider_number, free, free_reach, dx, flags):
    """Flag the nodes at which contact with a collider or a free body may act.

    Args:
        nodes: Normal and distance [m] of the nearest collider, shape (n, 64, 4).
        collider_number: Its number, shape (n, 64).
        free: Free bodies among the colliders, (colliders,) bool.
        free_reach: Distance up to which a free body acts, on both sides of its surface [cells].
        dx: Cell size [m].
        flags: Bit k: node k of the block is flagged (out), shape (n,) uint64.
    """
    for b in range(len(flags)):
        word = np.uint64(0)
        for node in range(64):
            d = nodes[b, node, 3]
            if free[collider_number[b, node]]:
                acts = abs(d) < free_reach * dx
            else:
                acts = d < np.inf
            if acts:
                word |= np.uint64(1) << np.uint64(node)
        flags[b] = word


@device_function
def _spread_flags(neighbors, flags, stencil):
    """Compute which base nodes of a patch have a flagged node among their 27.

    Args:
        neighbors: Rows of the 27 blocks neighbors, or -1.
        flags: Flags of the nodes, shape (blocks,).
        stencil: Bit 8 j + k of word i: base node (i, j, k) (out), shape (8,) uint64.

    Returns:
        Bit k: block k around has flagged nodes.
    """
    target = 0
    for k in range(27):
        if neighbors[k] >= 0 and flags[neighbors[k]] != 0:
            target |= 1 << k
    stencil[:] = 0
    if target == 0:
        return target
    bit, three_bits, four_bits = np.uint64(1), np.uint64(7), np.uint64(15)
    for i in range(8):
        word, gi = np.uint64(0), i + 3
        for j in range(8):
            gj = j + 3
            row = (gi >> 2) * 9 + (gj >> 2) * 3
            if not (target >> row) & 7:
                continue
            shift, nodes = np.uint64((gi & 3) * 16 + (gj & 3) * 4), np.uint64(0)
            if (target >> row) & 1:
                nodes |= (flags[neighbors[row]] >> (shift + np.uint64(3))) & bit
            if (target >> (row + 1)) & 1:
                nodes |= ((flags[neighbors[row + 1]] >> shift) & four_bits) << bit
            if (target >> (row + 2)) & 1:
                nodes |= ((flags[neighbors[row + 2]] >> shift) & three_bits) << np.uint64(5)
            word |= nodes << np.uint64(8 * j)
        word |= (word >> bit) | (word >> np.uint64(2))
        stencil[i] = word | (word >> np.uint64(8)) | (word >> np.uint64(16))
    for i in range(6):
        stencil[i] |= stencil[i + 1] | stencil[i + 2]
    return target


@kernel
def find_contributing_particles(rows, segments, particles, flags, stencils, scratch):
    """Find the particles of segments that reach flagged nodes.

    Args:
        rows: Segments, shape (m,).
        segments, particles: Segment table and particle arrays of the group.
        flags: Flags of the nodes of blocks near colliders, see `flag_nodes`.
        stencils: SurfaceStencils (in/out).
        scratch: Scratch of the calling thread.
    """
    cap = particles.f.shape[1]
    f, xi = particles.f.reshape(particles.f.size), particles.xi.reshape(particles.xi.size)
    base, stencil, box = scratch.integers, np.zeros(8, np.uint64), np.zeros(6, np.int64)
    for s in rows:
        q = stencils.number[s]
        stencils.target[q] = _spread_flags(stencils.neighbors[q], flags, stencil)
        if not stencil[:6].any():
            stencils.target[q] = 0
        if stencils.target[q] == 0:
            continue
        stencils.box[q, 0::2], stencils.box[q, 1::2] = 8, 0
        for k in range(stencils.batch[q + 1] - stencils.batch[q]):
            offset = segments.start[s] + k * BATCH
            n = max(min(BATCH, segments.count[s] - k * BATCH), 0)
            compute_base_rows(n, offset, cap, xi, base)
            first, end = n, 0
            for p in range(n):
                o = base[p]
                if (stencil[o >> 8] >> np.uint64((o >> 2) & 63)) & np.uint64(1):
                    first, end = min(first, p), p + 1
            interval = stencils.interval[stencils.batch[q] + k]
            interval[0], interval[1] = first, end
            if first < end:
                # from a multiple of 16 on: other lanes would lie behind the padding of the segment
                start = first // SIMD_WIDTH * SIMD_WIDTH
                node_range(end - start, offset + start, cap, xi, f, box)
                for a in range(3):
                    low, high = 2 * a, 2 * a + 1
                    stencils.box[q, low] = min(stencils.box[q, low], box[low])
                    stencils.box[q, high] = max(stencils.box[q, high], box[high])


@kernel
def particles_to_surface_nodes(rows, kind, offsets, law, segments, particles, sums, stencils,
                               scratch, dt):  # fmt: skip
    """Accumulate the contributions of particles next to surfaces to some nodal fields.

    Args:
        rows: Segments to process, shape (m,).
        kind: Contribution kind of the first four fields, nodal_fields/body_fields.py.
        offsets: Contribution kind of the fifth one, nodal_fields/surface_distance.py, or None.
        law: Material parameters of the group.
        segments, particles: Segment table and particle arrays of the group.
        sums: Accumulators of each field (in/out), shape (rows, words, 256).
        stencils: SurfaceStencils of this step.
        scratch: Scratch of the calling thread, with a patch for each field.
        dt: Time step [s].
    """
    cap = particles.f.shape[1]
    f, xi = particles.f.reshape(particles.f.size), particles.xi.reshape(particles.xi.size)
    weights, records, _, extra = split_scratch(scratch.real)
    peak, base = pointer(scratch.peak), scratch.integers
    for s in rows:
        q = stencils.number[s]
        box, target = stencils.box[q], stencils.target[q]
        if target == 0:
            continue
        for k in range(len(sums)):
            clear(patch_of(scratch.real, k), box)
        for b in range(stencils.batch[q], stencils.batch[q + 1]):
            n = stencils.interval[b, 1] - stencils.interval[b, 0]
            if n <= 0:
                continue
            offset = segments.start[s] + (b - stencils.batch[q]) * BATCH + stencils.interval[b, 0]
            compute_weights(n, offset, cap, xi, f, base, weights)
            particle_contribution(kind, law, n, offset, cap, f, extra, peak, records, dt)
            for k in range(4):
                scatter_values(n, records[4 * k :], weights, base, patch_of(scratch.real, k))
            if offsets is not None:
                particle_contribution(offsets, law, n, offset, cap, f, extra, peak, records, dt)
                accumulate(offsets, n, records, weights, base, patch_of(scratch.real, 4))
        for k in range(len(sums)):
            totals = pointer(sums[k].reshape(sums[k].size))
            patch, into = patch_of(scratch.real, k), segments.accumulator_rows[s]
            accumulate_patch_at(patch, totals, into, box, target)

"""Values that particles carry and exchange through the grid in every step: a PIC transfer.

    c_i = sum_p w_ip V_p c_p / sum_p w_ip V_p,     c_p <- sum_i w_ip c_i

V_p is the current volume. A field has three values times volume, and volume. Walls mirror no value:
nodes beyond them are ordinary nodes. Transferred colors are such values, and equal to those of
gaussians/color_diffusion.py.
"""

from typing import NamedTuple

import numpy as np

from vgmpi.kernels.particle_records import (
    BATCH,
    PATCH,
    box_of,
    compute_weights,
    load_patch,
    node_range,
    split_scratch,
    zero_padding,
)
from vgmpi.kernels.reproducible_sums import (
    blocks_at,
    finalize_node_block,
    next_power_of_two,
    sums_at,
)
from vgmpi.kernels.simd.row_ops import (
    broadcast,
    fourth_of,
    load_records,
    store_records,
    with_fourth,
)
from vgmpi.kernels.simd.vector16 import load, pointer, store
from vgmpi.kernels.stencil_sums import gather_value
from vgmpi.materials.tensor_math.select import select
from vgmpi.runtime.jit import borrowing_kernel, device_function, kernel

from .field_protocol import MIRROR_NONE, accumulate, particle_contribution
from .momentum import by_weights
from .surface_distance import current_volumes


class ValuesByVolume(NamedTuple):
    """Contribution of three values, weighted by the current volume."""

    mirror: float  # code of nodal_fields/field_protocol.py
    channel: float  # first of the three channels


def kind(plan, channel: int) -> ValuesByVolume:
    """Return the contribution of the values in three channels."""
    return ValuesByVolume(*(plan.real.type(v) for v in (MIRROR_NONE, channel)))


def accumulator_range(plan, span: np.ndarray) -> np.ndarray:
    """Return the scales of the sums, powers of two, shape (phases, 4).

    They are the volume of a cell times the largest value, and its volume.

    Args:
        plan: Plan of the run.
        span: Largest value of each phase, shape (phases,).
    """
    volume = next_power_of_two(plan.dx**3)
    product = volume * next_power_of_two(span)
    return np.stack([product, product, product, np.full_like(product, volume)], 1)


@particle_contribution.register(ValuesByVolume)
def _values_by_volume(kind, law, count, offset, cap, f, extra, peak, records, dt):
    zero = broadcast(f, 0.0)
    current_volumes(law, count, offset, cap, f, extra)
    first = np.int64(kind.channel) * cap + offset
    for n in range(0, count, 16):
        p, volume = first + n, load(extra, n)
        value, second, third = load(f, p), load(f, p + cap), load(f, p + 2 * cap)
        store_records(
            records,
            16 * n,
            (
                volume * value, volume * second, volume * third, volume, zero, zero, zero, zero,
                zero, zero, zero, zero, zero, zero, zero, zero,
            ),
        )  # fmt: skip


accumulate.register(ValuesByVolume)(by_weights)


@borrowing_kernel
def average_over_phases(blocks, tables, layer, set_of, report, k):
    """Compute the mean values at the nodes of some blocks, in place of sums.

    The mean is over all phases of a set.

    Args:
        blocks: Blocks to process, shape (n,).
        tables: Node blocks of the rank.
        layer: Sums of the field (in/out).
        set_of: (phases,) phases of one number share the mean, -1: none.
        report, k: Accumulator overflows (in/out) and number of the field, see
        kernels/reproducible_sums.py.
    """
    first, phase = pointer(tables.first), pointer(tables.phase)
    rows, field = blocks_at(tables), sums_at(layer)
    nodes = field.nodes
    for b in blocks:
        n0, n1 = first[b], first[b + 1]
        for nb in range(n0, n1):
            finalize_node_block(nb, rows, field, report, k)
        for nb in range(n0, n1):
            group = set_of[phase[nb]]
            is_done = False
            for other in range(n0, nb):
                is_done = is_done or set_of[phase[other]] == group
            if group >= 0 and not is_done:
                mean_over_set(nb, n1, group, phase, set_of, nodes)


@device_function
def mean_over_set(nb, last, group, phase, set_of, nodes):
    """Store the mean over a set of phases in all of its node blocks of one block.

    The mean is the sum of three numbers over the sum of the fourth, which stays that of each phase.

    Args:
        nb, last: First node block, and the one behind the last of the block.
        group: Number of the set.
        phase: Phase of each node block.
        set_of: Set of each phase.
        nodes: Nodal numbers, flat (in/out).
    """
    for c in range(0, 256, 16):
        total = load(nodes, 256 * nb + c)
        for other in range(nb + 1, last):
            if set_of[phase[other]] == group:
                total = total + load(nodes, 256 * other + c)
        volume = fourth_of(total)
        mean = select(volume > 0.0, total / volume, 0.0)
        for other in range(nb, last):
            if set_of[phase[other]] == group:
                store(nodes, 256 * other + c, with_fourth(mean, load(nodes, 256 * other + c)))


@kernel
def gather_values(rows, channel, segments, particles, nodes, scratch):
    """Gather three values from the grid, at the positions before particles move.

    Args:
        rows: Segments to process, shape (n,).
        channel: First of the three channels.
        segments, particles: Segment table and particle arrays (in/out) of the group.
        nodes: Mean values, shape (node blocks, 256).
        scratch: Scratch of the calling thread.
    """
    cap = particles.f.shape[1]
    f, xi = particles.f.reshape(particles.f.size), particles.xi.reshape(particles.xi.size)
    start, count, table = segments.start, segments.count, segments.table
    weights, records, patch, _ = split_scratch(scratch.real)
    patch[PATCH:] = 0
    base, box = scratch.integers, box_of(scratch.integers)
    for s in rows:
        node_range(count[s], start[s], cap, xi, f, box)
        load_patch(patch, nodes, table[s], box)
        for first in range(0, count[s], BATCH):
            n = min(BATCH, count[s] - first)
            offset = start[s] + first
            compute_weights(n, offset, cap, xi, f, base, weights)
            gather_value(n, records, weights, base, patch)
            zero_padding(n, records)
            for m in range(0, n, 16):
                value, second, third = load_records(records, 16 * m)[:3]
                p = channel * cap + offset + m
                store(f, p, value)
                store(f, p + cap, second)
                store(f, p + 2 * cap, third)

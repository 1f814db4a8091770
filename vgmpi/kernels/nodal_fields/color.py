"""Color transfer through the grid in every step, as published: a PIC transfer of three numbers.

    c_i = sum_p w_ip V_p c_p / sum_p w_ip V_p,     c_p <- sum_i w_ip c_i

V_p is the current volume. There is a field per coefficient: red, green, blue times volume, and
volume. Walls mirror no color: nodes beyond them are ordinary nodes, as in
gaussians/color_diffusion.py, to which this is equal.
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


class Color(NamedTuple):
    """Contribution of one color coefficient."""

    mirror: float  # code of nodal_fields/field_protocol.py
    channel: float  # first of the coefficient's three channels


def kind(plan, group, coefficient: int) -> Color:
    """Return the contribution of a group's particles to the field of a coefficient."""
    first = group.channels.first("color") + 3 * coefficient
    return Color(*(plan.real.type(v) for v in (MIRROR_NONE, first)))


def accumulator_range(plan, coefficient: int) -> np.ndarray:
    """Return the scales of the sums, powers of two, shape (phases, 4).

    They are the volume of a cell times the largest color, and its volume.
    """
    volume = next_power_of_two(plan.dx**3)
    hue = volume * next_power_of_two(plan.colors.span[:, coefficient])
    return np.stack([hue, hue, hue, np.full_like(hue, volume)], 1)


@particle_contribution.of(Color)
def _color(kind, law, count, offset, cap, f, extra, peak, records, dt):
    zero = broadcast(f, 0.0)
    current_volumes(law, count, offset, cap, f, extra)
    first = np.int64(kind.channel) * cap + offset
    for n in range(0, count, 16):
        p, volume = first + n, load(extra, n)
        red, green, blue = load(f, p), load(f, p + cap), load(f, p + 2 * cap)
        store_records(
            records,
            16 * n,
            (
                volume * red, volume * green, volume * blue, volume, zero, zero, zero, zero,
                zero, zero, zero, zero, zero, zero, zero, zero,
            ),
        )  # fmt: skip


accumulate.of(Color)(by_weights)


@borrowing_kernel
def average_over_phases(blocks, tables, layer, set_of, report, k):
    """Compute the mean color at the nodes of some blocks, in place of sums.

    The mean is over all phases of a set.

    Args:
        blocks: Blocks to process, shape (n,).
        tables: Node blocks of the rank.
        layer: Color sums (in/out).
        set_of: (phases,) phases of one number exchange colors, -1: none.
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
def gather_color(rows, channel, segments, particles, nodes, scratch):
    """Gather a color coefficient from the grid, at the positions before particles move.

    Args:
        rows: Segments to process, shape (n,).
        channel: First of the coefficient's three channels.
        segments, particles: Segment table and particle arrays (in/out) of the group.
        nodes: Mean colors, shape (node blocks, 256).
        scratch: Scratch of the calling thread.
    """
    cap = particles.f.shape[1]
    f, xi = particles.f.reshape(particles.f.size), particles.xi.reshape(particles.xi.size)
    start, count, table = segments.start, segments.count, segments.table
    weights, records, patch, _ = split_scratch(scratch.real)
    patch[PATCH:] = 0
    base, box = scratch.whole, box_of(scratch.whole)
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
                red, green, blue = load_records(records, 16 * m)[:3]
                p = channel * cap + offset + m
                store(f, p, red)
                store(f, p + cap, green)
                store(f, p + 2 * cap, blue)

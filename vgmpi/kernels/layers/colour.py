"""Colours through the grid with every step, as the paper has it: PIC's transfer of three numbers.

    c_i = sum_p w_ip V_p c_p / sum_p w_ip V_p,     c_p <- sum_i w_ip c_i

V_p is the volume as it is now. There is a layer per coefficient: red, green, blue times volume, and
volume. Walls mirror no colour: nodes beyond them are nodes like others, as in splatting/colour.py,
which this equals.
"""

from typing import NamedTuple

import numpy as np

from ...device.jit import inline, kernel
from ...device.select import select
from ...lanes.lanes import load, place, store
from ...lanes.nodes import fourth_of
from ...lanes.rows import load_records, spread, store_records
from ..patches import gather
from ..records import BATCH, PATCH, box_of, parts, reach, rest, weigh
from ..rowsums import scatter, values
from ..sums import blocks_at, power, sums_at, take_up
from .base import UNSEEN, add, contribute
from .offsets import present


class Colour(NamedTuple):
    mirror: float
    channel: float  # first of the coefficient's three


def kind(plan, group, coefficient: int) -> Colour:
    """What a group's particles contribute to the layer of a coefficient."""
    first = group.channels.first("colour") + 3 * coefficient
    return Colour(*(plan.real.type(v) for v in (UNSEEN, first)))


def full(plan, coefficient: int) -> np.ndarray:
    """Powers of two (phases, 4): a cell's volume times the largest colour, and its volume."""
    volume = power(plan.dx**3)
    hue = volume * power(plan.colours.span[:, coefficient])
    return np.stack([hue, hue, hue, np.full_like(hue, volume)], 1)


@contribute.of(Colour)
def _colour(kind, law, count, at, cap, f, extra, peak, records, dt):
    zero = spread(f, 0.0)
    present(law, count, at, cap, f, extra)
    first = np.int64(kind.channel) * cap + at
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


@add.of(Colour)
def _add(kind, count, records, weights, base, patch):
    scatter(count, records, weights, base, patch)


@kernel
def blend(blocks, tables, layer, set_of, report, k):
    """The mean colour at the nodes of some blocks, over all phases of a set, in place of sums.

    tables: NodeBlocks; layer: Sums; set_of: (phases,) those of one number exchange colours, -1:
    none; report, k: see sums.take_up.
    """
    first, phase = place(tables.first), place(tables.phase)
    rows, at = blocks_at(tables), sums_at(layer)
    nodes = at.nodes
    for b in blocks:
        n0, n1 = first[b], first[b + 1]
        for nb in range(n0, n1):
            take_up(nb, rows, at, report, k)
        for nb in range(n0, n1):
            group = set_of[phase[nb]]
            met = False
            for other in range(n0, nb):
                met = met or set_of[phase[other]] == group
            if group >= 0 and not met:
                mean(nb, n1, group, phase, set_of, nodes)


@inline
def mean(nb, last, group, phase, set_of, nodes):
    """The mean, sums over the fourth of them, of node block nb and of those behind it that are of
    its set, into all of them."""
    for c in range(0, 256, 16):
        total = load(nodes, 256 * nb + c)
        for other in range(nb + 1, last):
            if set_of[phase[other]] == group:
                total = total + load(nodes, 256 * other + c)
        volume = fourth_of(total)
        mean = select(volume > 0.0, total / volume, 0.0)
        for other in range(nb, last):
            if set_of[phase[other]] == group:
                store(nodes, 256 * other + c, mean)


@kernel
def take(rows, channel, segments, particles, nodes, scratch):
    """A coefficient of colour from the grid to the particles, where they are before they move.

    channel: the first of its three; nodes: (node blocks, 256).
    """
    cap = particles.f.shape[1]
    f, xi = particles.f.reshape(particles.f.size), particles.xi.reshape(particles.xi.size)
    start, count, table = segments.start, segments.count, segments.table
    weights, records, patch, _ = parts(scratch.real)
    patch[PATCH:] = 0
    base, box = scratch.whole, box_of(scratch.whole)
    for s in rows:
        reach(count[s], start[s], cap, xi, f, box)
        gather(patch, nodes, table[s], box)
        for first in range(0, count[s], BATCH):
            n = min(BATCH, count[s] - first)
            at = start[s] + first
            weigh(n, at, cap, xi, f, base, weights)
            values(n, records, weights, base, patch)
            rest(n, records)
            for m in range(0, n, 16):
                red, green, blue = load_records(records, 16 * m)[:3]
                p = channel * cap + at + m
                store(f, p, red)
                store(f, p + cap, green)
                store(f, p + 2 * cap, blue)

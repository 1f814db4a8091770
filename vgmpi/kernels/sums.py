"""Sums at nodes that do not depend on the order of their terms.

A sum is a double that rests at 1.5 2^52 u, u a power of two, its quantum. As long as it stays
within 2^51 u of rest its last place is worth u: a term is rounded to a multiple of u, and the
addition is exact. So patches, threads and ranks may add in any order, and in any tree. A term that
lies just between two multiples would be rounded by what was added before; it cannot: each is
multiplied by 1 + 2^-52 in the same rounding (fma), which leaves no ties for numbers of 53 bits that
are in range (Demmel & Nguyen 2015 pre-round for the same end).

In double precision what the first word lost of a term is added to a second word, with a quantum of
its own. A node block is 64 nodes of four numbers: 256 first words, then 256 second ones if any.
"""

import math
from typing import NamedTuple

import numpy as np

from ..device.jit import inline, kernel
from ..lanes.lanes import COUNT, ahead, load, place, store
from ..lanes.team import flat
from ..lanes.wide import (
    BLOCK,
    add_node,
    add_row,
    add_three,
    beyond,
    lowest,
    narrow,
    pack_node,
    unpack_node,
    words_of,
)
from .patches import row_of
from .walls import SIDE

DIGITS = 46  # binary digits that a sum keeps of the number that is called full
SECOND = 40  # digits that the second word begins behind the first


def words(real) -> int:
    """Doubles per sum, for terms of this precision."""
    return 1 if np.dtype(real) == np.float32 else 2


def rests(full: np.ndarray, real) -> np.ndarray:
    """What the sums of a row of four nodes rest at: (phases, words, 16).

    full: (phases, 4) powers of two: sums may reach 16 times as much, and keep DIGITS binary digits
    below it (and SECOND more in double precision).
    """
    quantum = full * 2.0**-DIGITS
    of = [quantum, quantum * 2.0**-SECOND][: words(real)]
    return np.ascontiguousarray(1.5 * 2.0**52 * np.tile(np.stack(of, 1), COUNT // 4))


def power(values) -> np.ndarray:
    """Each number as a power of two that is not below it; 1 for 0."""
    values = np.asarray(values, np.float64)
    return np.exp2(np.ceil(np.log2(np.where(values > 0.0, values, 1.0))))


def coarse(speed: float) -> float:
    """A power of 8 that is not below a speed [m/s], so that it changes seldom; of none, a very
    small one."""
    return 8.0 ** math.ceil(math.log2(max(speed, 1e-30)) / 3.0)


@inline
def push(patch, sums, blocks, box):
    """Add the nodes of a box of a patch to the sums of the 27 node blocks around it.

    patch: (2048,); sums: by their place (lanes.place); box: (6,) first and last nodes along x, y,
    z. A row of a patch, eight nodes along z, is one node of the block below, the four of its own
    and three of the block above.
    """
    size = BLOCK * words_of(patch)
    below, above = box[4] < 1, box[5] > 5
    for i in range(box[0], box[1]):
        for j in range(box[2], box[3]):
            row, at = row_of(i, j)
            of = (i * SIDE + j) * SIDE * 4
            if below:
                add_node(sums, size * blocks[row] + at + 12, patch, of)
            add_row(sums, size * blocks[row + 1] + at, patch, of + 4)
            if above:
                add_three(sums, size * blocks[row + 2] + at, patch, of + 20)


@inline
def settle(sums, rest, block, phase, nodes):
    """The sums of a node block as numbers of the run's precision, into nodes (256 blocks,); the
    sums are at rest again. All arrays by their places. Returns bits of the numbers that left their
    range, of all 16 rows together."""
    count = words_of(nodes)
    to, at, r = BLOCK * block, BLOCK * count * block, COUNT * count * phase
    first = load(rest, r)
    bad = 0
    for c in range(0, BLOCK, COUNT):
        # of the node block that follows
        ahead(sums, at + BLOCK * count + c)
        ahead(nodes, to + BLOCK + c)
        value = load(sums, at + c) - first
        store(sums, at + c, first)
        bad |= beyond(value, first)
        if count == 2:
            second = load(rest, r + COUNT)
            value = value + (load(sums, at + BLOCK + c) - second)
            store(sums, at + BLOCK + c, second)
        store(nodes, to + c, narrow(value, nodes))
    return bad


@inline
def unite(sums, rest, phase, to, of, count):
    """Add the sums of node block `of` to those of `to`, and leave it at rest. sums, rest: by their
    places; count: words."""
    for w in range(count):
        r = load(rest, COUNT * (count * phase + w))
        at, other = BLOCK * (count * to + w), BLOCK * (count * of + w)
        for c in range(0, BLOCK, COUNT):
            store(sums, at + c, load(sums, at + c) + (load(sums, other + c) - r))
            store(sums, other + c, r)


@kernel
def reset(sums, rest, rows, phase):
    """Put the sums of some node blocks to rest. sums: (rows, words, 256); rest: (phases, words,
    16); phase: of every row."""
    for row in rows:
        for w in range(sums.shape[1]):
            for c in range(BLOCK):
                sums[row, w, c] = rest[phase[row], w, c & 15]


class BlocksAt(NamedTuple):
    """What bringing sums together needs of NodeBlocks, by the places of the arrays."""

    phase: np.ndarray
    copied: np.ndarray
    copies: np.ndarray


class SumsAt(NamedTuple):
    """A tables.Sums by the places of its arrays."""

    sums: np.ndarray
    rest: np.ndarray
    asked: np.ndarray
    nodes: np.ndarray
    words: int


@inline
def blocks_at(tables):
    """tables: NodeBlocks."""
    return BlocksAt(place(tables.phase), place(tables.copied), place(tables.copies))


@inline
def sums_at(layer):
    """layer: tables.Sums."""
    return SumsAt(
        flat(layer.sums),
        flat(layer.rest),
        place(layer.asked),
        flat(layer.nodes),
        words_of(layer.nodes),
    )


@inline
def _unite_copies(nb, blocks, layer):
    """Add what threads summed by themselves to a node block."""
    for c in range(blocks.copied[nb], blocks.copied[nb + 1]):
        unite(layer.sums, layer.rest, blocks.phase[nb], nb, blocks.copies[c], layer.words)


@inline
def take_up(nb, blocks, layer, report, which):
    """Bring the sums of a node block together and turn them to numbers.

    blocks, layer: see `blocks_at`, `sums_at`; report: (layers,) lowest node block + 1 of which a
    sum left its range, or 0; which: layer.
    """
    if layer.asked[nb] == 0:
        return
    _unite_copies(nb, blocks, layer)
    if settle(layer.sums, layer.rest, nb, blocks.phase[nb], layer.nodes) != 0:
        if report[which] == 0 or nb < report[which] - 1:
            report[which] = nb + 1


@kernel
def merge(rows, tables, layer):
    """Add what threads summed by themselves to some node blocks, before ranks exchange these."""
    blocks, at = blocks_at(tables), sums_at(layer)
    for nb in rows:
        _unite_copies(nb, blocks, at)


@kernel
def pack(numbers, tails, blocks, masks, bits):
    """The sums of some nodes as a message: 52 bits each, since the exponent is that of what they
    rest at.

    numbers: (3 n,) uint64 and tails: (n,) uint16 out, of n times four sums, node after node and
    word after word (wide.pack_node); blocks: (m,); masks: (m,) uint64, bit k: node k of the 64 is
    wanted; bits: sums (rows, words, 256) as uint64.
    """
    of, to, behind = place(bits.reshape(bits.size)), place(numbers), place(tails)
    count, n = bits.shape[1], 0
    for q in range(len(blocks)):
        for w in range(count):
            here = BLOCK * (count * blocks[q] + w)
            left = masks[q]
            while left != 0:
                pack_node(to, 3 * n, behind, n, of, here + 4 * lowest(left))
                left &= left - np.uint64(1)
                n += 1


@kernel
def unpack(numbers, tails, blocks, masks, sums, rest, phase):
    """Add what another rank summed, the inverse of `pack`. sums: (rows, words, 256); rest: (phases,
    words, 16); phase: of each node block."""
    of, behind, r = place(numbers), place(tails), place(rest.reshape(rest.size))
    to, count, n = place(sums.reshape(sums.size)), sums.shape[1], 0
    for q in range(len(blocks)):
        for w in range(count):
            here = BLOCK * (count * blocks[q] + w)
            begins = COUNT * (count * phase[blocks[q]] + w)
            left = masks[q]
            while left != 0:
                unpack_node(to, here + 4 * lowest(left), of, 3 * n, behind, n, r, begins)
                left &= left - np.uint64(1)
                n += 1

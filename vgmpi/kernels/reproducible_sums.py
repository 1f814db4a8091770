"""Reproducible summation at grid nodes.

An accumulator is a double with the bias 1.5 2^52 u, where the quantum u is a power of two. As long
as it stays within 2^51 u of the bias, its last place is worth u: a term is rounded to a multiple of
u, and the addition is exact. So patches, threads and ranks may add in any order, and in any tree. A
term exactly between two multiples would be rounded depending on the previous terms; this is
excluded: each term is multiplied by 1 + 2^-52 in the same rounding (fma), which leaves no ties for
numbers of 53 bits that are in range (Demmel and Nguyen 2015 pre-round for the same purpose).

In double precision a second word, with a quantum of its own, accumulates what the first word rounds
off. A node block is 64 nodes of four numbers: 256 first words, then 256 second ones if any.
"""

import math
from typing import NamedTuple

import numpy as np

from vgmpi.kernels.simd.cooperative import flat_pointer
from vgmpi.kernels.simd.reproducible_add import (
    BLOCK,
    add_node,
    add_row,
    add_three,
    lowest,
    overflow_mask,
    pack_node,
    to_working_precision,
    unpack_node,
    words_of,
)
from vgmpi.kernels.simd.vector16 import SIMD_WIDTH, load, pointer, prefetch, store
from vgmpi.runtime.jit import always_inline, borrowing_kernel, device_function

from .particle_records import row_of
from .wall_boundary import SIDE

ACCUMULATOR_BITS = 46  # binary digits that a sum keeps below its scale
SECOND_WORD_SHIFT = 40  # binary digits from the quantum of the first word to that of the second
REMAINDER = 2.0**-36  # [quanta] quantum of what rounding to whole quanta leaves of a term


def accumulator_words(real) -> int:
    """Return the number of doubles per sum, for terms of this precision."""
    return 1 if np.dtype(real) == np.float32 else 2


def accumulator_biases(full: np.ndarray, real) -> np.ndarray:
    """Return the biases of the sums of a row of four nodes, shape (phases, words, 16).

    Args:
        full: Scales of the sums, powers of two, shape (phases, 4): sums may reach 16 times as much,
            and keep ACCUMULATOR_BITS binary digits below it (and SECOND_WORD_SHIFT more in double
            precision).
        real: Dtype of the terms.
    """
    quantum = full * 2.0**-ACCUMULATOR_BITS
    quanta = [quantum, quantum * 2.0**-SECOND_WORD_SHIFT][: accumulator_words(real)]
    return np.ascontiguousarray(1.5 * 2.0**52 * np.tile(np.stack(quanta, 1), SIMD_WIDTH // 4))


def next_power_of_two(values) -> np.ndarray:
    """Return for each number the least power of two that is not below it; 1 for 0."""
    values = np.asarray(values, np.float64)
    return np.exp2(np.ceil(np.log2(np.where(values > 0.0, values, 1.0))))


def quantize_speed(speed: float) -> float:
    """Return a power of 8 that is not below a speed [m/s], so that it seldom changes.

    The result for zero speed is very small.
    """
    return 8.0 ** math.ceil(math.log2(max(speed, 1e-30)) / 3.0)


@device_function
def accumulate_patch(patch, sums, blocks, box):
    """Add the nodes of a box of a patch to the sums of the 27 node blocks around it.

    A row of a patch, eight nodes along z, is one node of the block below, the four of its own block
    and three of the block above.

    Args:
        patch: Patch, shape (2048,).
        sums: Accumulators (in/out), as a pointer (vector16.pointer).
        blocks: Rows of the sums of the 27 node blocks.
        box: First and last nodes along x, y, z, shape (6,).
    """
    size = BLOCK * words_of(patch)
    below, above = box[4] < 1, box[5] > 5
    for i in range(box[0], box[1]):
        for j in range(box[2], box[3]):
            row, offset = row_of(i, j)
            source = (i * SIDE + j) * SIDE * 4
            if below:
                add_node(sums, size * blocks[row] + offset + 12, patch, source)
            add_row(sums, size * blocks[row + 1] + offset, patch, source + 4)
            if above:
                add_three(sums, size * blocks[row + 2] + offset, patch, source + 20)


@device_function
def accumulate_patch_at(patch, sums, blocks, box, target):
    """Add the nodes of a box of a patch to the sums of some of the 27 node blocks around it.

    Args:
        patch, sums, blocks, box: See `accumulate_patch`.
        target: Bit k: node block k receives sums.
    """
    size = BLOCK * words_of(patch)
    below, above = box[4] < 1, box[5] > 5
    for i in range(box[0], box[1]):
        for j in range(box[2], box[3]):
            row, offset = row_of(i, j)
            source, bits = (i * SIDE + j) * SIDE * 4, target >> row
            if below and bits & 1:
                add_node(sums, size * blocks[row] + offset + 12, patch, source)
            if bits & 2:
                add_row(sums, size * blocks[row + 1] + offset, patch, source + 4)
            if above and bits & 4:
                add_three(sums, size * blocks[row + 2] + offset, patch, source + 20)


@device_function
def finalize_sums(sums, bias, block, phase, nodes):
    """Convert the sums of a node block to numbers and reset the sums to their biases.

    Args:
        sums: Accumulators (in/out); all arrays are pointers.
        bias: Biases.
        block: Node block.
        phase: Its phase.
        nodes: Numbers in the working precision (out), (256 blocks,).

    Returns:
        Bits of the numbers that left their range, of all 16 rows together.
    """
    count = words_of(nodes)
    target, offset, r = BLOCK * block, BLOCK * count * block, SIMD_WIDTH * count * phase
    first = load(bias, r)
    bad = 0
    for c in range(0, BLOCK, SIMD_WIDTH):
        # prefetch the next node block
        prefetch(sums, offset + BLOCK * count + c)
        prefetch(nodes, target + BLOCK + c)
        value = load(sums, offset + c) - first
        store(sums, offset + c, first)
        bad |= overflow_mask(value, first)
        if count == 2:
            second = load(bias, r + SIMD_WIDTH)
            value = value + (load(sums, offset + BLOCK + c) - second)
            store(sums, offset + BLOCK + c, second)
        store(nodes, target + c, to_working_precision(value, nodes))
    return bad


@device_function
def merge_accumulators(sums, bias, phase, target, source, count):
    """Add the sums of one node block to those of another, and reset the former.

    Args:
        sums: Accumulators (in/out), as a pointer.
        bias: Biases, as a pointer.
        phase: Phase of both node blocks.
        target: Node block that receives the sums.
        source: Node block that is reset.
        count: Words per sum.
    """
    for w in range(count):
        r = load(bias, SIMD_WIDTH * (count * phase + w))
        offset, other = BLOCK * (count * target + w), BLOCK * (count * source + w)
        for c in range(0, BLOCK, SIMD_WIDTH):
            store(sums, offset + c, load(sums, offset + c) + (load(sums, other + c) - r))
            store(sums, other + c, r)


@borrowing_kernel
def reset(sums, bias, rows, phase):
    """Reset the sums of some node blocks to their biases.

    Args:
        sums: Accumulators (out), shape (rows, words, 256).
        bias: Biases, shape (phases, words, 16).
        rows: Rows to reset.
        phase: Phase of every row.
    """
    for row in rows:
        for w in range(sums.shape[1]):
            for c in range(BLOCK):
                sums[row, w, c] = bias[phase[row], w, c & 15]


class NodeBlockPointers(NamedTuple):
    """Node-block arrays that merging sums needs, as pointers."""

    phase: np.ndarray  # (node blocks,)
    copy_offsets: np.ndarray  # (node blocks + 1,) offsets into `copies`
    copies: np.ndarray  # rows of the private sums of threads


class FieldPointers(NamedTuple):
    """Arrays of a kernel_arguments.Sums, as pointers."""

    sums: np.ndarray  # accumulators
    bias: np.ndarray  # biases
    has_terms: np.ndarray  # (node blocks,) 1 if it has terms
    nodes: np.ndarray  # values in the working precision
    words: int  # doubles per sum


@device_function
def blocks_at(tables):
    """Return the pointers of a table of node blocks (kernel_arguments.NodeBlocks)."""
    return NodeBlockPointers(
        pointer(tables.phase), pointer(tables.copy_offsets), pointer(tables.copies)
    )


@device_function
def sums_at(layer):
    """Return the pointers of a nodal field (kernel_arguments.Sums)."""
    return FieldPointers(
        flat_pointer(layer.sums),
        flat_pointer(layer.bias),
        pointer(layer.has_terms),
        flat_pointer(layer.nodes),
        words_of(layer.nodes),
    )


@device_function
def _unite_copies(nb, blocks, layer):
    """Add the private sums of other threads to a node block."""
    for c in range(blocks.copy_offsets[nb], blocks.copy_offsets[nb + 1]):
        merge_accumulators(
            layer.sums, layer.bias, blocks.phase[nb], nb, blocks.copies[c], layer.words
        )


@device_function
def finalize_node_block(nb, blocks, layer, report, which):
    """Merge the sums of a node block and convert them to numbers.

    Args:
        nb: Node block.
        blocks: Node-block pointers, see `blocks_at`.
        layer: Field pointers (in/out), see `sums_at`.
        report: Lowest node block + 1 with a sum out of range, or 0, by field (in/out).
        which: Number of the field.
    """
    if layer.has_terms[nb] == 0:
        return
    _unite_copies(nb, blocks, layer)
    if finalize_sums(layer.sums, layer.bias, nb, blocks.phase[nb], layer.nodes) != 0:
        if report[which] == 0 or nb < report[which] - 1:
            report[which] = nb + 1


@borrowing_kernel
def finalize_field(tables, layer, report, which):
    """Convert the sums of a field to numbers at all node blocks of a rank.

    Args:
        tables: Node blocks of the rank, NodeBlocks.
        layer: Field, Sums (in/out).
        report: Lowest node block + 1 with a sum out of range, or 0, by field (in/out).
        which: Number of the field.
    """
    blocks, field = blocks_at(tables), sums_at(layer)
    for nb in range(len(tables.phase)):
        finalize_node_block(nb, blocks, field, report, which)


@borrowing_kernel
def merge_thread_copies(rows, tables, layer):
    """Add the private sums of threads to some node blocks, before ranks exchange these."""
    blocks, field = blocks_at(tables), sums_at(layer)
    for nb in rows:
        _unite_copies(nb, blocks, field)


@borrowing_kernel
def pack(numbers, tails, blocks, masks, bits):
    """Pack the sums of some nodes into a message, 52 bits each.

    The exponent of a sum is that of its bias and need not be sent.

    Args:
        numbers: Leading bits (out), shape (3 n,) uint64, of n times four sums, node after node and
            word after word (reproducible_add.pack_node).
        tails: Trailing bits (out), shape (n,) uint16.
        blocks: Node blocks, shape (m,).
        masks: Selected nodes, shape (m,) uint64: bit k selects node k of the 64.
        bits: Sums as uint64, shape (rows, words, 256).
    """
    source, target, tail_pointer = (
        pointer(bits.reshape(bits.size)),
        pointer(numbers),
        pointer(tails),
    )
    count, n = bits.shape[1], 0
    for q in range(len(blocks)):
        for w in range(count):
            offset = BLOCK * (count * blocks[q] + w)
            remaining = masks[q]
            while remaining != 0:
                pack_node(target, 3 * n, tail_pointer, n, source, offset + 4 * lowest(remaining))
                remaining &= remaining - np.uint64(1)
                n += 1


@borrowing_kernel
def unpack(numbers, tails, blocks, masks, sums, bias, phase):
    """Add the sums of another rank, the inverse of `pack`.

    Args:
        numbers, tails, blocks, masks: Message and nodes, see `pack`.
        sums: Accumulators (in/out), shape (rows, words, 256).
        bias: Biases, shape (phases, words, 16).
        phase: Phase of each node block.
    """
    source, tail_pointer, r = pointer(numbers), pointer(tails), pointer(bias.reshape(bias.size))
    target, count, n = pointer(sums.reshape(sums.size)), sums.shape[1], 0
    for q in range(len(blocks)):
        for w in range(count):
            offset = BLOCK * (count * blocks[q] + w)
            bias_offset = SIMD_WIDTH * (count * phase[blocks[q]] + w)
            remaining = masks[q]
            while remaining != 0:
                unpack_node(
                    target,
                    offset + 4 * lowest(remaining),
                    source,
                    3 * n,
                    tail_pointer,
                    n,
                    r,
                    bias_offset,
                )
                remaining &= remaining - np.uint64(1)
                n += 1


@always_inline
def add_in_quanta(sums, place, term, per_quantum):
    """Add a term to a sum of whole numbers, of quanta and of what rounding to these leaves.

    Args:
        sums: Whole numbers of quanta and of remainders, shape (n, 2) int64 (in/out).
        place: Number of the sum.
        term: The term.
        per_quantum: Inverse of the quantum.
    """
    quanta = term * per_quantum
    units = np.rint(quanta)
    sums[place, 0] += np.int64(units)
    sums[place, 1] += np.int64(np.rint((quanta - units) / REMAINDER))

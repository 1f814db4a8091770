"""Sums at nodes: the same bits in any order, over any threads and ranks; how exact they are."""

import math

import numpy as np
import pytest

from vgmpi.kernels import reproducible_sums
from vgmpi.kernels.kernel_arguments import NodeBlocks, Sums
from vgmpi.kernels.simd.vector16 import pointer
from vgmpi.runtime.aligned_arrays import aligned_zeros
from vgmpi.runtime.jit import kernel

REALS = [np.dtype(np.float32), np.dtype(np.float64)]
FULL = np.array([[0.25, 0.25, 0.25, 1.0], [2.0, 2.0, 2.0, 4.0]])  # of two phases
CASES = 5000  # drawn at random
PHASE = np.array([0] * 20 + [1] * 7)  # of the 27 node blocks around a block


@kernel
def push_all(order, patches, table, boxes, totals):
    flat = pointer(totals.reshape(totals.size))
    for p in order:
        reproducible_sums.accumulate_patch(patches[p], flat, table, boxes[p])


@kernel
def settle_all(tables, layer, report):
    rows, at = reproducible_sums.blocks_at(tables), reproducible_sums.sums_at(layer)
    for nb in range(len(tables.phase)):
        reproducible_sums.finalize_node_block(nb, rows, at, report, 0)


class Rank:
    """One rank's sums of 27 node blocks, with a copy of each for a second thread."""

    def __init__(self, real):
        self.bias = reproducible_sums.accumulator_biases(FULL, real)
        self.phase = np.concatenate([PHASE, PHASE])
        self.sums = aligned_zeros((54, reproducible_sums.accumulator_words(real), 256), np.float64)
        self.nodes = aligned_zeros((27, 256), real)
        reproducible_sums.reset(self.sums, self.bias, np.arange(54), self.phase)

    def push(self, order, patches, boxes, thread=0):
        push_all(order, patches, np.arange(27) + 27 * thread, boxes, self.sums)

    @property
    def layer(self):
        return Sums(self.sums, self.bias, np.ones(27, np.uint8), self.nodes)

    @property
    def tables(self):
        none = np.zeros(0, bool)
        copied = np.arange(28)
        return NodeBlocks(
            copied, PHASE, np.zeros((27, 3), np.int64), none, PHASE, copied, 27 + np.arange(27)
        )

    def give(self, other):
        """Everything this rank summed, to another."""
        blocks, masks = np.arange(27), np.full(27, 2**64 - 1, np.uint64)
        n = self.sums[:27].size // 4
        numbers, tails = np.zeros(3 * n, np.uint64), np.zeros(n, np.uint16)
        reproducible_sums.merge_thread_copies(blocks, self.tables, self.layer)
        reproducible_sums.pack(numbers, tails, blocks, masks, self.sums.view(np.uint64))
        return lambda: reproducible_sums.unpack(
            numbers, tails, blocks, masks, other.sums, other.bias, PHASE
        )

    def values(self):
        """(values at the nodes, whether a sum left its range)."""
        report = np.zeros(1, np.int64)
        settle_all(self.tables, self.layer, report)
        return self.nodes.copy(), int(report[0])


def drawn(seed, n, real):
    """Patches (n, 2048) of numbers of all sizes, some just between two multiples of a quantum, and
    the boxes that hold them."""
    random = np.random.default_rng(seed)
    wide = random.standard_normal((n, 8, 8, 8, 4)) * 2.0 ** random.integers(
        -70, -1, (n, 1, 1, 1, 4)
    )
    odd = 2 * random.integers(-(2**22), 2**22, wide.shape) + 1
    ties = odd * 2.0 ** -(
        reproducible_sums.ACCUMULATOR_BITS + 1 + random.integers(0, 4, wide.shape)
    )
    values = np.where(random.random(wide.shape) < 0.5, ties * FULL[0], wide * 2.0**-6)
    boxes = np.zeros((n, 6), np.int32)
    for p in range(n):
        low = random.integers(0, 6, 3)
        high = [random.integers(a + 3, 9) for a in low]
        boxes[p] = np.stack([low, high], 1).ravel()
        inside = np.zeros((8, 8, 8), bool)
        inside[low[0] : high[0], low[1] : high[1], low[2] : high[2]] = True
        values[p][~inside] = 0
    return aligned_as(values.reshape(n, 2048), real), boxes


def aligned_as(values, real):
    out = aligned_zeros(values.shape, real)
    out[:] = values
    return out


def spread_over(rank_of, thread_of, order, patches, boxes, real):
    """Values on every rank after all gave all what they summed."""
    ranks = [Rank(real) for _ in range(int(rank_of.max()) + 1)]
    for p in order:
        ranks[rank_of[p]].push(np.array([p]), patches, boxes, int(thread_of[p]))
    given_ = [a.give(b) for b in ranks for a in ranks if a is not b]
    for add in given_:
        add()
    return [rank.values() for rank in ranks]


@pytest.mark.parametrize("real", REALS, ids=str)
def test_any_order_and_any_split_gives_the_bits_of_one(real):
    """Segments in any order, over any ranks and threads."""
    met = np.zeros(5, int)
    for case in range(CASES):
        random = np.random.default_rng([case, 1])
        n, ranks = random.integers(1, 9), random.integers(1, 5)
        patches, boxes = drawn(case, n, real)
        one = Rank(real)
        one.push(np.arange(n), patches, boxes)
        want, _ = one.values()
        rank_of, thread_of = random.integers(0, ranks, n), random.integers(0, 2, n)
        order = random.permutation(n)
        for got, beyond in spread_over(rank_of, thread_of, order, patches, boxes, real):
            assert got.tobytes() == want.tobytes() and not beyond, case
        met[rank_of.max()] += 1
    assert (met[:4] > 100).all()


@pytest.mark.parametrize("real", REALS, ids=str)
def test_how_exact_a_sum_is(real):
    """A quantum of the last word per term, and the rounding of the result."""
    patches, boxes = drawn(5, 30, real)
    boxes[:] = [0, 8, 0, 8, 0, 8]
    rank = Rank(real)
    rank.push(np.arange(30), patches, boxes)
    got, _ = rank.values()
    got = got.reshape(3, 3, 3, 4, 4, 4, 4).transpose(0, 3, 1, 4, 2, 5, 6).reshape(12, 12, 12, 4)
    got = got[3:11, 3:11, 3:11].reshape(-1)
    exact = np.array([math.fsum(row) for row in patches.T.astype(np.float64)])
    digits = reproducible_sums.ACCUMULATOR_BITS + (
        reproducible_sums.SECOND_WORD_SHIFT if real == REALS[1] else 0
    )
    allowed = 30 * 2.0**-digits * np.maximum.reduce(FULL.max(0)) + np.finfo(real).eps * np.abs(
        exact
    )
    assert (np.abs(got - exact) <= allowed).all()


@pytest.mark.parametrize("real", REALS, ids=str)
@pytest.mark.parametrize("value", [17.0, -17.0, np.nan, np.inf])
def test_a_sum_beyond_its_range_is_told(real, value):
    """16 times what is called full is the most; the lowest node block is named."""
    for most, told in ((15.0, 0), (value, 14)):
        rank = Rank(real)
        patches = aligned_zeros((1, 2048), real)
        patches[0].reshape(8, 8, 8, 4)[2, 2, 2, 3] = most
        rank.push(np.zeros(1, np.int64), patches, np.array([[0, 8, 0, 8, 0, 8]], np.int32))
        assert rank.values()[1] == told


def test_a_sum_is_at_rest_again():
    rank = Rank(REALS[1])
    before = rank.sums.copy()
    patches, boxes = drawn(1, 4, REALS[1])
    rank.push(np.arange(4), patches, boxes, thread=1)
    assert (rank.sums != before).any()
    rank.values()
    assert rank.sums[:27].tobytes() == before[:27].tobytes()
    assert rank.sums[27:].tobytes() == before[27:].tobytes()


def test_plain_addition_would_not_do():
    """The same numbers, added as they are to the same sums: the order shows."""
    patches, _ = drawn(3, 8, REALS[0])
    at_rest = 1.5 * 2.0**52 * 2.0**-reproducible_sums.ACCUMULATOR_BITS * FULL[0, 0]
    found = set()
    for order in (range(8), range(7, -1, -1)):
        total = np.full(2048, at_rest)
        for p in order:
            total = total + patches[p].astype(np.float64)
        found.add(total.tobytes())
    assert len(found) == 2

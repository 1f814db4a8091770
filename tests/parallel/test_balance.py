"""Cuts of the curve: the largest piece is as small as it can be, little moves, and only when it
pays.
"""

from itertools import combinations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from vgmpi.parallel.load_balance import (
    AMORTIZATION_SORTS,
    CANDIDATES_PER_CUT,
    MIGRATION_COST,
    REPARTITION_COST,
    SHARES,
    SLACK,
    by_block,
    candidate_cuts,
    imbalance,
    loads,
    owners,
    partition,
    predicted_work,
    rebalance,
    should_rebalance,
)

weights = st.lists(st.floats(0.1, 100.0), max_size=60).map(np.array)


def some_keys(n, seed=0):
    return np.sort(np.random.default_rng(seed).choice(1000, n, replace=False))


def least_possible(work, ranks):
    """Smallest largest piece of all ways to cut, by trying them all."""
    sums = np.concatenate([[0.0], np.cumsum(work)])
    best = np.inf
    for at in combinations(range(len(work) + ranks - 1), ranks - 1):  # bars among stars
        at = np.array(at, int) - np.arange(ranks - 1)
        best = min(best, np.diff(sums[np.concatenate([[0], at, [len(work)]]).astype(int)]).max())
    return best


@given(work=weights, ranks=st.integers(1, 9), seed=st.integers(0, 9))
@settings(max_examples=200, deadline=None)
def test_every_key_has_one_owner(work, ranks, seed):
    keys = some_keys(len(work), seed)
    cut = partition(keys, work, ranks, None)
    assert len(cut) == ranks - 1 and (np.diff(cut) >= 0).all()
    owner = owners(keys, cut)
    assert (np.diff(owner) >= 0).all() and ((owner >= 0) & (owner < ranks)).all()


@given(
    work=st.lists(st.floats(0.1, 100.0), min_size=1, max_size=8).map(np.array),
    ranks=st.integers(1, 4),
    old=st.none() | st.lists(st.integers(0, 1000), min_size=3, max_size=3),
)
@settings(max_examples=200, deadline=None)
def test_no_way_to_cut_is_better(work, ranks, old):
    keys = some_keys(len(work))
    old = None if old is None else np.sort(old)[: ranks - 1]
    load = loads(keys, work, partition(keys, work, ranks, old))
    best = max(least_possible(work, ranks), SLACK * work.sum() / ranks)
    assert load.max() <= best * (1 + 2e-6)


@given(work=weights.filter(lambda w: len(w) > 0), ranks=st.integers(1, 9), seed=st.integers(0, 9))
@settings(max_examples=100, deadline=None)
def test_cuts_that_are_good_stay(work, ranks, seed):
    keys = some_keys(len(work), seed)
    cut = partition(keys, work, ranks, None)
    assert (owners(keys, partition(keys, work, ranks, cut)) == owners(keys, cut)).all()


def test_a_small_change_moves_little():
    """One of 1000 equal blocks grows: from greedy cuts all would shift, here only a few."""
    keys, work = np.arange(1000), np.ones(1000)
    cut = partition(keys, work, 8, None)
    work[400] = 4.0
    new = partition(keys, work, 8, cut)
    assert imbalance(loads(keys, work, new)) <= 1.02
    assert (owners(keys, new) != owners(keys, cut)).sum() <= 8


def test_new_cuts_are_taken_when_they_pay():
    """100 blocks of 100, the first rank has 60 of them: 10 blocks are to move."""
    keys, count = np.arange(100), np.full(100, 100)
    work, cut = SHARES * count, np.array([60])
    pays = int(
        np.ceil(MIGRATION_COST / AMORTIZATION_SORTS * 1000 / 1000)
    )  # steps until 1000 moved have saved it
    assert rebalance(keys, work, count, 2, cut, pays - 1).tolist() == [60]
    assert abs(int(rebalance(keys, work, count, 2, cut, pays + 1)[0]) - 50) <= 1


@given(
    work=st.lists(st.integers(1, 50), min_size=1, max_size=200).map(np.array),
    ranks=st.integers(1, 9),
    seed=st.integers(0, 99),
)
@settings(max_examples=200, deadline=None)
def test_cuts_between_runs_are_about_as_good(work, ranks, seed):
    """Ranks with any pieces offer runs of their blocks; these are all the work, in order, and
    begin where each piece does."""
    random = np.random.default_rng(seed)
    keys, total = some_keys(len(work), seed), int(work.sum())
    old = np.sort(random.integers(0, 1000, ranks - 1))
    pieces = np.split(np.arange(len(work)), np.searchsorted(keys, old))
    before = [int(work[: p[0]].sum()) if len(p) else 0 for p in pieces]
    found = [
        candidate_cuts(keys[p], work[p], work[p] + 1, b, total, ranks)
        for p, b in zip(pieces, before, strict=True)
    ]
    key, run, count = np.concatenate(found).T
    at = np.searchsorted(keys, key)
    assert (run == np.add.reduceat(work, at)).all() and count.sum() == total + len(work)
    assert {int(keys[p[0]]) for p in pieces if len(p)} <= set(key.tolist())
    assert max(map(len, found)) <= 2 * CANDIDATES_PER_CUT * ranks + 1
    best = loads(keys, work, partition(keys, work, ranks, None)).max()
    got = loads(keys, work, partition(key, run, ranks, old)).max()
    assert got <= max(best, SLACK * total / ranks) + work.max()


def test_even_blocks_are_cut_as_evenly_as_they_can():
    """Also from pieces that are far from even."""
    keys, work = np.arange(1000), np.full(1000, 7)
    for old in (
        [0] * 7,
        [10, 20, 30, 40, 50, 60, 70],
        [999] * 7,
        [125, 250, 375, 500, 625, 750, 9],
    ):
        pieces = np.split(keys, np.sort(old))
        key, run, _ = np.concatenate(
            [candidate_cuts(p, work[p], work[p], 7 * int(p[0]), 7000, 8) for p in pieces if len(p)]
        ).T
        assert loads(keys, work, partition(key, run, 8, None)).max() == 7 * 125


def test_blocks_are_made_of_segments():
    key, work, count = by_block(np.array([2, 2, 5]), np.array([10, 20, 30]), np.array([1, 2, 3]))
    assert (key.tolist(), work.tolist(), count.tolist()) == ([2, 5], [30, 30], [3, 3])
    none = np.zeros(0, np.int64)
    assert [len(a) for a in by_block(none, none, none)] == [0, 0, 0]


def test_work_is_whole_numbers():
    """Whose sum does not depend on who adds what."""
    work = predicted_work(np.array([1, 512]), np.array([1.0, 1.4]))
    assert work.dtype == np.int64 and work.tolist() == [36 * SHARES, round(SHARES * 751.8)]


def test_cuts_are_looked_at_when_it_can_pay():
    load = np.full(100, 1000 * SHARES)
    assert not should_rebalance(load, 1000)
    load[3] = int(load[3] * (SLACK - 1e-3))
    assert not should_rebalance(load, 1000)
    load[3] = 1100 * SHARES
    least = (
        REPARTITION_COST * 100 / (99 * AMORTIZATION_SORTS)
    )  # steps; all but a hundredth of 100 can be saved
    assert not should_rebalance(load, int(least)) and should_rebalance(load, int(least) + 1)


def test_imbalance():
    assert imbalance(np.array([3.0, 1.0])) == 1.5
    assert imbalance(np.zeros(4)) == 1.0

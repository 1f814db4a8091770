"""Cuts of the curve: the largest piece is as small as it can be, little moves, and only when it
pays.
"""

from itertools import combinations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from vgmpi.domain.balance import (
    LASTS,
    MOVED,
    SHARES,
    SLACK,
    cuts,
    imbalance,
    loads,
    owners,
    recut,
)  # fmt: skip

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
    cut = cuts(keys, work, ranks, None)
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
    load = loads(keys, work, cuts(keys, work, ranks, old))
    best = max(least_possible(work, ranks), SLACK * work.sum() / ranks)
    assert load.max() <= best * (1 + 2e-6)


@given(work=weights.filter(lambda w: len(w) > 0), ranks=st.integers(1, 9), seed=st.integers(0, 9))
@settings(max_examples=100, deadline=None)
def test_cuts_that_are_good_stay(work, ranks, seed):
    keys = some_keys(len(work), seed)
    cut = cuts(keys, work, ranks, None)
    assert (owners(keys, cuts(keys, work, ranks, cut)) == owners(keys, cut)).all()


def test_a_small_change_moves_little():
    """One of 1000 equal blocks grows: from greedy cuts all would shift, here only a few."""
    keys, work = np.arange(1000), np.ones(1000)
    cut = cuts(keys, work, 8, None)
    work[400] = 4.0
    new = cuts(keys, work, 8, cut)
    assert imbalance(loads(keys, work, new)) <= 1.02
    assert (owners(keys, new) != owners(keys, cut)).sum() <= 8


def test_new_cuts_are_taken_when_they_pay():
    """100 blocks of 100, the first rank has 60 of them: 10 blocks are to move."""
    keys, count = np.arange(100), np.full(100, 100)
    work, cut = SHARES * count, np.array([60])
    pays = int(np.ceil(MOVED / LASTS * 1000 / 1000))  # steps until 1000 moved have saved it
    assert recut(keys, work, count, 2, cut, pays - 1).tolist() == [60]
    assert abs(int(recut(keys, work, count, 2, cut, pays + 1)[0]) - 50) <= 1


def test_imbalance():
    assert imbalance(np.array([3.0, 1.0])) == 1.5
    assert imbalance(np.zeros(4)) == 1.0

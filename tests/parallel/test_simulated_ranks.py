"""The simulated ranks behave as MPI does, and make mistakes loud."""

import numpy as np
import pytest

from tests.support.simulated_ranks import Aborted, run


def rows(ranks, count=None):
    """Rank r's rows: values 100 r, 100 r + 1, ..."""
    return 100 * ranks.rank + np.arange(ranks.rank if count is None else count, dtype=np.int64)


def test_collectives():
    def job(ranks):
        r = ranks.rank
        assert ranks.bcast({"a": r}) == {"a": 0}
        assert ranks.max(np.array([r, -r])).tolist() == [2, 0]
        assert ranks.all_rows(rows(ranks)).tolist() == [100, 200, 201]
        root = ranks.gather_rows(rows(ranks))
        assert (root is None) == (r > 0)
        assert ranks.before(r + 1) == [0, 1, 3][r]
        assert ranks.total(r + 1) == 6
        got = ranks.exchange([np.full(target, 10 * r + target) for target in range(3)])
        assert ranks.each(np.array([r, 2 * r])).tolist() == [[0, 0], [1, 2], [2, 4]]
        to = np.array([2, 0, 2, r])[: 3 + (r == 1)]
        rows_to = ranks.sparse_exchange(10 * r + np.arange(len(to)), to).tolist()
        assert rows_to == [[1, 11, 21], [13], [0, 2, 10, 12, 20, 22]][r]
        return [g.tolist() for g in got]

    assert run(3, job) == [[[], [], []], [[1], [11], [21]], [[2, 2], [12, 12], [22, 22]]]


def test_messages_match_in_posting_order():
    def job(ranks):
        other = 1 - ranks.rank
        a, b, sent = np.zeros(2), np.zeros(3), np.full(2, 1.0 + ranks.rank)
        first = ranks.link([(other, sent)], [(other, a)])
        second = ranks.link([(other, np.full(3, 5.0))], [(other, b)])
        first.start()
        second.start()
        second.wait()
        first.wait()
        once = a[0], b[0]
        sent += 10
        first.start()
        first.progress()
        first.wait()
        first.close()
        second.close()
        return *once, a[0]

    assert run(2, job) == [(2.0, 5.0, 12.0), (1.0, 5.0, 11.0)]


def test_received_rows_are_copies():
    def job(ranks):
        mine = np.full(1, ranks.rank)
        all_rows = ranks.all_rows(mine)
        mine[:] = 9
        ranks.barrier()
        return all_rows.tolist()

    assert run(3, job) == [[0, 1, 2]] * 3


def changed_buffer(ranks):
    a, b = np.zeros(2), np.zeros(2)
    link = ranks.link([(1 - ranks.rank, a)], [(1 - ranks.rank, b)])
    link.start()
    a[0] = 1
    link.wait()


def wrong_length(ranks):
    peer = 1 - ranks.rank
    link = ranks.link([(peer, np.zeros(2))], [(peer, np.zeros(3))])
    link.start()
    link.wait()


def started_twice(ranks):
    link = ranks.link([], [])
    link.start()
    link.start()


def closed_too_early(ranks):
    link = ranks.link([], [])
    link.start()
    link.close()


@pytest.mark.parametrize(
    "job, text",
    [
        (lambda ranks: ranks.barrier() if ranks.rank else ranks.total(1), "different verbs"),
        (lambda ranks: ranks.barrier() if ranks.rank else None, "different verbs"),
        (
            lambda ranks: ranks.all_rows(np.zeros(1, [np.int32, np.int64][ranks.rank])),
            "different shapes or types",
        ),
        (lambda ranks: ranks.sparse_exchange(np.zeros(2), np.zeros(1, int)), "deliver: 2 rows"),
        (lambda ranks: ranks.sparse_exchange(np.zeros(1), np.array([2])), "deliver: 1 rows"),
        (changed_buffer, "changed a buffer"),
        (wrong_length, "has 16 bytes, its buffer 24"),
        (started_twice, "twice without waiting"),
        (closed_too_early, "messages under way"),
        (lambda ranks: ranks.link([(1 - ranks.rank, np.zeros(1))], []).start(), "nobody received"),
    ],
)
def test_mistakes_are_errors(job, text):
    with pytest.raises(AssertionError, match=text):
        run(2, job)


def test_one_failing_rank_ends_all():
    def job(ranks):
        if ranks.rank == 1:
            raise ValueError("rank 1 fails")
        ranks.barrier()

    with pytest.raises(ValueError, match="rank 1 fails"):
        run(3, job)
    with pytest.raises(Aborted):
        run(2, lambda ranks: ranks.abort(3) if ranks.rank == 0 else ranks.barrier())

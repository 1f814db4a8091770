"""The measured pace of a rank: where its work takes longer than predicted, it holds less of it."""

import time

import numpy as np
import pytest

from tests.support import simulated_ranks
from tests.support.simulate import begin
from tests.support.small_scenes import ROOM
from vgmpi.parallel import load_balance
from vgmpi.parallel.load_balance import MAX_PACE, NEWEST_SHARE, RankPace
from vgmpi.solver.diagnostics.progress import Clock
from vgmpi.solver.simulation import Simulation

SLAB = (
    ROOM
    + """
[[object]]
name = "slab"
material = "clay"
shape = { box = [[0.02, 0.02, 0.02], [0.38, 0.38, 0.18]] }
"""
)


class Segments:
    """A group of one segment of 100 particles, as far as the pace looks at it."""

    count = np.array([100])

    class plan:
        cost = 1.0


def paces(seconds, ranks=2, steps=10):
    """The pace of each rank after each of some sorts; seconds: of each rank up to each."""

    def job(one):
        pace = RankPace(one)
        out = []
        for row in seconds:
            pace.busy = lambda row=row: row[one.rank]
            out.append(pace.measure_work([Segments()], steps))
        return out

    return np.array(simulated_ranks.run(ranks, job)).T


def test_the_pace_is_measured_over_predicted_work():
    """Ranks with the same work, of which one takes three times as long: 1.5 and 0.5 of the mean."""
    first, second = paces([(3.0, 1.0), (6.0, 2.0)])
    np.testing.assert_allclose(first - 1.0, NEWEST_SHARE * np.array([0.5, -0.5]))
    np.testing.assert_allclose(second - first, NEWEST_SHARE * (np.array([1.5, 0.5]) - first))


def test_what_is_too_short_to_be_measured_changes_nothing():
    assert (paces([(1e-3, 3e-3)]) == 1.0).all()
    assert (paces([(3.0, 1.0)], steps=0) == 1.0).all()
    assert (paces([(3.0,)], ranks=1) == 1.0).all()


def test_the_pace_has_limits():
    many = paces([(1.0, *[1e-6] * 6)], ranks=7)[0]
    assert many[0] == 1.0 + NEWEST_SHARE * (MAX_PACE - 1.0)
    assert (many[1:] == 1.0 + NEWEST_SHARE * (1.0 / MAX_PACE - 1.0)).all()


def test_the_clock_counts_the_processor_time_of_work_alone():
    def compute():
        end = time.process_time() + 0.02
        while time.process_time() < end:
            pass

    clock = Clock()
    for stage in ("wait", "sort"):
        compute()
        clock(stage)
    assert clock.work == 0.0
    for stage in ("p2g", "grid", "g2p"):
        compute()
        clock(stage)
    time.sleep(0.05)
    clock("g2p")
    assert 0.06 <= clock.work < 0.1


@pytest.mark.parametrize("size", [2, 3])
def test_a_slow_rank_gives_work_away_and_no_bit_changes(tmp_path, size):
    """Rank 0 takes thrice the time of the others for the same work: it ends with a third of theirs,
    as far as blocks allow."""
    simulation, made = begin(tmp_path, SLAB)

    def job(ranks):
        one = Simulation(simulation.plan, ranks)
        mine = np.arange(len(made.x)) % ranks.size == ranks.rank
        ids = np.arange(len(made.x))[mine]
        one.put(made.x[mine], made.x[mine] * [0, 0, 1.0], made.vol0[mine], ids, made.object[mine])
        spent = [0.0]
        one.pace.busy = lambda: spent[0]
        before = sum(int(group.count.sum()) for group in one.groups)
        for _ in range(12):
            for _ in range(2):
                one.advance(one.bound())
            work = sum(
                load_balance.predicted_work(group.count, np.array(group.plan.cost)).sum()
                for group in one.groups
            )
            spent[0] += work * (3.0 if ranks.rank == 0 else 1.0)
            one.sort()
        held = sum(int(group.count.sum()) for group in one.groups)
        rows = [(group.ids[group.index()], group.positions()) for group in one.groups]
        return before, held, rows

    results = simulated_ranks.run(size, job)
    before, held = (np.array(column) for column in list(zip(*results, strict=True))[:2])
    assert held.sum() == before.sum() == len(made.x)
    assert before[0] > 0.8 * before.mean()
    assert held[0] < 0.6 * held[1:].mean()
    ids, x = (np.concatenate([row[k] for r in results for row in r[2]]) for k in (0, 1))
    alone = simulated_ranks.run(1, job)[0][2][0]
    np.testing.assert_array_equal(x[np.argsort(ids)], alone[1][np.argsort(alone[0])])

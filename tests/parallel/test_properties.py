"""Any cloud of particles, any ranks, threads and owners, any restart: the bits of one rank.

Each case throws some hundred particles of three groups into a small box, fast enough to be sorted
every few steps. One rank with one thread, which takes them in the order of their ids and is never
interrupted, says what is right.
"""

import threading
from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings

from tests.support import simulated_ranks
from tests.support.random_particles import CASES, box, cloud
from tests.support.rank_states import Kept, different, in_key_order, joined, padding
from vgmpi.kernels.transfer import g2p
from vgmpi.parallel import load_balance
from vgmpi.parallel.block_lattice import BlockLattice
from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.solver.engines.cpu import Cpu
from vgmpi.solver.restart.state_io import restore, save
from vgmpi.solver.run_outcome import BlowUp
from vgmpi.solver.simulation import Simulation

RECUT, OWNERS, WORTH = load_balance.rebalance, load_balance.owners, load_balance.should_rebalance


class Lot(threading.local):
    """Draws who owns what, anew at every sort; the same on every rank, which is a thread each.

    leg: 0 from the start, 1 after a restart.
    """

    def __init__(self, case, leg):
        self.case, self.leg, self.sorts, self.forced = case, leg, 0, False

    def rebalance(self, keys, work, count, ranks, cut, steps):
        self.sorts += 1
        self.random = np.random.default_rng([self.case.seed, self.leg, self.sorts])
        once = self.case.owners == "cut anew once" and self.forced
        if once or self.case.owners == "cut anew":
            return np.sort(self.random.integers(keys.min(), keys.max() + 2, ranks - 1))
        if self.case.owners == "dealt out" and cut is not None:
            return cut.copy()  # others from now on, so that all are told
        return RECUT(keys, work, count, ranks, cut, steps)

    def owners(self, keys, cut):
        from_file = self.leg == 1 and self.sorts <= 1  # ranks read one piece each
        if self.case.owners == "dealt out" and self.sorts and not from_file:
            return mixed(keys, self.case.seed + self.sorts) % (len(cut) + 1)
        return OWNERS(keys, cut)

    def should_rebalance(self, load, steps):
        return self.case.owners != "by load" or WORTH(load, steps)


def mixed(keys, seed):
    """Numbers that look drawn, from the keys alone: (n,)."""
    found = (keys + seed) * 2654435761 % (1 << 32)
    return (found ^ (found >> 15)) * 2246822519 % (1 << 32) >> 8


def go_on(simulation, case, until, lot=None):
    """Steps up to `until`, with the sort that the case asks for."""
    while simulation.step < until:
        if simulation.step == case.sort_at:
            if lot is not None:
                lot.forced = True
            simulation.sort()
            if lot is not None:
                lot.forced = False
        simulation.advance(simulation.bound())


def expected(case, precision):
    """(attrs, rows, sorts) on one rank, or what its blow-up says."""
    plan, colliders = box(precision)
    plan, x, v, volume, thing, surface = cloud(case, plan)
    simulation = Simulation(plan, SerialCommunicator(), colliders)
    simulation.put(x, v, volume, np.arange(len(x)), thing, surface=surface)
    try:
        go_on(simulation, case, case.steps)
    except BlowUp as error:
        return str(error)
    saved = save(simulation)
    return saved["attrs"], joined([saved]), simulation.sorts


def look(simulation):
    """What this rank met, as numbers to add up."""
    for group in simulation.groups:
        unused = padding(group)
        assert (group.ids[unused] == -1).all()
        assert (group.xi[:, unused] == 0).all(), "transfers look at the cells of unused places too"
    tables = simulation.exchange.tables
    return Counter(
        {
            "node blocks of this rank alone": int((~tables.receives_remote).sum()),
            "node blocks that others add to": int(tables.receives_remote.sum()),
            "both on one rank": int(
                tables.receives_remote.any() and not tables.receives_remote.all()
            ),
            "copies for threads": len(simulation.engine.blocks.copies),
            "idle ranks": int(not any(len(group) for group in simulation.groups)),
            "segments of one particle": sum(int((g.count == 1).sum()) for g in simulation.groups),
        }
    )


def found(case, precision, seen):
    """The same in the case's way, rows in the order of keys. Counts in `seen` what it met."""
    plan, colliders = box(precision)
    plan, x, v, volume, thing, surface = cloud(case, plan)
    random = np.random.default_rng(case.seed + 1)
    order, share = random.permutation(len(x)), random.integers(0, case.ranks[0], len(x))

    def put(simulation):
        here = order[share[order] == simulation.ranks.rank]
        rows = (row[here] for row in (x, v, volume))
        simulation.put(*rows, here, thing[here], surface=surface[here])

    def leg(number, until, begin):
        lot = Lot(case, number)

        def job(ranks):
            simulation = Simulation(plan, ranks, colliders, case.threads[ranks.rank])
            begin(simulation)
            go_on(simulation, case, until, lot)
            return save(simulation), simulation.sorts, look(simulation)

        with pytest.MonkeyPatch.context() as patch:
            for name in ("rebalance", "owners", "should_rebalance"):
                patch.setattr(load_balance, name, getattr(lot, name))
            if case.backwards:
                patch.setattr(Cpu, "each", simulated_ranks.last_first)
            done = simulated_ranks.run(case.ranks[number], job)
        saved, sorts, looks = zip(*done)
        seen.update(sum(looks, Counter()))
        rows = in_key_order(joined(saved), BlockLattice(plan.cells, plan.dx))
        if case.owners != "dealt out":
            assert different(joined(saved), rows) == [], "a rank does not hold one piece"
        assert len(set(sorts)) == 1
        return saved[0]["attrs"], rows, sorts[0]

    try:
        if case.restart_at is None or case.restart_at > case.steps:
            return leg(0, case.steps, put)
        attrs, rows, before = leg(0, case.restart_at, put)
        kept = Kept(attrs, rows)
        attrs, rows, after = leg(1, case.steps, lambda simulation: restore(simulation, kept))
        seen["restarted"] += 1
        return attrs, rows, before + after
    except BlowUp as error:
        seen["blown up"] += 1
        return str(error)


def check(case, precision, seen):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(g2p, "MAX_STRAY_CELLS", case.reach)
        want = expected(case, precision)
        got = found(case, precision, seen)
    seen["cases"] += 1
    if isinstance(want, str) or isinstance(got, str):
        assert got == want
        return
    seen["sorts"] += want[2]
    assert got[0] == want[0], "clock, step or bound"
    assert got[2] == want[2], "sorts"
    assert different(got[1], want[1]) == []


@pytest.mark.parametrize("precision", ["single", "double"])
def test_any_way_gives_the_bits_of_one_rank(precision):
    seen = Counter()

    @given(case=CASES)
    @settings(max_examples=60, derandomize=True, database=None, deadline=None)
    def cases(case):
        check(case, precision, seen)

    cases()
    print(dict(seen))
    for what in (
        "node blocks of this rank alone",
        "node blocks that others add to",
        "copies for threads",
        "segments of one particle",
    ):
        assert seen[what] > 100, what
    assert seen["both on one rank"] > 10
    assert seen["idle ranks"] > 5 and seen["restarted"] > 10
    assert seen["blown up"] < 0.1 * seen["cases"]
    assert seen["sorts"] > 2 * seen["cases"]


@pytest.mark.slow
@pytest.mark.timeout(2400)
@pytest.mark.parametrize("precision", ["single", "double"])
def test_many_more_cases(precision):
    @given(case=CASES)
    @settings(max_examples=2000, database=None, deadline=None, print_blob=True)
    def cases(case):
        check(case, precision, Counter())

    cases()

"""A census spread over the ranks tells each what the census of one rank tells, as far as it looks,
and no more on many ranks than on few.
"""

from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support import simulated_ranks
from tests.support.rank_states import Kept, different, joined
from tests.support.simulate import begin
from tests.support.small_scenes import MIXED
from vgmpi.parallel import block_ownership, exchange_topology, load_balance
from vgmpi.parallel.block_lattice import BlockLattice
from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.solver.restart.state_io import restore, save

LATTICE = BlockLattice((38, 26, 22), 0.02)


def grid(shape):
    return np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), -1).reshape(-1, 3)


class Drawn(NamedTuple):
    """Rows (n, 4) that ranks hold, wherever they belong: holder (n,)."""

    rows: np.ndarray
    holder: np.ndarray


def drawn(random, ranks, fill, lattice=LATTICE):
    """Some blocks of as many groups as `fill` has shares; up to three ranks hold rows of each."""
    found = []
    for g, share in enumerate(fill):
        blocks = grid(lattice.shape)
        blocks = blocks[random.random(len(blocks)) < share]
        blocks = np.repeat(blocks, random.integers(1, 4, len(blocks)), axis=0)
        key, count = lattice.key(blocks), random.integers(1, 600, len(blocks))
        found.append(np.stack([key, lattice.code(blocks), np.full_like(key, g), count], 1))
    rows = np.concatenate(found)
    return Drawn(rows, random.integers(0, ranks, len(rows)))


def truth(rows):
    """All segments, merged with a dict: {(key, group): (code, count)}."""
    out = {}
    for key, code, group, count in rows.tolist():
        out[key, group] = code, out.get((key, group), (0, 0))[1] + count
    return out


def check(table, rows, cut, lattice, rank):
    """`table` is what `rank` must know of all rows under these cuts."""
    want = truth(rows)
    at = sorted(want)
    key, group = np.array(at, np.int64).reshape(-1, 2).T
    code, count = np.array([want[a] for a in at], np.int64).reshape(-1, 2).T
    owner = np.array([sum(int(k) >= c for c in cut) for k in key], np.int64)
    block = lattice.block(code)
    own = block[owner == rank]
    near = [len(own) > 0 and np.abs(own - b).max(1).min() <= 2 for b in block]
    near = np.array(near, bool)
    for name, whole in zip(table._fields, (key, code, group, count, owner), strict=False):
        assert (getattr(table, name) == whole[near]).all(), name


@given(
    size=st.integers(1, 7),
    fill=st.lists(st.sampled_from([0.0, 0.002, 0.05, 0.4]), min_size=1, max_size=3),
    seed=st.integers(0, 999),
)
@settings(max_examples=40, deadline=None)
def test_a_rank_knows_its_own_and_two_rings(size, fill, seed):
    random = np.random.default_rng(seed)
    rounds = [drawn(random, size, fill) for _ in range(3)]
    costs = np.linspace(1.0, 2.3, len(fill))

    def job(ranks):
        cut = None
        for rows, holder in rounds:
            mine = rows[holder == ranks.rank]
            table, cut = block_ownership.build_block_directory(mine, LATTICE, ranks, costs, cut, 50)
            check(table, rows, cut, LATTICE, ranks.rank)
            own = table.owner == ranks.rank
            work = load_balance.predicted_work(table.particles[own], costs[table.group[own]]).sum()
            assert table.load[ranks.rank] == work
            assert (ranks.each(cut) == cut).all() and len(cut) == ranks.size - 1
            assert (ranks.each(table.load) == table.load).all()
        return len(table.key)

    simulated_ranks.run(size, job)


@pytest.mark.parametrize("ranks", [1, 3, 6])
@pytest.mark.parametrize("apart", [None, "near"])
def test_tables_are_those_of_the_whole(ranks, apart):
    """What a rank does not know of decides nothing in its tables."""
    random = np.random.default_rng(ranks)
    rows, holder = drawn(random, ranks, (0.15, 0.004))
    costs = np.ones(2)
    if apart is not None:
        pair = ~np.eye(2, dtype=bool)
        apart = exchange_topology.StressProximity(
            pair, pair, np.ones(2, bool), everywhere=np.zeros(2, bool)
        )
    needs = exchange_topology.TopologyRequirements(np.array([0, 1]), True, apart or False)
    whole, _ = block_ownership.build_block_directory(
        rows, LATTICE, SerialCommunicator(), costs, None, 0
    )

    def job(ranks):
        table, cut = block_ownership.build_block_directory(
            rows[holder == ranks.rank], LATTICE, ranks, costs, None, 0
        )
        return table, cut

    for rank, (table, cut) in enumerate(simulated_ranks.run(ranks, job)):
        owned = whole._replace(owner=load_balance.owners(whole.key, cut))
        got, want = (
            exchange_topology.build_topology(one, LATTICE, rank, needs) for one in (table, owned)
        )
        for name, a, b in zip(got._fields, got, want, strict=True):
            if name == "shared":
                assert {r: list(layers) for r, layers in a.items()} == {
                    r: list(layers) for r, layers in b.items()
                }
                flat = [[x for layers in one.values() for lists in layers.values() for x in lists]
                        for one in (a, b)]  # fmt: skip
            elif isinstance(a, dict):
                flat = [list(one.values()) for one in (a, b)]
            else:
                flat = [[a], [b]]
            assert all(np.array_equal(x, y) for x, y in zip(*flat, strict=True)), name


def pool(side, deep):
    """A lattice with a pool on its floor, under air as high as it is wide."""
    lattice = BlockLattice((4 * (side - 1),) * 3, 0.02)
    blocks = grid((side, side, deep))
    key = lattice.key(blocks)
    rows = np.stack([key, lattice.code(blocks), 0 * key, np.full_like(key, 512)], 1)
    return lattice, rows[np.argsort(key)]


def heard(ranks, side):
    """Most rows that a rank got in a sort with unchanged cuts, and most ranks it heard from."""
    lattice, rows = pool(side, 2)

    def job(one):
        share = slice(len(rows) * one.rank // ranks, len(rows) * (one.rank + 1) // ranks)
        table, cut = block_ownership.build_block_directory(
            rows[share], lattice, one, np.ones(1), None, 0
        )
        own = table.owner == one.rank
        held = np.stack([table.key, table.code, table.group, table.particles], 1)[own]
        one.delivered, one.partners = 0, set()
        table, again = block_ownership.build_block_directory(held, lattice, one, np.ones(1), cut, 1)
        assert again is cut
        return one.delivered, len(one.partners), len(table.key)

    return np.array(simulated_ranks.run(ranks, job)).max(0)


def test_many_ranks_tell_a_rank_no_more_than_few():
    """A pool under air on 8 and on 64 ranks, 16 blocks of it on each."""
    few, many = heard(8, 8), heard(64, 23)
    print(f"rows, partners, rows kept: 8 ranks {few}, 64 ranks {many}")
    assert (many <= 2 * few).all()


def test_without_the_empty_stretches_the_air_would_hear_all(monkeypatch):
    """The comparison above sees it when a rank hears from all around the air it owns."""
    real = block_ownership._rank_summary

    def told(*arguments):
        found = real(*arguments)
        found[2] = found[1]
        return found

    few = heard(8, 8)
    monkeypatch.setattr(block_ownership, "_rank_summary", told)
    many = heard(64, 23)
    print(f"rows, partners, rows kept: 8 ranks {few}, 64 ranks {many}")
    assert (many > 2 * few).any()


def test_ranks_that_disagree_on_owners_are_told():
    def job(ranks):
        rows = np.array([[4, 4, 0, 1], [40, 40, 0, 1]])
        cut = np.array([20 + 30 * ranks.rank])
        block_ownership.build_block_directory(rows, LATTICE, ranks, np.ones(1), cut, 1)

    with pytest.raises(RuntimeError, match="disagree on who owns"):
        simulated_ranks.run(2, job)


def test_the_first_cuts_spread_the_merging():
    """No rank merges much more than its share of rows before it knows the cuts, also where all hold
    particles of the same blocks, and where blocks fill a corner of the domain.
    """
    lattice, rows = pool(24, 3)
    rows = rows[:1200]

    def job(ranks, mine):
        cut = block_ownership._initial_cuts(mine(ranks.rank), ranks, np.ones(1))
        return np.bincount(load_balance.owners(rows[:, 0], cut), minlength=8).max() / (
            len(rows) / 8
        )

    for mine in (lambda r: rows[r::8], lambda r: rows[150 * r : 150 * (r + 1)], lambda r: rows):
        assert max(simulated_ranks.run(8, lambda ranks, mine=mine: job(ranks, mine))) < 1.5


def test_a_restart_reads_a_share_of_the_segments(tmp_path):
    text = MIXED.replace("PRECISION", "single")
    simulation, _ = begin(tmp_path, text)
    saved = save(simulation)
    rows = joined([saved])
    segments = sum(len(a) for name, a in rows.items() if name.endswith("/block"))

    class Counted(Kept):
        def read_rows(self, name, start, stop):
            self.read = getattr(self, "read", 0) + (stop - start) * name.endswith("/block")
            return super().read_rows(name, start, stop)

    def job(ranks):
        home = tmp_path / f"{ranks.rank}"
        home.mkdir(exist_ok=True)
        again, _ = begin(home, text, ranks)
        kept = Counted(saved["attrs"], rows)
        restore(again, kept)
        return save(again), kept.read

    for n in (1, 3, 7):
        found = simulated_ranks.run(n, job)
        assert different(joined([one for one, _ in found]), rows) == []
        # of each group a share, rounded, and the segment above it for the order
        assert max(read for _, read in found) <= segments / n + 2 * len(simulation.groups)

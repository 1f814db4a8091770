"""Blocks, the curve through them, sorting, migration, and who needs which nodes."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests import simulated
from tests.scenes import MIXED
from tests.simulate import begin
from vgmpi.domain import census, migrate, topology
from vgmpi.domain.balance import cuts, owners
from vgmpi.domain.blocks import BITS, INTEGER, Lattice, hilbert
from vgmpi.domain.ranks import Alone
from vgmpi.domain.state import LANES, Group
from vgmpi.materials.elastic import Elastic
from vgmpi.planning.plan import BASE_CHANNELS, GroupPlan
from vgmpi.solver.state import save

REALS = [np.dtype(np.float32), np.dtype(np.float64)]
LATTICE = Lattice((22, 13, 9), 0.02)


@pytest.mark.parametrize("real", REALS, ids=str)
@given(
    cells=st.tuples(*[st.integers(4, 400)] * 3),
    dx=st.floats(1e-3, 10.0),
    share=st.lists(st.tuples(*[st.floats(-0.0, 1.0)] * 3), min_size=1, max_size=20),
)
@settings(max_examples=60, deadline=None)
def test_place_and_position(real, cells, dx, share):
    lattice = Lattice(cells, dx)
    x = np.array(share) * np.array(cells) * dx
    block, xi = lattice.place(x, real)
    assert xi.dtype == INTEGER[real] and xi.shape == (3, len(x))
    assert ((block >= 0) & (block < lattice.shape)).all()
    half = 2 << BITS[real]
    assert ((xi >= -half) & (xi < half)).all(), "outside its block"
    back = lattice.position(block, xi, real)
    # half a unit of the fixed-point number, and rounding of x / dx
    allowed = (0.51 * 2.0 ** -BITS[real] + 4e-16 * max(cells)) * dx
    assert np.abs(back - x).max() <= allowed
    again_block, again = lattice.place(back, real)
    moved = (again_block != block).any(1)
    steps = np.abs(again.astype(np.int64) - xi).max(0)[~moved]
    assert (steps <= np.ceil(4e-16 * max(cells) * 2.0 ** BITS[real])).all()


def test_base_node_lies_in_its_block():
    """Block b holds base nodes floor(x / dx - 1/2) = 4 b - 1 .. 4 b + 2."""
    random = np.random.default_rng(0)
    x = random.uniform(0, 1, (5000, 3)) * np.array(LATTICE.cells) * LATTICE.dx
    block, _ = LATTICE.place(x, REALS[1])
    base = np.floor(x / LATTICE.dx - 0.5)
    inside = base - (4 * block - 1)
    assert inside.min() == 0 and inside.max() == 3
    assert (LATTICE.block(LATTICE.code(block)) == block).all()


@pytest.mark.parametrize("real", REALS, ids=str)
def test_place_just_below_the_next_block(real):
    """Rounding to a fixed-point number may land on the next block's first position."""
    edge = np.array([3.5, 7.5, 11.5])
    x = np.nextafter(edge, 0.0)[:, None] * np.ones(3)
    lattice = Lattice((22, 22, 22), 1.0)
    block, xi = lattice.place(x, real)
    half = 2 << BITS[real]
    assert ((xi >= -half) & (xi < half)).all()
    assert np.abs(lattice.position(block, xi, real) - x).max() <= 2.0 ** -BITS[real]


@pytest.mark.parametrize("levels", [1, 2, 3, 4])
def test_hilbert_curve_goes_from_neighbour_to_neighbour(levels):
    side = 1 << levels
    points = np.stack(np.meshgrid(*[np.arange(side)] * 3, indexing="ij"), -1).reshape(-1, 3)
    index = hilbert(points, levels)
    assert sorted(index) == list(range(side**3))
    walk = points[np.argsort(index)]
    assert (np.abs(np.diff(walk, axis=0)).sum(1) == 1).all()


def test_keys_of_a_domain_are_its_own():
    """Also where the domain is no cube and no power of two."""
    points = np.stack(np.meshgrid(*map(np.arange, LATTICE.shape), indexing="ij"), -1).reshape(-1, 3)
    assert len(np.unique(LATTICE.key(points))) == len(points)


# --- sorting and migration ---


def group_plan():
    law = Elastic(kind="elastic", youngs_modulus=1e5).law()
    return GroupPlan("a/b", 0, "b", law, 1000.0, (0.0,) * 9, 1.0, ("H",))


def mark(ids, channels):
    """Channel values that tell whose they are: (channels, n)."""
    return 100.0 * ids[None, :] + np.arange(channels)[:, None]


def check_order(group):
    """Segments in key order, at multiples of the lanes; particles by (cell, id); nothing else."""
    key = group.lattice.key(group.block)
    assert (np.diff(key) > 0).all()
    assert (group.start % LANES == 0).all()
    assert (group.start[1:] >= group.start[:-1] + group.count[:-1]).all()
    at = group.index()
    unused = np.ones(group.used, bool)
    unused[at] = False
    assert (group.ids[: group.used][unused] == -1).all()
    assert (group.f[:, : group.used][:, unused] == 0).all()
    cell = (group.xi[:, at].astype(np.int64) >> group.bits) + 2
    assert ((cell >= 0) & (cell < 4)).all(), "not in its block"
    cell = (cell[0] * 4 + cell[1]) * 4 + cell[2]
    segment = np.repeat(np.arange(len(group.count)), group.count)
    order = np.lexsort((group.ids[at], cell, segment))
    assert (order == np.arange(len(at))).all(), "not in the order (block, cell, id)"


@given(
    size=st.integers(1, 5),
    n=st.integers(0, 400),
    spread=st.sampled_from([0.1, 0.5, 1.0]),
    seed=st.integers(0, 99),
    real=st.sampled_from(REALS),
)
@settings(max_examples=30, deadline=None)
def test_every_particle_arrives_once(size, n, spread, seed, real):
    """Particles start anywhere, drift by up to a cell between sorts, and keep what they carry."""
    random = np.random.default_rng(seed)
    room = np.array(LATTICE.cells) * LATTICE.dx
    x = (0.5 + spread * random.uniform(-0.5, 0.5, (n, 3))) * room
    holder = random.integers(0, size, n)
    drift = random.uniform(-0.9, 0.9, (3, n, 3)) * LATTICE.dx
    path = [x]
    for d in drift:
        path.append(np.clip(path[-1] + d, 0.01 * room, 0.99 * room))
    channels = BASE_CHANNELS + 9

    def job(ranks):
        group = Group(group_plan(), LATTICE, real)
        mine = np.flatnonzero(holder == ranks.rank)
        block, xi = LATTICE.place(x[mine], real)
        migrate.arrive(group, block, xi, mark(mine, channels).astype(real), mine)
        cut = None
        for k in range(4):
            table, cut, _ = migrate.sort([group], ranks, cut, 50)
            check_order(group)
            here = table.owner == ranks.rank
            assert (np.diff(table.key) > 0).all() and ranks.total(table.count[here].sum()) == n
            assert (table.code[here] == group.code).all()
            assert (table.count[here] == group.count).all()
            at = group.index()
            ids = group.ids[at]
            assert (group.f[:, at] == mark(ids, channels).astype(real)).all()
            assert np.abs(group.positions() - path[k][ids]).max(initial=0.0) < 1e-8
            everyone = ranks.all_rows(ids)
            assert (np.sort(everyone) == np.arange(n)).all()
            if k < 3:
                delta = (path[k + 1][ids] - group.positions()) / LATTICE.dx
                moved = np.rint(delta * 2.0**group.bits).T.astype(np.int64)
                group.xi[:, at] += moved.astype(group.xi.dtype)
        return len(ids)

    assert sum(simulated.run(size, job)) == n


# --- who needs which nodes ---


def random_census(seed, ranks, scattered, lattice=LATTICE, filled=(0.3, 0.3)):
    """Blocks of two groups (two phases) here and there in the lattice, and their owners."""
    random = np.random.default_rng(seed)
    blocks = np.stack(np.meshgrid(*map(np.arange, lattice.shape), indexing="ij"), -1)
    blocks = blocks.reshape(-1, 3)
    rows = []
    for g in range(2):
        chosen = blocks[random.random(len(blocks)) < filled[g]]
        key, code = lattice.key(chosen), lattice.code(chosen)
        rows.append(np.stack([key, code, np.full_like(key, g), np.full_like(key, 5)], 1))
    table, _ = census.census(np.concatenate(rows), lattice, Alone(), np.ones(2), None, 0)
    keys, at = np.unique(table.key, return_inverse=True)
    if scattered:
        owner = random.integers(0, ranks, len(keys))[at]
    else:
        owner = owners(table.key, cuts(keys, np.ones(len(keys)), ranks, None))
    return table._replace(owner=owner)


def reach(block):
    """Nodes the patch of a block covers along each axis: 4 b - 2 .. 4 b + 5."""
    return 4 * block - 2, 4 * block + 6


@pytest.fixture(params=[(s, r, m) for s in range(3) for r in (1, 3, 5) for m in (False, True)])
def tables(request):
    seed, ranks, scattered = request.param
    whole = random_census(seed, ranks, scattered)
    phase_of = np.array([0, 1])
    return whole, [topology.build(whole, LATTICE, r, phase_of, True, None) for r in range(ranks)]


def test_all_patches_of_a_node_are_added_in_key_order(tables):
    """Every node that one of a rank's patches covers gets all patches that cover it, once each.
    (Two patches share a node exactly when their blocks are neighbours; of a node block at a rank's
    edge only the near nodes count.)
    """
    whole, built = tables
    where, phase = LATTICE.block(whole.code), np.array([0, 1])[whole.group]
    for rank, t in enumerate(built):
        assert (t.table >= 0).all(), "a patch reaches a node block that is not there"
        number = np.repeat(np.arange(len(t.first) - 1), np.diff(t.first))
        seen = {}  # node block -> own blocks that reach it
        for p, row in enumerate(t.table):
            own = np.flatnonzero(t.own)[p]
            for code, nb in enumerate(row):
                assert (t.block_at[number[nb]] == t.block[own] + topology.NEIGHBOURS[code]).all()
                assert t.phase[nb] == phase[t.row[own]]
                seen.setdefault(nb, []).append(t.block[own])
        for nb, mine in seen.items():
            here = slice(t.pull_first[nb], t.pull_first[nb + 1])
            at = t.block_at[number[nb]]
            reaches = (np.abs(where - at).max(1) <= 1) & (phase == t.phase[nb])
            beside = (np.abs(where[:, None] - np.array(mine)).max(2) <= 1).any(1)
            added = t.row[t.pull_patch[here]]
            assert (np.diff(added) > 0).all(), "not in key order, or twice"
            assert reaches[added].all() and np.isin(np.flatnonzero(reaches & beside), added).all()
            offsets = at - t.block[t.pull_patch[here]]
            assert (topology.NEIGHBOURS[t.pull_code[here]] == offsets).all()
        assert (whole.owner[t.row[t.own]] == rank).all()


def test_every_node_two_ranks_share_travels(tables):
    """The nodes that my patches have in common with another rank's lie in the boxes I get, and
    what one sends is what the other waits for.
    """
    whole, built = tables
    where = LATTICE.block(whole.code)
    for rank, t in enumerate(built):
        boxes = {}
        for other, patches, low, high in t.receives:
            assert other != rank and (whole.owner[t.row[patches]] == other).all()
            sent = [s for s in built[other].sends if s[0] == rank]
            assert len(sent) == 1
            _, theirs, their_low, their_high = sent[0]
            assert (built[other].row[theirs] == t.row[patches]).all()
            assert (their_low == low).all() and (their_high == high).all()
            for p, a, b in zip(patches, low, high, strict=True):
                boxes[int(t.row[p])] = (a, b)
        mine = where[whole.owner == rank]
        for row in np.flatnonzero(whole.owner != rank):
            near = mine[np.abs(mine - where[row]).max(1) <= 1]
            assert (row in boxes) == (len(near) > 0)
            for block in near:
                first, last = reach(where[row])
                my_first, my_last = reach(block)
                low = np.maximum(first, my_first) - first
                high = np.minimum(last, my_last) - first
                assert (boxes[row][0] <= low).all() and (boxes[row][1] >= high).all()


@pytest.mark.parametrize(
    "ranks, scattered, seed", [(4, False, s) for s in range(8)] + [(4, True, 5)]
)
def test_ranks_agree_on_where_contact_is_possible(ranks, scattered, seed):
    """A patch carries volumes and offsets on all ranks that hold it, or on none; and wherever
    patches of two phases share nodes, both do.
    """
    lattice = Lattice((60, 44, 40), 0.02)  # large, and the second phase rare: most patches do not
    whole = random_census(seed, ranks, scattered, lattice, (0.3, 0.008))
    wanted = {}
    for rank in range(ranks):
        t = topology.build(whole, lattice, rank, np.array([0, 1]), True, None)
        for row, asked in zip(t.row, t.offsets, strict=True):
            wanted.setdefault(int(row), set()).add(bool(asked))
        phase = whole.group[t.row]
        near = (np.abs(t.block[:, None] - t.block[None, :]) <= 1).all(2)
        meet = near & (phase[:, None] != phase[None, :]) & t.own[:, None]
        assert (t.offsets | ~meet.any(1)).all() and (t.offsets | ~meet.any(0)).all()
    assert all(len(said) == 1 for said in wanted.values())
    share = np.mean([True in said for said in wanted.values()])
    assert 0.1 < share < 0.6, "too many or too few to test anything"


@pytest.mark.parametrize("precision", ["single", "double"])
def test_threads_do_not_change_the_bits(precision, tmp_path):
    found = []
    for threads in (1, 2, 3):
        text = MIXED.replace("PRECISION", precision)
        simulation, _ = begin(tmp_path, text, threads=threads)
        for _ in range(60):
            simulation.advance(simulation.bound())
        groups = save(simulation)["groups"]
        found.append([a.tobytes() for group in groups.values() for a in group.values()])
    assert found[0] == found[1] == found[2]

"""Blocks, the curve through them, sorting, migration, and who needs which nodes."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support import simulated_ranks
from tests.support.simulate import begin
from tests.support.small_scenes import MIXED
from vgmpi.materials.neo_hookean import Elastic
from vgmpi.parallel import block_ownership, exchange_topology, migration, node_overlap
from vgmpi.parallel.block_lattice import BITS, INTEGER, BlockLattice, hilbert_index
from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.parallel.load_balance import owners, partition
from vgmpi.parallel.particle_group import SIMD_WIDTH, ParticleGroup
from vgmpi.planning.phases_and_groups import GroupPlan
from vgmpi.solver.engines.thread_memory import ThreadPartition, accumulator_copies
from vgmpi.solver.restart.state_io import save

REALS = [np.dtype(np.float32), np.dtype(np.float64)]
LATTICE = BlockLattice((22, 13, 9), 0.02)


@pytest.mark.parametrize("real", REALS, ids=str)
@given(
    cells=st.tuples(*[st.integers(4, 400)] * 3),
    dx=st.floats(1e-3, 10.0),
    share=st.lists(st.tuples(*[st.floats(-0.0, 1.0)] * 3), min_size=1, max_size=20),
)
@settings(max_examples=60, deadline=None)
def test_place_and_position(real, cells, dx, share):
    lattice = BlockLattice(cells, dx)
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
    lattice = BlockLattice((22, 22, 22), 1.0)
    block, xi = lattice.place(x, real)
    half = 2 << BITS[real]
    assert ((xi >= -half) & (xi < half)).all()
    assert np.abs(lattice.position(block, xi, real) - x).max() <= 2.0 ** -BITS[real]


@pytest.mark.parametrize("levels", [1, 2, 3, 4])
def test_hilbert_curve_goes_from_neighbour_to_neighbour(levels):
    side = 1 << levels
    points = np.stack(np.meshgrid(*[np.arange(side)] * 3, indexing="ij"), -1).reshape(-1, 3)
    index = hilbert_index(points, levels)
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
    return GroupPlan("a/b", 0, "b", "solid", law, 1000.0, (("H", (0.0,) * 9),), 1.0)


def mark(ids, channels):
    """Channel values that tell whose they are: (channels, n)."""
    return 100.0 * ids[None, :] + np.arange(channels)[:, None]


def check_order(group):
    """Segments in key order, at multiples of the lanes; particles by (cell, id); nothing else."""
    key = group.lattice.key(group.block)
    assert (np.diff(key) > 0).all()
    assert (group.start % SIMD_WIDTH == 0).all()
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
    channels = group_plan().channels.count

    def job(ranks):
        group = ParticleGroup(group_plan(), LATTICE, real)
        mine = np.flatnonzero(holder == ranks.rank)
        block, xi = LATTICE.place(x[mine], real)
        migration.append_particles(group, block, xi, mark(mine, channels).astype(real), mine)
        cut = None
        for k in range(4):
            table, cut, _ = migration.sort_particles([group], ranks, cut, 50)
            check_order(group)
            here = table.owner == ranks.rank
            assert (np.diff(table.key) > 0).all() and ranks.total(table.particles[here].sum()) == n
            assert (table.code[here] == group.code).all()
            assert (table.particles[here] == group.count).all()
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

    assert sum(simulated_ranks.run(size, job)) == n


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
    table, _ = block_ownership.build_block_directory(
        np.concatenate(rows), lattice, SerialCommunicator(), np.ones(2), None, 0
    )
    keys, at = np.unique(table.key, return_inverse=True)
    if scattered:
        owner = random.integers(0, ranks, len(keys))[at]
    else:
        owner = owners(table.key, partition(keys, np.ones(len(keys)), ranks, None))
    return table._replace(owner=owner)


NEEDS = exchange_topology.TopologyRequirements(np.array([0, 1]), True, False)


def nodes_of(block):
    """Nodes that the patch of a block reaches: 4 b - 2 .. 4 b + 5 along each axis."""
    return itertools.product(*(range(4 * b - 2, 4 * b + 6) for b in block))


def nodes_in(tables, blocks, masks):
    """(node, phase) of the bits of masks of node blocks, in their order."""
    number = np.repeat(np.arange(len(tables.first) - 1), np.diff(tables.first))
    found = []
    for nb, mask in zip(blocks, masks, strict=True):
        low = 4 * tables.coordinates[number[nb]] - 1
        for n in range(64):
            if int(mask) >> n & 1:
                node = (low[0] + n // 16, low[1] + n // 4 % 4, low[2] + n % 4)
                found.append((tuple(int(i) for i in node), int(tables.phase[nb])))
    return found


@pytest.fixture(params=[(s, r, m) for s in range(3) for r in (1, 3, 5) for m in (False, True)])
def tables(request):
    seed, ranks, scattered = request.param
    whole = random_census(seed, ranks, scattered)
    return whole, [exchange_topology.build_topology(whole, LATTICE, r, NEEDS) for r in range(ranks)]


def test_a_segment_adds_to_the_node_blocks_around_it(tables):
    """Of its phase, all 27; blocks and phases ascend."""
    whole, built = tables
    for rank, t in enumerate(built):
        mine = whole.owner == rank
        assert (t.code == whole.code[mine]).all() and (t.group == whole.group[mine]).all()
        assert (t.table >= 0).all(), "a patch reaches a node block that is not there"
        number = np.repeat(np.arange(len(t.first) - 1), np.diff(t.first))
        for block, group, row in zip(t.block, t.group, t.table, strict=True):
            assert (t.coordinates[number[row]] == block + node_overlap.NEIGHBORS).all()
            assert (t.phase[row] == group).all()
        order = [
            (*t.coordinates[b].tolist(), p) for b, p in zip(number, t.phase.tolist(), strict=True)
        ]
        assert order == sorted(set(order))


def test_every_node_two_ranks_share_travels_and_no_other(tables):
    """A rank gives another what its patches add to the nodes that the other's patches reach, of
    any phase; what one gives is what the other waits for, in the same order."""
    whole, built = tables
    where = LATTICE.block(whole.code)
    for rank, t in enumerate(built):
        for other in range(len(built)):
            if other == rank:
                continue
            theirs = {
                n for b in np.unique(where[whole.owner == other], axis=0) for n in nodes_of(b)
            }
            mine = zip(where[whole.owner == rank], whole.group[whole.owner == rank], strict=True)
            want = {(n, int(g)) for b, g in mine for n in nodes_of(b) if n in theirs}
            if not want:
                assert other not in t.shared
                continue
            lists = t.shared[other]["momentum"]
            gives = nodes_in(t, lists.send_blocks, lists.send_masks)
            assert set(gives) == want and len(gives) == len(want)
            back = built[other].shared[rank]["momentum"]
            assert nodes_in(built[other], back.receive_blocks, back.receive_masks) == gives


def test_the_border_and_who_waits(tables):
    whole, built = tables
    where = LATTICE.block(whole.code)
    for rank, t in enumerate(built):
        others = where[whole.owner != rank]
        near = [len(others) and np.abs(others - b).max(1).min() <= 1 for b in t.block]
        assert t.border.tolist() == [bool(n) for n in near]
        gets = {nb for lists in t.shared.values() for nb in lists["momentum"].receive_blocks}
        number = np.repeat(np.arange(len(t.first) - 1), np.diff(t.first))
        assert np.flatnonzero(t.receives_remote).tolist() == sorted(
            {int(number[nb]) for nb in gets}
        )


@pytest.mark.parametrize("scattered", [False, True])
def test_fields_near_bodies_travel_in_the_blocks_near_bodies_alone(scattered):
    """Fields that are summed near bodies alone are sent there and nowhere else, as received."""

    def solid(blocks):
        is_near = (blocks < 3).all(1)
        return np.where(is_near, np.cumsum(is_near) - 1, -1)

    names = exchange_topology.NEAR_BODIES
    both, region = np.ones(2, bool), exchange_topology.NEAR_SURFACES
    places = tuple(exchange_topology.FieldPlace(name, both, region) for name in names)
    needs = NEEDS._replace(fields=places, at_surfaces=True)
    whole, ranks = random_census(1, 3, scattered), range(3)
    built = [exchange_topology.build_topology(whole, LATTICE, r, needs, solid) for r in ranks]
    sent = 0
    for rank, t in enumerate(built):
        number = np.repeat(np.arange(len(t.coordinates)), np.diff(t.first))
        for other, lists in t.shared.items():
            everywhere, here = lists["momentum"], lists[names[0]]
            is_near = t.solid[number[everywhere.send_blocks]] >= 0
            assert here.send_blocks.tolist() == everywhere.send_blocks[is_near].tolist()
            gives = nodes_in(t, here.send_blocks, here.send_masks)
            back = built[other].shared[rank][names[0]]
            assert nodes_in(built[other], back.receive_blocks, back.receive_masks) == gives
            assert t.has_terms[names[0]][here.receive_blocks].all()  # others have no memory
            assert t.has_terms[names[0]][here.send_blocks].all()
            sent += len(here.send_blocks)
    assert sent > 0


@pytest.mark.parametrize(
    "ranks, scattered, seed", [(4, False, s) for s in range(8)] + [(4, True, 5)]
)
def test_ranks_agree_on_where_contact_is_possible(ranks, scattered, seed):
    """Wherever patches of two phases share nodes, both give volumes and offsets, and elsewhere most
    do not; whoever has the other's nodes gets them."""
    lattice = BlockLattice(
        (60, 44, 40), 0.02
    )  # large, and the second phase rare: most patches do not
    whole = random_census(seed, ranks, scattered, lattice, (0.3, 0.008))
    where, asked = lattice.block(whole.code), []
    for rank in range(ranks):
        t = exchange_topology.build_topology(whole, lattice, rank, NEEDS)
        takes = t.contributes["offsets"]
        apart = np.abs(t.block[:, None] - where[None, :]).max(2)
        meet = ((apart <= 1) & (t.group[:, None] != whole.group)).any(1)
        assert (takes == meet).all()
        asked.append(takes)
        for other, lists in t.shared.items():
            there = exchange_topology.build_topology(whole, lattice, other, NEEDS).shared[rank][
                "offsets"
            ]
            gives = nodes_in(t, lists["offsets"].send_blocks, lists["offsets"].send_masks)
            built = exchange_topology.build_topology(whole, lattice, other, NEEDS)
            assert nodes_in(built, there.receive_blocks, there.receive_masks) == gives
    share = np.concatenate(asked).mean()
    assert 0.1 < share < 0.6, "too many or too few to test anything"


@given(seed=st.integers(0, 999), threads=st.integers(2, 5), share=st.sampled_from([0.0, 0.3, 1.0]))
@settings(max_examples=40, deadline=None)
def test_threads_never_add_to_one_row_at_a_time(seed, threads, share):
    """While the border is transferred, and while the others are; every copy has its node block."""
    whole = random_census(seed, 1, False)
    t = exchange_topology.build_topology(whole, LATTICE, 0, NEEDS)
    random = np.random.default_rng(seed)
    rows = [np.flatnonzero(t.group == g) for g in range(2)]
    shares = [
        ThreadPartition(random.integers(1, 99, len(r)), random.random(len(r)) < share, threads)
        for r in rows
    ]
    into, first, copy_rows = accumulator_copies(t, rows, shares, threads)
    block_of = np.append(
        np.arange(len(t.phase)), np.repeat(np.arange(len(t.phase)), np.diff(first))
    )
    assert (block_of[into] == t.table).all()
    assert (copy_rows == len(t.phase) + np.arange(len(copy_rows))).all()
    for border in (True, False):
        used = [
            np.unique(np.concatenate([into[r[s.stage(border)[k]]].ravel() for r, s in
                                      zip(rows, shares, strict=True)]))
            for k in range(threads)
        ]  # fmt: skip
        every = np.concatenate(used)
        assert len(np.unique(every)) == len(every)


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

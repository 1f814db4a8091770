"""The same bits on simulated ranks, and proof that the comparison sees the mistakes it is for.

Every mutation breaks one rule that the promise rests on (vgmpi/domain, docs); it must end in an
error or in other bits than one rank gives.
"""

import threading

import numpy as np
import pytest

from tests.support import simulated_ranks
from tests.support.rank_states import by_id, different, state
from tests.support.small_scenes import MIXED
from vgmpi.parallel import (
    halo_exchange,
    load_balance,
    node_overlap,
    sort_kernels,
)
from vgmpi.parallel.block_ownership import BlockDirectory
from vgmpi.solver.engines import cpu, nodal_field_storage

STEPS = 240

BALL = """
[accuracy]
pressure = "explicit"
precision = "double"
[domain]
size = [0.48, 0.4, 0.4]
cell = 0.02
[time]
end = 1
[material.rubber]
kind = "elastic"
youngs_modulus = 1e5
[[object]]
name = "ball"
material = "rubber"
shape = { sphere = { center = [0, 0, 0], radius = 0.03 } }
position = [0.19, 0.19, 0.16]
velocity = [3, 0, 0]
"""


def alone(precision, tmp_path_factory):
    """(text, state on one rank)."""
    text = MIXED.replace("PRECISION", precision)
    rows, [(sorts, *_)] = state(tmp_path_factory.mktemp("one"), 1, text, STEPS)
    assert sorts >= 5, "too few sorts to test anything"
    return text, rows


@pytest.fixture(scope="module")
def double(tmp_path_factory):
    return alone("double", tmp_path_factory)


@pytest.fixture(scope="module", params=["single", "double"])
def one(request, tmp_path_factory):
    return alone(request.param, tmp_path_factory)


@pytest.mark.parametrize("n", [2, 3, 5])
def test_same_bits(one, n, tmp_path):
    text, want = one
    rows, seen = state(tmp_path, n, text, STEPS)
    assert different(rows, want) == []
    assert any(most > least for _, least, most in seen), "nothing migrated"


def test_idle_ranks(tmp_path):
    """A ball in one block, on seven ranks: it crosses into others, ranks wake up and fall idle."""
    want, _ = state(tmp_path, 1, BALL, STEPS)
    rows, seen = state(tmp_path, 7, BALL, STEPS)
    assert different(rows, want) == []
    assert sum(least == 0 for _, least, _ in seen) >= 4, "hardly a rank was ever idle"
    assert any(least == 0 < most for _, least, most in seen), "no rank woke up or fell idle"


def test_any_owner_will_do(one, tmp_path, monkeypatch):
    """Blocks dealt out at random: only the order of keys decides the bits."""
    text, want = one

    def dealt(keys, cut):
        return keys * 2654435761 % 1009 % (len(cut) + 1)

    monkeypatch.setattr(load_balance, "owners", dealt)
    rows, _ = state(tmp_path, 3, text, STEPS)
    assert different(by_id(rows), by_id(want)) == []


# --- mutations ---


def drop_a_neighbour(monkeypatch):
    """No rank gives anything to the last of its neighbours."""

    def change(tables):
        last = max(tables.shared, default=None)
        none = np.zeros(0, np.int64), np.zeros(0, np.uint64)
        shared = {
            rank: {
                name: lists._replace(send_blocks=none[0], send_masks=none[1])
                if rank == last
                else lists
                for name, lists in layers.items()
            }
            for rank, layers in tables.shared.items()
        }
        return tables._replace(shared=shared)

    changed_tables(monkeypatch, change)


def forget_corners(monkeypatch):
    """Both sides think that blocks which share only an edge or a corner do not touch."""
    masks = node_overlap.SHARED_NODE_MASKS.copy()
    masks[np.abs(node_overlap.NEIGHBORS).sum(1) > 1] = 0
    monkeypatch.setattr(node_overlap, "SHARED_NODE_MASKS", masks)


def changed_tables(monkeypatch, change):
    real = halo_exchange.build_topology
    monkeypatch.setattr(
        halo_exchange, "build_topology", lambda *arguments: change(real(*arguments))
    )


def turned(masks):
    """As many nodes, each one further."""
    return masks << np.uint64(1) | masks >> np.uint64(63)


def turn_masks(monkeypatch, names):
    def change(tables):
        shared = {
            rank: {
                name: lists._replace(**{field: turned(getattr(lists, field)) for field in names})
                for name, lists in layers.items()
            }
            for rank, layers in tables.shared.items()
        }
        return tables._replace(shared=shared)

    changed_tables(monkeypatch, change)


def turn_all_masks(monkeypatch):
    """Sender and receiver agree on other nodes than those they share."""
    turn_masks(monkeypatch, ["send_masks", "receive_masks"])


def turn_sent_masks(monkeypatch):
    """Only the sender takes others, as many as before."""
    turn_masks(monkeypatch, ["send_masks"])


def plain_sums(monkeypatch):
    """Sums begin at 0 and are rounded as numbers are."""

    def begin(self, dt):
        self.bias = np.zeros_like(self.bias)
        if self.speed == 0.0:
            self.sums[:] = 0
            self.speed = 1.0
            self.tables = self.tables._replace(sums=self.sums, bias=self.bias, nodes=self.nodes)
            self.tables = self.tables._replace(has_terms=self.has_terms)

    monkeypatch.setattr(nodal_field_storage.NodalField, "begin", begin)
    monkeypatch.setattr(cpu.Cpu, "_found_beyond", lambda self: [])


def quanta_of_its_own(monkeypatch):
    """One rank keeps fewer digits than the others."""
    real = nodal_field_storage.NodalField.begin

    def begin(self, dt):
        if threading.current_thread().name == "rank 1":
            full = self.sum_bounds
            self.sum_bounds = lambda dt: 2.0**20 * full(dt)
            real(self, dt)
            self.sum_bounds = full
        else:
            real(self, dt)

    monkeypatch.setattr(nodal_field_storage.NodalField, "begin", begin)


def add_twice(monkeypatch):
    """What another rank gave is added twice."""
    real = cpu.Cpu.add

    def add(self, part):
        real(self, part)
        real(self, part)

    monkeypatch.setattr(cpu.Cpu, "add", add)


def rest_is_left(monkeypatch):
    """Messages are added with what their sums rest at."""
    real = cpu.Cpu.add

    def add(self, part):
        layer = self.layers[part.layer]
        bias, layer.bias = layer.bias, np.zeros_like(layer.bias)
        real(self, part)
        layer.bias = bias

    monkeypatch.setattr(cpu.Cpu, "add", add)


def sort_without_id(monkeypatch):
    """Particles of a cell stay in the order they arrived in."""
    real = sort_kernels.counting_sort

    def arrange(start, count, targets, ids, *rest):
        return real(start, count, targets, np.zeros_like(ids), *rest)

    monkeypatch.setattr(sort_kernels, "counting_sort", arrange)


def skip_a_halo(monkeypatch):
    """In one step nobody gets what the others summed."""
    for name in ("start", "finish"):
        real = getattr(halo_exchange.HaloExchange, name)

        def but_not_then(self, step, *arguments, real=real):
            if step != 40:
                real(self, step, *arguments)

        monkeypatch.setattr(halo_exchange.HaloExchange, name, but_not_then)


def one_rank_is_late(monkeypatch):
    """One rank packs its message as of the step before."""
    real = halo_exchange.HaloExchange.start

    def start(self, step, *arguments):
        real(self, step - (step == 40 and self.rank == 0), *arguments)

    monkeypatch.setattr(halo_exchange.HaloExchange, "start", start)


def border_too_early(monkeypatch):
    """Blocks that wait for other ranks are summed with the others, before the messages arrive."""
    changed_tables(
        monkeypatch, lambda t: t._replace(receives_remote=np.zeros_like(t.receives_remote))
    )


def sent_too_early(monkeypatch):
    """Messages begin to travel before the segments at the border are transferred."""
    real = cpu.Cpu.fill

    def fill(self, border):
        if not border:
            for side in (True, False):
                real(self, side)

    monkeypatch.setattr(cpu.Cpu, "fill", fill)


def old_tables(monkeypatch):
    """A rank keeps its tables although blocks came or went."""
    monkeypatch.setattr(BlockDirectory, "has_segments_of", lambda before, after: True)


def local_cuts(monkeypatch):
    """A rank cuts the curve anew by what it holds itself."""
    real = simulated_ranks.Simulated.all_rows

    def all_rows(self, rows):
        every = real(self, rows)
        if self.rank == 1 and rows.ndim == 2 and rows.shape[1] == 3 and len(rows):
            every = every.copy()
            every[: len(every) // 2, 1] *= 10
        return every

    monkeypatch.setattr(simulated_ranks.Simulated, "all_rows", all_rows)


def keep_own_maxima(monkeypatch, part):
    """A rank does not hear of the others' maxima."""
    real = simulated_ranks.Simulated.max

    def max(self, values):
        out = real(self, values).copy()
        out[part] = values[part]
        return out

    monkeypatch.setattr(simulated_ranks.Simulated, "max", max)


def local_step(monkeypatch):
    """The time step follows from this rank's particles alone."""
    keep_own_maxima(monkeypatch, slice(0, 1))


def local_sort(monkeypatch):
    """A rank sorts when its own particles have strayed."""
    keep_own_maxima(monkeypatch, slice(4, 5))


BITS, ERROR = "other bits", "an error"
MUTATIONS = {
    drop_a_neighbour: ERROR,
    forget_corners: BITS,
    turn_all_masks: BITS,
    turn_sent_masks: ERROR,
    plain_sums: BITS,
    quanta_of_its_own: BITS,
    add_twice: BITS,
    rest_is_left: BITS,
    old_tables: ERROR,
    sort_without_id: BITS,
    skip_a_halo: BITS,
    one_rank_is_late: ERROR,
    border_too_early: ERROR,
    sent_too_early: BITS,
    local_cuts: ERROR,
    local_step: BITS,
    local_sort: ERROR,
}


@pytest.mark.parametrize("mutation", MUTATIONS, ids=lambda m: m.__name__)
def test_a_mutation_is_seen(mutation, double, tmp_path, monkeypatch):
    """Particles are compared one by one, so a different order alone does not count as seen."""
    text, want = double
    if MUTATIONS[mutation] == ERROR:
        monkeypatch.setattr(simulated_ranks, "PATIENCE", 3.0)  # where MPI would wait for ever
    mutation(monkeypatch)
    try:
        rows, _ = state(tmp_path, 3, text, STEPS)
    except Exception as error:
        seen = ERROR
        print(f"{mutation.__name__}: {type(error).__name__}: {error}")
    else:
        names = different(by_id(rows), by_id(want))
        seen = BITS if names else "nothing"
        print(f"{mutation.__name__}: {names}")
    assert seen == MUTATIONS[mutation]

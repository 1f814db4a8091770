"""The same bits on simulated ranks, and proof that the comparison sees the mistakes it is for.

Every mutation breaks one rule that the promise rests on (vgmpi/domain, docs); it must end in an
error or in other bits than one rank gives.
"""

import threading

import numpy as np
import pytest

from tests import simulated
from tests.scenes import MIXED
from tests.states import by_id, different, state
from vgmpi.domain import balance, halo, sorting, topology
from vgmpi.engines import cpu

STEPS = 240

BALL = """
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

    monkeypatch.setattr(balance, "owners", dealt)
    rows, _ = state(tmp_path, 3, text, STEPS)
    assert different(by_id(rows), by_id(want)) == []


# --- mutations ---


def drop_a_neighbour(monkeypatch):
    """The last neighbour of every rank gets no message."""
    changed_tables(monkeypatch, lambda tables: tables._replace(sends=tables.sends[:-1]))


def forget_corners(monkeypatch):
    """Both sides think that blocks which share only an edge or a corner do not touch."""
    real = topology._traffic

    def faces(*arguments, **sending):
        near = np.abs(topology.NEIGHBOURS).sum(1) <= 1
        with monkeypatch.context() as m:
            m.setattr(topology, "NEIGHBOURS", topology.NEIGHBOURS[near])
            return real(*arguments, **sending)

    # ranks are threads: the list of neighbours may be swapped by one at a time only
    lock = threading.Lock()
    build = topology.build

    def locked(*arguments):
        with lock:
            return build(*arguments)

    monkeypatch.setattr(topology, "_traffic", faces)
    monkeypatch.setattr(topology, "build", locked)


def changed_tables(monkeypatch, change):
    real = topology.build
    monkeypatch.setattr(topology, "build", lambda *arguments: change(real(*arguments)))


def ghosts_first(monkeypatch):
    """Patches of other ranks are added before this rank's own."""

    def change(tables):
        node_block = np.repeat(np.arange(len(tables.phase)), np.diff(tables.pull_first))
        order = np.lexsort((tables.own[tables.pull_patch], node_block))
        return tables._replace(
            pull_patch=tables.pull_patch[order], pull_code=tables.pull_code[order]
        )

    changed_tables(monkeypatch, change)


def swap_two_patches(monkeypatch):
    """In every node block the first two of three patches or more change places, on ranks that have
    ghosts.
    """

    def change(tables):
        if tables.own.all():
            return tables
        order = np.arange(len(tables.pull_patch))
        at = tables.pull_first[:-1][np.diff(tables.pull_first) > 2]
        order[at], order[at + 2] = at + 2, at
        return tables._replace(
            pull_patch=tables.pull_patch[order], pull_code=tables.pull_code[order]
        )

    changed_tables(monkeypatch, change)


def shift_boxes(tables, names):
    def shifted(parts):
        return [
            (rank, patches, np.maximum(low - 1, 0), high - 1) for rank, patches, low, high in parts
        ]

    return tables._replace(**{name: shifted(getattr(tables, name)) for name in names})


def shift_all_boxes(monkeypatch):
    """Sender and receiver agree on boxes that lie one node too low."""
    changed_tables(monkeypatch, lambda tables: shift_boxes(tables, ["sends", "receives"]))


def shift_sent_boxes(monkeypatch):
    """Only the sender's boxes lie one node too low, and are as large as before."""

    def change(tables):
        sends = [(r, p, low - (low > 0), high - (low > 0)) for r, p, low, high in tables.sends]
        return tables._replace(sends=sends)

    changed_tables(monkeypatch, change)


def sort_without_id(monkeypatch):
    """Particles of a cell stay in the order they arrived in."""
    real = sorting.arrange

    def arrange(start, count, targets, ids, *rest):
        return real(start, count, targets, np.zeros_like(ids), *rest)

    monkeypatch.setattr(sorting, "arrange", arrange)


def skip_a_halo(monkeypatch):
    """The ghost patches of one step are those of the step before."""
    for name in ("start", "finish"):
        real = getattr(halo.Halo, name)

        def but_not_then(self, step, *arguments, real=real):
            if step != 40:
                real(self, step, *arguments)

        monkeypatch.setattr(halo.Halo, name, but_not_then)


def one_rank_is_late(monkeypatch):
    """One rank packs its message as of the step before."""
    real = halo.Halo.start

    def start(self, step, *arguments):
        real(self, step - (step == 40 and self.rank == 0), *arguments)

    monkeypatch.setattr(halo.Halo, "start", start)


def border_too_early(monkeypatch):
    """Blocks that wait for other ranks are summed with the others, before the messages arrive."""
    changed_tables(monkeypatch, lambda t: t._replace(waits=np.zeros_like(t.waits)))


def sent_too_early(monkeypatch):
    """Messages begin to travel before the boundary patches are filled."""
    real = cpu.Cpu.p2g

    def p2g(self, dt, border):
        if not border:
            for side in (True, False):
                real(self, dt, side)

    monkeypatch.setattr(cpu.Cpu, "p2g", p2g)


def local_cuts(monkeypatch):
    """A rank cuts the curve anew by what it holds itself."""
    real = simulated.Simulated.all_rows

    def all_rows(self, rows):
        every = real(self, rows)
        if self.rank == 1 and rows.ndim == 2 and rows.shape[1] == 3 and len(rows):
            every = every.copy()
            every[: len(every) // 2, 1] *= 10
        return every

    monkeypatch.setattr(simulated.Simulated, "all_rows", all_rows)


def local_step(monkeypatch):
    """The time step follows from this rank's particles alone."""
    real = simulated.Simulated.max

    def max(self, values):
        out = real(self, values).copy()
        out[0] = values[0]
        return out

    monkeypatch.setattr(simulated.Simulated, "max", max)


def local_sort(monkeypatch):
    """A rank sorts when its own particles have strayed."""
    real = simulated.Simulated.max

    def max(self, values):
        out = real(self, values).copy()
        out[1:2] = values[1:2]
        return out

    monkeypatch.setattr(simulated.Simulated, "max", max)


BITS, ERROR = "other bits", "an error"
MUTATIONS = {
    drop_a_neighbour: ERROR,
    forget_corners: BITS,
    ghosts_first: BITS,
    swap_two_patches: BITS,
    shift_all_boxes: BITS,
    shift_sent_boxes: ERROR,
    sort_without_id: BITS,
    skip_a_halo: BITS,
    one_rank_is_late: ERROR,
    border_too_early: BITS,
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
        monkeypatch.setattr(simulated, "PATIENCE", 3.0)  # where MPI would wait for ever
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

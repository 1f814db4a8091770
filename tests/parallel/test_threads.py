"""Threads of a rank add to the same nodes: the same bits, however many there are and whoever is
first.

Threads take turns, the last one first, so that a mistake does not hide behind a lucky order. Every
mutation breaks one rule of who sums what (vgmpi/solver/engines/cpu.py,
solver/engines/thread_memory.py) and must be seen. That threads which run at the same time never
add to one row, tests/parallel/test_exchange_topology.py holds.
"""

import numpy as np
import pytest

from tests.support import simulated_ranks
from tests.support.rank_states import by_id, different, state
from tests.support.small_scenes import MIXED
from vgmpi.kernels import reproducible_sums
from vgmpi.kernels.kernel_arguments import Sums
from vgmpi.solver.engines import cpu, nodal_field_storage
from vgmpi.solver.run_outcome import BlowUp

STEPS = 120
# longer, so that ranks with neighbours have blocks away from these
LONG = (
    MIXED.replace("PRECISION", "double")
    .replace("[0.36, 0.24, 0.24]", "[0.72, 0.24, 0.24]")
    .replace("[0.16, 0.24,", "[0.5, 0.24,")
    .replace("[0.08, 0.12, 0", "[0.25, 0.12, 0")
    .replace("[0.28, 0.12, 0.0]", "[0.64, 0.12, 0.0]")
)


@pytest.fixture(scope="module")
def one(tmp_path_factory):
    """The state on one rank with one thread."""
    rows, [(sorts, *_)] = state(tmp_path_factory.mktemp("one"), 1, LONG, STEPS)
    assert sorts >= 3
    return rows


@pytest.mark.parametrize("ranks, threads", [(1, 2), (1, 3), (2, 2), (3, 3)])
def test_threads_in_any_order(ranks, threads, one, tmp_path, monkeypatch):
    monkeypatch.setattr(cpu.Cpu, "each", simulated_ranks.last_first)
    rows, _ = state(tmp_path, ranks, LONG, STEPS, threads)
    assert different(rows, one) == []


def changed_engine(monkeypatch, change):
    """change(engine), once tables and buffers are laid out."""
    real = cpu.Cpu.set_topology

    def adopt(self, tables, kept=False):
        real(self, tables, kept)
        change(self)

    monkeypatch.setattr(cpu.Cpu, "set_topology", adopt)


def copies_are_forgotten(monkeypatch):
    """What other threads than the first add to node blocks that several touch."""
    changed_engine(
        monkeypatch,
        lambda e: setattr(
            e, "blocks", e.blocks._replace(copy_offsets=np.zeros_like(e.blocks.copy_offsets))
        ),
    )


def messages_before_copies(monkeypatch):
    """Ranks are given what the first thread summed."""
    monkeypatch.setattr(reproducible_sums, "merge_thread_copies", lambda *arguments: None)


def copies_stay(monkeypatch):
    """They do not begin a step at rest."""
    real = cpu.Cpu.begin

    def begin(self, *arguments):
        real(self, *arguments)
        layer = self.layers["momentum"]
        layer.sums[self.blocks.copies, 0] *= 1.0 + 2.0**-20

    monkeypatch.setattr(cpu.Cpu, "begin", begin)


def forget_to_rest(monkeypatch):
    """Sums are not put to rest where the tables are new."""

    def begin(self, dt):
        self.bias = reproducible_sums.accumulator_biases(self.sum_bounds(dt), self.real)
        self.tables = Sums(self.sums, self.bias, self.has_terms, self.nodes)

    monkeypatch.setattr(nodal_field_storage.NodalField, "begin", begin)


def a_thread_is_left_out(monkeypatch):
    """The last thread does nothing at the border."""

    def change(engine):
        for part in engine.parts:
            part.partition.border[-1] = part.partition.border[-1][:0]

    changed_engine(monkeypatch, change)


MUTATIONS = {  # ranks; two threads each
    copies_are_forgotten: 1,
    copies_stay: 1,
    forget_to_rest: 1,
    messages_before_copies: 3,
    a_thread_is_left_out: 2,
}


@pytest.mark.parametrize("mutation", MUTATIONS, ids=lambda m: m.__name__)
def test_a_mutation_is_seen(mutation, one, tmp_path, monkeypatch):
    monkeypatch.setattr(cpu.Cpu, "each", simulated_ranks.last_first)
    mutation(monkeypatch)
    try:
        rows, _ = state(tmp_path, MUTATIONS[mutation], LONG, STEPS, threads=2)
    except BlowUp as error:
        seen = [str(error)]
    else:
        seen = different(by_id(rows), by_id(one))
    print(f"{mutation.__name__}: {seen}")
    assert seen

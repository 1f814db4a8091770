"""Patches are added to the nodes at once, or kept and summed later: the same bits, whoever does it.

Threads take turns, the last one first, so that a mistake does not hide behind a lucky order. Every
mutation breaks one rule of who sums what (vgmpi/kernels/cpu.py) and must be seen.
"""

import numpy as np
import pytest

from tests import simulated
from tests.scenes import MIXED
from tests.states import by_id, different, state
from vgmpi.kernels import cpu
from vgmpi.solver.step import BlowUp

STEPS = 120


@pytest.fixture(scope="module")
def one(tmp_path_factory):
    """(text, state on one rank with one thread)."""
    text = MIXED.replace("PRECISION", "double")
    rows, _ = state(tmp_path_factory.mktemp("one"), 1, text, STEPS)
    return text, rows


@pytest.mark.parametrize("ranks, threads", [(1, 2), (1, 3), (2, 2), (3, 3)])
def test_threads_in_any_order(ranks, threads, one, tmp_path, monkeypatch):
    text, want = one
    monkeypatch.setattr(cpu.Cpu, "each", simulated.last_first)
    rows, _ = state(tmp_path, ranks, text, STEPS, threads)
    assert different(rows, want) == []


def changed_engine(monkeypatch, change):
    """change(engine), once tables and buffers are laid out."""
    real = cpu.Cpu.adopt

    def adopt(self, *arguments):
        real(self, *arguments)
        change(self)

    monkeypatch.setattr(cpu.Cpu, "adopt", adopt)


def two_threads_sum(monkeypatch):
    """Node blocks between two threads are given to both."""

    def filled(t, filler):
        fillers = filler[t.pull_patch]
        by = np.minimum.reduceat(fillers, t.pull_first[:-1])
        return by, np.where(by[t.table] >= 0, t.table, -1)

    monkeypatch.setattr(cpu, "filled_by_one", filled)


def sent_patches_sum_too(monkeypatch):
    """Patches that are sent are added to the nodes at once, before these are cleared."""
    real = cpu.filled_by_one

    def filled(t, filler):
        return real(t, np.where(t.own & (filler < 0), 0, filler))

    monkeypatch.setattr(cpu, "filled_by_one", filled)


def forget_to_clear(monkeypatch):
    """One node block of each thread begins a step with the velocities of the step before."""

    def change(engine):
        engine.clears = [np.delete(rows, len(rows) // 2) for rows in engine.clears]

    changed_engine(monkeypatch, change)


def keep_only_what_is_sent(monkeypatch):
    """Patches at the border of another thread, or beside a patch that is sent, are not kept."""

    def change(engine):
        t, sent = engine.topology, ~engine.topology.own
        for _, patches, _, _ in t.sends:
            sent[patches] = True
        engine.slot[~sent] = -1

    changed_engine(monkeypatch, change)


def last_group_first(monkeypatch):
    """Patches of the last group are added first."""

    def change(engine):
        engine.parts.reverse()
        engine.shares.reverse()
        engine.reports = engine.reports[::-1]

    changed_engine(monkeypatch, change)


def last_key_first(monkeypatch):
    """The patches that are added at once are filled from the last to the first."""

    def change(engine):
        for shares in engine.shares:
            shares.inner = [rows[::-1].copy() for rows in shares.inner]

    changed_engine(monkeypatch, change)


MUTATIONS = {  # ranks; two threads each
    two_threads_sum: 1,
    forget_to_clear: 1,
    last_group_first: 1,
    last_key_first: 1,
    keep_only_what_is_sent: 3,
    sent_patches_sum_too: 3,
}


@pytest.mark.parametrize("mutation", MUTATIONS, ids=lambda m: m.__name__)
def test_a_mutation_is_seen(mutation, one, tmp_path, monkeypatch):
    text, want = one
    monkeypatch.setattr(cpu.Cpu, "each", simulated.last_first)
    mutation(monkeypatch)
    try:
        rows, _ = state(tmp_path, MUTATIONS[mutation], text, STEPS, threads=2)
    except BlowUp as error:
        seen = [str(error)]
    else:
        seen = different(by_id(rows), by_id(want))
    print(f"{mutation.__name__}: {seen}")
    assert seen

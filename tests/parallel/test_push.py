"""Patches are added to the nodes at once, or kept and summed later: the same bits, whoever does it.

Threads take turns, the last one first, so that a mistake does not hide behind a lucky order. Every
mutation breaks one rule of who sums what (vgmpi/engines/cpu.py) and must be seen.
"""

import numpy as np
import pytest

from tests import simulated
from tests.scenes import MIXED
from tests.states import by_id, different, state
from vgmpi.engines import cpu
from vgmpi.solver.step import BlowUp

STEPS = 80
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
    monkeypatch.setattr(cpu.Cpu, "each", simulated.last_first)
    rows, _ = state(tmp_path, ranks, LONG, STEPS, threads)
    assert different(rows, one) == []


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


def sent_patches_are_left_out(monkeypatch):
    """Patches that are sent are not added to the nodes here."""

    def change(engine):
        for part in engine.parts:
            part.into[part.sent] = -1

    changed_engine(monkeypatch, change)


def sent_patches_first(monkeypatch):
    """Patches that are sent are added before the others, not in their turn."""

    def change(engine):
        for part, shares in zip(engine.parts, engine.shares, strict=True):
            shares.inner = [
                np.concatenate([rows[part.sent[rows]], rows[~part.sent[rows]]])
                for rows in shares.inner
            ]

    changed_engine(monkeypatch, change)


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
    sent_patches_are_left_out: 3,
    sent_patches_first: 2,
}


@pytest.mark.parametrize("mutation", MUTATIONS, ids=lambda m: m.__name__)
def test_a_mutation_is_seen(mutation, one, tmp_path, monkeypatch):
    monkeypatch.setattr(cpu.Cpu, "each", simulated.last_first)
    mutation(monkeypatch)
    try:
        rows, _ = state(tmp_path, MUTATIONS[mutation], LONG, STEPS, threads=2)
    except BlowUp as error:
        seen = [str(error)]
    else:
        seen = different(by_id(rows), by_id(one))
    print(f"{mutation.__name__}: {seen}")
    assert seen

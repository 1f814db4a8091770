"""Rebalancing moves particles between ranks, in an ordinary run and as often as it is asked to, and
changes no bit.
"""

import re

import numpy as np
import pytest

from tests.support.file_digests import digests
from tests.support.launch import mpirun
from tests.support.rank_states import different, state
from tests.support.small_scenes import MIXED, write
from vgmpi.parallel import load_balance

END = "time.end=0.03"


def forced(scene, out, n):
    """(digests, sorts, particles each rank sent) of a run that is cut anew at each sort."""
    flags = ("-o", out, "--set", END)
    job = mpirun(n, "-m", "tests.parallel.rebalance_job", scene, *flags)
    assert job.returncode == 0, job.stderr
    said = re.findall(r"rank (\d+) sorted (\d+) times and sent (\d+) particles", job.stdout)
    assert sorted(int(rank) for rank, _, _ in said) == list(range(n))
    (sorts,) = {int(sorts) for _, sorts, _ in said}
    return digests(out), sorts, [int(sent) for _, _, sent in said]


@pytest.mark.mpi
@pytest.mark.parametrize("precision", ["single", pytest.param("double", marks=pytest.mark.slow)])
def test_forced_at_every_sort(precision, tmp_path):
    scene = write(tmp_path, MIXED.replace("PRECISION", precision))
    want, sorts, _ = forced(scene, tmp_path / "one", 1)
    steps = max(int(name) for name in re.findall(r"checkpoint_(\d+)", " ".join(want)))
    print(f"{sorts} sorts, last checkpoint at step {steps}")
    assert sorts > steps / 5
    for n in (2, 3):
        found, again, sent = forced(scene, tmp_path / f"on {n}", n)
        print(f"{n} ranks: {sent} particles sent")
        assert again == sorts
        assert min(sent) > 100 * sorts, "rebalancing moved little"
        assert found == want


@pytest.mark.parametrize("n", [2, 3, 5])
def test_an_ordinary_run_rebalances(n, tmp_path, monkeypatch):
    """The mixed scene asks for new cuts by itself, and particles move because of them."""
    moved, real = [], load_balance.rebalance

    def recut(keys, work, count, ranks, cut, steps):
        new = real(keys, work, count, ranks, cut, steps)
        if cut is not None:
            now, then = load_balance.owners(keys, cut), load_balance.owners(keys, new)
            moved.append(int(count[now != then].sum()))
        return new

    text = MIXED.replace("PRECISION", "single")
    want, _ = state(tmp_path, 1, text, 240)
    monkeypatch.setattr(load_balance, "rebalance", recut)
    rows, [(sorts, *_), *_] = state(tmp_path, n, text, 240)
    print(f"{n} ranks, {sorts} sorts: particles moved by new cuts {moved[::n]}")
    assert different(rows, want) == []
    assert np.count_nonzero(moved) >= n, "the cuts never changed"

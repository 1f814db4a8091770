"""The benchmark's processes: every contestant has a module, and a checkout its worker."""

import importlib.util
from pathlib import Path

import pytest

from vgmpi.bench import rounds
from vgmpi.bench.rounds import Contestant
from vgmpi.bench.scene import BenchError
from vgmpi.bench.worker import CONTESTANTS

ROOT = Path(__file__).parents[2]


def test_every_contestant_has_a_module():
    for module in rounds.NAMES:
        assert importlib.util.find_spec(Contestant(module).path), module
        assert Contestant(module, tree="elsewhere").path == ""
    assert set(rounds.NAMES) == {*CONTESTANTS, "inside"}


def test_a_worker_is_found_in_this_checkout_and_in_no_other_folder(tmp_path):
    assert importlib.util.find_spec(rounds.worker_of(ROOT))
    with pytest.raises(BenchError, match="no checkout"):
        rounds.worker_of(tmp_path)

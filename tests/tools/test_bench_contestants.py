"""The benchmark's processes: every contestant has a module, and a checkout its worker."""

import importlib.util
from pathlib import Path

import pytest

from vgmpi.tools.bench import interleaved_rounds
from vgmpi.tools.bench.benchmark_case import STEPS, BenchError, Case
from vgmpi.tools.bench.contestant_worker import CONTESTANTS
from vgmpi.tools.bench.interleaved_rounds import Contestant

ROOT = Path(__file__).parents[2]


def test_every_contestant_has_a_module():
    for module in interleaved_rounds.NAMES:
        assert importlib.util.find_spec(Contestant(module).path), module
        assert Contestant(module, tree="elsewhere").path == ""
    assert set(interleaved_rounds.NAMES) == set(CONTESTANTS)


def test_a_worker_is_found_in_this_checkout_and_in_no_other_folder(tmp_path):
    assert importlib.util.find_spec(interleaved_rounds.worker_of(ROOT))
    with pytest.raises(BenchError, match="no checkout"):
        interleaved_rounds.worker_of(tmp_path)


def test_the_fastest_slice_of_a_round_counts():
    """A neighbor on the machine makes slices longer: a trial, then three slices of each round."""

    class Disturbed:
        seconds = iter([9.0, 3.0, 2.0, 4.0, 5.0, 8.0, 1.0])

        def ask(self, do, units):
            return {"steps": 2 * units, "seconds": next(self.seconds), "wall": 10.0, "stages": {}}

    row: dict = {"module": "plain"}
    interleaved_rounds._turns(Case("fluid", 100), [(row, Disturbed())], 2, 0.001, lambda line: None)
    assert [answer["seconds"] for answer in row["rounds"]] == [2.0, 1.0]


def test_a_slice_of_ours_ends_before_the_walls():
    """Cycles of few particles are short; the rivals begin again by themselves."""

    class Quick:
        def ask(self, do, units):
            return {"steps": 19 * units, "seconds": 1e-3 * units, "wall": 1e-3, "stages": {}}

    steps = {}
    for module in ("own", "plain"):
        row: dict = {"module": module}
        interleaved_rounds._turns(Case("fluid", 100), [(row, Quick())], 1, 0.6, lambda line: None)
        steps[module] = row["rounds"][0]["steps"]
    assert steps["own"] + STEPS // 2 < STEPS < steps["plain"]

"""A load of damping has the same bits in every file for any number of ranks and threads.

Also after a restart while it acts."""

import pytest

from tests.support.file_digests import (
    RANKS_AND_THREADS,
    assert_same_after_stop,
    assert_same_files,
    run_on_one_rank,
)
from tests.support.small_scenes import MIXED

pytestmark = pytest.mark.mpi

SCENE = (
    MIXED.replace("PRECISION", "single")
    + """
[[load]]
object = ["ball", "pool"]
damping = "25 1/s"
ramp_time = "10 ms"
start_time = "5 ms"
end_time = "37 ms"
"""
)


@pytest.fixture(scope="module")
def one(tmp_path_factory):
    return run_on_one_rank(tmp_path_factory.mktemp("damped"), SCENE)


@RANKS_AND_THREADS
def test_any_ranks_and_threads(one, tmp_path, ranks, flags):
    assert_same_files(*one, tmp_path / "out", ranks, *flags)


def test_a_restart(one, tmp_path):
    assert_same_after_stop(*one, tmp_path / "out", 17)

"""Pinned parts that let go have the same bits in every file for any number of ranks and threads.

Also after a restart before and after the release.
"""

import pytest

from tests.support.file_digests import (
    RANKS_AND_THREADS,
    assert_same_after_stop,
    assert_same_files,
    run_on_one_rank,
)

pytestmark = pytest.mark.mpi

SCENE = """
[domain]
size = ["32 cm", "16 cm", "24 cm"]
cell = "2 cm"
[time]
end = "60 ms"
frames = 3
[material.rubber]
kind = "elastic"
density = 1100
youngs_modulus = "100 kPa"
friction = 0.3
[[object]]
name = "whip"
material = "rubber"
shape = { box = [["20 cm", "4 cm", "4 cm"], ["26 cm", "10 cm", "20 cm"]] }
[[object.pinned]]
box = [[0.19, 0.03, 0.03], [0.27, 0.11, 0.08]]
motion = { velocity = [-1, 0, 0] }
release_time = "21 ms"
[[object.pinned]]
box = [[0.19, 0.03, 0.16], [0.27, 0.11, 0.21]]
release_time = "33 ms"
[[object]]
name = "block"
material = "rubber"
shape = { box = [["6 cm", "4 cm", 0], ["14 cm", "12 cm", "8 cm"]] }
[[probe]]
name = "grip"
sampling_rate = 100
collider = "whip"
"""


@pytest.fixture(scope="module")
def one(tmp_path_factory):
    return run_on_one_rank(tmp_path_factory.mktemp("released"), SCENE)


@RANKS_AND_THREADS
def test_any_ranks_and_threads(one, tmp_path, ranks, flags):
    assert_same_files(*one, tmp_path / "out", ranks, *flags)


@pytest.mark.parametrize("steps", [8, 20, 34])
def test_a_restart(one, tmp_path, steps):
    """Before the first release, between the two, and after both."""
    assert_same_after_stop(*one, tmp_path / "out", steps)

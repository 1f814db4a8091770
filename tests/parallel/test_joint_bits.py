"""Jointed bodies have the same bits in every file for any number of ranks and threads, and after a
restart while they touch water, each other and a wall."""

import pytest

from tests.parallel.test_free_body_bits import SCENE as FREE
from tests.support.file_digests import (
    RANKS_AND_THREADS,
    assert_same_after_stop,
    assert_same_files,
    run_on_one_rank,
)

pytestmark = pytest.mark.mpi

SCENE = (
    FREE
    + """
[[joint]]
kind = "hinge"
between = ["ball"]
at = ["9 cm", "8 cm", "13.5 cm"]
axis = "y"
motor = { speed = "300 rpm", torque = 0.5 }
[[joint]]
kind = "spring"
between = ["crate", "ball"]
at = ["22 cm", "8 cm", "6 cm"]
to = ["13 cm", "8 cm", "13 cm"]
stiffness = 500
damping = 2
[[joint]]
name = "lid"
kind = "hinge"
between = ["lid", "crate"]
at = ["23 cm", "8 cm", "7 cm"]
axis = "y"
limits = ["-1 deg", "90 deg"]
[[probe]]
name = "lid"
sampling_interval = "2 ms"
joint = "lid"
"""
)


@pytest.fixture(scope="module")
def one(tmp_path_factory):
    folder = tmp_path_factory.mktemp("jointed")
    return run_on_one_rank(folder, SCENE)


@RANKS_AND_THREADS
def test_any_ranks_and_threads(one, tmp_path, ranks, flags):
    assert_same_files(*one, tmp_path / "out", ranks, *flags)


@pytest.mark.parametrize("steps", [17, pytest.param(40, marks=pytest.mark.slow)])
def test_a_restart(one, tmp_path, steps):
    assert_same_after_stop(*one, tmp_path / "out", steps)

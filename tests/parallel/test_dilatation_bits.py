"""The dilatation by cells has the same bits in every file for any number of ranks and threads, and
after a restart between two transfer corrections."""

import pytest

from tests.support.file_digests import (
    RANKS_AND_THREADS,
    assert_same_after_stop,
    assert_same_files,
    digests,
    frame_digests,
    run_on_one_rank,
)
from tests.support.launch import go
from tests.support.small_scenes import MIXED, write

pytestmark = pytest.mark.mpi

SCENE = MIXED.replace("PRECISION", "single").replace(
    "[accuracy]\n", '[accuracy]\ndilatation = "cells"\n'
)


@pytest.fixture(scope="module")
def one(tmp_path_factory):
    folder = tmp_path_factory.mktemp("dilatation")
    return run_on_one_rank(folder, SCENE)


def test_it_is_another_motion(one, tmp_path):
    """A scene without the key gives other frames: what is compared below is the dilatation's."""
    job = go(write(tmp_path, MIXED.replace("PRECISION", "single")), tmp_path / "plain", 1)
    assert job.returncode == 0, job.stderr
    plain, cells = frame_digests(digests(tmp_path / "plain")), frame_digests(one[1])
    assert plain.keys() == cells.keys() and plain != cells


@RANKS_AND_THREADS
def test_any_ranks_and_threads(one, tmp_path, ranks, flags):
    assert_same_files(*one, tmp_path / "out", ranks, *flags)


def test_a_restart(one, tmp_path):
    assert_same_after_stop(*one, tmp_path / "out", 31)

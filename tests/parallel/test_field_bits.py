"""Stress, pressure, strain and volume fractions have the same bits in every file for any number of
ranks and threads, and after a restart."""

import pytest

from tests.support.file_digests import (
    RANKS_AND_THREADS,
    assert_same_after_stop,
    assert_same_files,
    run_on_one_rank,
)
from tests.support.small_scenes import SHARED, every_law

pytestmark = pytest.mark.mpi

ASKED = '[output]\nfields = ["J", "stress", "pressure", "strain"'
SCENES = {
    "laws": every_law("single") + ASKED + "]\ncheckpoint_interval_steps = 40\n",
    "shared": SHARED.replace("PRECISION", "single").replace(
        "[output]\n", ASKED + ', "volume_fraction"]\n'
    ),
}


@pytest.fixture(scope="module", params=[pytest.param("laws", marks=pytest.mark.slow), "shared"])
def one(request, tmp_path_factory):
    return run_on_one_rank(tmp_path_factory.mktemp(request.param), SCENES[request.param])


def test_the_fields_are_in_the_files(one):
    names = {name.rpartition("/")[2] for name in one[1] if "frame_00001" in name}
    assert {"stress", "pressure", "strain"} <= names


@RANKS_AND_THREADS
def test_any_ranks_and_threads(one, tmp_path, ranks, flags):
    assert_same_files(*one, tmp_path / "out", ranks, *flags)


def test_a_restart(one, tmp_path):
    assert_same_after_stop(*one, tmp_path / "out", 31)

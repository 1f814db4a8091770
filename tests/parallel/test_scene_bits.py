"""Scenes with one feature each have the same bits in every file for any number of ranks and
threads, and after a restart while the feature acts.
"""

import pytest

from tests.support.feature_scenes import DOUBLE, SCENES, SINGLE
from tests.support.file_digests import (
    RANKS_AND_THREADS,
    assert_same_after_stop,
    assert_same_files,
    digests,
    frame_digests,
    run_on_one_rank,
)
from tests.support.simulated_runs import run_here
from tests.support.small_scenes import write

STOPS = [  # steps: before the first release of pins, between two, after both; others between sorts
    ("bodies alone", 40), ("bodies alone", 120), ("damping", 17), ("dilatation", 31),
    ("fields", 31), ("free bodies", 17), ("joints", 17), ("regions", 17), ("released pins", 8),
    ("released pins", 20), ("released pins", 34), ("slip on a collider", 17),
    ("slip on a body", 17), ("slip on a solid", 17), ("slip on a solid alone", 17),
    ("thin walls", 17), ("pins on colliders", 40), ("pins on a body", 40), ("wave zones", 30),
]  # fmt: skip
SLOW_STOPS = [("fields of laws", 31), ("free bodies", 40), ("joints", 40)]


def slow(*values):
    """Parameters of a slow test."""
    return pytest.param(*values, marks=pytest.mark.slow)


def on(*names):
    """A test of these scenes alone."""
    return pytest.mark.parametrize("one", names, indirect=True, scope="module")


@pytest.fixture(scope="module")
def one(request, tmp_path_factory):
    """The scene, and the digests of its files when run on one rank."""
    return run_on_one_rank(tmp_path_factory.mktemp("one"), SCENES[request.param])


@on(
    *(name for name in SCENES if name not in ("bodies alone", "fields of laws")),
    slow("fields of laws"),
)
@RANKS_AND_THREADS
def test_any_ranks_and_threads(one, tmp_path, start, ranks, flags):
    assert_same_files(*one, tmp_path / "out", start, ranks, *flags)


@on("bodies alone")
@pytest.mark.parametrize(
    "ranks, flags", [(2, []), (3, []), (1, ["--threads", "2"]), (1, ["--engine", "numpy"])]
)
def test_any_ranks_threads_and_engines(one, tmp_path, ranks, flags):
    assert_same_files(*one, tmp_path / "out", run_here, ranks, *flags)


@pytest.mark.parametrize(
    "one, steps",
    [*STOPS, *(slow(*stop) for stop in SLOW_STOPS)],
    indirect=["one"],
    scope="module",
)
def test_a_restart(one, tmp_path, steps):
    assert_same_after_stop(*one, tmp_path / "out", steps)


@pytest.mark.parametrize(
    "one, without",
    [("dilatation", SINGLE), ("wave zones", DOUBLE)],
    indirect=["one"],
    scope="module",
)
def test_what_is_compared_is_the_feature(one, tmp_path, without):
    """A scene without the keys has other frames."""
    run_here(write(tmp_path, without), tmp_path / "plain", 1)
    plain, found = frame_digests(digests(tmp_path / "plain")), frame_digests(one[1])
    assert plain.keys() == found.keys() and plain != found


@on(slow("fields of laws"), "fields")
def test_the_fields_are_in_the_files(one):
    names = {name.rpartition("/")[2] for name in one[1] if "frame_00001" in name}
    assert {"stress", "pressure", "strain"} <= names

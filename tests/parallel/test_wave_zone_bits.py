"""Wave zones have the same bits on any number of ranks, with threads and after a restart."""

import pytest

from tests.support.file_digests import (
    RANKS_AND_THREADS,
    assert_same_after_stop,
    assert_same_files,
    run_on_one_rank,
)
from tests.support.small_scenes import MIXED

SCENE = (
    MIXED.replace("PRECISION", "double")
    + """
[[wave_zone]]
name = "maker"
box = [[0, 0, 0], [0.2, 0.24, 0.24]]
outer = "west"
period = 0.5
level = 0.1
depth = 0.1
height = 0.03
[[wave_zone]]
name = "beach"
box = [[0, 0.1, 0], [0.36, 0.24, 0.24]]
outer = "north"
period = 0.5
level = 0.1
depth = 0.1
"""
)


@pytest.fixture(scope="module")
def one(tmp_path_factory):
    folder = tmp_path_factory.mktemp("waves")
    scene, found = run_on_one_rank(folder, SCENE)
    (folder / "without").mkdir()
    _, without = run_on_one_rank(folder / "without", MIXED.replace("PRECISION", "double"))
    frames = [name for name in found if "frame_" in name]
    assert any(found[name] != without[name] for name in frames[1:]), "the zones do nothing"
    return scene, found


@RANKS_AND_THREADS
def test_ranks_and_threads(one, start, ranks, flags, tmp_path):
    scene, expected = one
    assert_same_files(scene, expected, tmp_path, start, ranks, *flags)


def test_a_restart(one, tmp_path):
    scene, expected = one
    assert_same_after_stop(scene, expected, tmp_path, 30)

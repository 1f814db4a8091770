"""Bodies that leave walls without a kind have the same bits on any number of ranks and threads."""

import pytest

from tests.support.file_digests import RANKS_AND_THREADS, assert_same_files, run_on_one_rank

SCENE = """
[domain]
size = [0.36, 0.2, 0.22]
cell = 0.02
gravity_keyframes = [
    { time = 0.02, gravity = [0, 0, -9.8] }, { time = 0.021, gravity = [0, 4, 9.8] },
]
[time]
end = 0.1
frames = 3
[material.jelly]
kind = "elastic"
youngs_modulus = 2e4
[material.grains]
kind = "sand"
[[object]]
name = "cube"
material = "jelly"
velocity = [0.5, 0, 0.4]
shape = { box = [[0.02, 0.02, 0], [0.16, 0.16, 0.1]] }
[[object]]
name = "heap"
material = "grains"
velocity = [0.2, -0.5, 0]
shape = { box = [[0.22, 0, 0], [0.32, 0.12, 0.06]] }
"""


@pytest.fixture(scope="module")
def one(tmp_path_factory):
    return run_on_one_rank(tmp_path_factory.mktemp("walls"), SCENE)


@RANKS_AND_THREADS
def test_any_ranks_and_threads(one, tmp_path, start, ranks, flags):
    assert_same_files(*one, tmp_path / "out", start, ranks, *flags)

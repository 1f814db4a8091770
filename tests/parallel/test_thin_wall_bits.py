"""Thin walls, one of which is carried through water while water falls over its rim: the same bits
in every file for any number of ranks and threads and after a restart."""

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
size = ["24 cm", "16 cm", "20 cm"]
cell = "1 cm"
[time]
end = "60 ms"
frames = 3
[accuracy]
precision = "single"
[material.water]
kind = "fluid"
tait_coefficient = "20 kPa"
[material.grains]
kind = "sand"
[[object]]
name = "pool"
material = "water"
shape = { box = [[0, 0, 0], ["24 cm", "16 cm", "4 cm"]] }
velocity = [0.5, 0, 0]
[[object]]
name = "jet"
material = "water"
shape = { box = [["6 cm", "5 cm", "14 cm"], ["10 cm", "11 cm", "18 cm"]] }
velocity = [0, 0, -1]
[[object]]
name = "heap"
material = "grains"
shape = { box = [["8 cm", "5 cm", "6.5 cm"], ["15 cm", "11 cm", "9 cm"]] }
[[object]]
name = "cup"
role = "scenery"
collider = true
thin = true
shape = { difference = [
  { box = [["7.2 cm", "4 cm", "5 cm"], ["16.2 cm", "12 cm", "12 cm"]] },
  { box = [["7.7 cm", "4.5 cm", "6 cm"], ["15.7 cm", "11.5 cm", "30 cm"]] },
] }
motion = { velocity = [0, 0, -0.5], angular_velocity = 2, axis = "y" }
[[object]]
name = "plate"
role = "scenery"
collider = true
thin = true
shape = { box = [["20 cm", "-1 cm", "-1 cm"], ["20.5 cm", "17 cm", "9 cm"]] }
[[probe]]
name = "load"
sampling_rate = 200
collider = "cup"
"""


@pytest.fixture(scope="module")
def one(tmp_path_factory):
    folder = tmp_path_factory.mktemp("thin")
    return run_on_one_rank(folder, SCENE)


@RANKS_AND_THREADS
def test_any_ranks_and_threads(one, tmp_path, ranks, flags):
    assert_same_files(*one, tmp_path / "out", ranks, *flags)


def test_a_restart(one, tmp_path):
    assert_same_after_stop(*one, tmp_path / "out", 17)

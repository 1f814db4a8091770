"""Free rigid bodies have the same bits in every file for any number of ranks and threads, and after
a restart while they touch water, each other and a wall."""

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
cell = "1 cm"
boundary = { default = "slip", bottom = { kind = "separate", friction = 0.4 } }
[time]
end = "60 ms"
frames = 4
[accuracy]
precision = "single"
[material.water]
kind = "fluid"
tait_coefficient = "20 kPa"
[material.wood]
kind = "elastic"
preset = "cork"
friction = 0.3
[[object]]
name = "pool"
material = "water"
shape = { box = [[0, 0, 0], ["20 cm", "16 cm", "8 cm"]] }
velocity = [0.5, 0, 0]
[[object]]
name = "ball"
material = "wood"
rigid = true
restitution = 0.5
shape = { sphere = { center = ["9 cm", "8 cm", "13.5 cm"], radius = "5 cm" } }
velocity = [0, 0, -2]
angular_velocity = [0, 9, 3]
[[object]]
name = "crate"
material = "wood"
rigid = true
shape = { box = [["22 cm", "4 cm", 0], ["29 cm", "12 cm", "7 cm"]] }
[[object]]
name = "lid"
material = "wood"
rigid = true
shape = { box = [["23 cm", "5 cm", "7 cm"], ["28 cm", "11 cm", "9 cm"]] }
[[probe]]
name = "ball"
sampling_interval = "2 ms"
object = "ball"
"""


@pytest.fixture(scope="module")
def one(tmp_path_factory):
    folder = tmp_path_factory.mktemp("free")
    return run_on_one_rank(folder, SCENE)


@RANKS_AND_THREADS
def test_any_ranks_and_threads(one, tmp_path, ranks, flags):
    assert_same_files(*one, tmp_path / "out", ranks, *flags)


@pytest.mark.parametrize("steps", [17, pytest.param(40, marks=pytest.mark.slow)])
def test_a_restart(one, tmp_path, steps):
    assert_same_after_stop(*one, tmp_path / "out", steps)

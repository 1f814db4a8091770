"""A body with regions of other materials: the same bits in every file for any number of ranks and
threads and after a restart."""

import pytest

from tests.support.file_digests import (
    RANKS_AND_THREADS,
    assert_same_after_stop,
    assert_same_files,
    run_on_one_rank,
)

pytestmark = pytest.mark.mpi

HAMMER = """
[domain]
size = ["32 cm", "24 cm", "24 cm"]
cell = "1 cm"
[time]
end = "20 ms"
frames = 3
[accuracy]
precision = "single"
[material.water]
kind = "fluid"
tait_coefficient = "20 kPa"
[material.oak]
kind = "elastic"
density = 700
youngs_modulus = "0.1 MPa"
[material.iron]
kind = "elastic"
density = 3000
youngs_modulus = "1 MPa"
[[object]]
name = "pool"
material = "water"
shape = { box = [[0, 0, 0], ["32 cm", "24 cm", "6 cm"]] }
velocity = [0.5, 0, 0]
[[object]]
name = "hammer"
material = "oak"
shape = { box = [["6 cm", "9 cm", "8 cm"], ["26 cm", "15 cm", "13 cm"]] }
velocity = [0, 0, -2]
angular_velocity = [2, 9, 4]
[[object.region]]
material = "iron"
box = [["19 cm", 0, 0], ["32 cm", "24 cm", "24 cm"]]
[[object.region]]
material = "iron"
sphere = { center = ["9 cm", "12 cm", "10 cm"], radius = "2 cm" }
[[probe]]
name = "hammer"
sampling_rate = 200
object = "hammer"
[[load]]
object = "hammer"
acceleration = [0, 3, 0]
"""


@pytest.fixture(scope="module")
def one(tmp_path_factory):
    return run_on_one_rank(tmp_path_factory.mktemp("regions"), HAMMER)


@RANKS_AND_THREADS
def test_any_ranks_and_threads(one, tmp_path, ranks, flags):
    assert_same_files(*one, tmp_path / "out", ranks, *flags)


def test_a_restart(one, tmp_path):
    assert_same_after_stop(*one, tmp_path / "out", 17)

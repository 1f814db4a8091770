"""Liquids that stick to bodies or slip on colliders: the same bits in every file for any
number of ranks and threads and after a restart."""

import pytest

from tests.support.file_digests import (
    RANKS_AND_THREADS,
    assert_same_after_stop,
    assert_same_files,
    run_on_one_rank,
)

pytestmark = pytest.mark.mpi

COLLIDERS = """
[domain]
size = ["24 cm", "16 cm", "20 cm"]
cell = "1 cm"
[time]
end = "30 ms"
frames = 3
[accuracy]
precision = "single"
[material.honey]
kind = "fluid"
viscosity = 5
tait_coefficient = "20 kPa"
[material.wood]
kind = "elastic"
preset = "cork"
[[object]]
name = "pool"
material = "honey"
shape = { box = [[0, 0, "4 cm"], ["24 cm", "16 cm", "9 cm"]] }
velocity = [0.5, 0, 0]
[[object]]
name = "floor"
role = "scenery"
collider = true
slip_length = "3 mm"
shape = { box = [["-1 cm", "-1 cm", "-5 cm"], ["25 cm", "17 cm", "4 cm"]] }
[[probe]]
name = "drag"
sampling_rate = 200
collider = "floor"
"""
BODY = """
[[object]]
name = "ball"
material = "wood"
rigid = true
slip_length = 0
shape = { sphere = { center = ["12 cm", "8 cm", "12 cm"], radius = "4 cm" } }
velocity = [0, 0, -1]
angular_velocity = [0, 9, 3]
"""
SOLID = BODY.replace("rigid = true\n", "")
SCENES = {
    "colliders": COLLIDERS,
    "body": COLLIDERS + BODY,
    "solid": COLLIDERS + SOLID,
    "solid alone": COLLIDERS[: COLLIDERS.index('[[object]]\nname = "floor"')] + SOLID,
}


@pytest.fixture(scope="module", params=list(SCENES))
def one(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp("slip")
    return run_on_one_rank(folder, SCENES[request.param])


@RANKS_AND_THREADS
def test_any_ranks_and_threads(one, tmp_path, ranks, flags):
    assert_same_files(*one, tmp_path / "out", ranks, *flags)


def test_a_restart(one, tmp_path):
    assert_same_after_stop(*one, tmp_path / "out", 17)

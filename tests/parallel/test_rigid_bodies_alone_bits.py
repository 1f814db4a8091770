"""Rigid bodies alone have the same bits in every file for any number of ranks and threads, with the
NumPy engine, and after a restart while they touch each other, a collider and a wall."""

import pytest

from tests.support.file_digests import (
    assert_same_after_stop,
    assert_same_files,
    run_on_one_rank,
)

pytestmark = pytest.mark.mpi

SCENE = """
[domain]
size = ["32 cm", "16 cm", "24 cm"]
cell = "1 cm"
[time]
end = "300 ms"
frames = 4
[material.wood]
kind = "elastic"
preset = "cork"
friction = 0.3
[[object]]
name = "ball"
material = "wood"
rigid = true
restitution = 0.5
shape = { sphere = { center = ["9 cm", "8 cm", "13.5 cm"], radius = "4 cm" } }
velocity = [0.6, 0, -2]
angular_velocity = [0, 9, 3]
[[object]]
name = "crate"
material = "wood"
rigid = true
shape = { box = [["15 cm", "4 cm", "4 cm"], ["22 cm", "12 cm", "11 cm"]] }
[[object]]
name = "lid"
material = "wood"
rigid = true
shape = { box = [["16 cm", "5 cm", "12 cm"], ["21 cm", "11 cm", "14 cm"]] }
[[object]]
name = "step"
role = "scenery"
collider = true
shape = { box = [["14 cm", 0, 0], ["32 cm", "16 cm", "3 cm"]] }
[[joint]]
kind = "spring"
between = ["lid"]
at = ["16 cm", "5 cm", "13 cm"]
to = ["10 cm", "2 cm", "20 cm"]
stiffness = 20
damping = 0.2
[[probe]]
name = "ball"
sampling_interval = "5 ms"
object = "ball"
"""


@pytest.fixture(scope="module")
def one(tmp_path_factory):
    folder = tmp_path_factory.mktemp("rigid")
    return run_on_one_rank(folder, SCENE)


@pytest.mark.parametrize(
    "ranks, flags", [(2, []), (3, []), (1, ["--threads", "2"]), (1, ["--engine", "numpy"])]
)
def test_any_ranks_threads_and_engines(one, tmp_path, ranks, flags):
    assert_same_files(*one, tmp_path / "out", ranks, *flags)


@pytest.mark.parametrize("steps", [40, 120])
def test_a_restart(one, tmp_path, steps):
    assert_same_after_stop(*one, tmp_path / "out", steps)

"""Pinned parts have the same bits in every file for any number of ranks and threads, and after a
restart: parts that the world, a collider that turns and a rigid body in water hold, also across
regions of other materials."""

import pytest

from tests.support.file_digests import (
    RANKS_AND_THREADS,
    assert_same_after_stop,
    assert_same_files,
    run_on_one_rank,
)

ROOM = """
[domain]
size = ["32 cm", "16 cm", "24 cm"]
cell = "1 cm"
[time]
end = "60 ms"
frames = 3
[accuracy]
precision = "single"
[material.rubber]
kind = "elastic"
density = 1100
youngs_modulus = "100 kPa"
friction = 0.3
[material.gum]
kind = "elastic"
density = 1500
youngs_modulus = "60 kPa"
"""
COLLIDERS = """
[[object]]
name = "rim"
role = "scenery"
collider = true
shape = { cylinder = { AXLE, radius = "4 cm" } }
motion = { axis = "y", angular_velocity = 20 }
[[object]]
name = "tyre"
material = "rubber"
shape = { cylinder = { AXLE, radius = "7 cm" } }
pinned = { sphere = { center = ["10 cm", "8 cm", "12 cm"], radius = "4 cm" }, to = "rim" }
[[object]]
name = "whip"
material = "rubber"
shape = { box = [["20 cm", "6 cm", "4 cm"], ["24 cm", "10 cm", "20 cm"]] }
pinned = [
  { box = [[0.19, 0.05, 0.03], [0.25, 0.11, 0.07]], motion = { velocity = [1, 0, 0] } },
  { box = [[0.19, 0.05, 0.175], [0.25, 0.11, 0.21]] },
]
region = [{ material = "gum", box = [[0.22, 0, 0], [0.3, 0.2, 0.1]] }]
[[probe]]
name = "grip"
sampling_rate = 100
collider = "whip"
[[probe]]
name = "drive"
sampling_rate = 100
collider = "rim"
"""
AXLE = 'endpoints = [["10 cm", "6 cm", "12 cm"], ["10 cm", "10 cm", "12 cm"]]'
BODY = """
[material.water]
kind = "fluid"
tait_coefficient = "20 kPa"
[[object]]
name = "pool"
material = "water"
shape = { box = [[0, 0, 0], ["32 cm", "16 cm", "7 cm"]] }
velocity = [0.5, 0, 0]
[[object]]
name = "pot"
material = "rubber"
rigid = true
shape = { box = [["11 cm", "4 cm", "8 cm"], ["19 cm", "12 cm", "13 cm"]] }
velocity = [0, 0, -1]
angular_velocity = [0, 4, 3]
[[object]]
name = "tree"
material = "rubber"
shape = { box = [["13 cm", "6 cm", "10 cm"], ["17 cm", "10 cm", "21 cm"]] }
velocity = [0, 0, -1]
pinned = { box = [["12 cm", "5 cm", "9 cm"], ["18 cm", "11 cm", "13.5 cm"]], to = "pot" }
region = [{ material = "gum", box = [[0, 0, 0], ["32 cm", "8 cm", "16 cm"]] }]
"""
SCENES = {"colliders": ROOM + COLLIDERS.replace("AXLE", AXLE), "body": ROOM + BODY}


@pytest.fixture(scope="module", params=list(SCENES))
def one(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp("pinned")
    return run_on_one_rank(folder, SCENES[request.param])


@RANKS_AND_THREADS
def test_any_ranks_and_threads(one, tmp_path, start, ranks, flags):
    assert_same_files(*one, tmp_path / "out", start, ranks, *flags)


def test_a_restart(one, tmp_path):
    assert_same_after_stop(*one, tmp_path / "out", 40)

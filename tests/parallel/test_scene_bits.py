"""Scenes with one feature each have the same bits in every file for any number of ranks and
threads, and after a restart while the feature acts.
"""

import pytest

from tests.support.file_digests import (
    RANKS_AND_THREADS,
    assert_same_after_stop,
    assert_same_files,
    digests,
    frame_digests,
    run_on_one_rank,
)
from tests.support.simulated_runs import run_here
from tests.support.small_scenes import MIXED, SHARED, every_law, write

SINGLE = MIXED.replace("PRECISION", "single")
# free rigid bodies that touch water, each other and a wall
FREE_BODIES = """
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
# added to these: a motor, a spring and a hinge with limits
JOINTS = """
[[joint]]
kind = "hinge"
between = ["ball"]
at = ["9 cm", "8 cm", "13.5 cm"]
axis = "y"
motor = { speed = "300 rpm", torque = 0.5 }
[[joint]]
kind = "spring"
between = ["crate", "ball"]
at = ["22 cm", "8 cm", "6 cm"]
to = ["13 cm", "8 cm", "13 cm"]
stiffness = 500
damping = 2
[[joint]]
name = "lid"
kind = "hinge"
between = ["lid", "crate"]
at = ["23 cm", "8 cm", "7 cm"]
axis = "y"
limits = ["-1 deg", "90 deg"]
[[probe]]
name = "lid"
sampling_interval = "2 ms"
joint = "lid"
"""
# bodies without particles of a phase, which touch each other, a collider and a wall
BODIES_ALONE = """
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
# thin walls, one of which is carried through water while water falls over its rim
THIN_WALLS = """
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
# a body with regions of other materials
REGIONS = """
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
# pinned parts that let go
RELEASED_PINS = """
[domain]
size = ["32 cm", "16 cm", "24 cm"]
cell = "2 cm"
[time]
end = "60 ms"
frames = 3
[material.rubber]
kind = "elastic"
density = 1100
youngs_modulus = "100 kPa"
friction = 0.3
[[object]]
name = "whip"
material = "rubber"
shape = { box = [["20 cm", "4 cm", "4 cm"], ["26 cm", "10 cm", "20 cm"]] }
[[object.pinned]]
box = [[0.19, 0.03, 0.03], [0.27, 0.11, 0.08]]
motion = { velocity = [-1, 0, 0] }
release_time = "21 ms"
[[object.pinned]]
box = [[0.19, 0.03, 0.16], [0.27, 0.11, 0.21]]
release_time = "33 ms"
[[object]]
name = "block"
material = "rubber"
shape = { box = [["6 cm", "4 cm", 0], ["14 cm", "12 cm", "8 cm"]] }
[[probe]]
name = "grip"
sampling_rate = 100
collider = "whip"
"""
DAMPING = """
[[load]]
object = ["ball", "pool"]
damping = "25 1/s"
ramp_time = "10 ms"
start_time = "5 ms"
end_time = "37 ms"
"""
# a liquid that sticks to bodies or slips on colliders
SLIP = """
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
STICKY_BODY = """
[[object]]
name = "ball"
material = "wood"
rigid = true
slip_length = 0
shape = { sphere = { center = ["12 cm", "8 cm", "12 cm"], radius = "4 cm" } }
velocity = [0, 0, -1]
angular_velocity = [0, 9, 3]
"""
STICKY_SOLID = STICKY_BODY.replace("rigid = true\n", "")
ASKED_FIELDS = '[output]\nfields = ["J", "stress", "pressure", "strain"'
SCENES = {
    "free bodies": FREE_BODIES,
    "joints": FREE_BODIES + JOINTS,
    "bodies alone": BODIES_ALONE,
    "thin walls": THIN_WALLS,
    "regions": REGIONS,
    "released pins": RELEASED_PINS,
    "damping": SINGLE + DAMPING,
    "dilatation": SINGLE.replace("[accuracy]\n", '[accuracy]\ndilatation = "cells"\n'),
    "slip on a collider": SLIP,
    "slip on a body": SLIP + STICKY_BODY,
    "slip on a solid": SLIP + STICKY_SOLID,
    "slip on a solid alone": SLIP[: SLIP.index('[[object]]\nname = "floor"')] + STICKY_SOLID,
    "fields of laws": every_law("single") + ASKED_FIELDS + "]\ncheckpoint_interval_steps = 40\n",
    "fields": SHARED.replace("PRECISION", "single").replace(
        "[output]\n", ASKED_FIELDS + ', "volume_fraction"]\n'
    ),
}
STOPS = [  # steps: before the first release of pins, between two, after both; others between sorts
    ("bodies alone", 40), ("bodies alone", 120), ("damping", 17), ("dilatation", 31),
    ("fields", 31), ("free bodies", 17), ("joints", 17), ("regions", 17), ("released pins", 8),
    ("released pins", 20), ("released pins", 34), ("slip on a collider", 17),
    ("slip on a body", 17), ("slip on a solid", 17), ("slip on a solid alone", 17),
    ("thin walls", 17),
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


@on("dilatation")
def test_the_dilatation_by_cells_is_another_motion(one, tmp_path):
    """A scene without the key gives other frames: what is compared above is the dilatation's."""
    run_here(write(tmp_path, SINGLE), tmp_path / "plain", 1)
    plain, cells = frame_digests(digests(tmp_path / "plain")), frame_digests(one[1])
    assert plain.keys() == cells.keys() and plain != cells


@on(slow("fields of laws"), "fields")
def test_the_fields_are_in_the_files(one):
    names = {name.rpartition("/")[2] for name in one[1] if "frame_00001" in name}
    assert {"stress", "pressure", "strain"} <= names

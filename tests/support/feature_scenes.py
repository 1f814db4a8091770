"""Scenes with one feature each, for tests of the same bits."""

from tests.support.small_scenes import MIXED, SHARED, every_law


def room(size, end, boundary="", cell="1 cm", frames=3):
    """Return the tables [domain] and [time] of a scene."""
    walls = f"boundary = {boundary}\n" if boundary else ""
    return f"""
[accuracy]
pressure = "explicit"
[domain]
size = [{size}]
cell = "{cell}"
{walls}[time]
end = "{end}"
frames = {frames}
"""


SINGLE, DOUBLE = (MIXED.replace("PRECISION", word) for word in ("single", "double"))
RUBBING_FLOOR = '{ default = "slip", bottom = { kind = "separate", friction = 0.4 } }'
# free rigid bodies that touch water, each other and a wall
FREE_BODIES = (
    room('"32 cm", "16 cm", "24 cm"', "60 ms", RUBBING_FLOOR, frames=4)
    + """
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
)
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
BODIES_ALONE = (
    room('"32 cm", "16 cm", "24 cm"', "300 ms", frames=4)
    + """
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
)
# thin walls, one of which is carried through water while water falls over its rim
THIN_WALLS = (
    room('"24 cm", "16 cm", "20 cm"', "60 ms")
    + """
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
)
# a body with regions of other materials
REGIONS = (
    room('"32 cm", "24 cm", "24 cm"', "20 ms")
    + """
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
)
# pinned parts that let go
RELEASED_PINS = (
    room('"32 cm", "16 cm", "24 cm"', "60 ms", cell="2 cm")
    + """
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
)
DAMPING = """
[[load]]
object = ["ball", "pool"]
damping = "25 1/s"
ramp_time = "10 ms"
start_time = "5 ms"
end_time = "37 ms"
"""
# a liquid that sticks to bodies or slips on colliders
SLIP = (
    room('"24 cm", "16 cm", "20 cm"', "30 ms")
    + """
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
)
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
# pinned parts that the world, a collider that turns and a rigid body in water hold, also across
# regions of other materials
RUBBER_AND_GUM = (
    room('"32 cm", "16 cm", "24 cm"', "60 ms")
    + """
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
)
AXLE = 'endpoints = [["10 cm", "6 cm", "12 cm"], ["10 cm", "10 cm", "12 cm"]]'
PINNED_TO_COLLIDERS = """
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
""".replace("AXLE", AXLE)
PINNED_TO_BODY = """
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
# bodies that leave walls without a kind
LEFT_WALLS = """
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
# a maker of waves and a beach
WAVE_ZONES = """
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
    "pins on colliders": RUBBER_AND_GUM + PINNED_TO_COLLIDERS,
    "pins on a body": RUBBER_AND_GUM + PINNED_TO_BODY,
    "walls without a kind": LEFT_WALLS,
    "wave zones": DOUBLE + WAVE_ZONES,
    "fields of laws": every_law("single") + ASKED_FIELDS + "]\ncheckpoint_interval_steps = 40\n",
    "fields": SHARED.replace("PRECISION", "single").replace(
        "[output]\n", ASKED_FIELDS + ', "volume_fraction"]\n'
    ),
}

"""Spoiled scenes of rigid bodies, joints, slip lengths, regions, pinned parts and thin walls
through --check and --plan."""

from pathlib import Path

from tests.campaigns import scenes
from tests.campaigns.result import Result
from tests.campaigns.spoiled import Spoiler
from tests.scene import (
    test_joint_tables,
    test_pinned_tables,
    test_regions,
    test_rigid_objects,
    test_slip_length,
    test_thin_keys,
)

NAME = "rigid"
COUNT = 2000
SMALL = 200

# a slider, a ball and a fixed joint, two bodies that touch a collider, and probes of all
WORKSHOP = """
[accuracy]
pressure = "explicit"
[domain]
size = ["40 cm", "40 cm", "40 cm"]
cell = "2 cm"
boundary = { default = "slip", bottom = { kind = "separate", friction = 0.4 } }
[time]
end = "0.2 s"
frames = 3
[material.honey]
kind = "fluid"
preset = "honey"
[material.oak]
kind = "elastic"
density = 700
youngs_modulus = "1 MPa"
[material.iron]
kind = "elastic"
density = "7.8 g/cm3"
youngs_modulus = "10 MPa"
[[object]]
name = "pool"
material = "honey"
shape = { box = [[0, 0, 0], [0.4, 0.4, 0.1]] }
[[object]]
name = "floor"
role = "scenery"
collider = true
slip_length = 0
motion = { keyframes = [{ time = "0.1 s", translation = [0, 0, 0.01] }] }
shape = { box = [[0, 0, -0.1], [0.4, 0.4, 0.03]] }
[[object]]
name = "hammer"
material = "oak"
shape = { box = [[0.1, 0.18, 0.2], [0.3, 0.24, 0.26]] }
[[object.region]]
material = "iron"
cylinder = { endpoints = [[0.26, 0.1, 0.23], [0.26, 0.3, 0.23]], radius = "4 cm" }
color = "#606468"
[[object]]
name = "ball"
material = "iron"
rigid = true
restitution = 0.5
slip_length = "1 mm"
velocity = [0, 0, "-1 m/s"]
angular_velocity = ["60 rpm", 0, 0]
shape = { sphere = { center = [0.1, 0.1, 0.2], radius = "5 cm" } }
[[object]]
name = "arm"
material = "oak"
rigid = true
shape = { capsule = { endpoints = [[0.1, 0.1, 0.3], [0.3, 0.1, 0.3]], radius = "3 cm" } }
[[object]]
name = "weight"
material = "oak"
rigid = true
shape = { box = [[0.28, 0.28, 0.15], [0.36, 0.36, 0.23]] }
[[joint]]
name = "rail"
kind = "slider"
between = ["weight", "floor"]
at = [0.32, 0.32, 0.19]
axis = [0, 0, 1]
limits = ["-5 cm", "5 cm"]
motor = { speed = "10 cm/s", force = "5 N" }
[[joint]]
name = "shoulder"
kind = "ball"
between = ["arm", "ball"]
at = [0.1, 0.1, 0.27]
[[joint]]
kind = "fixed"
between = "arm"
at = [0.3, 0.1, 0.3]
[[joint]]
name = "string"
kind = "spring"
between = ["arm", "weight"]
at = [0.3, 0.1, 0.3]
to = [0.32, 0.32, 0.23]
stiffness = "50 N/m"
damping = 0.1
rest = "10 cm"
[[probe]]
name = "rail"
sampling_rate = 100
joint = "rail"
[[probe]]
name = "drag"
sampling_rate = 100
collider = "floor"
"""


def bases() -> list[str]:
    """Good scenes, with coarse cells."""
    modules = (
        test_rigid_objects, test_joint_tables, test_slip_length, test_regions, test_pinned_tables,
        test_thin_keys,
    )  # fmt: skip
    return [m.SCENE.replace("cell = 0.01", "cell = 0.02") for m in modules] + [WORKSHOP]


def campaign(count: int, seed: int, folder: Path) -> Result:
    """count: of scenes. Those that fail stay in the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    return scenes.spoiled_scenes(Spoiler(bases(), scenes.keys()), count, seed, folder)

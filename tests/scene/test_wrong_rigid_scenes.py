"""Wrong scenes of rigid bodies, joints, slip lengths, regions, pinned parts and thin walls: one
line for each mistake, with the number of the line where the key stands, or of the table that
lacks it.

The scenes are those of the modules that say what is refused, and CHANGES below.
"""

import re

import pytest

import vgmpi
from tests.scene import test_joint_tables as joints
from tests.scene import test_pinned_tables as pinned
from tests.scene import test_regions as regions
from tests.scene import test_rigid_objects as rigid
from tests.scene import test_slip_length as slip
from tests.scene import test_thin_keys as thin
from vgmpi.runtime.config.schema import SceneError

POINT, AXIS, MOTOR = (
    "at = [0.2, 0.1, 0.2]",
    'axis = "y"',
    'motor = { speed = "60 rpm", torque = 2 }',
)
THREE_NUMBERS = "axle.axis: must be 'x', '-x', 'y', '-y', 'z', '-z' or three numbers"
NAME = "name: must begin with a letter"
# scene, old text, new text, what the message says
CHANGES = [
    (joints, joints.PAIR, "between = 3", "axle.between: must be a list; got 3"),
    (joints, joints.PAIR, 'between = ["wheel", 4]', "axle.between.1: must be a text; got 4"),
    (joints, joints.PAIR, "between = { a = 1 }", "axle.between: must be a list"),
    (joints, joints.PAIR, 'between = ["a", "b", "c"]', "axle.between: must have at most 2 values"),
    (joints, POINT, "at = [0.2, 0.1]", "axle.at: has too few values"),
    (joints, POINT, "at = [nan, 0.1, 0.2]", "axle.at.0: must be finite; got nan"),
    (joints, POINT, "at = [1e200, 0, 0]", "axle.at.0: must be 0 or from 1e-100 to 1e+100 in size"),
    (joints, POINT, 'at = ["1 kg", 0, 0]', "axle.at.0: 'kg' does not measure a length"),
    (joints, POINT, "at = 0.2", "axle.at: must be a list; got 0.2"),
    (joints, POINT, "", "axle.at: required key is missing: point of the joint at the start"),
    (joints, AXIS, 'axis = "w"', THREE_NUMBERS),
    (joints, AXIS, "axis = [nan, 0, 1]", THREE_NUMBERS),
    (joints, AXIS, "axis = [1, 0]", THREE_NUMBERS),
    (joints, joints.LIMITS, "limits = [nan, 1]", "axle.limits.0: must be finite; got nan"),
    (joints, joints.LIMITS, 'limits = "30 deg"', "axle.limits: must be a list"),
    (joints, joints.LIMITS, "limits = [0, 0]", "axle.limits: must be [low, high]"),
    (joints, joints.LIMITS, "limits = [-1, 0, 1]", "axle.limits: must have at most 2 values"),
    (joints, MOTOR, "motor = 3", "axle.motor: must be a table of keys; got 3"),
    (joints, MOTOR, "motor = { torque = 2 }", "axle.motor.speed: required key is missing"),
    (joints, '"60 rpm"', "nan", "axle.motor.speed: must be finite; got nan"),
    (joints, '"60 rpm"', "1e300", "axle.motor.speed: must be 0 or from 1e-100 to 1e+100 in size"),
    (joints, "torque = 2", "torque = inf", "axle.motor.torque: must be > 0 N m; got inf"),
    (joints, "stiffness = 50", "stiffness = nan", "joint.1.stiffness: must be > 0 N/m; got nan"),
    (joints, "stiffness = 50", "stiffness = 1e300", "joint.1.stiffness: must be from 1e-100"),
    (joints, "stiffness = 50", "stiffness = 50\ndamping = -1", "joint.1.damping: must be >= 0"),
    (joints, "stiffness = 50", "stiffness = 50\nrest = inf", "joint.1.rest: must be > 0 m"),
    (joints, 'name = "axle"', 'name = ""', f"joint..{NAME}"),
    (joints, 'name = "axle"', "name = 3", f"joint.0.{NAME}"),
    (joints, 'name = "axle"', 'nmae = "axle"', "joint.0.nmae: unknown key (did you mean 'name'?)"),
    (joints, "[[joint]]\nkind", "[[joint]]\nangle = 3\nkind", "joint.1.angle: unknown key"),
    (rigid, "rigid = true", "rigid = 1", "log.rigid: must be true or false; got 1"),
    (rigid, "rigid = true", 'rigid = "yes"', "log.rigid: must be true or false; got 'yes'"),
    (rigid, "rigid = true", "rgid = true", "log.rgid: unknown key (did you mean 'rigid'?)"),
    (rigid, rigid.LOG, f"{rigid.LOG}restitution = nan\n", "log.restitution: must be >= 0 and <= 1"),
    (rigid, rigid.LOG, f'{rigid.LOG}restitution = "high"\n', "log.restitution: expected a number"),
    (rigid, rigid.LOG, f"{rigid.LOG}friction = 1\n", "log.friction: is only for scenery"),
    (rigid, rigid.LOG, f"{rigid.LOG}collider = true\n", "log.collider: is only for role"),
    (rigid, rigid.LOG, f"{rigid.LOG}collider = 1\n", "log.collider: must be true or false; got 1"),
    (rigid, rigid.LOG, f"{rigid.LOG}velocity = [1, 2]\n", "log.velocity: has too few values"),
    (rigid, rigid.LOG, f"{rigid.LOG}velocity = [nan, 0, 0]\n", "log.velocity.0: must be finite"),
    (rigid, rigid.LOG, f'{rigid.LOG}angular_velocity = ["3 m", 0, 0]\n',
     "log.angular_velocity.0: 'm' does not measure a turning speed"),
    (rigid, rigid.LOG, f'{rigid.LOG}prune = "auto"\n', "log.prune: is only for objects made of"),
    (rigid, rigid.LOG, f"{rigid.LOG}passive_gaussians = true\n",
     "log.passive_gaussians: needs prune"),
    (rigid, rigid.LOG, f'{rigid.LOG}initial_pressure = "hydrostatic"\n',
     "log.initial_pressure: is not for rigid bodies"),
    (rigid, rigid.LOG, f"{rigid.LOG}opacity_scale = 0.5\n", "log.opacity_scale: is only for"),
    (rigid, 'material = "oak"\n', "", "log.material: required key is missing"),
    (rigid, '"oak"\nrigid', '"okk"\nrigid', "log.material: there is no [material.okk]"),
    (rigid, "density = 700", "density = nan", "material.oak.density: must be > 0 kg/m3; got nan"),
    (rigid, "radius = 0.04", "radius = -1", "log.shape.sphere.radius: must be > 0 m"),
    (slip, '"1 mm"', "nan", "floor.slip_length: must be >= 0 m; got nan"),
    (slip, '"1 mm"', "inf", "floor.slip_length: must be >= 0 m; got inf"),
    (slip, '"1 mm"', "true", "floor.slip_length: expected a number [m]"),
    (slip, '"1 mm"', "[1]", "floor.slip_length: expected a number [m]"),
    (slip, '"1 mm"', '"10 %"', "floor.slip_length: '%' does not measure a length"),
    (pinned, "[0.08, 0.2, 0.2]]", "[0.08, 0.2]]", "beam.pinned.box.1: has too few values"),
    (pinned, "[0.08, 0.2, 0.2]]", "[nan, 0.2, 0.2]]", "beam.pinned.box.1.0: must be finite; got"),
    (pinned, "pinned =", "pined =", "beam.pined: unknown key (did you mean 'pinned'?)"),
    (pinned, 'to = "wall"', 'too = "wall"', "beam.pinned.too: unknown key (did you mean 'to'?)"),
    (thin, "thin = true", 'thin = "yes"', "plate.thin: must be true or false"),
    (thin, "thin = true", "thin = 1", "plate.thin: must be true or false"),
    (thin, "thin = true", "thinn = true", "plate.thinn: unknown key (did you mean 'thin'?)"),
    (thin, "thin = true", "thin = []", "plate.thin: must be true or false"),
    (slip, "slip_length", "slip_lenght", "floor.slip_lenght: unknown key (did you mean 'slip_leng"),
]  # fmt: skip
MODULES = rigid, joints, slip, regions, pinned, thin
TABLES = [(module, *change) for module in MODULES for change in module.WRONG]
# changes with more than one mistake, as keys of another kind of joint, of scenery, another motor
SEVERAL = (
    "axle.motor: unknown key",
    "axle.limits: unknown key",
    "axle.limits.0: 'deg'",
    "axle.motor.force: unknown key",
    "object.pool.rigid: is not for scenery",
    "object.beam.pinned: is not for accuracy",  # nor is the boat
    "object.wall.pinned: is not for scenery",
)


def number_of(text: str, path: str) -> int:
    """Number of the line of a key, such as joint.axle.between.1, or of what it would be in."""
    numbers, table, counts, index = {(): 1}, (), {}, -1
    for k, line in enumerate(text.splitlines(), 1):
        if header := re.fullmatch(r"(\[+)([\w.]+)\]+", line):
            table = tuple(header[2].split("."))
            if header[1] == "[[":
                above = (*table[:-1], str(index)) if len(table) > 1 else ()
                count = counts[above, table] = counts.get((above, table), -1) + 1
                index = count if len(table) == 1 else index
                table = (*above, table[-1], str(count))
            numbers.setdefault(table[:-1], k)
            numbers[table] = k
        elif key := re.match(r"(\w+) *=", line):
            numbers[(*table, key[1])] = k
            if key[1] == "name" and len(table) == 2:
                value = line.split("=")[1].strip().strip('"')
                counts["name", table[0], value] = table
    parts = tuple(path.split("."))
    table = counts.get(("name", *parts[:2]), parts[:2])
    while (*table, *parts[2:]) not in numbers:
        table, parts = (table, parts[:-1]) if len(parts) > 2 else (table[:-1], parts)
    return numbers[(*table, *parts[2:])]


@pytest.mark.parametrize(("module", "old", "new", "message"), CHANGES + TABLES)
def test_each_mistake_has_one_line_at_its_place(tmp_path, module, old, new, message):
    assert module.SCENE.count(old) >= 1
    text = module.SCENE.replace(old, new, 1)
    with pytest.raises(SceneError) as error:
        vgmpi.plan(vgmpi.load(tmp_path / "scene.toml", text=text))
    lines = str(error.value).splitlines()
    if not message.startswith(SEVERAL):
        assert len(lines) == 1, lines
    for line in lines:
        assert "\\n" not in line
        place, path, _ = line.split("scene.toml:")[1].split(": ", 2)
        assert int(place) == number_of(text, path), (line, text)
    assert any(message in line for line in lines), lines

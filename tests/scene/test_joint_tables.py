"""Joints in scenes: what is refused, with its line, and what is warned of."""

import logging

import pytest

import vgmpi
from vgmpi.planning.cost.plan_report import format_plan
from vgmpi.runtime.config.schema import SceneError
from vgmpi.scene.resume_rules import forbidden_changes

SCENE = """
[domain]
size = [0.6, 0.2, 0.4]
cell = 0.01
[time]
end = 0.1
[material.water]
kind = "fluid"
[material.oak]
kind = "elastic"
density = 700
youngs_modulus = 1e6
[[object]]
name = "pool"
material = "water"
shape = { box = [[0, 0, 0], [0.6, 0.2, 0.05]] }
[[object]]
name = "post"
role = "scenery"
collider = true
shape = { box = [[0, 0, 0.05], [0.06, 0.2, 0.4]] }
[[object]]
name = "picture"
role = "scenery"
shape = { box = [[0, 0, 0.05], [0.05, 0.2, 0.4]] }
[[object]]
name = "wheel"
material = "oak"
rigid = true
shape = { sphere = { center = [0.2, 0.1, 0.2], radius = 0.06 } }
[[object]]
name = "cart"
material = "oak"
rigid = true
shape = { box = [[0.3, 0.05, 0.15], [0.5, 0.15, 0.25]] }
[[joint]]
name = "axle"
kind = "hinge"
between = ["wheel", "cart"]
at = [0.2, 0.1, 0.2]
axis = "y"
limits = ["-30 deg", "30 deg"]
motor = { speed = "60 rpm", torque = 2 }
[[joint]]
kind = "spring"
between = "cart"
at = [0.4, 0.1, 0.25]
to = [0.4, 0.1, 0.4]
stiffness = 50
"""
LIMITS = 'limits = ["-30 deg", "30 deg"]'
PAIR = 'between = ["wheel", "cart"]'
MOTOR = "motor = { speed = "
AGAIN = (
    '[[joint]]\nkind = "{}"\nbetween = ["cart", "wheel"]\nat = {}\n{}\n[[joint]]\nkind = "spring"'
)
SPRING = '[[joint]]\nkind = "spring"'
WRONG = [
    (PAIR, 'between = ["wheel", "pool"]', "axle.between.1: 'pool' is no rigid body"),
    (PAIR, 'between = ["wheel", "picture"]', "axle.between.1: 'picture' is no rigid body"),
    (PAIR, 'between = ["wheel", "cat"]', "axle.between.1: there is no object 'cat' (did you mean"),
    (PAIR, 'between = ["wheel", "wheel"]', "axle.between: names 'wheel' twice"),
    (PAIR, 'between = ["post"]', "axle.between: names no free body"),
    (PAIR, "between = []", "axle.between: "),
    (PAIR, 'between = ["wheel", "cart", "post"]', "axle.between: "),
    (PAIR, "", "axle.between: required key is missing"),
    ('axis = "y"', "", "axle.axis: required key is missing"),
    ('axis = "y"', "axis = [0, 0, 0]", "axle.axis: must be 'x'"),
    ('kind = "hinge"', 'kind = "hing"', "axle.kind: must be one of hinge, ball, slider"),
    ('kind = "hinge"', "", "axle.kind: required key is missing"),
    ('kind = "hinge"', 'kind = "ball"', "axle.motor: unknown key"),
    ('kind = "hinge"', 'kind = "fixed"', "axle.limits: unknown key"),
    ('kind = "hinge"', 'kind = "slider"', "axle.limits.0: 'deg' does not measure a length"),
    (LIMITS, 'limits = ["30 deg", "-30 deg"]', "axle.limits: must be [low, high] with low < high"),
    (LIMITS, 'limits = ["3 deg", "30 deg"]', "axle.limits: must contain 0"),
    (LIMITS, "limits = [-1]", "axle.limits: has too few values"),
    ("torque = 2", "force = 2", "axle.motor.force: unknown key; known here: speed, torque"),
    ("torque = 2", "torque = -2", "axle.motor.torque: must be > 0 N m"),
    ("torque = 2", 'torque = "2 N"', "axle.motor.torque: 'N' does not measure a torque"),
    ('"60 rpm"', '"60 m/s"', "axle.motor.speed: 'm/s' does not measure a turning speed"),
    ("stiffness = 50", "stiffness = 0", "joint.1.stiffness: must be > 0 N/m"),
    ("stiffness = 50", "", "joint.1.stiffness: required key is missing"),
    ("stiffness = 50", "stiffness = 50\nrest = -1", "joint.1.rest: must be > 0 m"),
    ("to = [0.4, 0.1, 0.4]", "to = [0.4, 0.1, 0.25]", "joint.1.to: is the same point as at"),
    (SPRING, '[[joint]]\nname = "axle"\nkind = "spring"', "joint.axle.name: is taken"),
    (
        SPRING,
        AGAIN.format("hinge", "[0.2, 0.2, 0.2]", 'axis = "-y"'),
        "joint.1: joint 'axle' (",
    ),
    (SPRING, AGAIN.format("ball", "[0.2, 0.05, 0.2]", ""), "holds the same bodies in the same way"),
    (SPRING, AGAIN.format("fixed", "[0.4, 0.1, 0.2]", ""), "holds the same bodies in the same way"),
]


PROBE = '[[probe]]\nname = "p"\nsampling_rate = 100\njoint = "{}"\n'
WRONG += [(SPRING, PROBE.format("axel") + SPRING, "probe.p.joint: there is no joint 'axel' (did")]


def load(folder, text):
    return vgmpi.load(folder / "scene.toml", text=text)


@pytest.mark.parametrize(("old", "new", "message"), WRONG)
def test_what_is_refused(tmp_path, old, new, message):
    assert SCENE.count(old) >= 1
    with pytest.raises(SceneError) as error:
        load(tmp_path, SCENE.replace(old, new, 1))
    assert message in str(error.value)
    for line in str(error.value).splitlines():
        number = int(line.split("scene.toml:")[1].split(":")[0])
        assert number >= SCENE[: SCENE.index('name = "axle"')].count("\n"), line


@pytest.mark.parametrize(
    ("kind", "point", "more"),
    [
        ("hinge", "[0.2, 0.1, 0.3]", 'axis = "y"'),
        ("hinge", "[0.2, 0.1, 0.2]", 'axis = "z"'),
        ("ball", "[0.25, 0.1, 0.2]", ""),
        ("slider", "[0.2, 0.1, 0.2]", 'axis = "y"'),
    ],
)
def test_joints_that_add_something_are_accepted(tmp_path, kind, point, more):
    scene = load(tmp_path, SCENE.replace(SPRING, AGAIN.format(kind, point, more), 1))
    assert len(scene.lists["joint"]) == 3


def test_the_plan_names_them(tmp_path):
    scene = load(tmp_path, SCENE)
    report = format_plan(scene, vgmpi.plan(scene), ranks=1)
    assert "  joints      hinge of wheel and cart, spring of cart" in report


def test_a_resumed_run_keeps_its_joints(tmp_path):
    scene = load(tmp_path, SCENE)
    assert forbidden_changes(scene, scene.to_json()) == []
    softer = load(tmp_path, SCENE.replace("stiffness = 50", "stiffness = 40"))
    changes = forbidden_changes(softer, scene.to_json())
    assert [path for path, _ in changes] == [("joint", 1, "stiffness")]
    plain = load(tmp_path, SCENE[: SCENE.index("[[joint]]")])
    assert "joint" not in plain.to_json() and forbidden_changes(plain, plain.to_json()) == []
    assert forbidden_changes(scene, plain.to_json()) != []


def test_units_and_defaults(tmp_path):
    axle, spring = load(tmp_path, SCENE).lists["joint"]
    assert axle.motor.speed == pytest.approx(6.2831853)
    assert axle.limits == pytest.approx((-0.5235988, 0.5235988))
    assert spring.between == ("cart",) and spring.rest is None and spring.damping == 0.0


def test_a_point_far_from_both_bodies_is_warned_of(tmp_path, caplog):
    from vgmpi.preprocess.scene_builder import build_scene

    with caplog.at_level(logging.WARNING, "vgmpi"):
        build_scene(load(tmp_path, SCENE))
        assert "joint" not in caplog.text
        build_scene(load(tmp_path, SCENE.replace("at = [0.2, 0.1, 0.2]", "at = [0.2, 3, 0.2]")))
    assert "joint 'axle' is 2.84 m from the nearest of its bodies" in caplog.text


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('name = "axle"\nkind = "hinge"', 'name = "axle"\nkind = "hing"'),
        ('name = "axle"', 'nmae = "axle"'),
        ("stiffness = 50", "stiffness = -50"),  # of a joint without a name
        (SPRING, '[[joint]]\nkind = "spring"\nbetween = 3\n' + SPRING),
    ],
)
def test_a_probe_of_joints_one_of_which_is_wrong_gives_no_line_of_its_own(tmp_path, old, new):
    text = SCENE.replace(old, new, 1) + PROBE.format("axle" if "nmae" in new else "spoke")
    with pytest.raises(SceneError) as error:
        load(tmp_path, text)
    assert "there is no joint" not in str(error.value)


def test_joints_that_are_no_list_give_one_line(tmp_path):
    text = "joint = 3\n" + SCENE[: SCENE.index("[[joint]]")] + PROBE.format("axle")
    with pytest.raises(SceneError) as error:
        load(tmp_path, text)
    (line,) = str(error.value).splitlines()
    assert "scene.toml:1: joint: must be a list of tables: [[joint]]" in line

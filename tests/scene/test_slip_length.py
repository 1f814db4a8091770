"""Slip lengths in scenes: what is refused, with its line."""

import pytest

import vgmpi
from vgmpi.features.surface_slip.plan import SurfaceSlipPlan
from vgmpi.planning.cost.plan_report import format_plan
from vgmpi.runtime.config.schema import SceneError

SCENE = """
[domain]
size = [0.2, 0.2, 0.2]
cell = 0.01
[time]
end = 0.1
[accuracy]
transfer = "apic-corrected"
[material.honey]
kind = "fluid"
viscosity = 10
[material.grains]
kind = "sand"
[[object]]
name = "pool"
material = "honey"
shape = { box = [[0, 0, 0.05], [0.2, 0.2, 0.1]] }
[[object]]
name = "floor"
role = "scenery"
collider = true
slip_length = "1 mm"
shape = { box = [[0, 0, -0.1], [0.2, 0.2, 0.05]] }
"""
KEY = "object.floor.slip_length"
PASTE = 'kind = "paste"\npreset = "jam"'
BODY = 'role = "scenery"\ncollider = true\n'
SOLID = 'material = "gel"\n'
RUB = """slip_length = "1 mm"
shape = { box = [[0, 0, 0], [0.2, 0.2, 0.05]] }
[material.gel]
kind = "elastic"
youngs_modulus = 1e5
[[coupling]]
kind = "contact"
between = ["honey", "gel"]
friction = 0.3
[[object]]
name = "stand"
role = "scenery"
collider = true
"""
WRONG = [
    ('"1 mm"', '"-1 mm"', f"{KEY}: must be >= 0 m"),
    ('"1 mm"', '"1 kg"', f"{KEY}: "),
    ("collider = true\n", "",
     f"{KEY}: is only for bodies of solids and scenery with collider = true"),
    ('material = "honey"', 'material = "honey"\nslip_length = 0',
     "object.pool.slip_length: is only for bodies of solids and colliders: kind 'fluid' is none"),
    (BODY, SOLID + RUB,
     f"{KEY}: the coupling of 'honey' and 'gel' has friction: give one of the two"),
    ("collider = true", "collider = true\nfriction = 0.1",
     f"{KEY}: friction and slip_length given at once: give one"),
    ("viscosity = 10\n", "", f"{KEY}: needs a liquid with viscosity; the scene has none"),
    ('kind = "fluid"\nviscosity = 10', PASTE, f"{KEY}: must be 0 for kind 'paste'"),
    ("apic-corrected", "aflip", f'{KEY}: is not for accuracy.transfer = "aflip"'),
    (
        '[[object]]\nname = "floor"',
        '[[coupling]]\nkind = "drag"\nbetween = ["honey", "grains"]\nhydraulic_conductivity = 0.1\n'
        '[[object]]\nname = "heap"\nmaterial = "grains"\n'
        'shape = { box = [[0, 0, 0.1], [0.1, 0.1, 0.15]] }\n[[object]]\nname = "floor"',
        f"{KEY}: is not for scenes in which materials mix or flow through sand",
    ),
]  # fmt: skip


@pytest.mark.parametrize(("old", "new", "message"), WRONG)
def test_what_is_refused(tmp_path, old, new, message):
    assert SCENE.count(old) >= 1
    with pytest.raises(SceneError) as error:
        vgmpi.load(tmp_path / "scene.toml", text=SCENE.replace(old, new, 1))
    assert message in str(error.value)
    assert "scene.toml:" in str(error.value)


def test_liquids_stick_to_solids(tmp_path):
    """The table is symmetric; who is no liquid or has no slip length slips freely."""
    solid = RUB.replace("friction = 0.3", "friction = 0")
    text = SCENE.replace(BODY + 'slip_length = "1 mm"\n', SOLID + solid, 1)
    plan = vgmpi.plan(vgmpi.load(tmp_path / "scene.toml", text=text))
    names = [phase.name for phase in plan.phases]
    gel, honey = names.index("floor"), names.index("fluid")
    slip = plan.feature(SurfaceSlipPlan)
    lengths = slip.on_solids.lengths
    assert lengths[gel][honey] == lengths[honey][gel] == 1e-3
    assert lengths[gel][gel] == lengths[honey][honey] == float("inf")
    assert slip.on_colliders is None


def test_paste_may_stick(tmp_path):
    text = SCENE.replace('kind = "fluid"\nviscosity = 10', PASTE).replace('"1 mm"', "0")
    plan = vgmpi.plan(vgmpi.load(tmp_path / "scene.toml", text=text))
    assert plan.feature(SurfaceSlipPlan).on_colliders.lengths == ((0.0,),)


@pytest.mark.parametrize(
    ("key", "line"),
    [
        (
            'slip_length = "1 mm"',
            "slip        floor: viscous liquids slip with a length of 0.001 m",
        ),
        ("slip_length = 0", "slip        floor: viscous liquids stick to it"),
        ("", "honey slips freely on floor; its boundary layer is 13 cells thick"),
    ],
)
def test_the_plan_tells_of_slip(tmp_path, key, line):
    scene = vgmpi.load(tmp_path / "s.toml", text=SCENE.replace('slip_length = "1 mm"', key))
    assert line in format_plan(scene, vgmpi.plan(scene), ranks=1)


@pytest.mark.parametrize("change", ["friction = 0.2", "# thin"])
def test_the_plan_is_silent_where_slip_is_as_expected(tmp_path, change):
    text = SCENE.replace('slip_length = "1 mm"', change)
    if change == "# thin":
        text = text.replace("viscosity = 10", "viscosity = 0.001")
    scene = vgmpi.load(tmp_path / "s.toml", text=text)
    report = format_plan(scene, vgmpi.plan(scene), ranks=1)
    assert "  slip  " not in report and "slips freely" not in report

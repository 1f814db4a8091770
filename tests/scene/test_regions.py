"""Regions of bodies in scenes: what is refused, with its line, and what --plan says."""

import logging

import numpy as np
import pytest

import vgmpi
from vgmpi.gaussians.spherical_harmonics import dc_from_rgb
from vgmpi.planning.cost.plan_report import format_plan
from vgmpi.planning.plan import time_step_bounds
from vgmpi.preprocess.scene_builder import build_scene
from vgmpi.runtime.config.schema import SceneError
from vgmpi.scene.resume_rules import changes_without_effect, forbidden_changes

SCENE = """
[domain]
size = [0.4, 0.2, 0.2]
cell = 0.02
[time]
end = 0.1
[material.oak]
kind = "elastic"
density = 700
youngs_modulus = 1e5
[material.iron]
kind = "elastic"
density = 2800
youngs_modulus = 1e7
[material.jelly]
kind = "corotated"
youngs_modulus = 1e4
[material.water]
kind = "fluid"
[material.oil]
kind = "fluid"
[[object]]
name = "pool"
material = "water"
shape = { box = [[0, 0, 0], [0.4, 0.2, 0.04]] }
[[object]]
name = "hammer"
material = "oak"
shape = { box = [[0.1, 0.08, 0.08], [0.3, 0.12, 0.12]] }
[[object.region]]
material = "iron"
box = [[0.26, 0, 0], [0.4, 0.2, 0.2]]
[[object.region]]
material = "iron"
sphere = { center = [0.14, 0.1, 0.1], radius = 0.03 }
"""
HAMMER = '"hammer"\n'
BOX, SPHERE = "box = [[0.26, 0, 0], [0.4, 0.2, 0.2]]", "sphere = { center = [0.14, 0.1, 0.1]"
KEY = "object.hammer.region"
FIRST = f'material = "iron"\n{BOX}'
MIXING = '[[coupling]]\nkind = "mixing"\nbetween = ["water", "oil"]\n[[object]]\nname = "pool"'
LIQUID = 'material = "oil"\nbox = [[0, 0, 0], [0.2, 0.2, 0.04]]\n'
POOL = f"[0.4, 0.2, 0.04]] }}\n[[object.region]]\n{LIQUID}"
WRONG = [
    (FIRST, f'material = "jelly"\n{BOX}',
     f"{KEY}.0.material: must be of kind 'elastic', as 'oak' of the object is;"
     " 'jelly' is of kind 'corotated'"),
    (FIRST, f'material = "water"\n{BOX}', f"{KEY}.0.material: must be of kind 'elastic'"),
    (FIRST, f'material = "irn"\n{BOX}',
     f"{KEY}.0.material: there is no [material.irn] (did you mean 'iron'?); defined are oak, "),
    (FIRST, BOX, f"{KEY}.0.material: required key is missing"),
    (FIRST, f"material = 3\n{BOX}", f"{KEY}.0.material: must be"),
    (FIRST, 'material = "iron"', f"{KEY}.0: has no form: give one of box, sphere,"),
    (FIRST, f"{FIRST}\n{SPHERE}, radius = 1 }}", f"{KEY}.0: has box and sphere: give exactly one"),
    (FIRST, f"{FIRST}\nyoungs_modulus = 3", f"{KEY}.0.youngs_modulus: unknown key"),
    ("[0.26, 0, 0]", "[0.46, 0, 0]", f"{KEY}.0.box: must be [[x0, y0, z0], [x1, y1, z1]]"),
    ("radius = 0.03", "radius = -1", f"{KEY}.1.sphere.radius: must be > 0 m"),
    ("radius = 0.03", "radius = nan", f"{KEY}.1.sphere.radius: must be"),
    (HAMMER, f"{HAMMER}rigid = true\n", f"{KEY}: is not for rigid bodies: they have no particles"),
    ('material = "oak"\nshape', 'role = "scenery"\ncollider = true\nshape',
     f"{KEY}: is not for scenery: it has no mass"),
    (HAMMER, f"{HAMMER}motion = {{ velocity = [1, 0, 0] }}\n",
     f"{KEY}: is not for a body with motion: all of it is one rigid body until it is let go"),
    (HAMMER, f"{HAMMER}release_time = 0.1\n", f"{KEY}: is not for a body with release_time: "),
    ("[0.4, 0.2, 0.04]] }\n", f"{POOL}initial_pressure = 1\n", "initial_pressure: unknown key"),
    ('"water"\nshape', '"water"\ninitial_pressure = "hydrostatic"\n'
     f"region = [{{ {LIQUID.replace(chr(10), ', ', 1).strip()} }}]\nshape",
     'object.pool.region: is not for a body with initial_pressure = "hydrostatic"'),
    ('[[object]]\nname = "pool"\nmaterial = "water"\n'
     "shape = { box = [[0, 0, 0], [0.4, 0.2, 0.04]] }",
     f'{MIXING}\nmaterial = "water"\nshape = {{ box = [[0, 0, 0], {POOL}',
     "object.pool.region.0.material: 'oil' mixes or flows through sand by a coupling: no body of"
     " it has regions"),
    ("[0.4, 0.2, 0.04]] }\n", "[0.4, 0.2, 0.04]] }\nregion = 3\n", "object.pool.region: must be"),
    ("[0.4, 0.2, 0.04]] }\n", "[0.4, 0.2, 0.04]] }\nregion = [3]\n",
     "object.pool.region.0: must be a table"),
    ("[0.4, 0.2, 0.04]] }\n", "[0.4, 0.2, 0.04]] }\nregion = { material = 'oil' }\n",
     "object.pool.region: has no form"),
]  # fmt: skip
UNBUILT = [
    ("radius = 0.03", "radius = 0.001", f"{KEY}.1.sphere: holds no particle of hammer at"),
    (f'{FIRST}\n[[object.region]]\nmaterial = "iron"\n{SPHERE}, radius = 0.03 }}',
     f'material = "iron"\n{SPHERE}, radius = 0.03 }}\n[[object.region]]\nmaterial = "oak"\n'
     "box = [[0, 0, 0], [0.3, 0.2, 0.2]]",
     f"{KEY}.0.sphere: holds no particle: later regions take all of them"),
]  # fmt: skip


def change(old, new):
    assert SCENE.count(old) >= 1
    return SCENE.replace(old, new, 1)


@pytest.mark.parametrize(("old", "new", "message"), WRONG)
def test_what_is_refused(tmp_path, old, new, message):
    with pytest.raises(SceneError) as error:
        vgmpi.load(tmp_path / "scene.toml", text=change(old, new))
    lines = str(error.value).splitlines()
    assert len(lines) == 1
    assert message in lines[0]
    assert "scene.toml:" in lines[0]


@pytest.mark.parametrize(("old", "new", "message"), UNBUILT)
def test_regions_without_particles(tmp_path, old, new, message):
    scene = vgmpi.load(tmp_path / "scene.toml", text=change(old, new))
    with pytest.raises(SceneError) as error:
        build_scene(scene)
    (line,) = str(error.value).splitlines()
    assert message in line
    assert "scene.toml:" in line


def test_a_region_of_all_particles(tmp_path, caplog):
    text = change("[0.26, 0, 0]", "[0, 0, 0]").split('[[object.region]]\nmaterial = "iron"\nsph')[0]
    with caplog.at_level(logging.WARNING):
        build_scene(vgmpi.load(tmp_path / "scene.toml", text=text))
    message = "'hammer': region 0 holds all its particles: material 'oak' makes up nothing of it"
    assert message in caplog.text


def test_rows_of_regions_are_last_and_in_their_order(tmp_path):
    """160 x 40 x 40 mm at 10 mm: 16 particles across; the box begins at x = 0.26."""
    made = build_scene(vgmpi.load(tmp_path / "scene.toml", text=SCENE))
    entry = made.objects[1]
    box, sphere = entry["regions"]
    assert [part["material"] for part in (box, sphere)] == ["iron", "iron"]
    assert box["density"] == 2800
    assert box["row_count"] == 4 * 16
    assert sphere["first_row"] == box["first_row"] + box["row_count"]
    assert sphere["first_row"] + sphere["row_count"] == entry["first_row"] + entry["row_count"]
    rows = slice(box["first_row"], sphere["first_row"])
    assert (made.x[rows, 0] > 0.26).all()
    rows = slice(sphere["first_row"], None)
    assert (np.linalg.norm(made.x[rows] - [0.14, 0.1, 0.1], axis=1) < 0.03).all()


def test_a_region_has_its_color(tmp_path):
    text = change(BOX, f'{BOX}\ncolor = "#0000ff"') + "[appearance]\nbaked_shading = 0\n"
    made = build_scene(vgmpi.load(tmp_path / "scene.toml", text=text))
    part = made.objects[1]["regions"][0]
    rows = slice(part["first_row"], part["first_row"] + part["row_count"])
    blue = dc_from_rgb(np.array([0.0, 0.0, 1.0]))
    assert np.allclose(made.sh[rows, 0], blue, rtol=1e-6)
    assert not np.isclose(made.sh[part["first_row"] - 1, 0], blue).all()


def test_the_plan_tells_of_regions_and_steps_by_the_stiffest_part(tmp_path):
    scene = vgmpi.load(tmp_path / "scene.toml", {"accuracy.pressure": "explicit"}, SCENE)
    plan = vgmpi.plan(scene)
    report = format_plan(scene, plan, ranks=1)
    assert "  region      hammer: 64 of its 320 particles are of iron" in report
    assert f"{plan.regions[1].particles} of its 320 particles are of iron" in report
    assert "phase       hammer: 256 particles" not in report
    counts = 320 - 64 - plan.regions[1].particles
    assert f"phase       hammer: {counts} particles of oak" in report
    bound, cause = time_step_bounds(scene, plan)[0]
    assert cause == "material 'iron'"
    wave = np.sqrt((0.7 / (1.3 * 0.4)) * 1e7 / 2800)  # Poisson's ratio is 0.3
    assert bound == pytest.approx(scene.courant_number * 0.02 / wave, rel=0.01)
    assert "rigid = true saves" not in report


def test_a_scene_without_regions_does_not_name_them(tmp_path):
    text = SCENE.split("[[object.region]]")[0]
    scene = vgmpi.load(tmp_path / "scene.toml", text=text)
    assert all("region" not in entry for entry in scene.to_json()["object"])
    assert all("regions" not in entry for entry in build_scene(scene).objects)


def test_a_restart_refuses_other_regions(tmp_path):
    scene = vgmpi.load(tmp_path / "scene.toml", text=SCENE)
    other = vgmpi.load(tmp_path / "scene.toml", text=change("radius = 0.03", "radius = 0.02"))
    before = scene.to_json()
    assert forbidden_changes(scene, before) == []
    (line,) = changes_without_effect(other, forbidden_changes(other, before))
    assert line[0][:3] == ("object", 1, "region")

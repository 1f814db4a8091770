"""Pinned parts in scenes: what is refused, with its line, and what --plan says."""

import logging

import numpy as np
import pytest

import vgmpi
from tests.support.simulate import advance, begin, by_id
from vgmpi.features.pinned_parts.plan import PinnedPartsPlan
from vgmpi.features.rigid_bodies.plan import RigidBodiesPlan
from vgmpi.planning.cost.plan_report import format_plan
from vgmpi.planning.region_groups import groups_of_particles
from vgmpi.runtime.config.schema import SceneError

SCENE = """
[domain]
size = [0.4, 0.2, 0.2]
cell = 0.01
[time]
end = 0.01
[accuracy]
transfer = "apic-corrected"
[material.rubber]
kind = "elastic"
youngs_modulus = 1e5
[material.water]
kind = "fluid"
[material.grains]
kind = "sand"
[material.ice]
kind = "snow"
[[object]]
name = "beam"
material = "rubber"
shape = { box = [[0.04, 0.06, 0.06], [0.2, 0.12, 0.12]] }
pinned = { box = [[0, 0, 0], [0.08, 0.2, 0.2]], to = "wall" }
[[object]]
name = "wall"
role = "scenery"
collider = true
shape = { box = [[-0.1, -0.1, -0.1], [0.04, 0.3, 0.3]] }
[[object]]
name = "boat"
material = "rubber"
rigid = true
shape = { box = [[0.3, 0.06, 0.06], [0.36, 0.12, 0.12]] }
"""
KEY = "object.beam.pinned"
BOX = "{ box = [[0, 0, 0], [0.08, 0.2, 0.2]], "
MATERIAL = 'material = "rubber"\nshape'
WRONG = [
    ("[0.08, 0.2, 0.2]]", "[0.02, 0.2, 0.2]]", f"{KEY}: holds no particle of 'beam' at the start"),
    ("[0.08, 0.2, 0.2]]", "[0.3, 0.2, 0.2]]",
     f"{KEY}: holds all particles of 'beam': use rigid = true, or motion"),
    ('"wall" }', '"walls" }', f"{KEY}.to: there is no object 'walls' (did you mean 'wall'?)"),
    ('"wall" }', '"beam" }', f"{KEY}.to: 'beam' cannot hold itself"),
    ("collider = true\n", "", f"{KEY}.to: 'wall' holds nothing: scenery with collider = true"),
    ('"wall" }', "3 }", f"{KEY}.to: must be"),
    (MATERIAL, 'material = "water"\nshape', f"{KEY}: is only for solids; the material is of kind"),
    (MATERIAL, 'material = "grains"\nshape', f"{KEY}: is only for solids"),
    (MATERIAL, 'material = "ice"\nshape', f"{KEY}: is only for solids"),
    (MATERIAL, 'material = "rubber"\nrigid = true\nshape',
     f"{KEY}: rigid and pinned given at once: give one"),
    (MATERIAL, 'material = "rubber"\nmotion = { velocity = [1, 0, 0] }\nshape',
     f"{KEY}: motion and pinned given at once"),
    (MATERIAL, 'material = "rubber"\nrelease_time = 1\nshape',
     f"{KEY}: release_time and pinned given at once"),
    (MATERIAL, 'material = "rubber"\nvolume_fraction = 0.5\nshape',
     f"{KEY}: volume_fraction and pinned given at once"),
    ("apic-corrected", "flip", f'{KEY}: is not for accuracy.transfer = "flip"'),
    (BOX, "{ ", f"{KEY}: has no form: give one of box, sphere"),
    (BOX, BOX + "sphere = { center = [0, 0, 0], radius = 1 }, ", f"{KEY}: has box and sphere"),
    (BOX, BOX + 'color = "#ff0000", ', f"{KEY}.color: is not for pinned parts"),
    (BOX, BOX + "motion = { velocity = [1, 0, 0] }, ", f'{KEY}.motion: is only for to = "world"'),
    (f'pinned = {BOX}to = "wall" }}', f"pinned = {BOX}motion = {{ axis = 'x' }} }}",
     f"{KEY}.motion: has no motion"),
    (f'{BOX}to = "wall" }}', "[]", f"{KEY}: has no part"),
    (f'{BOX}to = "wall" }}', "true", f"{KEY}: must be"),
    ("collider = true\n", f"collider = true\npinned = {BOX}to = 'wall' }}\n",
     "object.wall.pinned: is not for scenery"),
]  # fmt: skip


def refusal(tmp_path, text: str) -> str:
    with pytest.raises(SceneError) as error:
        vgmpi.plan(vgmpi.load(tmp_path / "scene.toml", text=text))
    return str(error.value)


@pytest.mark.parametrize(("old", "new", "message"), WRONG)
def test_what_is_refused(tmp_path, old, new, message):
    assert SCENE.count(old) >= 1
    said = refusal(tmp_path, SCENE.replace(old, new, 1))
    assert message in said
    assert "scene.toml:" in said


def test_a_probe_of_a_body_that_a_collider_holds_is_refused(tmp_path):
    probe = '[[probe]]\nname = "grip"\nsampling_rate = 10\ncollider = "beam"\n'
    assert "a body that is pinned to the world" in refusal(tmp_path, SCENE + probe)


@pytest.mark.parametrize(
    ("to", "line"),
    [
        ("wall", "pinned      beam: 1,152 of 4,608 particles, 0.1584 kg, to wall"),
        ("world", "pinned      beam: 1,152 of 4,608 particles, 0.1584 kg, to the world"),
        ("boat", "1,152 of 4,608 particles, 0.1584 kg, to boat, which carries this mass"),
    ],
)  # fmt: skip
def test_plan_tells_what_is_pinned(tmp_path, to, line):
    text = SCENE.replace('"wall" }', f'"{to}" }}')
    scene = vgmpi.load(tmp_path / "scene.toml", text=text)
    assert line in format_plan(scene, vgmpi.plan(scene), 1)


def test_a_rigid_body_carries_the_mass_that_it_holds(tmp_path):
    plain = SCENE.replace(f'pinned = {BOX}to = "wall" }}\n', "")
    masses = []
    for text in (plain, SCENE.replace('"wall" }', '"boat" }')):
        plan = vgmpi.plan(vgmpi.load(tmp_path / "scene.toml", text=text))
        masses.append(plan.feature(RigidBodiesPlan).at_start.bodies[0].mass)
    assert masses[1] - masses[0] == pytest.approx(0.1584, rel=1e-12)


def test_a_part_far_from_what_holds_it_is_warned_of(tmp_path, caplog):
    text = SCENE.replace('"wall" }', '"boat" }')
    with caplog.at_level(logging.WARNING, "vgmpi"):
        vgmpi.plan(vgmpi.load(tmp_path / "scene.toml", text=text))
    assert "'beam': the pinned part begins 0.222 m from 'boat', which holds it" in caplog.text


def test_particles_inside_what_holds_the_body_are_warned_of(tmp_path, caplog):
    text = SCENE.replace(
        "[[-0.1, -0.1, -0.1], [0.04, 0.3, 0.3]]", "[[-0.1, -0.1, -0.1], [0.1, 0.3, 0.3]]"
    )
    with caplog.at_level(logging.WARNING, "vgmpi"):
        vgmpi.plan(vgmpi.load(tmp_path / "scene.toml", text=text))
    assert "'beam': 432 particles that are not pinned lie inside 'wall'" in caplog.text


BESIDE = """
[domain]
size = [0.32, 0.16, 0.16]
cell = 0.01
[time]
end = 0.01
[material.rubber]
kind = "elastic"
youngs_modulus = 1e5
[material.gum]
kind = "elastic"
youngs_modulus = 2e5
[material.water]
kind = "fluid"
[[object]]
name = "beam"
material = "rubber"
phase = "solid"
shape = { box = [[0.2, 0.06, 0.06], [0.3, 0.1, 0.1]] }
pinned = { box = [[0.27, 0, 0], [0.4, 0.2, 0.2]] }
[[object]]
name = "block"
material = "gum"
phase = "solid"
shape = { box = [[0.12, 0.06, 0.06], [0.16, 0.1, 0.1]] }
[[object.region]]
material = "rubber"
box = [[0.14, 0, 0], [0.2, 0.2, 0.2]]
"""
WALL = """
[[object]]
name = "pool"
material = "water"
shape = { box = [[0, 0, 0], [0.1, 0.16, 0.08]] }
[[object]]
name = "plate"
role = "scenery"
collider = true
thin = true
shape = { box = [[0.1, -0.1, -0.1], [0.105, 0.3, 0.3]] }
"""


@pytest.mark.parametrize("more", ["", WALL], ids=["alone", "beside a thin wall"])
def test_parts_regions_and_thin_walls_have_groups_of_their_own(tmp_path, more):
    """A region of the material of a body that is pinned belongs to the body's free group."""
    simulation, made = begin(tmp_path, BESIDE + more)
    plan = simulation.plan
    (part,), (region,) = plan.feature(PinnedPartsPlan).pinned, plan.regions
    (group,) = part.groups
    assert plan.groups[group].carrier and not plan.groups[region.group].carrier
    assert plan.groups[region.group].material == "rubber"
    counts = [group.count.sum() for group in simulation.groups]
    assert counts[group] == part.region.count and sum(counts) == len(made.x)
    advance(simulation, 2e-3)
    (x,) = by_id(simulation, "x")
    held = groups_of_particles(plan, np.arange(len(x)), made.object) == group
    assert (x[held] == made.x[held]).all() and not (x[~held] == made.x[~held]).all()

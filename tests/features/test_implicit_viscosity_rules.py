"""Scenes with an implicit viscosity: what they may not contain, and the step."""

import math

import pytest

import vgmpi
from tests.features.test_implicit_pressure_rules import POST, SAND, refusal
from vgmpi.commands import cli

PROBE = """
[[probe]]
name = "push"
wall = "bottom"
sampling_rate = 100
"""
SCENE = """
[accuracy]
pressure = "explicit"
viscosity = "implicit"
[domain]
size = [0.4, 0.2, 0.4]
cell = 0.02
[time]
end = 0.1
[material.honey]
kind = "fluid"
density = 1400
viscosity = 200
[[object]]
name = "pool"
material = "honey"
shape = { box = [[0, 0, 0], [0.4, 0.2, 0.1]] }
"""
OIL = """
[material.oil]
kind = "fluid"
viscosity = 0.1
[[object]]
name = "slick"
material = "oil"
shape = { box = [[0, 0, 0.1], [0.4, 0.2, 0.14]] }
"""
MIXING = """
[[coupling]]
between = ["oil", "honey"]
kind = "mixing"
diffusivity = 1e-3
slip_relaxation_time = 0.1
"""
DUCK = """
[material.rubber]
kind = "elastic"
youngs_modulus = 1e5
[[object]]
name = "duck"
material = "rubber"
rigid = true
shape = { sphere = { center = [0.2, 0.1, 0.2], radius = 0.04 } }
"""
BOTH = SCENE.replace('pressure = "explicit"', 'pressure = "implicit"')
BODIES = "bodies that are held or moved, and thin walls"
OTHER = "materials other than Newtonian liquids"


def with_lines(table, *lines):
    return SCENE.replace(f"{table}\n", "\n".join((table, *lines, "")))


@pytest.mark.parametrize(
    "key, what, text",
    [
        ("material.sand.kind", OTHER, SCENE + SAND),
        ("material.honey.kind", OTHER, SCENE.replace('"fluid"\ndensity = 1400\nviscosity = 200',
                                                     '"paste"\nyield_stress = 5\n'
                                                     "consistency_index = 1\n"
                                                     "shear_modulus = 500")),
        ("object.duck.rigid", BODIES, SCENE + DUCK),
        ("object.duck.slip_length", "slip lengths of free bodies",
         BOTH + DUCK + "slip_length = 0\n"),
        ("object.pool.release_time", BODIES, with_lines('name = "pool"', "release_time = 0.05")),
        ("object.post.thin", BODIES, SCENE + POST + "thin = true\n"),
        ("object.post.friction", "colliders with friction", SCENE + POST + "friction = 0.3\n"),
        ("object.post.slip_length", "slip lengths other than 0",
         SCENE + POST + "slip_length = 0.01\n"),
        ("probe.push.wall", "probes of forces on a wall or collider", SCENE + PROBE),
        ("domain.boundary", "walls with friction",
         with_lines("cell = 0.02", 'boundary = { bottom = { kind = "separate", friction = 1 } }')),
        ("accuracy.viscosity", "liquids of several densities or viscosities in one phase",
         SCENE + OIL),
        ("coupling.0.kind", "liquids that mix", SCENE + OIL + MIXING),
        ("output.fields", "the field stress, which is that of particles",
         SCENE + '[output]\nfields = ["stress"]\n'),
    ],
)  # fmt: skip
def test_a_feature_is_refused(tmp_path, key, what, text):
    line = refusal(tmp_path, text)
    assert f"{key}: accuracy.viscosity = 'implicit' is not for {what}" in line


@pytest.mark.parametrize(
    "text",
    [
        SCENE + POST + "slip_length = 0\n",
        SCENE + POST + "motion = { velocity = [0.1, 0, 0] }\n",
        SCENE + OIL.replace('name = "slick"', 'name = "slick"\nphase = "oil"'),
        with_lines(
            "cell = 0.02", 'boundary = { default = "slip", top = "open", bottom = "separate" }'
        ),
        BOTH,
        BOTH + DUCK,
    ],
    ids=["sticks", "moves", "phases", "walls", "pressure", "floats"],
)
def test_a_scene_that_can_have_it(tmp_path, text):
    vgmpi.plan(vgmpi.load(tmp_path / "scene.toml", text=text))


def test_viscosity_does_not_bound_the_step(tmp_path):
    """It is gravity's with an implicit pressure; else waves bound it."""
    explicit = SCENE.replace('viscosity = "implicit"', 'viscosity = "explicit"')
    plan = vgmpi.plan(vgmpi.load(tmp_path / "scene.toml", text=explicit))
    assert 1 / plan.time_step.min_rate == pytest.approx(0.02**2 / 6 / (200 / 1400))
    plan = vgmpi.plan(vgmpi.load(tmp_path / "scene.toml", text=SCENE))
    assert plan.time_step.min_rate == 0 and plan.groups[0].law.mu == 0
    plan = vgmpi.plan(vgmpi.load(tmp_path / "scene.toml", text=BOTH))
    assert 1 / plan.time_step.min_rate == pytest.approx(0.4 * 0.02 / math.sqrt(2 * 9.8 * 0.02))


@pytest.mark.parametrize(
    "old, new, is_named",
    [
        ("viscosity = 200", "viscosity = 200\ntait_coefficient = 200", True),
        ("viscosity = 200", "viscosity = 0.2\ntait_coefficient = 200", False),
        ('viscosity = "implicit"', 'viscosity = "implicit"\nprecision = "double"', False),
        ("end = 0.1", "end = 0.1\ndt = 1e-5", False),
    ],
    ids=["syrup", "thin", "chosen", "fixed step"],
)
def test_a_plan_names_it_where_it_suits(tmp_path, capsys, old, new, is_named):
    text = SCENE.replace(old, new)
    if "precision" not in new:
        text = text.replace('viscosity = "implicit"\n', "")
    path = tmp_path / "scene.toml"
    path.write_text(text)
    assert cli.main([str(path), "--plan"]) == 0
    line = 'accuracy.viscosity = "implicit" suits this scene: 24 times fewer steps'
    assert (line in capsys.readouterr().out) == is_named

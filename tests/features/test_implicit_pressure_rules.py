"""Scenes with an implicit pressure: what they may not contain is named by its key, and the step."""

import math

import numpy as np
import pytest

import vgmpi
from vgmpi.preprocess.scene_builder import build_scene
from vgmpi.scene.loader import SceneError

SCENE = """
[accuracy]
pressure = "implicit"
[domain]
size = [0.4, 0.2, 0.4]
cell = 0.02
[time]
end = 0.1
[material.water]
kind = "fluid"
[[object]]
name = "pool"
material = "water"
shape = { box = [[0, 0, 0], [0.4, 0.2, 0.1]] }
"""
POST = """
[[object]]
name = "post"
role = "scenery"
collider = true
shape = { box = [[0.1, 0.1, 0], [0.2, 0.16, 0.3]] }
"""
SAND = """
[material.sand]
kind = "sand"
youngs_modulus = 1e6
[[object]]
name = "heap"
material = "sand"
shape = { box = [[0, 0, 0.2], [0.1, 0.1, 0.3]] }
"""
OIL = """
[material.oil]
kind = "fluid"
density = 900
[[object]]
name = "slick"
material = "oil"
shape = { box = [[0, 0, 0.1], [0.4, 0.2, 0.14]] }
"""
BODIES = "bodies of particles that are held or moved, and colliders with friction"
WALLS = "walls that open"
PUBLISHED = """
[[coupling]]
kind = "mixing-versagauss"
between = ["water", "oil"]
diffusivity = 1e-3
"""

SEEPAGE = """
[[coupling]]
kind = "drag"
between = ["water", "sand"]
hydraulic_conductivity = 1e-2
"""
PUBLISHED_DRAG = SEEPAGE.replace('"drag"', '"drag-versagauss"')
RUBBING = """
[[coupling]]
kind = "contact"
between = ["water", "oil"]
friction = 0.5
"""


def refusal(tmp_path, text):
    with pytest.raises(SceneError) as error:
        vgmpi.plan(vgmpi.load(tmp_path / "scene.toml", text=text))
    return str(error.value)


@pytest.mark.parametrize(
    "key, feature, text",
    [
        ("object.post.friction", BODIES, SCENE + POST + "friction = 0.3\n"),
        (
            "material.sand.kind",
            "materials that are no fluid",
            SCENE.replace("[domain]", 'elasticity = "explicit"\n[domain]') + SAND,
        ),
        (
            "accuracy.pressure",
            "scenes without a liquid",
            SCENE[: SCENE.index("[material.water]")] + SAND,
        ),
        ("coupling.0.kind", "couplings of kind 'mixing-versagauss'", SCENE + OIL + PUBLISHED),
        ("coupling.0.kind", "couplings of kind 'drag-versagauss'", SCENE + SAND + PUBLISHED_DRAG),
        (
            "coupling.0.between",
            "sands through which only some of the liquids flow",
            SCENE + SAND + OIL + SEEPAGE,
        ),
        ("coupling.0.friction", "friction of liquids", SCENE + OIL + RUBBING),
        (
            "material.oil.density",
            "liquids that are more than 10,000 times as heavy as others",
            SCENE + OIL.replace("900", "0.09"),
        ),
        (
            "material.water.tension",
            "liquids without tension",
            SCENE.replace('kind = "fluid"', 'kind = "fluid"\ntension = "off"', 1),
        ),
        (
            "domain.boundary",
            WALLS,
            SCENE.replace(
                "cell = 0.02",
                'cell = 0.02\nboundary = { east = { kind = "slip", removal_time = 0.1 } }',
            ),
        ),
        (
            "object.pool.release_time",
            BODIES,
            SCENE.replace('material = "water"', 'material = "water"\nrelease_time = 0.05'),
        ),
    ],
)
def test_a_feature_is_refused(tmp_path, key, feature, text):
    line = refusal(tmp_path, text)
    assert f"{key}: accuracy.pressure = 'implicit' is not for {feature}" in line


@pytest.mark.parametrize(
    "key, value, needs",
    [
        ("transfer", "apic-corrected", "apic"),
        ("volume_correction", "shifting", "none"),
        ("dilatation", "cells", "particles"),
    ],
)
def test_other_keys_of_accuracy(tmp_path, key, value, needs):
    text = SCENE.replace("[domain]", f'{key} = "{value}"\n[domain]')
    line = refusal(tmp_path, text)
    assert f"accuracy.{key}: pressure = 'implicit' needs {key} = '{needs}'" in line


def test_defaults_and_the_bound_of_the_step(tmp_path):
    """A drop falls by at most cfl cells in a step; without gravity a step ends at a frame."""
    scene = vgmpi.load(tmp_path / "scene.toml", text=SCENE)
    assert scene.accuracy.transfer == "apic" and scene.accuracy.volume_correction == "none"
    plan = vgmpi.plan(scene)
    assert 1 / plan.time_step.min_rate == pytest.approx(0.4 * 0.02 / math.sqrt(2 * 9.8 * 0.02))
    still = SCENE.replace("cell = 0.02", "cell = 0.02\ngravity = [0, 0, 0]")
    plan = vgmpi.plan(vgmpi.load(tmp_path / "scene.toml", text=still))
    assert 1 / plan.time_step.min_rate == pytest.approx(0.1 / 49)


def test_a_hydrostatic_start_adds_no_mass(tmp_path):
    """Compressed water has more mass in its shape; an implicit pressure does not compress it."""
    key = 'initial_pressure = "hydrostatic"'
    still = SCENE.replace('material = "water"', f'material = "water"\n{key}')
    made = build_scene(vgmpi.load(tmp_path / "scene.toml", text=still))
    plain = build_scene(vgmpi.load(tmp_path / "plain.toml", text=SCENE))
    assert made.theta0.min() < 0
    assert np.array_equal(made.vol0, plain.vol0)
    explicit = still.replace("implicit", "explicit")
    more = build_scene(vgmpi.load(tmp_path / "explicit.toml", text=explicit))
    assert more.vol0.sum() > 1.0001 * plain.vol0.sum()


@pytest.mark.parametrize(
    "key, feature",
    [
        (
            "pinned = { box = [[0, 0, 0.2], [0.1, 0.1, 0.22]], motion = "
            '{ keyframes = [{ time = "0.1 s", translation = [0.1, 0, 0] }] } }',
            "pinned parts that move",
        ),
        (
            'motion = { keyframes = [{ time = "0.1 s", translation = [0.1, 0, 0] }] }',
            "bodies of particles that are moved",
        ),
    ],
)
def test_bodies_that_an_implicit_elasticity_is_not_for(tmp_path, key, feature):
    """It stands alone here: an implicit pressure refuses the same first."""
    text = SCENE[: SCENE.index("[[object]]")].replace("pressure", "elasticity")
    text += SAND.replace("sand", "rubber").replace('kind = "rubber"', 'kind = "elastic"')
    message = refusal(tmp_path, text + key)
    assert f"object.heap.{key.split()[0]}: accuracy.elasticity = 'implicit' is not for" in message
    assert feature in message


def test_an_implicit_elasticity_is_not_for_drag(tmp_path):
    text = SCENE.replace("pressure", 'pressure = "explicit"\nelasticity')
    message = refusal(tmp_path, text + SAND + SEEPAGE)
    feature = "couplings of kind 'drag'"
    assert f"coupling.0.kind: accuracy.elasticity = 'implicit' is not for {feature}" in message


@pytest.mark.parametrize("transfer", ["apic-corrected", "flip"])
def test_an_implicit_elasticity_needs_apic(tmp_path, transfer):
    """What the others restore of slowed waves would make them grow."""
    text = SCENE.replace("pressure", "elasticity")
    text = text.replace("[domain]", f'transfer = "{transfer}"\n[domain]')
    message = refusal(tmp_path, text + SAND)
    assert "accuracy.transfer: elasticity = 'implicit' needs transfer = 'apic' or 'pic'" in message

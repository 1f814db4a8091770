"""Configurations of PhysGaussian and VersaGauss become scenes: where bodies stand and what they are
made of, in numbers."""

import json
import math
from functools import partial

import numpy as np
import pytest

from tests.support.foreign_configs import BOX, CELL, HOLD, ONE, egg, named, scene_of, several
from vgmpi.gaussians.formats import registry
from vgmpi.materials.tensor_math import viscoplastic_flow
from vgmpi.preprocess.scene_builder import build_scene
from vgmpi.tools.convert.__main__ import main
from vgmpi.tools.convert.scene_converter import convert_scene


@pytest.fixture
def convert(tmp_path):
    return partial(scene_of, tmp_path)


@pytest.fixture
def capture(tmp_path):
    return egg(tmp_path)


def test_the_box_the_times_and_gravity(convert):
    scene, lines = convert(ONE)
    assert scene.domain.cell == pytest.approx(CELL)
    assert scene.domain.size == pytest.approx((2, 2, 2))
    assert scene.domain.gravity == (0, 0, -4)
    assert (scene.time.end, scene.time.frames) == (pytest.approx(0.6), 31)
    assert scene.domain.boundary.default.kind == "open"
    assert scene.domain.boundary.model_fields_set == {"default"}
    assert scene.accuracy.transfer == "apic"
    assert named(lines, "substep_dt")


def test_gravity_points_where_it_did(convert):
    scene, _ = convert(ONE | {"g": [1.0, -9.8, 0.5]})
    assert scene.domain.gravity == (1.0, -9.8, 0.5)
    assert convert(several(({}, {"center_point": [2, 2, 2]})))[0].domain.gravity == (0, 0, -9.8)


def test_a_box_stands_in_place_of_gaussians(convert):
    scene, lines = convert(ONE | {"scale": 0.8})
    assert np.allclose(scene.object[0].shape.box, [[0.6] * 3, [1.4] * 3])
    assert any("is a box in place of its Gaussians" in line for line in lines)


def theirs(cloud, angles, scale):
    """Places in their box, by their way."""
    x = cloud.x[cloud.opacity > 0.02]
    for degrees, axis in angles:
        c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
        turn = {
            0: [[1, 0, 0], [0, c, -s], [0, s, c]],
            1: [[c, 0, s], [0, 1, 0], [-s, 0, c]],
            2: [[c, -s, 0], [s, c, 0], [0, 0, 1]],
        }[axis]
        x = x @ np.array(turn).T
    low, high = x.min(axis=0), x.max(axis=0)
    return (x - (low + high) / 2) * (scale / (high - low).max()) + 1


@pytest.mark.parametrize("walls, shift", [([], 0.0), ([BOX], 2 * CELL)])
def test_gaussians_stand_where_theirs_do(convert, capture, walls, shift):
    turns = [(30.0, 0), (-50.0, 2), (15.0, 1)]
    config = ONE | {
        "scale": 0.9, "rotation_degree": [a for a, _ in turns],
        "rotation_axis": [a for _, a in turns], "boundary_conditions": walls,
    }  # fmt: skip
    scene, _ = convert(config, capture)
    assert np.allclose(
        build_scene(scene).x, theirs(registry.read(capture), turns, 0.9) - shift, atol=1e-6
    )
    assert scene.object[0].fill is False


def test_where_several_stand(convert, capture):
    config = several(
        ({}, {"center_point": [1.5, 2.0, 2.5], "scale": 1.2, "rotation_degree": [20],
              "rotation_axis": [1]}),
        ({}, {"center_point": [2.8, 2.0, 1.0], "scale": 0.6}),
    )  # fmt: skip
    scene, _ = convert(config, capture, capture)
    assert [thing.name for thing in scene.object] == ["a", "b"]
    made, cloud = build_scene(scene), registry.read(capture)
    assert np.allclose(
        made.x[made.object == 0], theirs(cloud, [(20, 1)], 1.2) + [0.5, 1, 1.5], atol=1e-6
    )
    assert np.allclose(made.x[made.object == 1], theirs(cloud, [], 0.6) + [1.8, 1, 0], atol=1e-6)


@pytest.mark.parametrize(
    "config, wanted",
    [
        ({}, {"kind": "corotated"}),
        # |s| = yield_stress is sqrt(3/2) of it in tension; hardening is 3 mu xi there
        (
            {"material": "metal", "yield_stress": 100},
            {"yield_stress": 122.474487, "hardening_modulus": 0},
        ),
        (
            {"material": "metal", "yield_stress": 100, "hardening": 1, "xi": 0.1},
            {"kind": "metal", "hardening_modulus": 3 * 3e4 / 2.7 * 0.1},
        ),
        ({"material": "sand"}, {"kind": "sand", "porosity": 0, "friction_angle": math.radians(25)}),
        (
            {"material": "sand", "friction_angle": 40},
            {"friction_angle": math.radians(40), "friction_angle_test": "triaxial"},
        ),
        (
            {"material": "foam", "yield_stress": 30, "plastic_viscosity": 8},
            {"kind": "foam", "yield_stress": 17.3205081, "viscosity": 4},
        ),
        ({"material": "foam", "yield_stress": 30}, {"kind": "metal", "yield_stress": 30}),
        ({"material": "snow"}, {"kind": "snow", "hardening_coefficient": 10}),
        ({"material": "plasticine"}, {"kind": "corotated"}),
        (
            {"material": "plasticine", "yield_stress": 100, "softening": 50},
            {"kind": "plasticine", "residual_yield_stress": 1.22474487,
             "softening_strain": 0.99 * 122.474487 / 75},
        ),
        (
            {"material": "plasticine", "yield_stress": 100, "hardening": 1, "xi": 0.1},
            {"kind": "metal", "hardening_modulus": 3 * 3e4 / 2.7 * 0.1 - 0.15},
        ),
    ],
)  # fmt: skip
def test_materials_of_physgaussian(convert, config, wanted):
    made = convert(ONE | config)[0].material["body"]
    assert (made.youngs_modulus, made.poisson_ratio) == (3e4, 0.35)
    assert made.bulk_density == pytest.approx(120)
    for key, value in wanted.items():
        assert getattr(made, key) == (value if isinstance(value, str) else pytest.approx(value))


def test_materials_of_versagauss(convert):
    water = {"material": "fluid", "bulk_modulus": 500, "density": 60, "gamma": 8}
    sand = {"material": "sand", "density": 90, "porosity": 0.4, "permeability": 0.2, "gamma": 5}
    snow = {
        "material": "snow", "compression": 0.015, "stretch": 0.008, "hardening_coe": 4, "gamma": 6,
    }  # fmt: skip
    at = [{"center_point": [1.2 + 0.8 * k, 2, 2], "scale": 0.6} for k in range(3)]
    scene, lines = convert(several(*zip((water, sand, snow), at, strict=True)))
    a, b, c = scene.material.values()
    assert (a.kind, a.tait_coefficient, a.density) == ("fluid", 500, 60)
    assert a.tait_exponent == 6  # the last one's
    assert (b.bulk_density, b.porosity) == (pytest.approx(90), 0.4)
    assert (c.critical_compression, c.critical_stretch, c.hardening_coefficient) == (
        0.015,
        0.008,
        4,
    )
    assert scene.coupling[0].kind == "drag" and scene.coupling[0].hydraulic_conductivity == 0.2
    assert named(lines, "material_params.0.gamma")
    jam = {"material": "jam", "bulk_modulus": 400}
    assert convert(several((jam, at[1])))[0].material["a"].kind == "fluid"


def test_fluids_mix(convert):
    one = {"material": "fluid", "bulk_modulus": 500, "diff_coe": 8e-4}
    stands = [{"center_point": [2, 2, z], "scale": 0.8, "opacity_scale": 0.02} for z in (1.5, 2.5)]
    scene, _ = convert(several((one, stands[0]), (one, stands[1])))
    assert (scene.coupling[0].kind, scene.coupling[0].diffusivity) == ("mixing", 8e-4)
    assert [thing.opacity_scale for thing in scene.object] == [0.02, 0.02]


PART = {"point": [1, 1, 1.5], "size": [1, 1, 0.4], "E": 5e4, "nu": 0.2, "density": 70}


def test_parts_of_other_material(convert, capture):
    """The box ends at z = 1.1 in theirs, 1.1 less the 2 cells of 0.1 below the walls here."""
    scene, lines = convert(ONE | {"additional_material_params": [PART]}, capture)
    (body,) = scene.object
    (region,) = body.region
    made = [scene.material[name] for name in (body.material, region.material)]
    assert [m.kind for m in made] == ["corotated", "corotated"]
    assert [m.density for m in made] == [120, 70]
    assert [m.youngs_modulus for m in made] == [3e4, 5e4]
    assert [m.poisson_ratio for m in made] == [0.35, 0.2]
    prepared = build_scene(scene)
    (part,) = prepared.objects[0]["regions"]
    above = np.arange(len(prepared.x)) >= part["first_row"]
    low = region.box[0][2]
    assert prepared.x[~above][:, 2].max() <= low <= prepared.x[above][:, 2].min()
    assert len(prepared.x) == 810
    assert 0 < part["row_count"] < 810
    assert not named(lines, "additional_material_params.0")


def test_parts_in_any_box_and_of_filled_and_turned_captures(convert, capture):
    across = PART | {"point": [1, 1, 1], "size": [0.2, 0.15, 0.3]}
    turned = {"rotation_degree": [30.0], "rotation_axis": [2]}
    parts = {"additional_material_params": [across, PART]}
    scene, lines = convert(ONE | parts | {"particle_filling": {"n_grid": 20}} | turned, capture)
    assert not named(lines, "additional_material_params.0")
    first, last = scene.object[0].region
    assert np.ptp(first.box, axis=0) == pytest.approx([0.4, 0.3, 0.6])
    assert first.material != last.material
    assert sum(part["row_count"] for part in build_scene(scene).objects[0]["regions"]) > 0


def test_a_part_that_holds_all_is_the_material(convert, capture):
    every = PART | {"point": [1, 1, 1], "size": [3, 3, 3]}
    scene, lines = convert(ONE | {"additional_material_params": [PART, every]}, capture)
    assert scene.object[0].region is None
    assert scene.material[scene.object[0].material].density == 70
    assert not named(lines, "additional_material_params.0")


@pytest.mark.parametrize(
    ("more", "reason"),
    [
        ({"additional_material_params": [PART | {"point": [1, 1, 9]}]}, "no part of the body"),
        ({"material": "snow", "additional_material_params": [PART]}, "no stress for snow"),
        (
            {"additional_material_params": [PART], "boundary_conditions": [HOLD]},
            "the body is driven",
        ),
    ],
)
def test_parts_that_are_not_brought_over(convert, capture, more, reason):
    scene, lines = convert(ONE | more, capture)
    (line,) = named(lines, "additional_material_params.0")
    assert reason in line
    assert scene.object[0].region is None


def test_every_other_key_is_named(convert):
    camera = {"init_radius": 2.0, "mpm_space_vertical_upward_axis": [0, 0, 1], "show_hint": False}
    given = camera | {"grid_v_damping_scale": 0.999, "rpic_damping": 0.5, "pic_damping": 0.1}
    given |= {"friction_angle": 30, "sofening": 3}
    lines = convert(ONE | given)[1]
    assert all(named(lines, key) for key in given)
    assert "did you mean 'softening'?" in named(lines, "sofening")[0]
    assert "render.toml" in named(lines, "init_radius")[0]
    lines = convert(ONE | {"material": "metal", "yield_stress": 9, "xi": 0.1})[1]
    assert "a switch" in named(lines, "xi")[0]
    assert convert(ONE | {"rpic_damping": -1.0})[0].accuracy.transfer == "pic"


def test_the_command(tmp_path, capsys):
    config, scene = tmp_path / "c.json", tmp_path / "s.toml"
    config.write_text(json.dumps(ONE))
    assert main([str(config), "-o", str(scene)]) == 0
    said = capsys.readouterr()
    assert said.out.startswith(f"{scene}: written") and f"{config}: substep_dt: 0.0001:" in said.err
    assert main([str(config), "-o", str(scene)]) == 2
    assert "--overwrite" in capsys.readouterr().err
    assert main([str(config), "-o", str(scene), "--overwrite"]) == 0
    assert main([str(config), "-o", str(tmp_path / "no" / "s.toml")]) == 2


def made_of(convert, **more):
    return convert(ONE | more)[0].material["body"].law()


def test_bodies_yield_where_theirs_do(convert):
    """By what the laws compute with: sizes of deviators, as theirs."""
    metal = made_of(convert, material="metal", yield_stress=100, hardening=1, xi=0.1)
    assert 2 * metal.mu * metal.strain == pytest.approx(100)
    root = math.sqrt(2 / 3)  # plastic strain in tension per size of it
    assert 2 * metal.mu * metal.slope * root == pytest.approx(2 * metal.mu * 0.1)
    clay = made_of(convert, material="plasticine", yield_stress=100, softening=50)
    assert 2 * clay.mu * clay.strain == pytest.approx(100)
    assert 2 * clay.mu * clay.slope * root == pytest.approx(50)
    foam = made_of(convert, material="foam", yield_stress=30, plastic_viscosity=8)
    assert 2 * foam.mu * foam.strain == pytest.approx(root * 30)
    dt = 1e-4  # the share of what is beyond that flows in a step
    theirs = 1 / (1 + 8 / (2 * foam.mu * dt))
    assert viscoplastic_flow.bingham(foam.mu * dt, foam.viscosity) == pytest.approx(theirs)
    stiff = made_of(convert, material="foam", yield_stress=30)
    assert 2 * stiff.mu * stiff.strain == pytest.approx(root * 30)


def test_sand_slides_where_theirs_does(convert):
    sand = made_of(convert, material="sand", friction_angle=30)
    alpha = math.sqrt(2 / 3) * 2 * 0.5 / 2.5
    # |e| = -(3 lam + 2 mu) / (2 mu) alpha tr(e), with three times the mean for the trace
    assert sand.slope == pytest.approx((3 * sand.lam + 2 * sand.mu) / (2 * sand.mu) * alpha * 3)
    assert sand.apex_strain == 0


def leaves(value, at=()):
    """Places of all numbers, words and switches."""
    items = value.items() if isinstance(value, dict) else enumerate(value)
    for key, one in items:
        if isinstance(one, dict | list):
            yield from leaves(one, (*at, key))
        else:
            yield (*at, key)


def changed(config, at):
    """The configuration with another value at one place."""
    out = here = json.loads(json.dumps(config))
    for key in at[:-1]:
        here = here[key]
    value = here[at[-1]]
    more = value + 1 if isinstance(value, int) else 1.05 * value + 0.003
    here[at[-1]] = not value if isinstance(value, bool) else more
    return out


def test_no_key_is_dropped_without_a_word(tmp_path, capture):
    """Another value makes another scene, or another line."""
    part = {"point": [1, 1, 9], "size": [0.1, 0.1, 0.1], "E": 1e4, "nu": 0.1, "density": 9}
    config = ONE | {
        "material": "plasticine", "yield_stress": 90, "softening": 40, "hardening": 2, "xi": 3,
        "plastic_viscosity": 4, "friction_angle": 30, "rpic_damping": 0.2, "pic_damping": 0.1,
        "grid_v_damping_scale": 0.9, "grid_lim": 2, "scale": 0.7, "show_hint": False,
        "init_radius": 2, "additional_material_params": [part], "unheard": 5,
        "particle_filling": {
            "n_grid": 70, "density_threshold": 5, "search_threshold": 1, "smooth": True,
            "search_exclude_direction": 2, "ray_cast_direction": 1, "max_particles_num": 1000,
            "max_partciels_per_cell": 2, "visualize": True, "boundary": [0.8, 1, 0.8, 1, 0.8, 1],
        },
    }  # fmt: skip

    def text(config):
        path = tmp_path / "config.json"
        path.write_text(json.dumps(config))
        return convert_scene(path, [capture], tmp_path)[0]

    found = list(leaves(config))
    assert len(found) > 40
    for at in found:
        # the line of a box shows where it begins
        if at != ("material",) and (at[0] != "additional_material_params" or at[2] == "point"):
            assert text(changed(config, at)) != text(config), at

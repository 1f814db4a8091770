"""The total deformation gradient of bodies whose law does not know it."""

import numpy as np
import pytest

from tests.support.simulate import advance, begin
from tests.support.small_scenes import scene
from vgmpi.planning.phases_and_groups import stores_deformation
from vgmpi.solver.restart.state_io import by_id, frame_rows
from vgmpi.solver.step_to_target import next_step

# a metal toy that turns, an elastic one, water in the pores of sand, snow that asks for nothing
SCENE = """
[domain]
size = [0.32, 0.24, 0.24]
cell = 0.02
gravity = [0, 0, -9.80665]
[time]
end = 0.02
[accuracy]
precision = "PRECISION"
[material.water]
kind = "fluid"
tait_coefficient = 5e4
[material.grains]
kind = "sand"
youngs_modulus = 1e5
[material.flakes]
kind = "snow"
youngs_modulus = 1e5
[material.tin]
kind = "metal"
youngs_modulus = 1e6
yield_stress = 2e3
[material.rubber]
kind = "elastic"
density = 700
youngs_modulus = 1e5
[[object]]
name = "pores"
material = "water"
track_deformation = true
shape = { box = [[0, 0, 0], [0.16, 0.24, 0.06]] }
volume_fraction = 0.4
velocity = [0.4, 0, 0]
[[object]]
name = "bed"
material = "grains"
track_deformation = true
shape = { box = [[0, 0, 0], [0.16, 0.24, 0.06]] }
[[object]]
name = "ball"
material = "flakes"
shape = { sphere = { center = [0.24, 0.06, 0.05], radius = 0.03 } }
[[object]]
name = "toy"
material = "tin"
shape = { sphere = { center = [0.08, 0.12, 0.11], radius = 0.03 } }
angular_velocity = [0, 30, 10]
velocity = [0, 0, -2]
[[object]]
name = "other"
material = "rubber"
shape = { sphere = { center = [0.24, 0.16, 0.11], radius = 0.03 } }
angular_velocity = [0, 30, 10]
[[coupling]]
between = ["water", "grains"]
kind = "drag"
hydraulic_conductivity = 1e-2
"""


def gradients(simulation):
    ids, rows = frame_rows(simulation, ("J", "F"))
    order = np.argsort(ids)
    return rows["F"][order].reshape(-1, 3, 3), rows["J"][order]


@pytest.mark.parametrize("precision, most", [("double", 2e-7), ("single", 1e-5)])
def test_it_is_the_product_of_what_each_step_does(precision, most, tmp_path):
    """Beside F <- (I + dt C) F in numpy; frames are in single precision. Bodies whose F is not
    followed show the isotropic one of their volume."""
    simulation, made = begin(tmp_path, SCENE.replace("PRECISION", precision))
    want = np.tile(np.eye(3), (len(made.x), 1, 1))
    for _ in range(40):
        dt, _ = next_step(simulation.time, 1.0, simulation.bound())
        simulation.advance(dt)
        (C,) = by_id(simulation, "C")
        want += dt * C.reshape(-1, 3, 3) @ want
    got, J = gradients(simulation)
    names = [thing["name"] for thing in made.objects]
    assert [thing["tracks_deformation"] for thing in made.objects] == [
        True,
        True,
        False,
        True,
        True,
    ]
    for k, name in enumerate(names):
        own = made.object == k
        if name == "ball":
            ball = np.cbrt(J[own])[:, None, None] * np.eye(3)
            np.testing.assert_allclose(got[own], ball, atol=1e-7)
            continue
        assert np.abs(want[own] - np.eye(3)).max() > 0.01, name
        np.testing.assert_allclose(got[own], want[own], rtol=0, atol=most, err_msg=name)


def test_nothing_else_sees_it(tmp_path):
    """The same bits with and without it."""
    text = SCENE.replace("PRECISION", "double")
    without = (
        text.replace("track_deformation = true\n", "") + '[output]\nfields = ["velocity", "J"]\n'
    )
    found = []
    for one in (text, without):
        simulation, _ = begin(tmp_path, one)
        advance(simulation, 0.01)
        found.append(by_id(simulation, "x", "v", "C", "J"))
    for a, b in zip(*found, strict=True):
        np.testing.assert_array_equal(a, b)


def test_it_takes_memory_only_where_it_is_asked_for(tmp_path):
    simulation, _ = begin(tmp_path, SCENE.replace("PRECISION", "double"))
    plan = simulation.plan
    followed = {group.material: group.tracks_deformation for group in plan.groups}
    assert followed == {
        "water": True, "grains": True, "flakes": False, "tin": True, "rubber": False,
    }  # fmt: skip
    size = {g.material: plan.bytes_per_particle(k) for k, g in enumerate(plan.groups)}
    assert size["grains"] - size["flakes"] == 9 * 8
    known = {group.material for group in plan.groups if group.surface}
    assert known <= {"tin", "rubber"} and "tin" in known
    assert size["tin"] - size["flakes"] == 9 * 8 + 10 * 8  # and its body's surface


@pytest.mark.parametrize(
    "said, fields, want",
    [
        ("", '["J", "F"]', [True, True]),
        ("track_deformation = false", '["J", "F"]', [False, False]),
        ("track_deformation = true", '["J", "F"]', [True, True]),
        (
            "track_deformation = true",
            '["J"]',
            [False, True],
        ),  # frames do not have F: nothing is followed
    ],
)
def test_solids_are_followed_unless_the_scene_says_otherwise(said, fields, want, tmp_path):
    text = SCENE.replace("PRECISION", "double").replace('[[object]]\nname = "toy"', "TOY")
    text = text.replace("TOY", f'[[object]]\n{said}\nname = "toy"')
    text = text.replace('name = "other"', f'name = "other"\n{said}')
    loaded = scene(tmp_path, f"{text}\n[output]\nfields = {fields}\n")
    assert [stores_deformation(loaded, thing) for thing in loaded.object[3:]] == want

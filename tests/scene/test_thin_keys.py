"""Thin walls in scenes: what is refused, with its line; what `--plan` and warnings tell."""

import logging

import numpy as np
import pytest
from scipy.spatial import cKDTree

import vgmpi
from vgmpi.features.thin_walls.shells import with_shell
from vgmpi.planning.cost.plan_report import format_plan
from vgmpi.preprocess.placement import PlacementError
from vgmpi.preprocess.scene_builder import build_scene
from vgmpi.runtime.config.schema import SceneError

SCENE = """
[domain]
size = [0.2, 0.2, 0.2]
cell = 0.01
[time]
end = 0.1
[accuracy]
transfer = "apic-corrected"
[appearance]
color_transfer = "frame"
[material.water]
kind = "fluid"
viscosity = 0.001
tait_coefficient = 2e4
[material.grains]
kind = "sand"
[material.oak]
kind = "elastic"
youngs_modulus = 1e6
[[object]]
name = "pool"
material = "water"
shape = { box = [[0, 0, 0], [0.09, 0.2, 0.1]] }
[[object]]
name = "plate"
role = "scenery"
collider = true
thin = true
shape = { box = [[0.09, -0.1, -0.1], [0.1, 0.3, 0.3]] }
"""
KEY = "object.plate.thin"
BALL = """[[object]]
name = "ball"
material = "oak"
rigid = true
shape = { sphere = { center = [0.15, 0.1, 0.1], radius = 0.04 } }
"""
DRAG = """[[coupling]]
kind = "drag"
between = ["water", "grains"]
hydraulic_conductivity = 0.1
[[object]]
name = "heap"
material = "grains"
shape = { box = [[0, 0, 0.1], [0.05, 0.1, 0.15]] }
"""
FLOOR = """[[object]]
name = "floor"
role = "scenery"
collider = true
slip_length = 0
shape = { box = [[-0.1, -0.1, -0.1], [0.3, 0.3, 0.01]] }
"""
WRONG = [
    ("collider = true\n", "", f"{KEY}: is only for scenery with collider = true"),
    ('material = "water"', 'material = "water"\nthin = true',
     "object.pool.thin: is only for scenery with collider = true"),
    ("thin = true", "thin = 2", f"{KEY}: "),
    ("apic-corrected", "aflip", f'{KEY}: is not for accuracy.transfer = "aflip"'),
    ("[[object]]", DRAG + "[[object]]",
     f"{KEY}: is not for scenes in which materials mix or flow through sand"),
    ("[[object]]", FLOOR + "[[object]]", f"{KEY}: is not for scenes with object.slip_length"),
    ("[[object]]", BALL + "[[object]]", f"{KEY}: is not for scenes with free rigid bodies"),
]  # fmt: skip
THICK = "[0.09, -0.1, -0.1], [0.1, 0.3, 0.3]", "[0.09, -0.1, -0.1], [0.13, 0.3, 0.3]"


class MoebiusStrip:
    """A strip a cell thick and four wide whose ends are joined after half a turn."""

    course = body = None

    def __init__(self):
        u, w = np.meshgrid(np.linspace(0, 2 * np.pi, 800), np.linspace(-0.02, 0.02, 41))
        r = 0.05 + w * np.cos(u / 2)
        points = np.stack([r * np.cos(u), r * np.sin(u), w * np.sin(u / 2)], -1)
        self.tree = cKDTree(points.reshape(-1, 3))

    def distance(self, points):
        return self.tree.query(points)[0] - 0.005

    def ends(self):
        return np.array([-0.075, -0.075, -0.025]), np.array([0.075, 0.075, 0.025])


def load(folder, text):
    return vgmpi.load(folder / "scene.toml", text=text)


@pytest.mark.parametrize(("old", "new", "message"), WRONG)
def test_what_is_refused(tmp_path, old, new, message):
    assert SCENE.count(old) >= 1
    with pytest.raises(SceneError) as error:
        load(tmp_path, SCENE.replace(old, new, 1))
    assert message in str(error.value)
    assert "scene.toml:" in str(error.value)


def test_what_is_nowhere_thin_is_refused(tmp_path):
    assert THICK[0] in SCENE
    scene = load(tmp_path, SCENE.replace(*THICK))
    with pytest.raises(SceneError) as error:
        build_scene(scene)
    assert f"{KEY}: is not needed: nowhere are two faces up to three cells" in str(error.value)


def test_a_wall_without_two_sides_is_refused():
    with pytest.raises(
        PlacementError, match="has no two sides: a thin wall may not twist"
    ) as error:
        with_shell(MoebiusStrip(), 0.01, (1.0, 1.0, 1.0))
    assert error.value.key == "thin"


def test_colors_do_not_travel_with_steps(tmp_path):
    scene = load(tmp_path, SCENE.replace('"frame"', '"step"'))
    with pytest.raises(SceneError) as error:
        vgmpi.plan(scene)
    assert f'{KEY}: is not for appearance.color_transfer = "step"' in str(error.value)


def test_plan_names_them_and_has_one_phase_for_the_user(tmp_path):
    scene = load(tmp_path, SCENE)
    text = format_plan(scene, vgmpi.plan(scene), 1)
    assert "  thin walls  plate: what flows on one side does not feel the other" in text
    assert text.count("  phase ") == 1
    assert "back side" not in text


@pytest.mark.parametrize("thin", ["true", "false"])
def test_the_warning_of_thin_colliders_names_the_key(tmp_path, caplog, thin):
    with caplog.at_level(logging.WARNING, "vgmpi"):
        build_scene(load(tmp_path, SCENE.replace("thin = true", f"thin = {thin}")))
    assert ("unless object.thin = true" in caplog.text) == (thin == "false")

"""Colors of materials against the color that a scene names."""

import pytest

import vgmpi
from tests.preprocess.test_surface_mesh import painted
from vgmpi.preprocess.object_builder import build_object


@pytest.mark.parametrize("color, share_of_red", [("", 0.06), ('color = "#00ff00"\n', 0.0)])
def test_a_color_of_the_scene_goes_before_that_of_a_material(tmp_path, color, share_of_red):
    """Kd colors one of two equal triangles; many programs write a gray one that nobody chose."""
    painted(tmp_path, picture=None)
    text = MATERIAL_SCENE.replace("COLOR\n", color)
    cloud = build_object(vgmpi.load(tmp_path / "scene.toml", text=text), 1).cloud
    assert (cloud.rgb[:, 0] > 2 * cloud.rgb[:, 1]).mean() == pytest.approx(share_of_red, abs=0.02)


MATERIAL_SCENE = """
[domain]
size = [1, 1, 1]
cell = 0.1
[time]
end = 0.1
[material.rubber]
kind = "elastic"
density = 400
youngs_modulus = "0.1 MPa"
[[object]]
name = "ball"
material = "rubber"
shape = { sphere = { center = [0.5, 0.5, 0.7], radius = 0.2 } }
[[object]]
name = "square"
role = "scenery"
mesh = "square.obj"
width = 0.5
position = [0.5, 0.5, 0.1]
COLOR
"""

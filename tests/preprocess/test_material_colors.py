"""Colors of materials against the color that a scene names."""

import pytest

import vgmpi
from tests.preprocess.test_surface_mesh import painted
from tests.support.small_scenes import PEBBLE
from vgmpi.preprocess.object_builder import build_object

SQUARE = """
[[object]]
name = "square"
role = "scenery"
mesh = "square.obj"
width = 0.5
position = [0.32, 0.32, 0.1]
"""


@pytest.mark.parametrize("color, share_of_red", [("", 0.06), ('color = "#00ff00"\n', 0.0)])
def test_a_color_of_the_scene_goes_before_that_of_a_material(tmp_path, color, share_of_red):
    """Kd colors one of two equal triangles; many programs write a gray one that nobody chose."""
    painted(tmp_path, picture=None)
    loaded = vgmpi.load(tmp_path / "scene.toml", text=PEBBLE + SQUARE + color)
    cloud = build_object(loaded, 1).cloud
    assert (cloud.rgb[:, 0] > 2 * cloud.rgb[:, 1]).mean() == pytest.approx(share_of_red, abs=0.02)

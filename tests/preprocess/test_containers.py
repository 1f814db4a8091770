"""A container that holds all there is has no outer side: nothing gets through its walls, however
thin they are."""

import numpy as np
import pytest

from tests.support.small_scenes import scene
from vgmpi.preprocess.scene_builder import build_scene

SCENE = """
[accuracy]
precision = "double"
[domain]
size = [0.4, 0.4, 0.4]
cell = 0.02
[time]
end = 0.1
[material.water]
kind = "fluid"
[[object]]
name = "inside"
material = "water"
shape = {{ box = [[0.12, 0.12, 0.12], [0.28, 0.28, 0.2]] }}
{more}
[[object]]
name = "box"
role = "scenery"
collider = true
shape = {{ difference = [{parts}] }}
"""
OUTER = "{ box = [[0.08, 0.08, 0.08], [0.32, 0.32, 0.32]] }"
INNER = "{ box = [[0.12, 0.12, 0.12], [0.28, 0.28, 0.28]] }"
HOLE = "{ box = [[0.18, 0.18, 0.26], [0.22, 0.22, 0.4]] }"
BESIDE = """[[object]]
name = "beside"
material = "water"
shape = { box = [[0.34, 0, 0], [0.4, 0.2, 0.2]] }
"""


def made(folder, parts=(OUTER, INNER), more=""):
    text = SCENE.format(parts=", ".join(parts), more=more)
    (collider,) = build_scene(scene(folder, text)).colliders
    return collider


def test_walls_that_hold_all_have_no_outer_side(tmp_path):
    collider = made(tmp_path)
    points = np.array([[0.2, 0.2, 0.2], [0.3, 0.2, 0.2], [0.35, 0.2, 0.2], [0.3, 0.3, 0.2]])
    expected = [0.08, -0.02, -0.07, -np.hypot(0.02, 0.02)]
    np.testing.assert_allclose(collider.distance(points), expected, atol=1e-12)
    normal = collider.normal(points[1:])
    np.testing.assert_allclose(normal[0], [-1, 0, 0], atol=1e-6)
    np.testing.assert_allclose(normal[2], [-(0.5**0.5), -(0.5**0.5), 0], atol=1e-6)
    np.testing.assert_allclose(collider.ends(), [[0.08] * 3, [0.32] * 3])


@pytest.mark.parametrize(
    "parts, more",
    [((OUTER, INNER, HOLE), ""), ((OUTER, INNER), BESIDE)],
    ids=["with a hole", "not all is inside"],
)
def test_others_keep_both_sides(tmp_path, parts, more):
    collider = made(tmp_path, parts, more)
    at = np.array([[0.31, 0.2, 0.2], [0.35, 0.2, 0.2]])
    np.testing.assert_allclose(collider.distance(at), [-0.01, 0.03], atol=1e-12)

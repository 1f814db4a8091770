"""Shapes: distances against brute force, volumes against formulas, reach, colors, placement."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from tests.support.small_scenes import ROOM, scene
from vgmpi.gaussians import shape_distance
from vgmpi.preprocess import shape_sdf
from vgmpi.preprocess.collider_sdf import ShapeCollider, VoxelCollider
from vgmpi.preprocess.placement import PlacementError, axis_rotation, placement
from vgmpi.preprocess.sampling.voxels import Voxels
from vgmpi.preprocess.scene_builder import build_scene
from vgmpi.scene.objects import Object
from vgmpi.scene.shapes import Shape, validate_shape

SHAPES = {
    "box": ({"box": [[-0.2, 0.1, 0.0], [0.3, 0.3, 0.25]]}, 0.5 * 0.2 * 0.25),
    "sphere": ({"sphere": {"center": [0.1, 0, 0.2], "radius": 0.2}}, 4 / 3 * np.pi * 0.2**3),
    "ellipsoid": (
        {"ellipsoid": {"center": [0, 0.1, 0], "radii": [0.3, 0.2, 0.15]}},
        4 / 3 * np.pi * 0.3 * 0.2 * 0.15,
    ),
    "cylinder": (
        {"cylinder": {"endpoints": [[0, 0, 0], [0.2, 0.1, 0.2]], "radius": 0.12}},
        np.pi * 0.12**2 * 0.3,
    ),
    "capsule": (
        {"capsule": {"endpoints": [[0, 0, 0], [0.2, 0.1, 0.2]], "radius": 0.12}},
        np.pi * 0.12**2 * 0.3 + 4 / 3 * np.pi * 0.12**3,
    ),
    "cone": (
        {"cone": {"endpoints": [[0, 0, 0], [0.2, 0.1, 0.2]], "radii": [0.15, 0]}},
        np.pi * 0.15**2 * 0.3 / 3,
    ),
    "frustum": (
        {"cone": {"endpoints": [[0, 0.1, 0], [0, 0.1, 0.3]], "radii": [0.08, 0.2]}},
        np.pi * 0.3 * (0.08**2 + 0.08 * 0.2 + 0.2**2) / 3,
    ),
    "torus": (
        {
            "torus": {
                "center": [0.1, 0, 0.1],
                "axis": [1, 2, 2],
                "major_radius": 0.2,
                "minor_radius": 0.08,
            }
        },
        2 * np.pi**2 * 0.2 * 0.08**2,
    ),
    "union": (
        {
            "union": [
                {"box": [[0, 0, 0], [0.2, 0.2, 0.2]]},
                {"box": [[0.1, 0, 0], [0.4, 0.2, 0.2]]},
            ]
        },
        0.4 * 0.2 * 0.2,
    ),
    "difference": (
        {
            "difference": [
                {"box": [[0, 0, 0], [0.4, 0.3, 0.3]]},
                {"box": [[0.1, 0.1, 0.1], [0.3, 0.2, 0.2]]},
                {"box": [[0.3, 0, 0], [0.5, 0.3, 0.3]]},
            ]
        },
        0.3 * 0.3 * 0.3 - 0.2 * 0.1 * 0.1,
    ),
}


EXACT = ["box", "sphere", "cylinder", "capsule", "cone", "frustum", "torus"]


def filled(shape, spacing):
    directions = np.eye(3)
    high = np.array([shape_sdf.support(shape, d) for d in directions])
    low = -np.array([shape_sdf.support(shape, -d) for d in directions])
    return shape_sdf.lattice(lambda x: shape_distance.distance(shape, x) < 0, low, high, spacing)


@pytest.mark.parametrize("name", SHAPES)
def test_volume_and_extent(name):
    raw, volume = SHAPES[name]
    shape, h = Shape.model_validate(raw), 0.005
    x = filled(shape, h)
    assert len(x) * h**3 == pytest.approx(volume, rel=0.005)
    rng = np.random.default_rng(3)
    for d in rng.normal(size=(20, 3)):
        d /= np.linalg.norm(d)
        gap = shape_sdf.support(shape, d) - (x @ d).max()
        if name == "difference":
            assert gap > -1e-12  # the reach of its first part bounds it
        else:
            assert 0 < gap < 2 * h


@pytest.mark.parametrize("name", EXACT)
def test_distance_is_the_distance_to_the_surface(name):
    shape, h = Shape.model_validate(SHAPES[name][0]), 0.015
    inside = filled(shape, h)
    all_ = shape_sdf.lattice(lambda x: np.ones(len(x), bool), [-0.5] * 3, [0.6] * 3, h)
    value = shape_distance.distance(shape, all_)
    outside = all_[value >= 0]
    rng = np.random.default_rng(4)
    probe = rng.uniform(-0.5, 0.6, (400, 3))
    to_inside, to_outside = (cKDTree(x).query(probe)[0] for x in (inside, outside))
    found = shape_distance.distance(shape, probe)
    brute = np.where(found < 0, -to_outside, to_inside)
    assert np.abs(found - brute).max() < 2 * h


def test_cone_at_chosen_points():
    """Above the tip, beside the slope (45 degrees), under the base, inside near each."""
    cone = Shape.model_validate({"cone": {"endpoints": [[0, 0, 0], [0, 0, 1]], "radii": [1, 0]}})
    points = [[0, 0, 1.5], [1, 0, 1], [0.5, 0, -0.3], [2, 0, -1], [0, 0, 0.1], [0, 0, 0.8]]
    root = np.sqrt(0.5)
    want = [0.5, root, 0.3, np.sqrt(2), -0.1, -0.2 * root]
    assert np.allclose(shape_distance.distance(cone, np.array(points, float)), want, atol=1e-14)


def test_a_blend_fills_the_edge_where_parts_meet():
    """A post on a plate: the parabola between them turned about the axis is known."""
    post, plate = (
        {"cylinder": {"endpoints": [[0, 0, -0.2], [0, 0, 0.4]], "radius": 0.1}},
        {"box": [[-0.5, -0.5, -0.3], [0.5, 0.5, 0]]},
    )
    sharp = Shape.model_validate({"union": [post, plate]})
    k, h = 0.12, 0.0025
    blended = Shape.model_validate({"union": [post, plate], "blend_radius": k})

    def new(x):
        return (shape_distance.distance(blended, x) < 0) & (shape_distance.distance(sharp, x) >= 0)

    edge = shape_sdf.lattice(new, [-0.25, -0.25, -0.01], [0.25, 0.25, 0.15], h)
    more = 2 * np.pi * (0.1 * k**2 / 6 + k**3 / 30)
    assert len(edge) * h**3 == pytest.approx(more, rel=0.01)
    elsewhere = shape_sdf.lattice(new, [-0.6, -0.6, -0.4], [0.6, 0.6, 0.5], 0.02)
    assert np.hypot(*elsewhere[:, :2].T).max() < 0.1 + k


def test_blended_distances_are_bounds():
    """Slopes are at most 1, and nothing sticks out further than `blend_overhang`."""
    balls = [{"sphere": {"center": [x, 0, 0], "radius": 0.1}} for x in (0.0, 0.13, 0.26)]
    shape = Shape.model_validate({"union": balls, "blend_radius": 0.08})
    rng = np.random.default_rng(6)
    x, step = rng.uniform(-0.3, 0.5, (4000, 3)), rng.normal(size=(4000, 3))
    step *= 1e-4 / np.linalg.norm(step, axis=1)[:, None]
    slope = (
        np.abs(shape_distance.distance(shape, x + step) - shape_distance.distance(shape, x)) / 1e-4
    )
    assert slope.max() < 1 + 1e-9
    assert shape_sdf.blend_overhang(shape) == pytest.approx(2 * 0.08 / 4)
    same = Shape.model_validate({"union": [balls[0], balls[0]], "blend_radius": 0.08})
    assert shape_distance.distance(same, np.array([[0.12, 0, 0]]))[0] == pytest.approx(0.0)
    cut = Shape.model_validate({"difference": [{"union": balls, "blend_radius": 0.08}, balls[0]]})
    assert shape_sdf.blend_overhang(cut) == 0.0  # its extents are searched, with the blend
    assert shape_sdf.support(cut, np.array([1.0, 0, 0])) == pytest.approx(0.36, abs=1e-6)


def test_a_blended_shape_as_a_body(tmp_path):
    """Particles stand where the blend sticks out beyond its parts' reach, too."""
    text = """
[[object]]
name = "lump"
material = "clay"
position = [0.2, 0.2, 0.1]
[object.shape]
blend_radius = 0.08
union = [
  { sphere = { center = [0, 0, 0], radius = 0.06 }, color = "#ff0000" },
  { sphere = { center = [0, 0, 0], radius = 0.06 } },
]
"""
    made = build_scene(scene(tmp_path, ROOM + text))
    assert made.vol0.sum() == pytest.approx(4 / 3 * np.pi * 0.08**3, rel=0.02)
    assert made.x[:, 2].min() < 0.1 - 0.01  # placed by its parts


def test_a_blend_is_for_unions_only():
    ball = {"sphere": {"center": [0, 0, 0], "radius": 1}, "blend_radius": 0.1}
    [(path, said)] = validate_shape(ball, ("shape",))
    assert path == ("shape", "blend_radius") and said == "is only for a union"


def test_ellipsoid_distance_near_the_surface():
    shape = Shape.model_validate(SHAPES["ellipsoid"][0])
    rng = np.random.default_rng(5)
    unit = rng.normal(size=(500, 3))
    unit /= np.linalg.norm(unit, axis=1)[:, None]
    radii, center = np.array([0.3, 0.2, 0.15]), np.array([0, 0.1, 0])
    normal = unit / radii
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    for step in (-0.01, 0.0, 0.01):
        found = shape_distance.distance(shape, center + unit * radii + step * normal)
        assert np.abs(found - step).max() < 0.001
    assert shape_distance.distance(shape, center[None])[0] == pytest.approx(-0.15)


def test_lattice_is_aligned_and_faces_on_points_take_one_side():
    shape = Shape.model_validate({"box": [[0, 0.01, 0.005], [0.04, 0.03, 0.025]]})
    x = filled(shape, 0.01)
    assert np.allclose(np.unique(x[:, 0]), [0.005, 0.015, 0.025, 0.035], atol=1e-15)
    assert np.allclose(np.unique(x[:, 1]), [0.015, 0.025], atol=1e-15)
    assert np.allclose(np.unique(x[:, 2]), [0.005, 0.015], atol=1e-15)  # not 0.025
    assert len(x) == 4 * 2 * 2


def test_colors_of_parts():
    shape = Shape.model_validate(
        {
            "union": [
                {"box": [[0, 0, 0], [1, 1, 1]], "color": "#ff0000"},
                {
                    "difference": [
                        {"box": [[0, 0, 0], [2, 1, 1]]},
                        {"box": [[1.5, 0, 0], [2, 1, 1]]},
                    ],
                    "color": "#0000ff",
                },
                {"box": [[2, 0, 0], [3, 1, 1]]},
            ]
        }
    )
    points = np.array([[0.5, 0.5, 0.5], [1.2, 0.5, 0.5], [2.5, 0.5, 0.5], [9.0, 0.5, 0.5]])
    grey = (0.5, 0.5, 0.5)
    expected = [(1, 0, 0), (0, 0, 1), grey, grey]
    assert np.array_equal(shape_sdf.colors(shape, points, grey), expected)


def thing(**keys):
    base = {"name": "thing", "material": "m", "shape": {"box": [[0, 0, 0], [2, 1, 0.5]]}}
    return Object.model_validate({**base, **keys})


def corners(placement):
    box = np.array([[x, y, z] for x in (0, 2) for y in (0, 1) for z in (0, 0.5)])
    return placement.to_domain(box)


def placed(**keys):
    item = thing(**keys)
    return placement(item, lambda d: shape_sdf.support(item.shape, d))


@pytest.mark.parametrize(
    "keys, size",
    [
        ({"height": 1}, (4, 2, 1)),
        ({"width": 1}, (1, 0.5, 0.25)),
        ({"depth": 3}, (6, 3, 1.5)),
        ({"scale": 2}, (4, 2, 1)),
        ({"up": "y", "height": 1}, (2, 0.5, 1)),
        ({"up": "-y", "width": 1}, (1, 0.25, 0.5)),
        ({"up": "x", "height": 1}, (0.5, 0.25, 1)),
        ({"up": "-x", "scale": 1}, (1, 0.5, 2)),
        ({"height": 1, "rotation": {"axis": "z", "angle": "90 deg"}}, (2, 4, 1)),
        (
            {
                "scale": 1,
                "rotation": [{"axis": "z", "angle": "90 deg"}, {"axis": "x", "angle": "90 deg"}],
            },
            (1, 0.5, 2),
        ),
    ],
)
def test_size_and_base_after_placing(keys, size):
    x = corners(placed(position=[5, 6, 7], **keys))
    low, high = x.min(axis=0), x.max(axis=0)
    assert np.allclose(high - low, size, atol=1e-12)
    assert np.allclose([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]], [5, 6, 7])


def test_up_axes_are_turns_and_point_up():
    for up in ("x", "-x", "y", "-y", "z", "-z"):
        rotation = placed(up=up, origin=[0, 0, 0]).rotation
        axis = np.zeros(3)
        axis["xyz".index(up[-1])] = -1 if up[0] == "-" else 1
        assert np.allclose(rotation @ axis, [0, 0, 1])
        assert np.linalg.det(rotation) == pytest.approx(1)


def test_origin_keeps_parts_together_and_own_undoes_points():
    at = placed(origin=[1, 2, 3], scale=0.5, rotation={"axis": "y", "angle": "30 deg"})
    assert np.allclose(at.to_domain(np.zeros((1, 3))), [[1, 2, 3]])
    x = np.random.default_rng(1).normal(size=(50, 3))
    assert np.allclose(at.to_local(at.to_domain(x)), x, atol=1e-14)
    matrix = np.array(at.matrix())
    homogeneous = np.concatenate([x, np.ones((50, 1))], axis=1) @ matrix.T
    assert np.allclose(homogeneous[:, :3], at.to_domain(x)) and np.allclose(homogeneous[:, 3], 1)


def test_flat_things_cannot_be_scaled_along_their_thickness():
    with pytest.raises(PlacementError) as caught:
        placement(thing(height=1), lambda d: float(abs(d[0]) + abs(d[1])))
    assert caught.value.key == "height"


def test_rotation_is_right_handed():
    assert np.allclose(axis_rotation((0, 0, 1), np.pi / 2) @ [1, 0, 0], [0, 1, 0])


def test_shape_collider_in_the_domain():
    item = thing(
        shape={"sphere": {"center": [0, 0, 0], "radius": 1}}, scale=0.1, position=[0.5, 0.5, 0.2]
    )
    at = placement(item, lambda d: shape_sdf.support(item.shape, d))
    collider = ShapeCollider("ball", item.shape, at, 0.005)
    middle = np.array([0.5, 0.5, 0.3])
    x = middle + np.random.default_rng(2).normal(size=(200, 3)) * 0.1
    away = np.linalg.norm(x - middle, axis=1)
    assert np.allclose(collider.distance(x), away - 0.1, atol=1e-14)
    far = away > 0.02
    assert np.allclose(collider.normal(x)[far], ((x - middle) / away[:, None])[far], atol=0.02)


def test_voxel_collider_is_near_the_true_distance():
    h, radius, middle = 0.02, 0.2, np.array([0.5, 0.4, 0.3])
    voxels = Voxels.enclosing(np.stack([middle - radius, middle + radius]), h)
    centers = voxels.centers(np.ones(voxels.shape, bool))
    solid = (np.linalg.norm(centers - middle, axis=1) < radius).reshape(voxels.shape)
    collider = VoxelCollider.from_voxels("ball", voxels, solid)
    rng = np.random.default_rng(6)
    x = middle + rng.uniform(-0.35, 0.35, (500, 3))
    away = np.linalg.norm(x - middle, axis=1)
    inside_box = (np.abs(x - middle) < radius + h).all(axis=1)
    assert np.abs(collider.distance(x) - (away - radius))[inside_box].max() < h
    assert ((collider.distance(x) > 0) == (away > radius))[np.abs(away - radius) > h].all()
    turned = (collider.normal(x) * (x - middle) / away[:, None]).sum(axis=1)
    assert turned[inside_box & (away > 0.1)].min() > 0.9

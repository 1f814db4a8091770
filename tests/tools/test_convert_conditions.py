"""Boundary conditions of PhysGaussian and VersaGauss: walls, colliders, motions, loads, inlets in
numbers, and by name what has no place in a scene."""

from functools import partial

import numpy as np
import pytest

from tests.support.foreign_configs import (
    BOX,
    CELL,
    HOLD,
    LONG,
    ONE,
    TURN,
    egg,
    named,
    scene_of,
    several,
)
from vgmpi.preprocess.scene_builder import build_scene


@pytest.fixture
def convert(tmp_path):
    return partial(scene_of, tmp_path)


@pytest.fixture
def capture(tmp_path):
    return egg(tmp_path)


def test_walls(convert):
    box = convert(ONE | {"boundary_conditions": [BOX]})[0].domain
    assert box.size == pytest.approx((15 * CELL,) * 3)  # nodes 2 to 17
    floor = {
        "type": "surface_collider", "point": [1, 1, 0.45], "normal": [0, 0, 1],
        "surface": "sticky", "friction": 0, **LONG,
    }  # fmt: skip
    scene, lines = convert(ONE | {"boundary_conditions": [BOX, floor]})
    assert scene.domain.size == pytest.approx((15 * CELL, 15 * CELL, 13 * CELL))  # from node 4
    assert scene.domain.boundary.bottom.kind == "stick"
    assert scene.domain.boundary.top.kind == "separate"
    assert np.allclose(scene.object[0].shape.box[0], [0.3, 0.3, 0.1])
    assert not named(lines, "boundary_conditions.1")
    slip = floor | {"surface": "slip", "friction": 0.3}
    lines = convert(ONE | {"boundary_conditions": [slip]})[1]
    assert named(lines, "boundary_conditions.0.surface")
    assert named(lines, "boundary_conditions.0.friction")
    for wrong in ({"normal": [0, 1, 1]}, {"end_time": 0.1}, {"surface": "cut"}):
        lines = convert(ONE | {"boundary_conditions": [floor | wrong]})[1]
        assert named(lines, "boundary_conditions.0")


def test_planes_of_versagauss(convert):
    plane = {"type": "add_plane", "x_plane": [1, 3], "y_plane": [0.95, 3], "z_plane": [0.52, 4]}
    config = several(({}, {"center_point": [2, 2, 2]}), boundary_conditions=[BOX, plane])
    domain = convert(config)[0].domain
    assert domain.size == pytest.approx((2, 2.1, 3))  # z from node 5 of either to node 35


def test_a_cuboid_below_is_a_floor(convert, capture):
    """What it holds is drawn; the rest stands on a wall that sticks."""
    slab = {
        "type": "cuboid", "point": [1, 1, 0.5], "size": [0.6, 0.6, 0.26], "velocity": [0, 0, 0],
    }  # fmt: skip
    scene, lines = convert(ONE | {"boundary_conditions": [slab]}, capture)
    assert scene.domain.boundary.bottom.kind == "stick"
    assert scene.domain.size == pytest.approx((2, 2, 1.3))  # from node 7
    assert [thing.role for thing in scene.object] == ["body", "scenery"]
    made = build_scene(scene)
    assert made.x[:, 2].min() >= 0 and made.scenery.x[:, 2].max() <= 0
    assert len(made.x) + len(made.scenery.x) == 810
    assert "wall" in named(lines, "boundary_conditions.0")[0]


def test_a_cuboid_beside_is_a_collider(convert):
    post = {"type": "cuboid", "point": [1.8, 1, 1], "size": [0.1, 0.2, 0.3], "velocity": [0, 0, 0]}
    scene, lines = convert(ONE | {"boundary_conditions": [BOX, post]})
    assert scene.object[1].collider and scene.object[1].motion is None
    assert np.allclose(scene.object[1].shape.box, [[1.5, 0.6, 0.5], [1.7, 1.0, 1.1]])
    assert "holds it fast" in named(lines, "boundary_conditions.1")[0]
    moving = post | {"velocity": [-0.1, 0, 0]}
    scene, _ = convert(ONE | {"boundary_conditions": [BOX, moving]})
    assert scene.object[1].motion.velocity == (-0.1, 0, 0)
    lines = convert(ONE | {"boundary_conditions": [post | {"end_time": 0.1}]})[1]
    assert named(lines, "boundary_conditions.0")


def test_bodies_are_held_and_moved(convert):
    assert convert(ONE | {"boundary_conditions": [HOLD]})[0].object[0].release_time == 0.2
    motion = (
        convert(ONE | {"boundary_conditions": [HOLD | {"velocity": [0, 0.1, 0]}]})[0]
        .object[0]
        .motion
    )
    assert (motion.velocity, motion.end_time) == ((0, 0.1, 0), 0.2)
    motion = convert(ONE | {"boundary_conditions": [BOX, TURN]})[0].object[0].motion
    assert (motion.angular_velocity, motion.axis, motion.end_time) == (
        -1.5,
        (0, 0, 1),
        0.3,
    )  # the left hand's way
    assert np.allclose(motion.pivot, (0.8, 0.8, 0.9)) and np.allclose(motion.velocity, (0, 0, 0.2))


def test_motions_one_after_the_other(convert):
    back = TURN | {"rotation_scale": -3.0, "translation_scale": 0.0, "start_time": 0.3}
    motion = (
        convert(ONE | {"boundary_conditions": [TURN, back | {"end_time": 0.5}]})[0].object[0].motion
    )
    assert [(key.time, round(key.angle, 9)) for key in motion.keyframes] == [
        (0.3, -0.45), (0.5, 0.15),
    ]  # fmt: skip
    assert (
        np.allclose(motion.keyframes[1].translation, (0, 0, 0.06))
        and motion.interpolation == "linear"
    )


@pytest.mark.parametrize(
    "condition",
    [
        HOLD | {"size": [0.4, 0.9, 0.9]},  # a part of it
        HOLD | {"point": [1, 1, 9]},  # nothing of it
        HOLD | {"start_time": 0.1},
        HOLD | {"start_time": 0.2},
        TURN | {"half_height_and_radius": [0.9, 0.3]},
        TURN | {"normal": [0, 0, 0]},
        {"type": "particle_impulse", "force": [1, 0, 0]},  # of how many is not known
        {"type": "release_particles_sequentially", "normal": [0, 0, 1], "start_position": 1.5,
         "end_position": 0.5, "num_layers": 50, "start_time": 0, "end_time": 0.4},  # a solid
    ],
)  # fmt: skip
def test_conditions_that_are_not_brought_over_are_named(convert, condition):
    scene, lines = convert(ONE | {"boundary_conditions": [condition]})
    assert any(line.startswith("boundary_conditions.0") for line in lines)
    assert scene.object[0].motion is None and scene.object[0].release_time is None
    assert not scene.lists["load"]


def test_a_part_that_is_held_to_the_end_is_pinned(convert):
    part = HOLD | {"size": [0.4, 0.9, 0.9], "point": [1.2, 1, 1], "end_time": 1e3}
    pinned = convert(ONE | {"boundary_conditions": [part]})[0].object[0].pinned
    assert [item.to for item in pinned] == ["world"] and pinned[0].motion is None
    low, high = np.array(pinned[0].box)
    assert np.allclose(high - low, [0.8, 1.8, 1.8])
    scene, lines = convert(ONE | {"boundary_conditions": [part | {"velocity": [0, 0.1, 0]}]})
    assert scene.object[0].pinned[0].motion.velocity == (0, 0.1, 0)
    assert not named(lines, "boundary_conditions.0")
    other = part | {"point": [0.6, 1, 1], "size": [0.1, 0.9, 0.9]}
    assert len(convert(ONE | {"boundary_conditions": [part, other]})[0].object[0].pinned) == 2
    turn = TURN | {"half_height_and_radius": [0.9, 0.2], "end_time": 1e3}
    pinned = convert(ONE | {"boundary_conditions": [BOX, turn]})[0].object[0].pinned
    assert pinned[0].cylinder.radius == 0.2 and pinned[0].motion.angular_velocity == -1.5
    assert np.allclose(pinned[0].motion.pivot, (0.8, 0.8, 0.9))
    slab = {"type": "cuboid", "point": [1.2, 1, 1], "size": [0.4, 0.9, 0.9], "velocity": [0, 0, 1]}
    scene, lines = convert(ONE | {"boundary_conditions": [slab]})
    assert scene.object[0].pinned[0].motion.velocity == (0, 0, 1)
    assert "theirs holds what enters" in named(lines, "boundary_conditions.0")[0]


@pytest.mark.parametrize(
    "changes, also",
    [
        ({"start_time": 0.1}, {}),
        ({"end_time": 0.1}, {}),
        ({}, {"material": "sand"}),
        (
            {},
            {
                "additional_material_params": [
                    {"point": [1, 1, 1], "size": [0.1] * 3, "E": 1e6, "nu": 0.3}
                ]
            },
        ),
    ],
)
def test_a_part_that_is_not_held_as_here_is_named(convert, changes, also):
    part = HOLD | {"size": [0.4, 0.9, 0.9], "point": [1.2, 1, 1], "end_time": 1e3} | changes
    scene, lines = convert(ONE | also | {"boundary_conditions": [part]})
    assert not any(obj.pinned for obj in scene.object)
    assert "only whole bodies" in named(lines, "boundary_conditions.0")[0]


def test_layers_are_let_go(convert):
    layers = {
        "type": "release_particles_sequentially", "normal": [0, 0, 1], "start_position": 1.5,
        "end_position": 0.5, "num_layers": 50, "start_time": 0, "end_time": 0.5,
    }  # fmt: skip
    sand = ONE | {"material": "sand", "boundary_conditions": [layers]}
    body = convert(sand)[0].object[0]
    assert (body.release_time, body.release_end_time) == (pytest.approx(0.01), pytest.approx(0.5))
    assert body.release_order == "top-down"
    layers |= {"start_position": 0.5, "end_position": 1.5}
    assert (
        convert(sand | {"boundary_conditions": [layers]})[0].object[0].release_order == "bottom-up"
    )
    lines = convert(sand | {"boundary_conditions": [layers | {"normal": [1, 0, 0]}]})[1]
    assert "along z alone" in named(lines, "boundary_conditions.0")[0]


def test_an_impulse_is_that_of_all_particles(convert, capture):
    push = {"type": "particle_impulse", "force": [-0.2, 0, 0], "num_dt": 3, "start_time": 0.1}
    scene, lines = convert(ONE | {"boundary_conditions": [push]}, capture)
    assert scene.lists["load"][0].impulse == pytest.approx((-0.2 * 3e-4 * 810, 0, 0))
    assert scene.lists["load"][0].start_time == 0.1 and named(lines, "boundary_conditions.0")


def test_areas_and_filling(convert, capture):
    """A part of the capture moves, the rest is drawn; the part is what they scale."""
    filling = {"n_grid": 40, "max_partciels_per_cell": 1, "visualize": True, "smooth": True}
    config = ONE | {"sim_area": [2, 4, 0, 2, -9, -2], "particle_filling": filling}
    scene, lines = convert(config, capture)
    body, *rest = scene.object
    assert [thing.role for thing in rest] == ["scenery"]
    assert (body.fill, body.particles_per_cell) == ("visible", 8)
    made = build_scene(scene)
    assert np.allclose(made.x.min(axis=0)[2], 0.5, atol=0.05) and len(made.scenery.x) > 300
    keys = {line.split(":")[0] for line in lines}
    assert "particle_filling.smooth" in keys and "particle_filling.n_grid" not in keys
    turned = config | {"rotation_degree": [30], "rotation_axis": [0]}
    lines = convert(turned | {"sim_area": [-9, 9, -9, 9, -9, 9]}, capture)[1]
    assert "own axes" in named(lines, "sim_area")[0]


def test_what_comes_with_every_frame_is_an_inlet(convert):
    water = ({"material": "fluid", "bulk_modulus": 900}, {"center_point": [2, 2, 2.5]})
    more = {"boundary": [1.6, 2.4, 1.7, 2.3, 2.4, 2.6], "start_time": 0.04, "additional": 1}
    scene, lines = convert(several(water, add_particle=more))
    inlet = scene.lists["inlet"][0]
    assert (
        inlet.volume_flow_rate == pytest.approx(0.8 * 0.6 * 0.2 / 0.04) and inlet.start_time == 0.04
    )
    assert (inlet.rectangle.width, inlet.rectangle.height) == pytest.approx((0.8, 0.6))
    assert inlet.rectangle.center == pytest.approx((2, 2, 2.4)) and not scene.object
    scene, lines = convert(several(water, add_particle=more | {"additional": False}))
    assert not scene.lists["inlet"] and named(lines, "add_particle")


def test_what_only_pours_is_in_no_walls_way(convert, capture):
    plane = {"type": "add_plane", "x_plane": [1.8, 2.2], "y_plane": [0, 4], "z_plane": [0, 4]}
    water = ({"material": "fluid", "bulk_modulus": 900}, {"center_point": [2, 2, 2.5]})
    more = {"boundary": [1.6, 2.4, 1.7, 2.3, 2.4, 2.6], "additional": True}
    some = several(water, boundary_conditions=[plane])
    assert named(convert(some, capture)[1], "boundary_conditions.0.x_plane")
    scene, lines = convert(some | {"add_particle": more}, capture)
    assert scene.domain.size[0] == pytest.approx(0.4) and named(
        lines, "preprocess_params.0.model_path"
    )
    assert not named(lines, "boundary_conditions.0.x_plane")


def test_a_name_longer_than_files_allow_is_a_box(convert):
    """No file has the name: a box stands in, under a name that a scene may have."""
    scene, lines = convert(several(({}, {"center_point": [2, 2, 2.5], "model_path": "9" * 500})))
    (lost,) = named(lines, "preprocess_params.0.model_path")
    assert "File name too long" in lost
    assert scene.object[0].name.startswith("body 99") and len(scene.object[0].name) <= 120


def test_what_is_static_is_scenery(convert):
    bowl = ({"static": True, "E": 5e3}, {"center_point": [2, 2, 1]})
    ball = ({}, {"center_point": [2, 2, 2.5]})
    turn = TURN | {"point": [2, 2, 1], "object_index": 0, "start_time": 0.1, "end_time": 0.15}
    scene, lines = convert(several(bowl, ball, boundary_conditions=[turn]))
    assert scene.object[0].collider and scene.object[1].role == "body"
    frames = scene.object[0].motion.keyframes
    assert [(key.time, key.angle) for key in frames] == [(0.1, 0), (0.15, pytest.approx(-0.075))]
    assert named(lines, "material_params.0.E")
    assert named(lines, "material_params.0.static")

"""Where cameras stand and what they see."""

import numpy as np
import pytest

from vgmpi.gaussians.camera import Camera, fit_orbit_to_box, look_at, orbit_eye


def pixel(camera: Camera, point):
    p = camera.world_to_camera @ [*point, 1]
    return np.array([camera.fx * p[0], camera.fy * p[1]]) / p[2] + [camera.cx, camera.cy]


def test_look_at_puts_the_target_in_the_middle_and_up_upwards():
    c = look_at((1, -2, 0.5), (0.2, 0.1, 0.3), (0, 0, 1), 40, 640, 480)
    np.testing.assert_allclose(pixel(c, (0.2, 0.1, 0.3)), [320, 240])
    np.testing.assert_allclose(c.eye, (1, -2, 0.5), atol=1e-14)
    above = pixel(c, (0.2, 0.1, 0.4))
    assert above[1] < 240 and above[0] == pytest.approx(320)
    assert np.linalg.det(c.world_to_camera) == pytest.approx(1)


def test_east_is_right_when_looking_north():
    c = look_at((0, -2, 0), (0, 0, 0), (0, 0, 1), 40, 100, 100)
    assert pixel(c, (0.1, 0, 0))[0] > 50


def test_fov_is_the_vertical_angle():
    c = look_at((0, -2, 0), (0, 0, 0), (0, 0, 1), 60, 300, 200)
    np.testing.assert_allclose(pixel(c, (0, 0, 2 * np.tan(np.radians(30)))), [150, 0], atol=1e-10)


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("up", [(0, 0, 1), (1, 0, 0), (0, 1, 0), (1, 1, 1)])
def test_looking_along_up_still_gives_a_rigid_camera(side, up):
    c = look_at(side * 2.0 * np.array(up), (0, 0, 0), up, 40, 100, 100)
    R = c.world_to_camera[:3, :3]
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(pixel(c, (0, 0, 0)), [50, 50], atol=1e-9)


def test_a_camera_at_its_target_is_refused():
    with pytest.raises(ValueError, match="target"):
        look_at((1, 2, 3), (1, 2, 3), (0, 0, 1), 40, 100, 100)


def test_the_near_plane_shrinks_with_small_scenes_only():
    assert look_at((0, -8, 0), (0, 0, 0), (0, 0, 1), 40, 10, 10).near_plane == 0.2
    assert look_at((0, -1, 0), (0, 0, 0), (0, 0, 1), 40, 10, 10).near_plane == pytest.approx(0.05)
    assert look_at((0, -1, 0), (0, 0, 0), (0, 0, 1), 40, 10, 10, near_plane=0.3).near_plane == 0.3


@pytest.mark.parametrize("up", [(0, 0, 1), (0, -1, 0), (0, 1, 0), (1, 2, 3)])
def test_orbits_keep_distance_and_height(up):
    target = np.array([0.3, 0.4, 0.5])
    axis = np.array(up) / np.linalg.norm(up)
    eyes = np.array([orbit_eye(target, 2.0, 0.7, a, up) for a in range(0, 360, 30)])
    np.testing.assert_allclose(np.linalg.norm(eyes - target, axis=1), 2.0)
    np.testing.assert_allclose((eyes - target) @ axis, 0.7)
    np.testing.assert_allclose(eyes.mean(axis=0), target + 0.7 * axis, atol=1e-12)


def test_orbit_angles_start_in_the_south_and_go_east():
    np.testing.assert_allclose(orbit_eye(np.zeros(3), 1, 0, 0), [0, -1, 0], atol=1e-12)
    np.testing.assert_allclose(orbit_eye(np.zeros(3), 1, 0, 90), [1, 0, 0], atol=1e-12)


@pytest.mark.parametrize("size", [(1, 1, 1), (3, 0.5, 1), (0.1, 0.1, 2)])
@pytest.mark.parametrize("shape", [(800, 800), (1200, 300), (300, 900)])
def test_the_overview_has_the_box_in_view_and_fills_the_picture(size, shape):
    size, (width, height) = np.array(size), shape
    angles = np.arange(0, 360, 10)
    target, distance, up = fit_orbit_to_box(np.zeros(3), size, 40, width / height, angles)
    corners = np.indices((2, 2, 2)).reshape(3, -1).T * size
    closest = np.inf
    for angle in angles:
        eye = orbit_eye(target, distance, up, angle)
        c = look_at(eye, target, (0, 0, 1), 40, width, height)
        at = np.array([pixel(c, corner) for corner in corners])
        room = np.minimum(at, [width, height] - at).min()
        assert room > 0
        closest = min(closest, room / min(width, height))
    assert closest < 0.1

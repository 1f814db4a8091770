"""Pinhole cameras in the OpenCV convention: x to the right, y down, z forward."""

from dataclasses import dataclass, replace

import numpy as np

HEIGHT = 0.35  # of the eye above the target, as part of the distance, where nothing is asked for
NEAR = 0.2  # the usual near plane of Gaussian renderers, in the units of the scene


@dataclass(frozen=True)
class Camera:
    """world_to_camera: rigid (4, 4). fx, fy, cx, cy: focal lengths and centre [pixels].

    width, height: of the picture [pixels]. near: depth [m] before which nothing is drawn.
    """

    world_to_camera: np.ndarray
    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int
    near: float = NEAR

    @property
    def eye(self) -> np.ndarray:
        """Position in the world [m], (3,)."""
        rotation, shift = self.world_to_camera[:3, :3], self.world_to_camera[:3, 3]
        return -rotation.T @ shift


def look_at(
    eye: np.ndarray,
    target: np.ndarray,
    up: np.ndarray,
    fov: float,
    width: int,
    height: int,
    near: float | None = None,
) -> Camera:
    """A camera at `eye` that sees `target` in the middle of the picture.

    fov: vertical field of view [degrees]. up: the direction that points up in the picture. near: by
    default 0.2 m or a twentieth of the distance to the target, whichever is less, so that small
    scenes are not cut.
    """
    eye, target, up = (np.asarray(v, dtype=np.float64) for v in (eye, target, up))
    distance = np.linalg.norm(target - eye)
    if not distance > 0:
        raise ValueError("the camera stands at its target")
    forward = (target - eye) / distance
    right = np.cross(forward, up)
    if np.linalg.norm(right) < 1e-9 * np.linalg.norm(up):  # straight up or down: any right will do
        right = np.cross(forward, np.eye(3)[np.argmin(np.abs(forward))])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    world_to_camera = np.eye(4)
    world_to_camera[:3, :3] = rotation
    world_to_camera[:3, 3] = -rotation @ eye
    focal = 0.5 * height / np.tan(0.5 * np.radians(fov))
    near = min(NEAR, 0.05 * distance) if near is None else near
    return Camera(world_to_camera, focal, focal, width / 2, height / 2, width, height, near)


def through_lens(
    camera: Camera, aperture: float, focus: float, sample: int, samples: int
) -> Camera:
    """The camera from one of `samples` points of a lens of radius `aperture` [m], even over it (H.
    Vogel's spiral, 1979); what is at the depth `focus` [m] stays where it is in the picture."""
    turn = sample * np.pi * (3 - np.sqrt(5))
    off = aperture * np.sqrt((sample + 0.5) / samples) * np.array([np.cos(turn), np.sin(turn)])
    matrix = camera.world_to_camera.copy()
    matrix[:2, 3] -= off
    cx, cy = camera.cx + camera.fx * off[0] / focus, camera.cy + camera.fy * off[1] / focus
    return replace(camera, world_to_camera=matrix, cx=float(cx), cy=float(cy))


def orbit_eye(
    target: np.ndarray, distance: float, height: float, angle: float, up: np.ndarray = (0, 0, 1)
) -> np.ndarray:
    """Position on a circle around the axis `up` through `target`, (3,).

    distance: from target to eye [m]. height: of the eye above the target [m], within +- distance.
    angle: around the axis [degrees]; with up = z, angle 0 looks from -y (the south wall) and 90
    from +x.
    """
    target, axis = np.asarray(target, dtype=np.float64), np.asarray(up, dtype=np.float64)
    axis = axis / np.linalg.norm(axis)
    seed = np.array([0.0, -1.0, 0.0]) if abs(axis[1]) < 0.9 else np.array([0.0, 0.0, 1.0])
    first = seed - axis * (seed @ axis)
    first /= np.linalg.norm(first)
    second = np.cross(axis, first)
    height = float(np.clip(height, -0.999 * distance, 0.999 * distance))
    radius = np.sqrt(distance**2 - height**2)
    turn = np.radians(angle)
    return target + height * axis + radius * (np.cos(turn) * first + np.sin(turn) * second)


def overview(
    lower: np.ndarray,
    upper: np.ndarray,
    fov: float,
    aspect: float,
    angles: np.ndarray = (0.0,),
    up: np.ndarray = (0, 0, 1),
) -> tuple[np.ndarray, float, float]:
    """Target (3,), distance and height [m] of an orbit that keeps the box lower .. upper in view.

    aspect: width / height of the picture. angles: of the orbit [degrees]; the box fits at all of
    them, with a margin of 5 %.
    """
    lower, upper = np.asarray(lower, dtype=np.float64), np.asarray(upper, dtype=np.float64)
    target = 0.5 * (lower + upper)
    half = np.maximum(0.5 * (upper - lower), 1e-6)
    corners = half * (np.indices((2, 2, 2)).reshape(3, -1).T * 2 - 1)
    slope = np.tan(0.5 * np.radians(fov))
    distance = 0.0
    for angle in angles:
        eye = orbit_eye(np.zeros(3), 1.0, HEIGHT, angle, up)
        rotation = look_at(eye, np.zeros(3), up, fov, 1, 1).world_to_camera[:3, :3]
        x, y, z = rotation @ corners.T
        reach = np.maximum(np.abs(x) / (slope * aspect), np.abs(y) / slope)
        distance = max(distance, float((reach - z).max()))
    return target, 1.05 * distance, HEIGHT * 1.05 * distance

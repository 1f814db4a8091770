"""Pinhole cameras in the OpenCV convention: x to the right, y down, z forward."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

HEIGHT = 0.35  # [distances] default height of the eye above the target
MIN_AXIS_DEPTH = 1e-3  # [distances] least depth of a point that a viewer turns about
NEAR_PLANE = 0.2  # [scene units] usual near plane of Gaussian renderers


@dataclass(frozen=True)
class Camera:
    """Pinhole camera with its pose, intrinsics and picture size.

    Attributes:
        world_to_camera: Rigid transform, shape (4, 4).
        fx, fy: Focal lengths [pixels].
        cx, cy: Principal point [pixels].
        width, height: Picture size [pixels].
        near_plane: Depth of the near plane [m]; nothing closer is drawn.
    """

    world_to_camera: np.ndarray
    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int
    near_plane: float = NEAR_PLANE

    @property
    def eye(self) -> np.ndarray:
        """Position in the world, shape (3,) [m]."""
        rotation, shift = self.world_to_camera[:3, :3], self.world_to_camera[:3, 3]
        return -rotation.T @ shift

    def axis_point(self, point: np.ndarray) -> np.ndarray:
        """Return the point on the camera's axis at the depth of a point, both of shape (3,) [m].

        A point behind the eye has the depth MIN_AXIS_DEPTH, in its distances from the eye.
        """
        forward, offset = self.world_to_camera[2, :3], point - self.eye
        min_depth = MIN_AXIS_DEPTH * (float(np.linalg.norm(offset)) or 1.0)
        return self.eye + max(float(forward @ offset), min_depth) * forward

    def pixels(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return pixel positions (n, 2) and depths (n,) [m] of points (n, 3).

        Pixels of points that are not in front of the camera mean nothing.
        """
        local = points @ self.world_to_camera[:3, :3].T + self.world_to_camera[:3, 3]
        depth = local[:, 2]
        safe_depth = np.where(depth > 0, depth, 1.0)[:, None]
        return local[:, :2] / safe_depth * (self.fx, self.fy) + (self.cx, self.cy), depth

    def vertical_fov(self, aspect: float | None = None) -> float:
        """Return the vertical field of view of a window that shows all of the picture [rad].

        Args:
            aspect: Width of the window over its height; None is that of the picture.
        """
        height = self.height if aspect is None else max(self.height, self.width / aspect)
        return float(2 * np.arctan(0.5 * height / self.fy))


def look_at(
    eye: np.ndarray,
    target: np.ndarray,
    up: ArrayLike,
    fov: float,
    width: int,
    height: int,
    near_plane: float | None = None,
) -> Camera:
    """Return a camera at `eye` whose picture is centered on `target`.

    Args:
        eye: Position of the camera, shape (3,) [m].
        target: Point in the middle of the picture, shape (3,) [m].
        up: Direction that points up in the picture, shape (3,).
        fov: Vertical field of view [degrees].
        width, height: Picture size [pixels].
        near_plane: Depth of the near plane [m]. The default is 0.2 m or a twentieth of the distance
            to the target, whichever is less, so that small scenes are not cut.

    Raises:
        ValueError: If the eye and the target coincide.
    """
    eye, target, up = (np.asarray(v, dtype=np.float64) for v in (eye, target, up))
    distance = np.linalg.norm(target - eye)
    if not distance > 0:
        raise ValueError("the camera stands at its target")
    forward = (target - eye) / distance
    right = np.cross(forward, up)
    if np.linalg.norm(right) < 1e-9 * np.linalg.norm(up):  # a vertical view has no preferred right
        right = np.cross(forward, np.eye(3)[np.argmin(np.abs(forward))])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    world_to_camera = np.eye(4)
    world_to_camera[:3, :3] = rotation
    world_to_camera[:3, 3] = -rotation @ eye
    focal = 0.5 * height / np.tan(0.5 * np.radians(fov))
    near = min(NEAR_PLANE, float(0.05 * distance)) if near_plane is None else near_plane
    return Camera(world_to_camera, focal, focal, width / 2, height / 2, width, height, near)


def thin_lens_sample(
    camera: Camera, aperture: float, focus: float, sample: int, samples: int
) -> Camera:
    """Return the camera moved to one of `samples` points of a thin lens.

    The points fill the lens evenly. Points at the depth `focus` keep their place in the picture.

    Args:
        camera: Camera at the center of the lens.
        aperture: Radius of the lens [m].
        focus: Depth of the plane in focus [m].
        sample: Index of the point, 0 to samples - 1.
        samples: Number of points.

    References:
        H. Vogel 1979 (spiral of points).
    """
    angle = sample * np.pi * (3 - np.sqrt(5))
    offset = aperture * np.sqrt((sample + 0.5) / samples) * np.array([np.cos(angle), np.sin(angle)])
    matrix = camera.world_to_camera.copy()
    matrix[:2, 3] -= offset
    cx, cy = camera.cx + camera.fx * offset[0] / focus, camera.cy + camera.fy * offset[1] / focus
    return replace(camera, world_to_camera=matrix, cx=float(cx), cy=float(cy))


def orbit_eye(
    target: np.ndarray, distance: float, height: float, angle: float, up: ArrayLike = (0, 0, 1)
) -> np.ndarray:
    """Return a position on a circle around the axis `up` through `target`.

    Args:
        target: Point on the axis, shape (3,) [m].
        distance: Distance from the target to the eye [m].
        height: Height of the eye above the target [m], clamped to 0.999 * distance in size.
        angle: Angle around the axis [degrees]. With up = z, angle 0 looks from -y (the south wall)
            and 90 from +x.
        up: Axis of the circle, shape (3,).

    Returns:
        Position of the eye, shape (3,) [m].
    """
    target, axis = np.asarray(target, dtype=np.float64), np.asarray(up, dtype=np.float64)
    axis = axis / np.linalg.norm(axis)
    seed = np.array([0.0, -1.0, 0.0]) if abs(axis[1]) < 0.9 else np.array([0.0, 0.0, 1.0])
    first = seed - axis * (seed @ axis)
    first /= np.linalg.norm(first)
    second = np.cross(axis, first)
    height = float(np.clip(height, -0.999 * distance, 0.999 * distance))
    radius = np.sqrt(distance**2 - height**2)
    radians = np.radians(angle)
    return target + height * axis + radius * (np.cos(radians) * first + np.sin(radians) * second)


def fit_orbit_to_box(
    lower: np.ndarray,
    upper: np.ndarray,
    fov: float,
    aspect: float,
    angles: Iterable[float] = (0.0,),
    up: ArrayLike = (0, 0, 1),
) -> tuple[np.ndarray, float, float]:
    """Fit an orbit that keeps an axis-aligned box in view, with a margin of 5 %.

    Args:
        lower, upper: Corners of the box, shape (3,) [m].
        fov: Vertical field of view [degrees].
        aspect: Width over height of the picture.
        angles: Angles of the orbit [degrees]; the box fits at all of them.
        up: Axis of the orbit, shape (3,).

    Returns:
        Target, shape (3,) [m], distance [m] and height [m] of the orbit.
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

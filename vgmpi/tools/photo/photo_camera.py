"""Pinhole camera of the photograph: pixels to directions and back.

All coordinates are upright and relative to the eye: x to the right, y away from it, level, z up.
"""

from dataclasses import dataclass

import numpy as np

from vgmpi.gaussians.camera import Camera, look_at


@dataclass(frozen=True)
class View:
    """Pinhole camera at the origin of the upright axes."""

    width: int  # [pixels]
    height: int  # [pixels]
    fov: float  # [degrees] vertical field of view
    pitch: float  # [degrees] angle by which the camera looks down

    @property
    def focal(self) -> float:
        """Return the focal length [pixels]."""
        return 0.5 * self.height / float(np.tan(0.5 * np.radians(self.fov)))

    @property
    def forward(self) -> np.ndarray:
        """Return the unit direction of the optical axis, shape (3,)."""
        down = np.radians(self.pitch)
        return np.array([0.0, np.cos(down), -np.sin(down)])

    def camera(self, eye: np.ndarray, near_plane: float | None = None) -> Camera:
        """Return the splatter's camera at `eye` (3,); near_plane as in look_at()."""
        eye = np.asarray(eye, dtype=np.float64)
        target = eye + self.forward
        return look_at(
            eye, target, np.array([0.0, 0.0, 1.0]), self.fov, self.width, self.height, near_plane
        )

    def rotation(self) -> np.ndarray:
        """Return the rotation (3, 3) with the rows right, down and forward of the picture."""
        return self.camera(np.zeros(3)).world_to_camera[:3, :3]

    def pixels(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Project points (..., 3) about the eye.

        Returns:
            Pixel positions (..., 2) and depths (...) along the axis in the units of the points;
            points behind the camera get NaN.
        """
        camera_points = np.asarray(x) @ self.rotation().T
        depth = camera_points[..., 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            flat = (
                self.focal * camera_points[..., :2] / np.where(depth > 0, depth, np.nan)[..., None]
            )
        return flat + (self.width / 2, self.height / 2), depth

    def rays(self, pixels: np.ndarray) -> np.ndarray:
        """Return directions (..., 3) of pixels (..., 2), scaled to a depth of 1 along the axis."""
        flat = (np.asarray(pixels) - (self.width / 2, self.height / 2)) / self.focal
        return np.concatenate([flat, np.ones((*flat.shape[:-1], 1))], axis=-1) @ self.rotation()

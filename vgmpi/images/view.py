"""The camera of the photograph, between pixels and directions.

All is told in upright axes about the eye: x to the right, y away from it, level, z up.
"""

from dataclasses import dataclass

import numpy as np

from vgmpi.splatting.camera import Camera, look_at


@dataclass(frozen=True)
class View:
    """width, height: of the picture [pixels]. fov: vertical [degrees]. pitch: by how much the
    camera looks down [degrees]."""

    width: int
    height: int
    fov: float
    pitch: float

    @property
    def focal(self) -> float:
        """Focal length [pixels]."""
        return 0.5 * self.height / float(np.tan(0.5 * np.radians(self.fov)))

    @property
    def forward(self) -> np.ndarray:
        """Where the middle of the picture is, (3,)."""
        down = np.radians(self.pitch)
        return np.array([0.0, np.cos(down), -np.sin(down)])

    def camera(self, eye: np.ndarray, near: float | None = None) -> Camera:
        """The camera at `eye` (3,) for the splatter; near: as of look_at()."""
        eye = np.asarray(eye, dtype=np.float64)
        target = eye + self.forward
        return look_at(
            eye, target, np.array([0.0, 0.0, 1.0]), self.fov, self.width, self.height, near
        )

    def rotation(self) -> np.ndarray:
        """Rows: right, down and forward of the picture, (3, 3)."""
        return self.camera(np.zeros(3)).world_to_camera[:3, :3]

    def pixels(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Places in the picture (..., 2) [pixels] of points (..., 3) about the eye, and their
        depths along its axis (...), in the units of the points; what lies behind has NaN."""
        seen = np.asarray(x) @ self.rotation().T
        depth = seen[..., 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            flat = self.focal * seen[..., :2] / np.where(depth > 0, depth, np.nan)[..., None]
        return flat + (self.width / 2, self.height / 2), depth

    def rays(self, at: np.ndarray) -> np.ndarray:
        """Directions (..., 3) of places in the picture (..., 2) [pixels], as long as they reach a
        depth of 1 along its axis."""
        flat = (np.asarray(at) - (self.width / 2, self.height / 2)) / self.focal
        return np.concatenate([flat, np.ones((*flat.shape[:-1], 1))], axis=-1) @ self.rotation()

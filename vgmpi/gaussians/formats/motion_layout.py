"""Layout of moving Gaussians in one stream of bytes: header, rest Gaussians, frames.

docs/reference/web-format.md describes it for other readers.
"""

from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np

MAGIC = b"VGMPIWEB"
VERSION = 1
KEY_INTERVAL = 12  # [frames] from one key frame to the next

STATIC, POSED, FREE = "static", "posed", "free"  # how the centers of a group move
FIXED, SIZE, DEFORMATION = "fixed", "size", "deformation"  # how their shapes change
SHAPE_CHANNELS = {FIXED: 0, SIZE: 1, DEFORMATION: 10}
# [-] size of one unit of the stored integers; positions have a step of their own
STEPS = {"size": 1 / 128, "rotation": 1 / 64, "stretch": 1 / 64, "color": 1 / 100}


@dataclass(frozen=True)
class MotionGroup:
    """Consecutive Gaussians that move in the same manner.

    Attributes:
        name: Name of the object.
        count: Number of Gaussians.
        motion: STATIC, POSED (a rigid pose per frame) or FREE (a position per Gaussian and frame).
        shape: FIXED, SIZE (one factor) or DEFORMATION (rotation and stretch); FIXED unless FREE.
        color: Whether the colors are stored in each frame.
        pose: Index of the pose of a POSED group.
        compensated_lowpass: Variance of its antialiased training [pixels^2], 0 for none.
    """

    name: str
    count: int
    motion: str
    shape: str = FIXED
    color: bool = False
    pose: int = -1
    compensated_lowpass: float = 0.0

    @property
    def channels(self) -> int:
        """Number of integers per Gaussian and frame."""
        if self.motion != FREE:
            return 0
        return 3 + SHAPE_CHANNELS[self.shape] + 3 * self.color

    def to_json(self) -> dict[str, Any]:
        """Return its entry in the header, without the lowpass if it has none."""
        entry = asdict(self)
        if not self.compensated_lowpass:
            del entry["compensated_lowpass"]
        return entry


class RestGaussians(NamedTuple):
    """Values that do not change from frame to frame, in the order of the groups.

    Attributes:
        x: Centers at rest, shape (n, 3) [m].
        root: Square roots of the covariances at rest, upper triangles, shape (n, 6) [m].
        opacity: Opacities, shape (n,).
        sh: Color coefficients, shape (n, K, 3).
    """

    x: np.ndarray
    root: np.ndarray
    opacity: np.ndarray
    sh: np.ndarray


class GroupState(NamedTuple):
    """State of a FREE group in one frame.

    Attributes:
        present: Whether each Gaussian exists, shape (n,); the other arrays have a row for each
            that does.
        x: Centers, shape (m, 3) [m].
        size: Factors on the lengths of SIZE groups, shape (m,).
        quat: Rotations of DEFORMATION groups as w, x, y, z, shape (m, 4).
        stretch: Right stretches of DEFORMATION groups, upper triangles, shape (m, 6).
        color: Colors 0..1 without view dependence, shape (m, 3).
    """

    present: np.ndarray
    x: np.ndarray
    size: np.ndarray | None = None
    quat: np.ndarray | None = None
    stretch: np.ndarray | None = None
    color: np.ndarray | None = None


IDENTITY = np.array([1.0, 0, 0, 1, 0, 1])  # upper triangle of the unit matrix

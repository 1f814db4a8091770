"""Scene of viser, whose unit of length is a grid cell.

viser sends covariances in half precision, whose smallest number is 6e-8 and whose largest is 65504.
In meters, Gaussians of less than 0.2 mm would be points; in cells, those of all scenes are alike.
"""

from typing import Any, NamedTuple

import numpy as np

from vgmpi.gaussians.camera import Camera

MAX_HALF = float(np.finfo(np.float16).max)  # [-] largest number of half precision
FAR_DISTANCE = 100.0  # [reaches] far plane; viser shows no Gaussian beyond
NEAR_DISTANCE = 1e-4  # [reaches] near plane
MATRIX_INDICES = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))  # matrix indices of cov (n, 6)


class ViewerCamera(NamedTuple):
    """Camera of viser."""

    position: tuple[float, float, float]  # eye [cells]
    look_at: tuple[float, float, float]  # point about which a viewer turns [cells]
    fov: float  # vertical field of view [rad]
    near_plane: float  # distance [cells]
    far_plane: float  # distance [cells]

    def set_as(self, camera: Any) -> None:
        """Make a camera of viser this one, the first of all viewers or that of one."""
        camera.position, camera.look_at = self.position, self.look_at
        camera.fov, camera.near, camera.far = self.fov, self.near_plane, self.far_plane


def viewer_camera(camera: Camera, box: tuple[np.ndarray, np.ndarray], cell: float) -> ViewerCamera:
    """Return viser's camera that turns about the middle of a scene.

    Args:
        camera: Camera [m].
        box: Lower and upper corner of what is visible, shape (3,) each [m].
        cell: Edge of a grid cell [m].
    """
    center = 0.5 * (box[0] + box[1])
    # from the eye to the end of the scene
    reach = float(np.linalg.norm(box[1] - box[0]) + np.linalg.norm(center - camera.eye)) / cell
    position, look_at = (
        tuple((point / cell).tolist()) for point in (camera.eye, camera.axis_point(center))
    )
    planes = NEAR_DISTANCE * reach, FAR_DISTANCE * reach
    return ViewerCamera(position, look_at, camera.vertical_fov(), *planes)


def show_domain(scene: Any, box: tuple[np.ndarray, np.ndarray], cell: float) -> None:
    """Show the edges of the domain.

    Args:
        scene: Scene of viser.
        box: Lower and upper corner, shape (3,) each [m].
        cell: Edge of a grid cell [m].
    """
    edges = (box_edges(*box) / cell).astype(np.float32)
    scene.add_line_segments(
        "/domain", edges, colors=(150, 150, 150), thickness=1.0, thickness_units="screen"
    )


def splat_arrays(
    x: np.ndarray, cov: np.ndarray, color: np.ndarray, opacity: np.ndarray, cell: float
) -> dict[str, np.ndarray]:
    """Return viser's arrays of Gaussians.

    A Gaussian with a covariance beyond half precision, of some 256 cells, is shown smaller.

    Args:
        x: Centers, shape (n, 3) [m].
        cov: Covariances, shape (n, 6) [m2].
        color: Colors, shape (n, 3), in 0..1; others are clipped.
        opacity: Opacities, shape (n,).
        cell: Edge of a grid cell [m].
    """
    cov = cov / cell**2
    cov *= (MAX_HALF / np.maximum(cov[:, (0, 3, 5)].max(axis=1, initial=0), MAX_HALF))[:, None]
    matrices = np.empty((len(cov), 3, 3), dtype=np.float32)
    for k, (i, j) in enumerate(MATRIX_INDICES):
        matrices[:, i, j] = matrices[:, j, i] = cov[:, k]
    return {
        "centers": (x / cell).astype(np.float32),
        "covariances": matrices,
        "rgbs": np.clip(color, 0, 1).astype(np.float32),
        "opacities": opacity[:, None].astype(np.float32),
    }


def box_edges(lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Return the edges of a box, shape (12, 2, 3)."""
    corners = np.indices((2, 2, 2)).reshape(3, -1).T
    pairs = [(a, b) for a in corners for b in corners if (b - a).sum() == 1 and (b >= a).all()]
    return lower + np.array(pairs) * (upper - lower)

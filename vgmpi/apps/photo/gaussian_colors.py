"""Colored Gaussians on a surface, with the colors of the photograph."""

import numpy as np
from scipy import ndimage

from vgmpi.gaussians.cloud import GaussianCloud
from vgmpi.gaussians.spherical_harmonics import dc_from_rgb
from vgmpi.preprocess.meshes import surface_mesh
from vgmpi.preprocess.meshes.surface_mesh import Mesh

from .photo_camera import View

MAX_GAUSSIANS = 60_000  # upper limit of the Gaussians of a body
OPACITY = 0.95  # [-] of every Gaussian of a body
MIXED_EDGE_PIXELS = 2  # [pixels] along an outline colors are mixed with the background


def gaussians(
    body: Mesh, rgb: np.ndarray, mask: np.ndarray, view: View, seed: int
) -> GaussianCloud:
    """Cover a body about the eye with flat Gaussians, one per pixel up to MAX_GAUSSIANS.

    Each has the color of the pixel in which it would be seen if nothing covered it: the back
    mirrors the front.

    Args:
        body: Surface about the eye.
        rgb: Photograph, shape (height, width, 3) uint8.
        mask: The object, shape (height, width) bool.
        view: Camera of the photograph.
        seed: Seed of the sampling; equal seeds give equal bits.
    """
    pixel = 1 / view.focal
    corner = body.corners()
    cross = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    area = float(np.linalg.norm(cross, axis=1).sum() / 2)
    spacing = max(pixel, np.sqrt(area / MAX_GAUSSIANS))
    cloud = surface_mesh.sample(body, 2 * spacing, (0.5, 0.5, 0.5), OPACITY, [seed])
    pixels, _ = view.pixels(cloud.x)
    color = sample_picture(extend_colors(rgb, mask), pixels)
    sh = dc_from_rgb(color)[:, None, :].astype(np.float32)
    return GaussianCloud(cloud.x, cloud.quat, cloud.scale, cloud.opacity, sh)


def extend_colors(rgb: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Return colors 0..1 (height, width, 3) without any background.

    Every pixel takes the color of the nearest pixel well inside the mask.
    """
    interior = mask
    for _ in range(MIXED_EDGE_PIXELS):
        eroded = ndimage.binary_erosion(interior)
        interior = eroded if eroded.sum() > 0.3 * mask.sum() else interior
    nearest = ndimage.distance_transform_edt(~interior, return_distances=False, return_indices=True)
    return rgb[nearest[0], nearest[1]].astype(np.float64) / 255


def sample_picture(picture: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Interpolate a picture (height, width, 3) at pixels (n, 2); returns (n, 3) in 0..1."""
    coordinates = np.nan_to_num(pixels[:, ::-1].T - 0.5)
    channels = [
        ndimage.map_coordinates(picture[..., k], coordinates, order=1, mode="nearest")
        for k in range(3)
    ]
    return np.clip(np.stack(channels, axis=-1), 0, 1)

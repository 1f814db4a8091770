"""Colored Gaussians on a surface, with the colors of the photograph."""

from dataclasses import replace

import numpy as np
from scipy import ndimage

from vgmpi.gaussians.cloud import (
    GaussianCloud,
    pack_symmetric,
    principal_axes,
    rotation_matrices,
)
from vgmpi.gaussians.spherical_harmonics import dc_from_rgb
from vgmpi.preprocess.meshes import surface_mesh
from vgmpi.preprocess.meshes.triangle_mesh import Mesh

from .photo_camera import View

MAX_GAUSSIANS = 200_000  # upper limit of the Gaussians of a body
MIN_GAUSSIANS = 4000  # lower limit of them
OPACITY = 0.95  # [-] of every Gaussian of a body
SPACING = 1.0  # [pixels] between Gaussians, as the camera sees them
SLANT = 0.4  # [-] factor on depths: at a slant, Gaussians are up to 1 / SLANT times as long
MIN_DEPTH = 0.1  # [-] least depth of a point relative to the largest depth of its body
MIXED_EDGE_PIXELS = 1  # [pixels] along an outline colors are mixed with the background
LIQUID_EDGE_PIXELS = 3  # [pixels] along the outline of a liquid are mixed with its cup


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
    cloud = _sampled(body, view, seed)
    pixels, _ = view.pixels(cloud.x)
    color = np.clip(sample_picture(extend_colors(rgb, mask), pixels), 0, 1)
    return replace(cloud, sh=dc_from_rgb(color)[:, None, :].astype(np.float32))


def _sampled(body: Mesh, view: View, seed: int) -> GaussianCloud:
    """Return Gaussians without colors that are evenly spaced as the camera sees them.

    The body is sampled in coordinates of the picture: column, row, and the logarithm of the depth,
    scaled so that lengths are those of the pixels, times SLANT. Surfaces that are seen at a slant
    have fewer Gaussians, which are longer.
    """
    scale = SLANT * view.focal
    pixels, depth = view.pixels(body.points)
    depth = np.maximum(depth, MIN_DEPTH * depth.max())
    points = np.column_stack([np.nan_to_num(pixels), scale * np.log(depth)])
    picture = Mesh(points, body.triangles)
    corner = picture.corners()
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    area = float(np.linalg.norm(normal, axis=1).sum() / 2)
    spacing = max(SPACING, np.sqrt(area / MAX_GAUSSIANS))
    cloud = surface_mesh.sample(
        picture, 2 * spacing, (0.5, 0.5, 0.5), OPACITY, [seed], MIN_GAUSSIANS
    )  # fmt: skip
    position, shape = cloud.x, rotation_matrices(cloud.quat) * cloud.scale[:, None]
    ray, depth = view.rays(position[:, :2]), np.exp(position[:, 2] / scale)[:, None]
    rotation = view.rotation()
    across = np.broadcast_to(rotation[:2], (len(ray), 2, 3))
    derivative = np.concatenate([across, ray[:, None] / SLANT], axis=1).swapaxes(1, 2)
    shape = derivative @ shape * (depth / view.focal)[:, None]
    quat, deviation = principal_axes(pack_symmetric(shape @ shape.swapaxes(1, 2)))
    return GaussianCloud(ray * depth, quat, deviation, cloud.opacity, np.zeros((len(ray), 1, 3)))


def extend_colors(rgb: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Return colors 0..1 (height, width, 3) without any background.

    Every pixel takes the color of the nearest pixel well inside the mask.
    """
    rows, columns = interior_pixels(mask)
    return rgb[rows, columns].astype(np.float64) / 255


def interior_pixels(mask: np.ndarray) -> np.ndarray:
    """Return row and column (2, height, width) of the nearest pixel well inside a mask."""
    interior = _eroded(mask, MIXED_EDGE_PIXELS)
    return ndimage.distance_transform_edt(~interior, return_distances=False, return_indices=True)


def liquid_interior(mask: np.ndarray) -> np.ndarray:
    """Return the pixels (height, width) bool well inside the mask of a liquid in a cup."""
    return _eroded(mask, LIQUID_EDGE_PIXELS)


def _eroded(mask: np.ndarray, pixels: int) -> np.ndarray:
    """Return a mask (height, width) without its edge, of which 0.3 of its pixels are left."""
    interior = mask
    for _ in range(pixels):
        smaller = ndimage.binary_erosion(interior)
        interior = smaller if smaller.sum() > 0.3 * mask.sum() else interior
    return interior


def sample_picture(picture: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Interpolate a picture (height, width, 3) at pixels (n, 2); returns (n, 3)."""
    coordinates = np.nan_to_num(pixels[:, ::-1].T - 0.5)
    channels = [
        ndimage.map_coordinates(picture[..., k], coordinates, order=1, mode="nearest")
        for k in range(3)
    ]
    return np.stack(channels, axis=-1)

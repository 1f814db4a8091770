"""Colored Gaussians on a surface, for which the first frame is the photograph.

A body is not quite as its mask, and a Gaussian is wider than the pixel from which it took its
color, so that bodies would be drawn blurred. What is seen of a body first takes the color that the
photograph has there, if that pixel is of any object. Each iteration then draws the first frame and
adds what it lacks to the colors, at the pixel where each Gaussian is seen: the deconvolution of van
Cittert 1931, whose blur is the rasterizer.
"""

from dataclasses import replace

import numpy as np
from scipy import ndimage

from vgmpi.gaussians.camera import Camera
from vgmpi.gaussians.cloud import (
    GaussianCloud,
    pack_symmetric,
    principal_axes,
    rotation_matrices,
)
from vgmpi.gaussians.spherical_harmonics import dc_from_rgb
from vgmpi.preprocess.meshes import surface_mesh
from vgmpi.preprocess.meshes.triangle_mesh import Mesh

from . import preview
from .photo_camera import View

MAX_GAUSSIANS = 200_000  # upper limit of the Gaussians of a body
MIN_GAUSSIANS = 4000  # lower limit of them
OPACITY = 0.95  # [-] of every Gaussian of a body
SPACING = 1.0  # [pixels] between Gaussians, as the camera sees them
SLANT = 0.4  # [-] factor on depths: at a slant, Gaussians are up to 1 / SLANT times as long
MIN_DEPTH = 0.1  # [-] least depth of a point relative to the largest depth of its body
MIXED_EDGE_PIXELS = 1  # [pixels] along an outline colors are mixed with the background
LIQUID_EDGE_PIXELS = 3  # [pixels] along the outline of a liquid are mixed with its cup
ITERATIONS = 8
MAX_CORRECTION = 0.25  # [-] largest change of a color 0..1: gaps cannot be closed by colors
LAYER = 3.0  # [standard deviations] Gaussians this far behind the visible surface are part of it


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


def correct_colors(
    clouds: list[GaussianCloud],
    masks: list[np.ndarray | None],
    camera: Camera,
    rgb: np.ndarray,
    background: np.ndarray,
) -> list[GaussianCloud]:
    """Return clouds whose first frame is nearer to the photograph.

    Args:
        clouds: Bodies in their places.
        masks: Object of each, (height, width) bool; None for a body that keeps its colors.
        camera: Camera of the photograph.
        rgb: Photograph, shape (height, width, 3) uint8.
        background: What is seen behind the bodies, shape (height, width, 3) uint8.
    """
    photo, under = rgb / 255.0, background / 255.0
    objects = [mask for mask in masks if mask is not None]
    if not objects:
        return clouds
    rows, columns = interior_pixels(np.logical_or.reduce(objects))
    surface = ndimage.maximum_filter(preview.depth(clouds, camera), 3)
    visible = [_visible(cloud, camera, surface) for cloud in clouds]
    corrected = [k for k, mask in enumerate(masks) if mask is not None]
    clouds, first = list(clouds), {}
    for k in corrected:
        pixels, is_visible = visible[k]
        first[k] = sample_picture(photo[rows, columns], pixels[is_visible])
        clouds[k] = _colored(clouds[k], is_visible, first[k])
    for _ in range(ITERATIONS):
        missing = (photo - preview.frame(clouds, camera, under))[rows, columns]
        for k in corrected:
            pixels, is_visible = visible[k]
            change = clouds[k].rgb[is_visible] - first[k]
            change += sample_picture(missing, pixels[is_visible])
            color = first[k] + np.clip(change, -MAX_CORRECTION, MAX_CORRECTION)
            clouds[k] = _colored(clouds[k], is_visible, color)
    return clouds


def _visible(
    cloud: GaussianCloud, camera: Camera, surface: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the pixels (n, 2) of Gaussians, and whether they are visible, (n,) bool.

    Args:
        cloud: Gaussians in their places.
        camera: Camera of the photograph.
        surface: Depth of the visible surface, shape (height, width) [m].
    """
    pixels, depth = camera.pixels(cloud.x)
    index = np.clip(pixels.astype(int), 0, (camera.width - 1, camera.height - 1))
    distance = depth - surface[index[:, 1], index[:, 0]]
    return pixels, distance < LAYER * cloud.scale.max(axis=1)


def _colored(cloud: GaussianCloud, rows: np.ndarray, color: np.ndarray) -> GaussianCloud:
    """Return Gaussians of which some rows (n,) bool have colors (m, 3), clipped to 0..1."""
    sh = cloud.sh.copy()
    sh[rows, 0] = dc_from_rgb(np.clip(color, 0, 1))
    return replace(cloud, sh=sh)

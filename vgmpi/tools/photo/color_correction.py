"""Colors of Gaussians for which the first frame is the photograph.

A body is not quite as its mask, and a Gaussian is wider than the pixel from which it took its
color, so that bodies would be drawn blurred. What is seen of a body first takes the color that the
photograph has there, if that pixel is of any object. Each iteration then draws the first frame and
adds what it lacks to the colors, at the pixel where each Gaussian is seen: the deconvolution of
van Cittert 1931, whose blur is the rasterizer.
"""

from dataclasses import replace

import numpy as np
from scipy import ndimage

from vgmpi.gaussians.camera import Camera
from vgmpi.gaussians.cloud import GaussianCloud
from vgmpi.gaussians.spherical_harmonics import dc_from_rgb

from . import preview
from .gaussian_colors import interior_pixels, sample_picture

ITERATIONS = 8
MAX_CORRECTION = 0.25  # [-] largest change of a color 0..1: gaps cannot be closed by colors
LAYER = 3.0  # [standard deviations] Gaussians this far behind the visible surface are part of it


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

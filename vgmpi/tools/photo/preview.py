"""Preview pictures: the first frame, check.png, and crops of the objects."""

import numpy as np
from scipy import ndimage

from vgmpi.gaussians import spherical_harmonics
from vgmpi.gaussians.camera import Camera
from vgmpi.gaussians.cloud import GaussianCloud
from vgmpi.postprocess.raster import rasterize
from vgmpi.postprocess.raster.psnr import psnr
from vgmpi.postprocess.studio import tone_mapping
from vgmpi.postprocess.studio.studio_renderer import EDGE_OVERSAMPLING

CROP_MARGIN = 1.2  # [-] edge of the square crop for generators relative to the box's longer side


def frame(clouds: list[GaussianCloud], camera: Camera, background: np.ndarray) -> np.ndarray:
    """Render clouds before a background (height, width, 3) in 0..1, as the studio draws solids.

    Linear light is blended, more pixels are drawn across and down, and their display values are
    averaged.
    """
    fine = rasterize.supersampled_camera(camera, EDGE_OVERSAMPLING)
    light = tone_mapping.to_linear(np.asarray(background, dtype=np.float64))
    under = rasterize.background_image(light, camera, EDGE_OVERSAMPLING)
    light, transmittance = rasterize.render(_splats(clouds, camera), fine, under)
    drawn = np.empty(light.shape, dtype=np.float32)
    tone_mapping.show(light, 0, drawn)
    return rasterize.box_downsample((drawn, transmittance), EDGE_OVERSAMPLING)[0]


def depth(clouds: list[GaussianCloud], camera: Camera) -> np.ndarray:
    """Return the depth of the visible surface (height, width) [m], infinite beside clouds."""
    return rasterize.render(_splats(clouds, camera), camera, depth="median")[2]


def _splats(clouds: list[GaussianCloud], camera: Camera) -> rasterize.ProjectableGaussians:
    """Return the Gaussians of all clouds, with their linear colors."""
    color = [spherical_harmonics.evaluate(cloud.sh, cloud.x - camera.eye) for cloud in clouds]
    return rasterize.ProjectableGaussians(
        np.concatenate([cloud.x for cloud in clouds]),
        np.concatenate([cloud.cov() for cloud in clouds]),
        np.concatenate([cloud.opacity for cloud in clouds]),
        tone_mapping.to_linear(np.concatenate(color)),
    )


def psnr_in_mask(drawn: np.ndarray, rgb: np.ndarray, mask: np.ndarray) -> float:
    """Return the PSNR [dB] of a frame (height, width, 3) in 0..1 inside a mask."""
    return psnr((drawn[mask] - rgb[mask] / 255.0) ** 2)


def comparison_image(rgb: np.ndarray, drawn: np.ndarray, masks: list[np.ndarray]) -> np.ndarray:
    """Join the photograph with its outlines and the first frame side by side, uint8."""
    left = rgb.copy()
    for mask in masks:
        left[mask ^ ndimage.binary_erosion(mask, iterations=1)] = (255, 0, 255)
    right = (255 * drawn + 0.5).astype(np.uint8)
    return np.concatenate([left, np.full((len(rgb), 6, 3), 255, np.uint8), right], axis=1)


def crop(rgb: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Return an object alone (n, n, 4) uint8, centered in a square, transparent around it."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    middle = (rows[0] + rows[-1] + 1) // 2, (columns[0] + columns[-1] + 1) // 2
    side = int(np.ceil(CROP_MARGIN * max(np.ptp(rows), np.ptp(columns)) / 2)) + 1
    rgba = np.dstack([rgb, np.where(mask, 255, 0).astype(np.uint8)])
    rgba = np.pad(rgba, ((side, side), (side, side), (0, 0)))
    part = rgba[middle[0] : middle[0] + 2 * side, middle[1] : middle[1] + 2 * side].copy()
    part[part[..., 3] == 0] = 0
    return part

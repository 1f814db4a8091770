"""Similarity of two sets of Gaussians: the signal-to-noise ratio of their images."""

from dataclasses import dataclass

import numpy as np

from vgmpi.gaussians import spherical_harmonics
from vgmpi.gaussians.camera import Camera, look_at
from vgmpi.gaussians.cloud import GaussianCloud
from vgmpi.postprocess.raster.psnr import psnr
from vgmpi.postprocess.raster.rasterize import ALPHA_MIN, ProjectableGaussians, render

PIXELS = 400  # [pixels] edge of an image
ANGLES = 4  # cameras on each of the three circles
HEIGHTS = (-0.35, 0.15, 0.7)  # [-] sines of the circles' elevations
FOV = 40.0  # [degrees]
_MARGIN = 1.1  # [-] half edge of an image relative to the object's radius


@dataclass(frozen=True)
class PsnrPair:
    """Peak signal-to-noise ratios [dB]: inside the object's outline, and of full images."""

    inside: float
    full: float


def cameras(x: np.ndarray, pixels: int = PIXELS) -> list[Camera]:
    """Return twelve fixed cameras around points (n, 3) [m], which fill most of each image."""
    low, high = x.min(axis=0), x.max(axis=0)
    center, radius = (low + high) / 2, max(float(np.linalg.norm(high - low)) / 2, 1e-9)
    distance = _MARGIN * radius / np.sin(np.radians(FOV / 2))
    views = []
    for row, sine in enumerate(HEIGHTS):
        for k in range(ANGLES):
            angle = 2 * np.pi * (k + row / len(HEIGHTS)) / ANGLES
            horizontal = np.sqrt(1 - sine * sine)
            direction = np.array([horizontal * np.cos(angle), horizontal * np.sin(angle), sine])
            eye = center + distance * direction
            views.append(look_at(eye, center, (0.0, 0.0, 1.0), FOV, pixels, pixels))
    return views


def render_views(
    cloud: GaussianCloud, views: list[Camera], cov: np.ndarray | None = None
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return (image before white, 0..1; transmittance) of a cloud for every camera.

    cov: covariances (n, 6) [m2] to draw instead of its own.
    """
    cov = cloud.cov() if cov is None else cov
    compensated = np.full(len(cloud), cloud.lowpass) if cloud.is_antialiased else None
    out = []
    for view in views:
        color = spherical_harmonics.evaluate(cloud.sh, cloud.x - view.eye)
        splats = ProjectableGaussians(cloud.x, cov, cloud.opacity, color, compensated)
        picture, through = render(splats, view, alpha_min=ALPHA_MIN)
        out.append((np.clip(picture, 0.0, 1.0), through))
    return out


def image_psnr(reference: list, test: list) -> PsnrPair:
    """Return the PSNR of two results of `render_views` for the same cameras.

    Mean square errors are taken over all images. Inside is where less than half of the background
    is visible through the reference object.
    """
    inside, full = [], []
    for (a, through), (b, _) in zip(reference, test, strict=True):
        square = ((a.astype(np.float64) - b) ** 2).mean(axis=2)
        inside.append(square[through < 0.5])
        full.append(square.ravel())
    return PsnrPair(psnr(np.concatenate(inside)), psnr(np.concatenate(full)))

"""Image metrics of a run: blur, sand-like grain and excessive saturation."""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from vgmpi.gaussians.camera import Camera
from vgmpi.gaussians.shape_evolution import FAMILIES_DRAWN_AS_SPHERES
from vgmpi.postprocess.frames.appearance import Appearance
from vgmpi.postprocess.raster import rasterize
from vgmpi.postprocess.raster.psnr import psnr
from vgmpi.postprocess.raster.rasterize import ProjectableGaussians

GREY = (0.299, 0.587, 0.114)  # luminance of r, g, b (Rec. 601)
GRAIN_SIZE = 2.0  # [pixels] finer structures count as grain
SATURATION_MIN = 0.7  # [-] saturation above which a pixel counts as saturated
EDGE_SHARE = 0.1  # [-] share of the pixels on solids that counts as edges
SOLID_SHARE_MIN = 0.9  # [-] least share of solids in the color of a pixel that belongs to them
LOOSE_SHARE_MIN = 0.1  # [-] such a share of fluid, sand and snow, which are translucent
OUTLINE_MARGIN = 8  # [pixels] distance from solids, whose outlines are no grain
SCENERY, SOLID, GRANULAR_OR_LIQUID = 0, 1, 2


@dataclass(frozen=True)
class Regions:
    """Measured pixels, bool (height, width).

    solid: bodies with a shape, clearly visible. granular_or_liquid: fluid, sand and snow, away from
    solids.
    """

    solid: np.ndarray
    granular_or_liquid: np.ndarray


@dataclass(frozen=True)
class ImageMetrics:
    """Metrics of one image relative to that of the full method; colors are in 0..255.

    psnr: PSNR of the whole image [dB], infinite if equal. edge: mean gradient of the luminance
    [1/pixel] at the edges of solids in the full method; lower is blur. grain: median of |luminance
    - luminance smoothed over GRAIN_SIZE| on fluid, sand and snow; higher is sand-like. streaks:
    root mean square of that difference, which a few strong streaks raise too. saturation: mean of
    (max - min) / max of r, g, b there. saturated_fraction: share of pixels there above
    SATURATION_MIN. NaN without pixels.
    """

    psnr: float
    edge: float
    grain: float
    streaks: float
    saturation: float
    saturated_fraction: float


def kinds(look: Appearance, frame: dict[str, np.ndarray], count: int) -> np.ndarray:
    """Return the kind of each of the `count` Gaussians of a frame, in drawing order."""
    is_loose = np.array(
        [entry.get("family") in FAMILIES_DRAWN_AS_SPHERES for entry in look.objects]
    )
    moving = np.where(is_loose[look.object[frame["id"]]], GRANULAR_OR_LIQUID, SOLID)
    still = 0 if look.scenery is None else len(look.scenery.x0)
    passive = count - still - len(moving)  # only solids have any
    return np.concatenate([np.full(still, SCENERY), moving, np.full(passive, SOLID)])


def regions(splats: ProjectableGaussians, kind: np.ndarray, camera: Camera, **options) -> Regions:
    """Return the measured pixels from the image of the full method.

    kind: result of `kinds`. options: those of splat.render.
    """

    def share(body_kind: int) -> np.ndarray:  # share in each pixel's color, over black
        """Return the share of a kind in the color of each pixel."""
        color = np.repeat((kind == body_kind)[:, None].astype(np.float64), 3, axis=1)
        plain = ProjectableGaussians(splats.x, splats.cov, splats.opacity, color)
        return rasterize.render(plain, camera, np.zeros(3), **options)[0][..., 0]

    solid = share(SOLID)
    near_solid = ndimage.binary_dilation(solid > 1 - SOLID_SHARE_MIN, iterations=OUTLINE_MARGIN)
    return Regions(
        solid > SOLID_SHARE_MIN, (share(GRANULAR_OR_LIQUID) > LOOSE_SHARE_MIN) & ~near_solid
    )


def measured(picture: np.ndarray, full: np.ndarray, where: Regions) -> ImageMetrics:
    """Return the metrics of an image; picture, full: uint8 (height, width, 3)."""
    color = picture.astype(np.float64)
    grey = color @ GREY
    fine = np.abs(grain(grey))
    top = color.max(axis=2)
    saturation = (top - color.min(axis=2)) / np.maximum(top, 1.0)
    return ImageMetrics(
        psnr=psnr(((color - full) / 255) ** 2),
        edge=_reduce(np.mean, _gradient(grey)[_edges(full, where.solid)]),
        grain=_reduce(np.median, fine[where.granular_or_liquid]),
        streaks=_reduce(np.mean, fine[where.granular_or_liquid] ** 2) ** 0.5,
        saturation=_reduce(np.mean, saturation[where.granular_or_liquid]),
        saturated_fraction=_reduce(np.mean, saturation[where.granular_or_liquid] > SATURATION_MIN),
    )


def grain(grey: np.ndarray) -> np.ndarray:
    """Return the structures finer than GRAIN_SIZE in a luminance (height, width)."""
    return grey - ndimage.gaussian_filter(grey, GRAIN_SIZE)


def _gradient(grey: np.ndarray) -> np.ndarray:
    """Return the magnitude of the gradient."""
    return np.hypot(*np.gradient(grey))


def _edges(full: np.ndarray, solid: np.ndarray) -> np.ndarray:
    """Return the steepest pixels of solids, a share of EDGE_SHARE.

    Elsewhere shading decides, not sharpness.
    """
    slope = np.where(solid, _gradient(full.astype(np.float64) @ GREY), -1.0)
    if not solid.any():
        return solid
    return (slope > 0) & (slope >= np.quantile(slope[solid], 1 - EDGE_SHARE))


def _reduce(reduction, values: np.ndarray) -> float:
    """Apply a reduction, nan for no values."""
    return float(reduction(values)) if len(values) else float("nan")

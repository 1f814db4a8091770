"""Numbers for what is wrong with a picture of a run: blur, a surface like sand, too much colour."""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from postprocess.look import Look
from vgmpi.gaussians.evolve import BALLS
from vgmpi.splatting import splat
from vgmpi.splatting.camera import Camera
from vgmpi.splatting.decibels import decibels
from vgmpi.splatting.splat import Splats

GREY = (0.299, 0.587, 0.114)  # luminance of r, g, b (Rec. 601)
GRAIN = 2.0  # pixels: what is finer counts as grain
RICH = 0.7  # saturation from which a pixel counts as saturated
EDGES = 0.1  # part of the pixels on solids that counts as edges
SEEN = 0.9  # part of a pixel's colour that must come from solids for it to be theirs
WATER = 0.1  # the same of fluid, sand and snow, which let through what is behind
MARGIN = 8  # pixels between what is measured and a body in it: its outline is no grain
SCENERY, SOLID, LOOSE = 0, 1, 2


@dataclass(frozen=True)
class Regions:
    """Which pixels are measured, bool (height, width). solid: bodies with a shape, seen plainly.
    loose: fluid, sand and snow, away from solids."""

    solid: np.ndarray
    loose: np.ndarray


@dataclass(frozen=True)
class Figures:
    """Of one picture beside that of the full method; numbers of colours in 0..255.

    psnr: of the whole picture [dB], infinite where it is the same. edge: mean gradient of the
    luminance [1/pixel] where the full method has the edges of solids, lower: blur. grain: median of
    |luminance - smoothed over GRAIN| on fluid, sand and snow, higher: like sand. streaks: root of
    the mean square of the same, which few but strong ones raise too. saturation: mean of (max -
    min) / max of r, g, b there. rich: share of pixels there above RICH. NaN where no pixel is to be
    measured.
    """

    psnr: float
    edge: float
    grain: float
    streaks: float
    saturation: float
    rich: float


def kinds(look: Look, frame: dict[str, np.ndarray], count: int) -> np.ndarray:
    """SCENERY, SOLID or LOOSE for each of the `count` Gaussians of a frame, in the order drawn."""
    loose = np.array([entry.get("family") in BALLS for entry in look.objects])
    moving = np.where(loose[look.object[frame["id"]]], LOOSE, SOLID)
    still = 0 if look.scenery is None else len(look.scenery.x0)
    passive = count - still - len(moving)  # only solids have any
    return np.concatenate([np.full(still, SCENERY), moving, np.full(passive, SOLID)])


def regions(splats: Splats, kind: np.ndarray, camera: Camera, **options) -> Regions:
    """What is measured, from the picture of the full method. kind: as from `kinds`."""

    def share(of: int) -> np.ndarray:  # of each pixel's colour, the rest before black
        color = np.repeat((kind == of)[:, None].astype(np.float64), 3, axis=1)
        plain = Splats(splats.x, splats.cov, splats.opacity, color)
        return splat.render(plain, camera, np.zeros(3), **options)[0][..., 0]

    solid = share(SOLID)
    near = ndimage.binary_dilation(solid > 1 - SEEN, iterations=MARGIN)
    return Regions(solid > SEEN, (share(LOOSE) > WATER) & ~near)


def measured(picture: np.ndarray, full: np.ndarray, where: Regions) -> Figures:
    """picture, full: uint8 (height, width, 3)."""
    color = picture.astype(np.float64)
    grey = color @ GREY
    fine = np.abs(grain(grey))
    top = color.max(axis=2)
    saturation = (top - color.min(axis=2)) / np.maximum(top, 1.0)
    return Figures(
        psnr=decibels(((color - full) / 255) ** 2),
        edge=_over(np.mean, _gradient(grey)[_edges(full, where.solid)]),
        grain=_over(np.median, fine[where.loose]),
        streaks=_over(np.mean, fine[where.loose] ** 2) ** 0.5,
        saturation=_over(np.mean, saturation[where.loose]),
        rich=_over(np.mean, saturation[where.loose] > RICH),
    )


def grain(grey: np.ndarray) -> np.ndarray:
    """What is finer than GRAIN in a luminance (height, width)."""
    return grey - ndimage.gaussian_filter(grey, GRAIN)


def _gradient(grey: np.ndarray) -> np.ndarray:
    return np.hypot(*np.gradient(grey))


def _edges(full: np.ndarray, solid: np.ndarray) -> np.ndarray:
    """The EDGES steepest pixels of solids: between them shading decides, not sharpness."""
    slope = np.where(solid, _gradient(full.astype(np.float64) @ GREY), -1.0)
    if not solid.any():
        return solid
    return (slope > 0) & (slope >= np.quantile(slope[solid], 1 - EDGES))


def _over(how, values: np.ndarray) -> float:
    return float(how(values)) if len(values) else float("nan")

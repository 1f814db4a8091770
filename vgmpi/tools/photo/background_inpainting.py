"""Inpainting of the photograph behind its objects.

Edges of tables, floors and walls continue behind the objects, level or upright. Each gap is
therefore first filled along its rows and along its columns by linear interpolation between its two
ends, and the direction whose ends agree better has the larger weight. Grain, tiles and grass do not
continue so: patches of the photograph fill the gap again, and what resembles the photograph more is
taken. OpenCV's inpainting (Telea 2004) rounds edges off and blurs grain.
"""

import numpy as np
from scipy import ndimage

from .grabcut import MaskError
from .texture_synthesis import patch_distance, synthesize

MASK_DILATION = 3  # [pixels] masks are widened by this before they are inpainted
END_PIXELS = 4  # [pixels] this many are averaged at each end of a gap
COLOR_NOISE = 4.0  # [0..255] noise makes equal ends differ by about this
RING = 3, 12  # [pixels] distances from a gap between which steps between pixels are usual
WEIGHT_SMOOTHING = 2.0  # [pixels] the weights are smoothed over neighboring rows or columns by this


def inpaint_background(rgb: np.ndarray, masks: list[np.ndarray]) -> np.ndarray:
    """Return the photograph with its objects inpainted, (height, width, 3) uint8.

    Args:
        rgb: Photograph, shape (height, width, 3) uint8.
        masks: Objects to remove, each (height, width) bool.

    Raises:
        MaskError: The objects fill the whole picture.
    """
    gap, lines = _fill_along_lines(rgb, masks)
    return min((lines, synthesize(lines, gap)), key=lambda filled: visibility(filled, gap))


def interpolate_background(rgb: np.ndarray, masks: list[np.ndarray]) -> np.ndarray:
    """Return the photograph with its objects filled by interpolation alone, as inpaint_background.

    Raises:
        MaskError: The objects fill the whole picture.
    """
    return _fill_along_lines(rgb, masks)[1]


def visibility(rgb: np.ndarray, gap: np.ndarray) -> float:
    """Return how visible a filled gap is: by its texture and its seam [0..255].

    Args:
        rgb: Picture with the filled gap, shape (height, width, 3) uint8.
        gap: Pixels that were filled, (height, width) bool.
    """
    return patch_distance(rgb, gap) * max(seam_contrast(rgb, gap), 1.0)


def seam_contrast(rgb: np.ndarray, gap: np.ndarray) -> float:
    """Return the mean step across the rim of a gap over that between pixels around it.

    Args:
        rgb: Picture with the filled gap, shape (height, width, 3) uint8.
        gap: Pixels that were filled, (height, width) bool.
    """
    inner = ndimage.binary_dilation(gap, iterations=RING[0])
    ring = ndimage.binary_dilation(gap, iterations=RING[1]) & ~inner
    across, beyond = [], []
    for picture, mask, area in ((rgb, gap, ring), (rgb.swapaxes(0, 1), gap.T, ring.T)):
        step = np.abs(np.diff(picture.astype(np.float64), axis=0)).mean(-1)
        across.append(step[mask[1:] != mask[:-1]])
        beyond.append(step[area[1:] & area[:-1]])
    seam, usual = np.concatenate(across), np.concatenate(beyond)
    return float(seam.mean() / max(usual.mean(), 1e-9)) if len(seam) and len(usual) else 1.0


def _fill_along_lines(rgb: np.ndarray, masks: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Return the gap that objects leave, and the photograph with the gap filled by interpolation.

    Args:
        rgb: Photograph, shape (height, width, 3) uint8.
        masks: Objects to remove, each (height, width) bool.

    Raises:
        MaskError: The objects fill the whole picture.
    """
    gap = ndimage.binary_dilation(np.logical_or.reduce(masks), iterations=MASK_DILATION)
    if gap.all():
        raise MaskError("the objects fill the whole picture: no background is left")
    level, level_weight = _fill_rows(rgb, gap)
    upright, upright_weight = _fill_rows(rgb.swapaxes(0, 1), gap.T)
    upright, upright_weight = upright.swapaxes(0, 1), upright_weight.T
    weight = ndimage.gaussian_filter(level_weight, (WEIGHT_SMOOTHING, 0))[..., None]
    other = ndimage.gaussian_filter(upright_weight, (0, WEIGHT_SMOOTHING))[..., None]
    mean = (weight * level + other * upright) / np.maximum(weight + other, 1e-30)
    filled = np.where(gap[..., None], np.clip(mean + 0.5, 0, 255), rgb).astype(np.uint8)
    return gap, filled


def _fill_rows(rgb: np.ndarray, gap: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Fill the gaps of a picture (height, width, 3) along its rows.

    Returns:
        The filled picture, and the weight of each filled pixel, shape (height, width), 0 where
        nothing could be interpolated.
    """
    filled = rgb.astype(np.float64)
    trust = np.zeros(gap.shape)
    edges = np.diff(np.pad(gap, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    starts, stops = np.argwhere(edges == 1), np.argwhere(edges == -1)
    for (row, first), (_, last) in zip(starts, stops):
        line = rgb[row].astype(np.float64)
        ends = [line[max(0, first - END_PIXELS) : first], line[last : last + END_PIXELS]]
        ends = [end for end in ends if len(end)]
        if not ends:
            continue
        left, right = ends[0].mean(axis=0), ends[-1].mean(axis=0)
        fraction = ((np.arange(first, last) - first + 0.5) / (last - first))[:, None]
        filled[row, first:last] = left * (1 - fraction) + right * fraction
        difference = float(np.abs(left - right).mean()) + COLOR_NOISE
        alone = 4.0 if len(ends) == 1 else 1.0  # a single end constrains the gap less
        trust[row, first:last] = 1 / (alone * (last - first) * difference) ** 2
    return filled, trust

"""Shadows that objects cast in a photograph.

A shadow darkens what it falls on by one factor in all colors. Pixels that are darker than the lit
surroundings, in the same hue, and that touch an object are its shadow. Objects in the air throw
shadows that touch nothing: compact ones of their size count, too.
"""

import numpy as np
from scipy import ndimage

# [-] height and width over which the lit surroundings are averaged, of the longer side: tables and
# floors change along the rows less than towards the horizon
REACH = (0.012, 0.15)
ITERATIONS = 6  # the surroundings are averaged this often without what is darker
DARKENING = 0.22  # [-] natural logarithm of the weakest darkening that counts
HUE_TOLERANCE = 0.2  # [-] by how much the logarithms of the three colors may differ
SMOOTHING = 1.5  # [pixels] smoothing of the grain
TOUCH = 4  # [pixels] a shadow begins at most this far from its object
PENUMBRA = 4  # [pixels] a shadow is widened by this
MAX_AREA = 1.5  # [-] darker regions that exceed all objects by this factor are no shadow
MIN_AIRBORNE_AREA = 0.1  # [-] area of the shadow of an object in the air, relative to the object
MIN_COMPACTNESS = 0.45  # [-] area of such a shadow relative to its box


def cast_shadows(rgb: np.ndarray, masks: list[np.ndarray], airborne: list[bool]) -> np.ndarray:
    """Return the pixels in the shadows of objects, (height, width) bool.

    Args:
        rgb: Photograph, shape (height, width, 3) uint8.
        masks: Objects, each (height, width) bool.
        airborne: Whether each object is in the air.
    """
    objects = np.logical_or.reduce(masks)
    log_color = np.log(rgb.astype(np.float64) + 2.0)
    smooth = ndimage.gaussian_filter(log_color, (SMOOTHING, SMOOTHING, 0))
    width = [part * max(objects.shape) for part in REACH]
    lit = ~ndimage.binary_dilation(objects, iterations=2)
    for _ in range(ITERATIONS):
        weight = ndimage.gaussian_filter(lit.astype(np.float64), width)
        mean = ndimage.gaussian_filter(lit[..., None] * smooth, (*width, 0))
        difference = smooth - mean / np.maximum(weight, 1e-9)[..., None]
        lit = lit & (difference.mean(axis=-1) > -DARKENING / 2)
    dark = difference.mean(axis=-1) < -DARKENING
    same_hue = np.ptp(difference, axis=-1) < HUE_TOLERANCE
    candidates = ndimage.binary_opening(dark & same_hue & ~objects, iterations=2)
    return _belonging(candidates, masks, airborne) & ~objects


def _belonging(candidates: np.ndarray, masks: list[np.ndarray], airborne: list[bool]) -> np.ndarray:
    """Return the regions that touch an object, or may be the shadow of one in the air."""
    label, count = ndimage.label(candidates)
    if not count:
        return candidates
    area = ndimage.sum_labels(candidates, label, np.arange(1, count + 1))
    touch = ndimage.binary_dilation(np.logical_or.reduce(masks), iterations=TOUCH)
    touching = np.isin(np.arange(1, count + 1), np.unique(label[touch & candidates]))
    sizes = [mask.sum() for mask, is_airborne in zip(masks, airborne) if is_airborne]
    boxes = [
        (rows.stop - rows.start) * (columns.stop - columns.start)
        for rows, columns in ndimage.find_objects(label)
    ]
    compact = area > MIN_COMPACTNESS * np.array(boxes)
    if sizes:
        touching |= compact & (area > MIN_AIRBORNE_AREA * min(sizes))
    touching &= area < MAX_AREA * sum(mask.sum() for mask in masks)
    shadow = np.isin(label, 1 + np.flatnonzero(touching))
    return ndimage.binary_dilation(shadow, iterations=PENUMBRA) if shadow.any() else shadow

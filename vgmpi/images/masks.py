"""Which pixels of a photograph are an object's: by GrabCut, from its box and from clicks."""

import logging
from typing import NamedTuple

import numpy as np
from scipy import ndimage

log = logging.getLogger("vgmpi")

ROUNDS = 6  # of GrabCut
CLICK = 0.008  # radius of what a click is sure of, relative to the picture's longer side
MARGIN = 0.35  # of the box's size: as much of the background around it is looked at
FEWEST = 64  # pixels of an object
ALIKE = 12  # difference of colours, 0..255, of what a click is for
THREAD = 0.025  # of the shorter side of a box: what is thinner is no part of an object
_SEED = 1


class MaskError(ValueError):
    """An object that has no usable mask: what is wrong with it, one line."""


class Box(NamedTuple):
    """Corners of a box in the picture [pixels], right and lower ends left out."""

    left: int
    top: int
    right: int
    bottom: int


def opencv():
    """The package cv2, told not to take all processors. Raises MaskError where it is missing."""
    try:
        import cv2
    except ImportError:
        said = "GrabCut needs OpenCV: pip install 'vgmpi[images]'"
        raise MaskError(said) from None
    cv2.setNumThreads(1)
    cv2.setRNGSeed(_SEED)
    return cv2


def grabcut(rgb: np.ndarray, box: Box, clicks: list[tuple[float, float, bool]]) -> np.ndarray:
    """The object in a box, (height, width) bool (Rother, Kolmogorov and Blake 2004).

    rgb: (height, width, 3) uint8. clicks: x, y and whether it is the object there. What is outside
    the box is background. Raises MaskError.
    """
    cv2 = opencv()
    height, width = rgb.shape[:2]
    reach = [MARGIN * (box.right - box.left) + 8, MARGIN * (box.bottom - box.top) + 8]
    x0, y0 = max(0, int(box.left - reach[0])), max(0, int(box.top - reach[1]))
    x1, y1 = min(width, int(box.right + reach[0])), min(height, int(box.bottom + reach[1]))
    part = np.ascontiguousarray(rgb[y0:y1, x0:x1])
    label = np.full(part.shape[:2], cv2.GC_BGD, dtype=np.uint8)
    label[box.top - y0 : box.bottom - y0, box.left - x0 : box.right - x0] = cv2.GC_PR_FGD
    radius = max(1, round(CLICK * max(width, height)))
    for x, y, is_it in sorted(clicks, key=lambda click: click[2]):  # what is it goes last
        at = (int(x) - x0, int(y) - y0)
        if not (0 <= at[0] < part.shape[1] and 0 <= at[1] < part.shape[0]):
            continue  # beyond what is looked at nothing is the object's
        if not is_it:
            label[_alike(cv2, part, at)] = cv2.GC_BGD
        kind = cv2.GC_FGD if is_it else cv2.GC_BGD
        cv2.circle(label, at, radius, int(kind), -1)
    if not (label == cv2.GC_BGD).any():
        raise MaskError("the box is the whole picture: nothing is left that is background")
    back, fore = np.zeros((1, 65)), np.zeros((1, 65))
    try:
        cv2.grabCut(part, label, None, back, fore, ROUNDS, cv2.GC_INIT_WITH_MASK)
    except cv2.error as error:
        said = str(error).strip().splitlines()[0]
        raise MaskError(f"GrabCut finds nothing in the box: {said}") from None
    found = np.zeros((height, width), dtype=bool)
    found[y0:y1, x0:x1] = (label == cv2.GC_FGD) | (label == cv2.GC_PR_FGD)
    return largest(opened(found, box))


def _alike(cv2, part: np.ndarray, at: tuple[int, int]) -> np.ndarray:
    """What around a place has its colour, (height, width) bool: a click alone is a few pixels, of
    which the colours of all others would take no notice."""
    smooth = cv2.GaussianBlur(part, (0, 0), 1.5)
    found = np.zeros((part.shape[0] + 2, part.shape[1] + 2), dtype=np.uint8)
    way = 4 | cv2.FLOODFILL_MASK_ONLY | cv2.FLOODFILL_FIXED_RANGE | (255 << 8)
    cv2.floodFill(smooth, found, at, 0, (ALIKE,) * 3, (ALIKE,) * 3, way)
    return found[1:-1, 1:-1] > 0


def opened(mask: np.ndarray, box: Box) -> np.ndarray:
    """A mask without what is thinner than a part of its box: edges behind an object that have its
    colour make such threads."""
    radius = max(1, round(THREAD * min(box.right - box.left, box.bottom - box.top) / 2))
    y, x = np.mgrid[-radius : radius + 1, -radius : radius + 1]
    kept = ndimage.binary_opening(mask, x * x + y * y <= radius * radius)
    return kept if kept.sum() > 0.5 * mask.sum() else mask


def largest(mask: np.ndarray) -> np.ndarray:
    """The largest connected piece of a mask without its holes; empty stays empty."""
    label, count = ndimage.label(mask)
    if not count:
        return mask
    size = ndimage.sum_labels(mask, label, np.arange(1, count + 1))
    return ndimage.binary_fill_holes(label == 1 + int(np.argmax(size)))


def checked(mask: np.ndarray) -> list[str]:
    """What is to be said about a mask that is used. Raises MaskError where it cannot be."""
    count = int(mask.sum())
    if count < FEWEST:
        what = "is empty" if not count else f"has {count} pixels only, at least {FEWEST} are needed"
        raise MaskError(f"its mask {what}: give another box, clicks, or mask = 'file.png'")
    edges = {"left": mask[:, 0], "right": mask[:, -1], "upper": mask[0], "lower": mask[-1]}
    touched = [name for name, edge in edges.items() if edge.any()]
    if touched:
        names = " and ".join(touched)
        return [f"its mask touches the {names} edge of the picture: what lies beyond is cut off"]
    return []


def iou(a: np.ndarray, b: np.ndarray) -> float:
    """Intersection over union of two masks of one shape."""
    either = int((a | b).sum())
    return float((a & b).sum() / either) if either else 1.0


def box_of(mask: np.ndarray) -> Box:
    """The smallest box around a mask that is not empty."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    return Box(int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1)

"""Straight line segments of a photograph, which edges of tables, tiles and boxes leave in it."""

from typing import NamedTuple

import numpy as np

from .grabcut import opencv

MAX_SIDE = 1000  # [pixels] longer side of the picture in which segments are detected
MIN_LENGTH = 0.025  # [-] of a segment, relative to the diagonal
MAX_COUNT = 300  # the longest segments are kept
RIM = 0.01  # [-] of the diagonal: segments so close to an edge of the picture are its frame


class Segments(NamedTuple):
    """Segments about the middle of the picture, in pixels of the photograph."""

    middle: np.ndarray  # (n, 2) [pixels] x to the right, y down
    along: np.ndarray  # (n, 2) unit vectors
    length: np.ndarray  # (n,) [pixels]

    def select(self, chosen: np.ndarray) -> "Segments":
        """Return the segments of a mask or of indices."""
        return Segments(self.middle[chosen], self.along[chosen], self.length[chosen])


def detect_segments(rgb: np.ndarray) -> Segments:
    """Detect segments in a photograph (height, width, 3) uint8, the longest first.

    The detector is that of Grompone von Gioi et al. (2010).

    Raises:
        MaskError: OpenCV is missing.
    """
    cv2 = opencv()
    height, width = rgb.shape[:2]
    scale = min(1.0, MAX_SIDE / max(height, width))
    gray = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)
    if scale < 1:
        size = (round(width * scale), round(height * scale))
        gray = cv2.resize(gray, size, interpolation=cv2.INTER_AREA)
    lines = cv2.createLineSegmentDetector().detect(gray)[0]
    if lines is None:
        return Segments(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0))
    ratio = np.array([width / gray.shape[1], height / gray.shape[0]])
    # the detector counts from the middle of the first pixel
    ends = (lines.reshape(-1, 2, 2).astype(np.float64) + 0.5) * ratio - (width / 2, height / 2)
    return _longest(ends, width, height)


def _longest(ends: np.ndarray, width: int, height: int) -> Segments:
    """Return the segments of ends (n, 2, 2) without short ones and without the picture's rim."""
    step = ends[:, 1] - ends[:, 0]
    length = np.hypot(*step.T)
    diagonal = np.hypot(width, height)
    gap = (width / 2, height / 2) - np.abs(ends)  # to the edges of the picture, (n, 2, 2)
    on_rim = (gap < RIM * diagonal).all(axis=1).any(axis=1)
    used = np.flatnonzero((length > MIN_LENGTH * diagonal) & ~on_rim)
    used = used[np.argsort(-length[used], kind="stable")][:MAX_COUNT]
    return Segments(ends[used].mean(axis=1), step[used] / length[used, None], length[used])

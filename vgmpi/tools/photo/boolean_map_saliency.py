"""Boxes of regions that something else surrounds, in photographs without a plain background.

Each level of each color channel splits the picture into two sets of regions. Regions that do not
touch an edge of the picture are surrounded, and pixels count how often they are (Zhang and Sclaroff
2013, Saliency detection: a Boolean map approach).
"""

import numpy as np
from scipy import ndimage

from .grabcut import Box, box_overlap, opencv

LEVEL_STEPS = (8, 4, 4)  # [0..255] between levels of lightness and of both color channels
FRACTIONS = (0.1, 0.2, 0.3, 0.45, 0.6, 0.75)  # [-] of the largest count at which regions are cut
CLOSING = 3  # [pixels] gaps of regions that are closed
MAX_BOXES = 24  # upper limit of the boxes
SAME_BOX = 0.7  # [-] two boxes count as one from this intersection over union on


def surroundedness(rgb: np.ndarray) -> np.ndarray:
    """Return how many levels surround each pixel, (height, width).

    Args:
        rgb: Photograph, shape (height, width, 3) uint8.

    Raises:
        MaskError: OpenCV is missing.
    """
    cv2 = opencv()
    lab = cv2.GaussianBlur(cv2.cvtColor(rgb, cv2.COLOR_RGB2LAB), (0, 0), 1)
    square = np.ones((3, 3), np.uint8)
    total = np.zeros(rgb.shape[:2])
    for channel, step in enumerate(LEVEL_STEPS):
        values = lab[..., channel]
        for level in range(int(values.min()) + step // 2, int(values.max()), step):
            for side in (values > level, values <= level):
                opened = cv2.morphologyEx(side.astype(np.uint8), cv2.MORPH_OPEN, square)
                count, label = cv2.connectedComponents(opened, connectivity=4)
                is_surrounded = np.ones(count, dtype=bool)
                is_surrounded[0] = False
                for edge in (label[0], label[-1], label[:, 0], label[:, -1]):
                    is_surrounded[edge] = False
                total += is_surrounded[label]
    return total


def surrounded_boxes(rgb: np.ndarray, min_area: float) -> list[Box]:
    """Return boxes of surrounded regions, those of the lowest fraction first.

    Args:
        rgb: Photograph, shape (height, width, 3) uint8.
        min_area: Smallest area of a region relative to the picture.

    Raises:
        MaskError: OpenCV is missing.
    """
    total = surroundedness(rgb)
    boxes: list[Box] = []
    for fraction in FRACTIONS:
        mask = np.pad(ndimage.binary_opening(total > fraction * total.max()), CLOSING)
        mask = ndimage.binary_fill_holes(ndimage.binary_closing(mask, iterations=CLOSING))
        label, count = ndimage.label(mask[CLOSING:-CLOSING, CLOSING:-CLOSING])
        area = ndimage.sum_labels(label > 0, label, np.arange(1, count + 1)) / label.size
        for share, (rows, columns) in zip(area, ndimage.find_objects(label)):
            box = Box(columns.start, rows.start, columns.stop, rows.stop)
            if share >= min_area and all(box_overlap(box, other) < SAME_BOX for other in boxes):
                boxes.append(box)
    return boxes[:MAX_BOXES]

"""Proposed boxes of objects in a photograph, and a layout that contains them."""

from collections.abc import Callable

import numpy as np
from scipy import ndimage

from .grabcut import Box, opencv
from .photograph import Photograph

MIN_AREA, MAX_AREA = 0.003, 0.5  # [-] area of an object relative to the picture
MAX_PROPOSALS = 12  # upper limit of the proposals
MARGIN = 0.06  # [-] boxes are widened by this fraction of their size
CHROMA_WEIGHT = (
    2.0  # [-] weight of hue and saturation relative to lightness, which shadows change too
)
SALIENCY_FACTOR = 4.0  # [-] a salient pixel deviates from its row by this multiple of the median
SHADOW_WEIGHT = 0.25  # [-] weight of darkening, which may be a shadow
MAX_OVERLAP = 0.6  # [-] two boxes count as one from this overlap of the smaller one on

Proposer = Callable[[np.ndarray], list[Box]]


def saliency_boxes(rgb: np.ndarray) -> list[Box]:
    """Return boxes of regions that differ from the rest of their rows, the largest first.

    Objects on a table before a wall do so.

    Args:
        rgb: Photograph, shape (height, width, 3) uint8.

    Raises:
        MaskError: OpenCV is missing.
    """
    cv2 = opencv()
    lab = cv2.cvtColor(rgb, cv2.COLOR_RGB2LAB).astype(np.float32)
    lab = ndimage.gaussian_filter(lab, (1.5, 1.5, 0))
    row_median = ndimage.median_filter(np.median(lab, axis=1), size=(5, 1))[:, None]
    deviation = lab - row_median
    color = CHROMA_WEIGHT * np.hypot(deviation[..., 1], deviation[..., 2])
    light = np.where(deviation[..., 0] < 0, SHADOW_WEIGHT, 1.0) * np.abs(deviation[..., 0])
    differs = np.hypot(color, light)
    level = max(_otsu(differs), SALIENCY_FACTOR * float(np.median(differs)))
    size = max(2, round(0.006 * max(rgb.shape[:2])))
    mask = ndimage.binary_opening(differs > level, iterations=size // 2 + 1)
    mask = ndimage.binary_fill_holes(ndimage.binary_closing(np.pad(mask, size), iterations=size))
    mask = mask[size:-size, size:-size]
    label, count = ndimage.label(mask)
    area = ndimage.sum_labels(mask, label, np.arange(1, count + 1)) / mask.size
    slices = ndimage.find_objects(label)
    boxes = []
    for k in np.argsort(-area):
        if MIN_AREA <= area[k] <= MAX_AREA:
            rows, columns = slices[k]
            boxes.append(_wider(Box(columns.start, rows.start, columns.stop, rows.stop), rgb))
    return suppress_overlaps(boxes)[:MAX_PROPOSALS]


def suppress_overlaps(boxes: list[Box]) -> list[Box]:
    """Drop boxes that largely overlap an earlier box (non-maximum suppression)."""
    result: list[Box] = []
    for box in boxes:
        if all(_common(box, previous) < MAX_OVERLAP for previous in result):
            result.append(box)
    return result


def text(boxes: list[Box], photo: Photograph, layout_text: str = "") -> str:
    """Return the text of a layout with the proposed boxes.

    Args:
        boxes: Boxes in the pixels of the reduced photograph.
        photo: The photograph.
        layout_text: Text of a layout without objects, which goes before.
    """
    head = [
        "# Proposed by --find: find.png shows the boxes. Name the objects by what they are (names",
        "# tell materials), take out what is none, give the height of at least one that stands.",
    ]
    out = [layout_text.rstrip(), *head] if layout_text.strip() else head
    for k, box in enumerate(boxes):
        corners = [round(v * photo.reduced) for v in box]
        out += ["", "[[object]]", f'name = "thing {k + 1}"', f"box = {corners}"]
        out += ['# height = "10 cm"', '# reconstruction = "inflate"  # or "revolve", "extrude"']
    return "\n".join(out) + "\n"


def draw_boxes(rgb: np.ndarray, boxes: list[Box]) -> np.ndarray:
    """Draw numbered boxes into the photograph, uint8."""
    from PIL import Image, ImageDraw

    image = Image.fromarray(rgb)
    pen = ImageDraw.Draw(image)
    for k, box in enumerate(boxes):
        pen.rectangle((*box[:2], box.right - 1, box.bottom - 1), outline=(255, 0, 255), width=2)
        pen.text((box.left + 5, box.top + 4), f"thing {k + 1}", fill=(255, 0, 255))
    return np.asarray(image)


def _wider(box: Box, rgb: np.ndarray) -> Box:
    """Widen a box by MARGIN within the picture."""
    margin = max(4, round(MARGIN * max(box.right - box.left, box.bottom - box.top)))
    height, width = rgb.shape[:2]
    return Box(
        max(0, box.left - margin), max(0, box.top - margin),
        min(width, box.right + margin), min(height, box.bottom + margin),
    )  # fmt: skip


def _common(a: Box, b: Box) -> float:
    """Return the intersection of two boxes over the smaller of them."""
    wide = min(a.right, b.right) - max(a.left, b.left)
    high = min(a.bottom, b.bottom) - max(a.top, b.top)
    small = min((x.right - x.left) * (x.bottom - x.top) for x in (a, b))
    return max(0, wide) * max(0, high) / max(small, 1)


def _otsu(values: np.ndarray) -> float:
    """Return the level that splits values into two groups of least variance (Otsu 1979)."""
    count, edges = np.histogram(values, 256)
    middle = (edges[1:] + edges[:-1]) / 2
    below = np.cumsum(count)
    above = below[-1] - below
    total = np.cumsum(count * middle)
    with np.errstate(divide="ignore", invalid="ignore"):
        separation = below * above * (total / below - (total[-1] - total) / above) ** 2
    return float(middle[int(np.nanargmax(np.where(np.isfinite(separation), separation, -1)))])

"""Proposed boxes of objects in a photograph, and a layout that contains them.

Without a plain background, boxes are those of regions that something else surrounds. Each level of
each color channel splits the picture into two sets of regions. Regions that do not touch an edge of
the picture are surrounded, and pixels count how often they are (Zhang and Sclaroff 2013, Saliency
detection: a Boolean map approach).
"""

from collections.abc import Callable

import numpy as np
from scipy import ndimage

from .grabcut import (
    MIN_CONTRAST,
    MIN_FILL,
    Box,
    MaskError,
    box_of,
    box_overlap,
    opencv,
    rim_contrast,
    segment_box,
)
from .photograph import Photograph

LEVEL_STEPS = (8, 4, 4)  # [0..255] between levels of lightness and of both color channels
FRACTIONS = (0.1, 0.2, 0.3, 0.45, 0.6, 0.75)  # [-] of the largest count at which regions are cut
CLOSING = 3  # [pixels] gaps of regions that are closed
MAX_BOXES = 24  # upper limit of the boxes
EQUAL_BOX_OVERLAP = 0.7  # [-] two boxes count as one from this intersection over union on
MIN_AREA, MAX_AREA = 0.003, 0.5  # [-] area of an object relative to the picture
MAX_PROPOSALS = 12  # upper limit of the proposals
MARGIN = 0.06  # [-] boxes are widened by this fraction of their size
CHROMA_WEIGHT = (
    2.0  # [-] weight of hue and saturation relative to lightness, which shadows change too
)
SALIENCY_FACTOR = 4.0  # [-] a salient pixel deviates from its row by this multiple of the median
SHADOW_WEIGHT = 0.25  # [-] weight of darkening, which may be a shadow
MAX_OVERLAP = 0.6  # [-] two boxes count as one from this overlap of the smaller one on
CHECK_SIDE = 400  # [pixels] longer side of the photograph in which proposals are cut out
MAX_MASK = 0.8  # [-] largest area of a proposal that was cut out, relative to the picture
MAX_CUTS = 4  # a box grows at most this often, as its mask reaches to its edges
SAME_BOX = 0.9  # [-] a box that agrees with its mask's box so well grows no more
MIN_PART = 0.25  # [-] a proposal inside another one has at least this part of its area
MAX_RECURRENCE = 0.4  # [-] of the remainder that may have the colors of the proposal
_RING = 0.25  # [-] width of the surroundings of a proposal relative to its size
_BINS = (16, 6, 6)  # [0..255] width of color bins: lightness and both color channels
Proposer = Callable[[np.ndarray], list[Box]]


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
            if share >= min_area and all(
                box_overlap(box, other) < EQUAL_BOX_OVERLAP for other in boxes
            ):
                boxes.append(box)
    return boxes[:MAX_BOXES]


def propose_boxes(rgb: np.ndarray) -> list[Box]:
    """Return boxes of objects, each checked by cutting out its object.

    They are regions that differ from their rows. If there are none, or all of them touch the left
    or the right edge, as the table beside a large object does, they are regions that something
    else surrounds.

    Args:
        rgb: Photograph, shape (height, width, 3) uint8.

    Raises:
        MaskError: OpenCV is missing.
    """
    cv2 = opencv()
    height, width = rgb.shape[:2]
    scale = max(1.0, max(height, width) / CHECK_SIDE)
    size = round(width / scale), round(height / scale)
    small = cv2.resize(rgb, size, interpolation=cv2.INTER_AREA)
    rows = [
        box for box in saliency_boxes(rgb)
        if _cut_out(small, Box(*(round(v / scale) for v in box))) is not None
    ]  # fmt: skip
    if any(box.left > 0 and box.right < width for box in rows):
        return rows
    masks = [_cut_out(small, box) for box in surrounded_boxes(small, MIN_AREA)]
    lab = cv2.cvtColor(small, cv2.COLOR_RGB2LAB)
    distinct = [
        mask for mask in masks
        if mask is not None and _recurrence(lab, mask) <= MAX_RECURRENCE
    ]  # fmt: skip
    boxes: list[Box] = []
    for box in map(box_of, sorted(distinct, key=np.sum, reverse=True)):
        if all(_is_separate(box, other) for other in boxes):
            boxes.append(box)
    enlarged = [Box(*(round(v * scale) for v in box)) for box in boxes]
    return [_wider(box, rgb) for box in enlarged][:MAX_PROPOSALS] or rows


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


def _cut_out(rgb: np.ndarray, box: Box) -> np.ndarray | None:
    """Return the mask (height, width) bool of the object in a box; None if there is none.

    The box follows its mask, so that it comes to hold an object of which it holds a part.

    Args:
        rgb: Photograph, shape (height, width, 3) uint8.
        box: Box in it.
    """
    result = None
    picture = Box(0, 0, rgb.shape[1], rgb.shape[0])
    for _ in range(MAX_CUTS):
        wide = _wider(box, rgb)
        try:
            mask = segment_box(rgb, box if wide == picture else wide, [])
        except MaskError:
            break
        area = float(mask.mean())
        if not MIN_AREA <= area <= MAX_MASK or (result is not None and area < result.mean()):
            break
        outline = box_of(mask)
        if mask.sum() / outline.area < MIN_FILL or rim_contrast(rgb, mask) < MIN_CONTRAST:
            break
        result = mask
        if box_overlap(outline, box) > SAME_BOX:
            break
        box = outline
    return result


def _recurrence(lab: np.ndarray, mask: np.ndarray) -> float:
    """Return the fraction of the remote pixels that have colors of an object.

    They look more like the object than like its surroundings, as those of a tile among tiles do.

    Args:
        lab: Photograph in the color space CIELAB, shape (height, width, 3) uint8.
        mask: The object, shape (height, width) bool.
    """
    bins = tuple(lab[..., k] // _BINS[k] for k in range(3))
    box = box_of(mask)
    margin = round(_RING * max(box.right - box.left, box.bottom - box.top))
    nearby = np.zeros(mask.shape, dtype=bool)
    nearby[max(0, box.top - margin) : box.bottom + margin,
           max(0, box.left - margin) : box.right + margin] = True  # fmt: skip
    remote = ~nearby if (~nearby).mean() > 0.05 else ~mask
    shares = []
    for region in (mask, nearby & ~mask):
        count = np.zeros(tuple(255 // width + 1 for width in _BINS))
        np.add.at(count, tuple(v[region] for v in bins), 1.0)
        shares.append(ndimage.gaussian_filter(count, 1.0)[bins] / max(int(region.sum()), 1))
    return float((shares[0] > shares[1])[remote].mean())


def _is_separate(box: Box, larger: Box) -> bool:
    """Return whether a box is another object than a larger one, or a large part of it."""
    if _common(box, larger) < MAX_OVERLAP:
        return True
    return MIN_PART * larger.area <= box.area and box_overlap(box, larger) < MAX_OVERLAP


def _wider(box: Box, rgb: np.ndarray) -> Box:
    """Widen a box by MARGIN within the picture."""
    x, y = (max(4, round(MARGIN * size)) for size in (box.right - box.left, box.bottom - box.top))
    height, width = rgb.shape[:2]
    return Box(
        max(0, box.left - x), max(0, box.top - y),
        min(width, box.right + x), min(height, box.bottom + y),
    )  # fmt: skip


def _common(a: Box, b: Box) -> float:
    """Return the intersection of two boxes over the smaller of them."""
    return a.shared_area(b) / max(min(a.area, b.area), 1)


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

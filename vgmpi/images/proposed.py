"""Boxes of what may be objects in a photograph, and a layout that has them."""

from collections.abc import Callable

import numpy as np
from scipy import ndimage

from vgmpi.images.masks import Box, opencv
from vgmpi.images.photograph import Photograph

LEAST, MOST = 0.003, 0.5  # share of the picture that an object has
MANY = 12  # proposals at the most
MARGIN = 0.06  # of a box's size by which it is larger than what was found
CHROMA = 2.0  # weight of hue and saturation against lightness, in which shadows differ too
SPREAD = 4.0  # how many times the usual deviation of its row makes a pixel stand out
SHADOW = 0.25  # of what stands out in colour: less than that in colour and darker is a shadow
SAME = 0.6  # intersection over the smaller of two boxes that are one

Proposer = Callable[[np.ndarray], list[Box]]


def standing_out(rgb: np.ndarray) -> list[Box]:
    """Boxes around what differs from most of its rows, as things on a table before a wall do; the
    largest first. rgb: (height, width, 3) uint8. Raises MaskError without OpenCV."""
    cv2 = opencv()
    lab = cv2.cvtColor(rgb, cv2.COLOR_RGB2LAB).astype(np.float32)
    lab = ndimage.gaussian_filter(lab, (1.5, 1.5, 0))
    usual = ndimage.median_filter(np.median(lab, axis=1), size=(5, 1))[:, None]
    off = lab - usual
    colour = CHROMA * np.hypot(off[..., 1], off[..., 2])
    light = np.where(off[..., 0] < 0, SHADOW, 1.0) * np.abs(off[..., 0])
    differs = np.hypot(colour, light)
    level = max(_otsu(differs), SPREAD * float(np.median(differs)))
    size = max(2, round(0.006 * max(rgb.shape[:2])))
    found = ndimage.binary_opening(differs > level, iterations=size // 2 + 1)
    found = ndimage.binary_fill_holes(ndimage.binary_closing(np.pad(found, size), iterations=size))
    found = found[size:-size, size:-size]
    label, count = ndimage.label(found)
    area = ndimage.sum_labels(found, label, np.arange(1, count + 1)) / found.size
    found_at = ndimage.find_objects(label)
    boxes = []
    for k in np.argsort(-area):
        if LEAST <= area[k] <= MOST:
            rows, columns = found_at[k]
            boxes.append(_wider(Box(columns.start, rows.start, columns.stop, rows.stop), rgb))
    return distinct(boxes)[:MANY]


def distinct(boxes: list[Box]) -> list[Box]:
    """Boxes in their order without those that lie in one before them."""
    kept: list[Box] = []
    for box in boxes:
        if all(_common(box, one) < SAME for one in kept):
            kept.append(box)
    return kept


def text(boxes: list[Box], photo: Photograph, given: str = "") -> str:
    """The layout of what was proposed. boxes: in the pixels that are worked with; given: the text
    of a layout without objects."""
    head = [
        "# Proposed by --find: find.png shows the boxes. Name the objects by what they are (names",
        "# tell materials), take out what is none, give the height of at least one that stands.",
    ]
    out = [given.rstrip(), *head] if given.strip() else head
    for k, box in enumerate(boxes):
        told = [round(v * photo.reduced) for v in box]
        out += ["", "[[object]]", f'name = "thing {k + 1}"', f"box = {told}"]
        out += ['# height = "10 cm"', '# form = "inflate"  # or "revolve", "extrude"']
    return "\n".join(out) + "\n"


def drawn(rgb: np.ndarray, boxes: list[Box]) -> np.ndarray:
    """The photograph with numbered boxes, uint8."""
    from PIL import Image, ImageDraw

    shown = Image.fromarray(rgb)
    pen = ImageDraw.Draw(shown)
    for k, box in enumerate(boxes):
        pen.rectangle((*box[:2], box.right - 1, box.bottom - 1), outline=(255, 0, 255), width=2)
        pen.text((box.left + 5, box.top + 4), f"thing {k + 1}", fill=(255, 0, 255))
    return np.asarray(shown)


def _wider(box: Box, rgb: np.ndarray) -> Box:
    by = max(4, round(MARGIN * max(box.right - box.left, box.bottom - box.top)))
    height, width = rgb.shape[:2]
    return Box(
        max(0, box.left - by), max(0, box.top - by),
        min(width, box.right + by), min(height, box.bottom + by),
    )  # fmt: skip


def _common(a: Box, b: Box) -> float:
    """Intersection of two boxes over the smaller of them."""
    wide = min(a.right, b.right) - max(a.left, b.left)
    high = min(a.bottom, b.bottom) - max(a.top, b.top)
    small = min((x.right - x.left) * (x.bottom - x.top) for x in (a, b))
    return max(0, wide) * max(0, high) / max(small, 1)


def _otsu(values: np.ndarray) -> float:
    """The level that parts values into two groups of the least variance (Otsu 1979)."""
    count, edges = np.histogram(values, 256)
    middle = (edges[1:] + edges[:-1]) / 2
    below = np.cumsum(count)
    above = below[-1] - below
    total = np.cumsum(count * middle)
    with np.errstate(divide="ignore", invalid="ignore"):
        apart = below * above * (total / below - (total[-1] - total) / above) ** 2
    return float(middle[int(np.nanargmax(np.where(np.isfinite(apart), apart, -1)))])

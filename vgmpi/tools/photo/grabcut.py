"""Segmentation of an object by GrabCut from its box and from points; operations on masks."""

import logging
from typing import NamedTuple

import numpy as np
from scipy import ndimage

log = logging.getLogger("vgmpi")

GRABCUT_ITERATIONS = 6  # iterations of GrabCut
POINT_RADIUS = 0.008  # [-] radius around a point that it decides, relative to the longer side
MARGIN = 0.35  # [-] background around the box that is used, relative to the box
MIN_PIXELS = 64  # [pixels] smallest usable mask
MIN_FILL = 0.5  # [-] a mask that fills less of its box is reported
MIN_CONTRAST = 0.7  # [-] a mask is reported if less of its rim differs in color from the outside
COLOR_TOLERANCE = 12  # [0..255] color tolerance of the region that a point marks
THREAD_WIDTH = 0.025  # [-] thinner parts are removed, relative to the box's shorter side
RIM_STEP = 4.0  # [pixels] distance from the rim at which colors inside and outside are compared
SCALES = (2, 1)  # large parts of one color are cut from a reduced photograph, without its texture
MIN_SIDE = 40  # [pixels] shorter side of a photograph that is reduced
_SEED = 1


class MaskError(ValueError):
    """Error of an object without a usable mask; one line."""


class Box(NamedTuple):
    """Corners of a box in the picture [pixels]; right and bottom are exclusive."""

    left: int
    top: int
    right: int
    bottom: int

    @property
    def area(self) -> int:
        """Pixels in the box."""
        return (self.right - self.left) * (self.bottom - self.top)

    def shared_area(self, other: "Box") -> int:
        """Return the number of pixels in both boxes."""
        wide = min(self.right, other.right) - max(self.left, other.left)
        high = min(self.bottom, other.bottom) - max(self.top, other.top)
        return max(0, wide) * max(0, high)


def opencv():
    """Return the package cv2, limited to one thread and with a fixed seed.

    Raises:
        MaskError: OpenCV is missing.
    """
    try:
        import cv2
    except ImportError:
        message = "GrabCut needs OpenCV: pip install 'vgmpi[images]'"
        raise MaskError(message) from None
    cv2.setNumThreads(1)
    cv2.setRNGSeed(_SEED)
    return cv2


def segment_box(rgb: np.ndarray, box: Box, points: list[tuple[float, float, bool]]) -> np.ndarray:
    """Return the object in a box, (height, width) bool.

    Args:
        rgb: Photograph, shape (height, width, 3) uint8.
        box: Box of the object [pixels]; everything outside it is background.
        points: x, y [pixels] and whether the object is there.

    Raises:
        MaskError: The box is the whole picture, or GrabCut finds nothing in it.

    References:
        Rother, Kolmogorov and Blake 2004.
    """
    cv2 = opencv()
    height, width = rgb.shape[:2]
    margins = [MARGIN * (box.right - box.left) + 8, MARGIN * (box.bottom - box.top) + 8]
    x0, y0 = max(0, int(box.left - margins[0])), max(0, int(box.top - margins[1]))
    x1, y1 = min(width, int(box.right + margins[0])), min(height, int(box.bottom + margins[1]))
    patch = rgb[y0:y1, x0:x1]
    local_box = Box(box.left - x0, box.top - y0, box.right - x0, box.bottom - y0)
    local_points = [(x - x0, y - y0, is_object) for x, y, is_object in points]
    radius = POINT_RADIUS * max(width, height)
    estimate: np.ndarray | None = None
    for scale in SCALES:
        if scale == 1 or min(patch.shape[:2]) >= scale * MIN_SIDE:
            size = (x1 - x0) // scale, (y1 - y0) // scale
            small = cv2.resize(patch, size, interpolation=cv2.INTER_AREA)
            marks = [
                (int(x / scale), int(y / scale), is_object) for x, y, is_object in local_points
            ]
            label = _initial_label(cv2, small, local_box, scale, estimate)
            _mark_points(cv2, small, label, marks, max(1, round(radius / scale)))
            try:
                estimate = _cut(cv2, small, label)
            except MaskError:  # a small box may be none in the reduced photograph
                if scale == 1:
                    raise
    result = np.zeros((height, width), dtype=bool)
    assert estimate is not None
    result[y0:y1, x0:x1] = estimate > 0
    return clean_mask(result, box, points)


def _initial_label(
    cv2, patch: np.ndarray, box: Box, scale: int, estimate: np.ndarray | None
) -> np.ndarray:
    """Return the labels from which GrabCut starts, (height, width) uint8.

    Args:
        cv2: OpenCV.
        patch: Part of the photograph, shape (height, width, 3) uint8, reduced by `scale`.
        box: Box of the object in the part before it was reduced [pixels].
        scale: Factor by which pixels are enlarged.
        estimate: Object at a coarser scale, (rows, columns) uint8, or None.
    """
    height, width = patch.shape[:2]
    label = np.full((height, width), cv2.GC_BGD, dtype=np.uint8)
    left, top, right, bottom = (round(v / scale) for v in box)
    label[top:bottom, left:right] = cv2.GC_PR_FGD
    if estimate is not None and estimate.any():
        inside = cv2.resize(estimate, (width, height), interpolation=cv2.INTER_NEAREST) > 0
        label[(label == cv2.GC_PR_FGD) & ~inside] = cv2.GC_PR_BGD
    return label


def _mark_points(cv2, patch: np.ndarray, label: np.ndarray, points: list, radius: int) -> None:
    """Set the labels at points and in the regions of their colors.

    Args:
        cv2: OpenCV.
        patch: Part of the photograph, shape (height, width, 3) uint8.
        label: Labels of GrabCut (in/out), (height, width) uint8.
        points: x, y [pixels] in the part and whether the object is there.
        radius: Distance from a point that it decides whatever the colors are [pixels].
    """
    height, width = label.shape
    # those of the object come last and have precedence; the object does not reach beyond the part
    for x, y, is_object in sorted(points, key=lambda point: point[2]):
        if 0 <= x < width and 0 <= y < height:
            kind = cv2.GC_FGD if is_object else cv2.GC_BGD
            label[_same_color_region(cv2, patch, (x, y)) & (label != cv2.GC_BGD)] = kind
            cv2.circle(label, (x, y), radius, int(kind), -1)


def _cut(cv2, patch: np.ndarray, label: np.ndarray) -> np.ndarray:
    """Return the object by GrabCut, (height, width) uint8.

    Args:
        cv2: OpenCV.
        patch: Part of the photograph, shape (height, width, 3) uint8.
        label: Labels from which GrabCut starts, which changes them.

    Raises:
        MaskError: The box is the whole picture, or GrabCut finds nothing in it.
    """
    if not (label == cv2.GC_BGD).any():
        raise MaskError("the box is the whole picture: nothing is left that is background")
    back, fore = np.zeros((1, 65)), np.zeros((1, 65))
    try:
        cv2.grabCut(patch, label, None, back, fore, GRABCUT_ITERATIONS, cv2.GC_INIT_WITH_MASK)
    except cv2.error as error:
        message = str(error).strip().splitlines()[0]
        raise MaskError(f"GrabCut finds nothing in the box: {message}") from None
    return ((label == cv2.GC_FGD) | (label == cv2.GC_PR_FGD)).astype(np.uint8)


def _same_color_region(cv2, patch: np.ndarray, seed: tuple[int, int]) -> np.ndarray:
    """Return the region (height, width) bool around a point that has the point's color.

    A point alone is a few pixels, which would hardly change the color model of all the others.
    """
    smooth = cv2.GaussianBlur(patch, (0, 0), 1.5)
    flooded = np.zeros((patch.shape[0] + 2, patch.shape[1] + 2), dtype=np.uint8)
    flags = 4 | cv2.FLOODFILL_MASK_ONLY | cv2.FLOODFILL_FIXED_RANGE | (255 << 8)
    cv2.floodFill(smooth, flooded, seed, 0, (COLOR_TOLERANCE,) * 3, (COLOR_TOLERANCE,) * 3, flags)
    return flooded[1:-1, 1:-1] > 0


def remove_threads(mask: np.ndarray, box: Box) -> np.ndarray:
    """Remove parts of a mask that are thinner than a fraction of its box.

    Background edges of the object's color make such threads.
    """
    radius = max(1, round(THREAD_WIDTH * min(box.right - box.left, box.bottom - box.top) / 2))
    y, x = np.mgrid[-radius : radius + 1, -radius : radius + 1]
    result = ndimage.binary_opening(mask, x * x + y * y <= radius * radius)
    return result if result.sum() > 0.5 * mask.sum() else mask


def largest_component(mask: np.ndarray) -> np.ndarray:
    """Return the largest connected component of a mask without its holes; empty stays empty."""
    return ndimage.binary_fill_holes(_largest_part(mask))


def _largest_part(mask: np.ndarray) -> np.ndarray:
    """Return the largest connected component of a mask; empty stays empty."""
    label, count = ndimage.label(mask)
    if not count:
        return mask
    size = ndimage.sum_labels(mask, label, np.arange(1, count + 1))
    return label == 1 + int(np.argmax(size))


def clean_mask(mask: np.ndarray, box: Box, points: list[tuple[float, float, bool]]) -> np.ndarray:
    """Remove threads, small parts and holes from a mask, except where points decide.

    The largest part remains, and each part and thread on which a point of the object lies, with the
    threads that end there. A hole with a point of the background remains a hole.

    Args:
        mask: Mask, (height, width) bool.
        box: Box of the object [pixels].
        points: x, y [pixels] and whether the object is there.
    """
    opened = remove_threads(mask, box)
    threads = mask & ~opened
    marked = _parts_at(opened, points, True) & ~_largest_part(opened)
    label, _ = ndimage.label(threads)
    ends = np.unique(label[ndimage.binary_dilation(marked)])
    attached = np.isin(label, ends[ends > 0]) | _parts_at(threads, points, True)
    return marked_parts(opened | attached, points)


def marked_parts(mask: np.ndarray, points: list[tuple[float, float, bool]]) -> np.ndarray:
    """Return the largest part of a mask and those that points mark, without unmarked holes.

    Args:
        mask: Mask, (height, width) bool.
        points: x, y [pixels] and whether the object is there.
    """
    parts = _parts_at(mask, points, True) | _largest_part(mask)
    holes = ndimage.binary_fill_holes(parts) & ~parts
    return parts | (holes & ~_parts_at(holes, points, False))


def _parts_at(
    mask: np.ndarray, points: list[tuple[float, float, bool]], is_object: bool
) -> np.ndarray:
    """Return the connected components of a mask that hold a point of the object, or of none."""
    label, _ = ndimage.label(mask)
    numbers = {int(label[int(y), int(x)]) for x, y, on_object in points if on_object == is_object}
    return np.isin(label, list(numbers - {0}))


def rim_contrast(rgb: np.ndarray, mask: np.ndarray) -> float:
    """Return the fraction of a mask's rim at which the colors inside and outside differ.

    Args:
        rgb: Photograph, shape (height, width, 3) uint8.
        mask: Mask, (height, width) bool.
    """
    depth = ndimage.distance_transform_edt(mask) - ndimage.distance_transform_edt(~mask)
    rim = (depth >= 1) & (depth < 2)
    slope = np.stack(np.gradient(ndimage.gaussian_filter(depth, 2.0)), -1)
    slope /= np.maximum(np.linalg.norm(slope, axis=-1, keepdims=True), 1e-9)
    smooth = ndimage.gaussian_filter(rgb.astype(np.float64), (1.0, 1.0, 0))
    pixels = np.argwhere(rim)
    step = RIM_STEP * slope[rim]
    size = np.array(mask.shape) - 1
    inner, outer = (np.clip(np.rint(pixels + sign * step), 0, size).astype(int) for sign in (1, -1))
    difference = np.abs(smooth[tuple(inner.T)] - smooth[tuple(outer.T)]).max(-1)
    return float((difference > COLOR_TOLERANCE).mean()) if len(pixels) else 1.0


def check_mask(mask: np.ndarray) -> None:
    """Check that a mask is usable.

    Raises:
        MaskError: The mask is empty or too small.
    """
    count = int(mask.sum())
    if count < MIN_PIXELS:
        problem = (
            "is empty"
            if not count
            else f"has {count} pixels only, at least {MIN_PIXELS} are needed"
        )
        raise MaskError(
            f"its mask {problem}: give another box, point_prompts, or mask = 'file.png'"
        )


def mask_warnings(rgb: np.ndarray, mask: np.ndarray, box: Box | None) -> list[str]:
    """Return warnings about a usable mask.

    Args:
        rgb: Photograph, shape (height, width, 3) uint8.
        mask: Mask, (height, width) bool.
        box: Box of the object in the layout, or None.
    """
    warnings = []
    edges = {"left": mask[:, 0], "right": mask[:, -1], "upper": mask[0], "lower": mask[-1]}
    touched = [name for name, edge in edges.items() if edge.any()]
    if touched:
        names = " and ".join(touched)
        warnings = [f"its mask touches the {names} edge of the picture: the rest is cut off"]
    fill = mask.sum() / ((box.right - box.left) * (box.bottom - box.top)) if box else 1.0
    if fill < MIN_FILL:
        warnings.append(
            f"its mask fills {100 * fill:.0f} % of its box: if parts are missing, add"
            " point_prompts on them"
        )
    contrast = rim_contrast(rgb, mask)
    if contrast < MIN_CONTRAST:
        warnings.append(
            f"{100 * (1 - contrast):.0f} % of the rim of its mask have the color of what lies"
            " outside: add point_prompts on both sides of the true rim"
        )
    return warnings


def iou(a: np.ndarray, b: np.ndarray) -> float:
    """Return the intersection over union of two masks of one shape."""
    either = int((a | b).sum())
    return float((a & b).sum() / either) if either else 1.0


def box_overlap(a: Box, b: Box) -> float:
    """Return the intersection over union of two boxes."""
    shared = a.shared_area(b)
    return shared / (a.area + b.area - shared)


def box_of(mask: np.ndarray) -> Box:
    """Return the smallest box around a mask that is not empty."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    return Box(int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1)

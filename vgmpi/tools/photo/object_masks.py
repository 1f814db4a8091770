"""Masks of the layout's objects from files, from the alpha channel, or from a segmenter."""

import logging
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np

from . import photograph
from .grabcut import Box, MaskError, check_mask, largest_component, mask_warnings, segment_box
from .layout_config import LayoutError, LoadedLayout, ObjectTable
from .photograph import Photograph, PhotographError

log = logging.getLogger("vgmpi.tools.photo")

PointPrompts = list[tuple[float, float, bool]]
NO_MASK = (
    "needs a box = [left, top, right, bottom] in pixels, or a mask = 'file.png'; --find proposes"
    " boxes, --edit draws them"
)
OVERLAP_WARNING = 0.25  # [-] masks that share this fraction of the smaller one are reported


class Finder(Protocol):
    """Segmenter: find an object by a box, points or words.

    The result is (height, width) bool. Raises MaskError.
    """

    def __call__(
        self, rgb: np.ndarray, box: Box | None, points: PointPrompts, text: str | None
    ) -> np.ndarray:
        """Return the pixels of one object, (height, width) bool."""
        ...


class ObjectMask(NamedTuple):
    """Mask of one object and its origin."""

    mask: np.ndarray  # (height, width) bool
    origin: str  # origin of the mask, for messages
    is_from_file: bool  # True if the layout names a file with the mask


def grabcut(rgb: np.ndarray, box: Box | None, points: PointPrompts, text: str | None) -> np.ndarray:
    """Segment an object by GrabCut: a Finder without weights that needs a box.

    Args:
        rgb: Photograph, shape (height, width, 3) uint8.
        box: Box of the object [pixels].
        points: x, y [pixels] and whether the object is there.
        text: Ignored.

    Raises:
        MaskError: There is no box, or GrabCut finds nothing in it.
    """
    if box is None:
        raise MaskError("GrabCut needs box = [left, top, right, bottom] around it")
    return segment_box(rgb, box, points)


def segment_objects(loaded: LoadedLayout, photo: Photograph, finder: Finder) -> list[ObjectMask]:
    """Return the mask of every object.

    Raises:
        LayoutError: Some objects have no usable mask; it reports all of them.
    """
    errors: list[tuple[tuple, str]] = []
    results: list[ObjectMask | None] = []
    for k, obj in enumerate(loaded.layout.object):
        try:
            results.append(_object_mask(obj, loaded, photo, finder))
        except KeyedError as error:
            errors.append((("object", k, error.key), str(error)))
            results.append(None)
    if errors:
        raise LayoutError(loaded.source.lines(errors))
    object_masks = [object_mask for object_mask in results if object_mask is not None]
    for k, (obj, object_mask) in enumerate(zip(loaded.layout.object, object_masks)):
        log.info("'%s': %d pixels, %s", obj.name, object_mask.mask.sum(), object_mask.origin)
        box = None if object_mask.is_from_file else scaled_box(obj, photo)
        for warning in mask_warnings(photo.rgb, object_mask.mask, box):
            log.warning("'%s': %s", obj.name, warning)
        for point in missed_points(obj, object_mask.mask, photo.reduced):
            _, where = loaded.source.place(("object", k, "point_prompts"))
            log.warning("%s: object.%s.point_prompts: %s: %s", where, obj.name, point,
                        "give mask = 'file.png', or more points")  # fmt: skip
    return object_masks


def missed_points(obj: ObjectTable, mask: np.ndarray, reduced: float) -> list[str]:
    """Return what is wrong at each point of an object that its mask contradicts.

    Args:
        obj: The object of the layout.
        mask: Its mask, (height, width) bool.
        reduced: Pixels of the file per pixel of the mask.
    """
    return [
        f"[{x:g}, {y:g}] is not in the mask"
        if is_object
        else f'[{x:g}, {y:g}, "out"] is in the mask'
        for x, y, is_object in obj.point_prompts
        if mask[int(y / reduced), int(x / reduced)] != is_object
    ]


class KeyedError(MaskError):
    """Error of one key of an object."""

    def __init__(self, key: str, message: object):
        super().__init__(str(message))
        self.key = key


def _object_mask(
    obj: ObjectTable, loaded: LoadedLayout, photo: Photograph, finder: Finder
) -> ObjectMask:
    """Return the mask of one object.

    Raises:
        KeyedError: The object has no usable mask.
    """
    box = scaled_box(obj, photo)
    points = scaled_points(obj, photo, box)
    segmenter = loaded.layout.masks.method
    if obj.mask is not None:
        key, origin = "mask", f"the mask {obj.mask}"
    elif box is None and not points:
        if photo.alpha is None:
            raise KeyedError("box", NO_MASK)
        key, origin = "box", "what the picture's alpha shows"
    else:
        key = "box" if box is not None else "point_prompts"
        origin = f"found by {segmenter} from its {key.replace('_', ' ')}"
    try:
        if obj.mask is not None or origin.startswith("what"):
            mask = file_mask(obj, loaded.source.folder, photo)
        else:
            mask = finder(photo.rgb, box, points, obj.text)
        check_mask(mask)
    except (MaskError, PhotographError) as error:
        raise KeyedError(key, error) from None
    return ObjectMask(mask, origin, obj.mask is not None)


def file_mask(obj: ObjectTable, folder: Path, photo: Photograph) -> np.ndarray:
    """Return the mask (height, width) bool of an object from its file, or from the alpha channel.

    Args:
        obj: The object of the layout.
        folder: Folder of the layout.
        photo: The photograph.

    Raises:
        MaskError: There is neither a file nor an alpha channel.
        PhotographError: The file is unreadable or has another size.
    """
    if obj.mask is not None:
        return _reduced_mask(photograph.read_mask(folder / obj.mask, photo), photo)
    if photo.alpha is None:
        raise KeyedError("box", NO_MASK)
    return largest_component(photo.alpha > 127)


def _reduced_mask(mask: np.ndarray, photo: Photograph) -> np.ndarray:
    """Resize a mask from the pixels of the file to the pixels of the reduced photograph."""
    height, width = photo.rgb.shape[:2]
    if mask.shape == (height, width):
        return mask
    from PIL import Image

    levels = Image.fromarray(np.where(mask, 255, 0).astype(np.uint8))
    return np.asarray(levels.resize((width, height), Image.Resampling.BOX)) > 127


def scaled_box(obj: ObjectTable, photo: Photograph) -> Box | None:
    """Return the box in the pixels of the reduced photograph, clipped to the picture.

    Raises:
        KeyedError: The box lies outside the picture, or is too small.
    """
    if obj.box is None:
        return None
    width, height = photo.size
    left, top, right, bottom = obj.box
    if right <= 0 or bottom <= 0 or left >= width or top >= height:
        message = f"lies outside the picture, which has {width} x {height} pixels"
        raise KeyedError("box", f"{message}; got {list(obj.box)}")
    if left < -width / 10 or top < -height / 10 or right > 1.1 * width or bottom > 1.1 * height:
        message = f"reaches far out of the picture, which has {width} x {height} pixels"
        raise KeyedError("box", f"{message}; got {list(obj.box)}")
    small = (round(v / photo.reduced) for v in obj.box)
    left, top, right, bottom = small
    rows, columns = photo.rgb.shape[:2]
    box = Box(max(0, left), max(0, top), min(columns, right), min(rows, bottom))
    if min(box.right - box.left, box.bottom - box.top) < 4:
        raise KeyedError("box", f"is less than 4 pixels wide or high; got {list(obj.box)}")
    return box


def scaled_points(obj: ObjectTable, photo: Photograph, box: Box | None) -> PointPrompts:
    """Return the points in the pixels of the reduced photograph.

    Raises:
        KeyedError: A point lies outside the picture or the box.
    """
    width, height = photo.size
    small = []
    for x, y, is_object in obj.point_prompts:
        if not (0 <= x < width and 0 <= y < height):
            message = f"lies outside the picture, which has {width} x {height} pixels"
            raise KeyedError("point_prompts", f"[{x:g}, {y:g}] {message}")
        x, y = x / photo.reduced, y / photo.reduced
        inside = box is None or (box.left <= x < box.right and box.top <= y < box.bottom)
        if is_object and not inside:
            raise KeyedError("point_prompts", f"[{x:g}, {y:g}] lies outside the object's own box")
        small.append((x, y, is_object))
    return small


def share_pixels(a: np.ndarray, b: np.ndarray) -> bool:
    """Return whether two masks (height, width) bool share much of the smaller one."""
    return int((a & b).sum()) > OVERLAP_WARNING * min(int(a.sum()), int(b.sum()))


def overlapping_masks(object_masks: list[ObjectMask], objects: tuple[ObjectTable, ...]) -> None:
    """Report pairs of masks that share many pixels, except a liquid's with its cup's."""
    for k, (current, obj) in enumerate(zip(object_masks, objects)):
        for other, previous in zip(object_masks[:k], objects[:k]):
            are_nested = obj.inside == previous.name or previous.inside == obj.name
            if not are_nested and share_pixels(current.mask, other.mask):
                shared = int((current.mask & other.mask).sum())
                log.warning("'%s' and '%s' share %d pixels: the smaller one is taken as in front",
                            previous.name, obj.name, shared)  # fmt: skip

"""The masks of a layout's objects, from whoever finds them."""

import logging
from typing import NamedTuple, Protocol

import numpy as np

from vgmpi.images import masks, photograph
from vgmpi.images.layout import LayoutError, ObjectTable, Told
from vgmpi.images.masks import Box, MaskError
from vgmpi.images.photograph import Photograph, PhotographError

log = logging.getLogger("vgmpi.images")

Clicks = list[tuple[float, float, bool]]
LESS = 0.25  # of an outline that others cover: then it is told


class Finder(Protocol):
    """Whoever finds the pixels of an object (height, width) bool, by a box, clicks or words. Raises
    MaskError."""

    def __call__(
        self, rgb: np.ndarray, box: Box | None, clicks: Clicks, text: str | None
    ) -> np.ndarray: ...


class Found(NamedTuple):
    """mask: (height, width) bool. how: where it came from, for people. given: whether it is a file
    of the layout's."""

    mask: np.ndarray
    how: str
    given: bool


def grabcut(rgb: np.ndarray, box: Box | None, clicks: Clicks, text: str | None) -> np.ndarray:
    """A Finder that needs no weights, and a box."""
    if box is None:
        raise MaskError("GrabCut needs box = [left, top, right, bottom] around it")
    return masks.grabcut(rgb, box, clicks)


def find(told: Told, photo: Photograph, finder: Finder) -> list[Found]:
    """The mask of every object. Raises LayoutError with all that is wrong."""
    wrong: list[tuple[tuple, str]] = []
    found: list[Found | None] = []
    for k, thing in enumerate(told.layout.object):
        try:
            found.append(_one(thing, told, photo, finder))
        except _KeyedError as error:
            wrong.append((("object", k, error.key), str(error)))
            found.append(None)
    if wrong:
        raise LayoutError(told.source.lines(wrong))
    kept = [one for one in found if one is not None]
    for thing, one in zip(told.layout.object, kept):
        log.info("'%s': %d pixels, %s", thing.name, one.mask.sum(), one.how)
        for said in masks.checked(one.mask):
            log.warning("'%s': %s", thing.name, said)
    return kept


class _KeyedError(ValueError):
    """What is wrong with a key of an object."""

    def __init__(self, key: str, said: object):
        super().__init__(str(said))
        self.key = key


def _one(thing: ObjectTable, told: Told, photo: Photograph, finder: Finder) -> Found:
    """The mask of one object. Raises _KeyedError."""
    box = _box(thing, photo)
    clicks = _clicks(thing, photo, box)
    by = told.layout.masks.by
    if thing.mask is not None:
        key, how = "mask", f"the mask {thing.mask}"
    elif box is None and not clicks:
        if photo.alpha is None:
            said = "needs a box = [left, top, right, bottom] in pixels, or a mask = 'file.png'"
            raise _KeyedError("box", f"{said}; --find proposes boxes")
        key, how = "box", "what the picture's alpha shows"
    else:
        key = "box" if box is not None else "clicks"
        how = f"found by {by} from its {key}"
    try:
        if thing.mask is not None:
            mask = _small(photograph.grey(told.path(thing.mask), photo), photo)
        elif how.startswith("what"):
            assert photo.alpha is not None
            mask = masks.largest(photo.alpha > 127)
        else:
            mask = finder(photo.rgb, box, clicks, thing.text)
        masks.checked(mask)
    except (MaskError, PhotographError) as error:
        raise _KeyedError(key, error) from None
    return Found(mask, how, thing.mask is not None)


def _small(mask: np.ndarray, photo: Photograph) -> np.ndarray:
    """A mask in the pixels of the file, in those that are worked with."""
    height, width = photo.rgb.shape[:2]
    if mask.shape == (height, width):
        return mask
    from PIL import Image

    levels = Image.fromarray(np.where(mask, 255, 0).astype(np.uint8))
    return np.asarray(levels.resize((width, height), Image.Resampling.BOX)) > 127


def _box(thing: ObjectTable, photo: Photograph) -> Box | None:
    """The box in the pixels that are worked with, cut to the picture."""
    if thing.box is None:
        return None
    width, height = photo.size
    left, top, right, bottom = thing.box
    if right <= 0 or bottom <= 0 or left >= width or top >= height:
        said = f"lies outside the picture, which has {width} x {height} pixels"
        raise _KeyedError("box", f"{said}; got {list(thing.box)}")
    if left < -width / 10 or top < -height / 10 or right > 1.1 * width or bottom > 1.1 * height:
        said = f"reaches far out of the picture, which has {width} x {height} pixels"
        raise _KeyedError("box", f"{said}; got {list(thing.box)}")
    small = (round(v / photo.reduced) for v in thing.box)
    left, top, right, bottom = small
    rows, columns = photo.rgb.shape[:2]
    box = Box(max(0, left), max(0, top), min(columns, right), min(rows, bottom))
    if min(box.right - box.left, box.bottom - box.top) < 4:
        raise _KeyedError("box", f"is less than 4 pixels wide or high; got {list(thing.box)}")
    return box


def _clicks(thing: ObjectTable, photo: Photograph, box: Box | None) -> Clicks:
    """The clicks in the pixels that are worked with."""
    width, height = photo.size
    small = []
    for x, y, is_it in thing.clicks:
        if not (0 <= x < width and 0 <= y < height):
            said = f"lies outside the picture, which has {width} x {height} pixels"
            raise _KeyedError("clicks", f"[{x:g}, {y:g}] {said}")
        x, y = x / photo.reduced, y / photo.reduced
        inside = box is None or (box.left <= x < box.right and box.top <= y < box.bottom)
        if is_it and not inside:
            raise _KeyedError("clicks", f"[{x:g}, {y:g}] lies outside the object's own box")
        small.append((x, y, is_it))
    return small


def hidden(found: list[Found], names: list[str]) -> None:
    """A line where masks share pixels, which cannot be both."""
    for k, one in enumerate(found):
        for j in range(k):
            both = int((one.mask & found[j].mask).sum())
            if both > LESS * min(int(one.mask.sum()), int(found[j].mask.sum())):
                log.warning(
                    "'%s' and '%s' share %d pixels: is one of them the other?",
                    names[j], names[k], both,
                )  # fmt: skip

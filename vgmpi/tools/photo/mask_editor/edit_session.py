"""Editing of a layout: masks of objects by boxes, points and painted strokes, and their file.

The page sends the state of an object and gets its mask. All masks are made here, by the functions
that `vgmpi photo` uses, so that the saved layout gives the masks that the page has shown.
"""

import io
import threading
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field, ValidationError

from vgmpi.runtime.config.schema import StrictModel, format_validation_errors
from vgmpi.runtime.user_files import replace_file

from .. import box_proposals, grabcut, layout_config, layout_text, learned_models, object_masks
from ..grabcut import Box, MaskError
from ..layout_config import LayoutError, ObjectTable
from ..photograph import Photograph

CLICK_BOX = (
    0.15  # [-] half side of the box around a point, relative to the photograph's longer side
)
POINT_MARGIN = 8  # [pixels] a box reaches at least this far beyond the points on its object

Pixel = Annotated[float, Field(ge=-1e4, le=1e4)]


class Stroke(StrictModel):
    """Stroke of the brush."""

    radius: Annotated[float, Field(ge=0.5, le=500)]  # [pixels]
    erases: bool
    path: Annotated[tuple[tuple[Pixel, Pixel], ...], Field(min_length=1, max_length=20000)]


class EditedObject(StrictModel):
    """State of an object on the page, in pixels of the reduced photograph."""

    key: Annotated[str, Field(max_length=100)]
    """identifies the object while the page is open"""
    name: str
    height: str = ""
    """with its unit; "" if it is not known"""
    box: tuple[int, int, int, int] | None = None
    points: Annotated[tuple[tuple[Pixel, Pixel, bool], ...], Field(max_length=1000)] = ()
    strokes: Annotated[tuple[Stroke, ...], Field(max_length=5000)] = ()
    uses_file: bool = False
    """whether the mask of the file is shown, and not one from box and points"""


class EditedLayout(StrictModel):
    """All objects of the page."""

    objects: Annotated[tuple[EditedObject, ...], Field(max_length=layout_config.MAX_OBJECTS)]


class EditSession:
    """Layout that is edited.

    Args:
        photo: The photograph.
        path: The layout; it need not exist.

    Raises:
        LayoutError: The layout is invalid, or a model cannot be loaded.
    """

    def __init__(self, photo: Photograph, path: Path):
        self.photo, self.path = photo, path
        self._lock = threading.Lock()
        self._table_numbers: dict[str, int] = {}  # of the objects in the file, by their keys
        self._file_masks: dict[str, np.ndarray] = {}
        self._in_file: dict[str, EditedObject] = {}  # states of the objects in the file
        self._salient: list[Box] | None = None
        empty, self._text, tables = layout_config.read_unfinished(path)
        self._finder = learned_models.finder(empty, path.parent)
        self.objects = [self._read_object(k, table) for k, table in enumerate(tables)]

    def _read_object(self, number: int, table: ObjectTable) -> EditedObject:
        """Return the state of an object of the file."""
        key = f"file-{number}"
        self._table_numbers[key] = number
        box = object_masks.scaled_box(table, self.photo)
        points = object_masks.scaled_points(table, self.photo, box)
        uses_file = table.mask is not None or (box is None and not points)
        if uses_file:
            self._file_masks[key] = object_masks.file_mask(table, self.path.parent, self.photo)
        height = "" if table.height is None else f"{table.height:g} m"
        state = EditedObject(
            key=key, name=table.name, height=height, box=box, points=tuple(points),
            uses_file=uses_file,
        )  # fmt: skip
        self._in_file[key] = state
        return state

    def mask(self, edited: EditedObject) -> tuple[np.ndarray, Box | None]:
        """Return the mask of an object, (height, width) bool, and the box that was used.

        Raises:
            MaskError: Box and points give no mask.
        """
        with self._lock:
            edited = self._with_box(edited)
            if edited.uses_file and edited.key in self._file_masks:
                mask = self._file_masks[edited.key]
            elif edited.box is None:
                mask = np.zeros(self.photo.rgb.shape[:2], dtype=bool)
            else:
                table = self._table(edited)
                box = object_masks.scaled_box(table, self.photo)
                points = object_masks.scaled_points(table, self.photo, box)
                mask = self._finder(self.photo.rgb, box, points, table.text)
        return paint(mask, edited.strokes), None if edited.box is None else Box(*edited.box)

    def warnings(self, edited: EditedObject, mask: np.ndarray) -> list[str]:
        """Return what is doubtful about the mask of an object."""
        try:
            grabcut.check_mask(mask)
        except MaskError as error:
            return [str(error)]
        if edited.strokes:
            return []
        box = None if edited.box is None else Box(*edited.box)
        return grabcut.mask_warnings(self.photo.rgb, mask, box)

    def save(self, edited: EditedLayout) -> list[Path]:
        """Write the layout, and the masks that were painted, beside it.

        Returns:
            The files that were written.

        Raises:
            LayoutError: An object has no usable name, height or mask; nothing is written.
            OSError: A file cannot be written.
        """
        masks, errors = {}, []
        for item in edited.objects:
            try:
                mask, box = self.mask(item)
                grabcut.check_mask(mask)
                previous = self._in_file.get(item.key)
                if item.strokes or (item.uses_file and previous and previous.strokes):
                    masks[item.key] = mask
                self._table(item.model_copy(update={"box": box}))
            except (MaskError, LayoutError) as error:
                errors.append(f"'{item.name}': {error}")
        names = [item.name.lower() for item in edited.objects]
        errors += [f"two objects have the name '{n}'" for n in sorted(set(names)) if
                   names.count(n) > 1]  # fmt: skip
        if not names:
            errors.append("there is no object: drag a box around one, or paint it")
        if errors:
            raise LayoutError(errors)
        with self._lock:
            return self._write(edited, masks)

    def _write(self, edited: EditedLayout, masks: dict[str, np.ndarray]) -> list[Path]:
        """Write the masks and the layout; return their paths."""
        tables: list[tuple[int | None, dict[str, Any]]] = []
        files, states = [], {}
        for item in edited.objects:
            item = self._with_box(item)
            values, previous = self._layout_values(item), self._in_file.get(item.key)
            if previous is not None:  # what was not edited stays as it was written
                unchanged = {"box": item.box == previous.box, "height": item.height
                             == previous.height, "point_prompts": item.points == previous.points,
                             }  # fmt: skip
                values = {k: v for k, v in values.items() if not unchanged.get(k)}
            if item.key in masks:
                file = self.path.parent / "masks" / f"{item.name}.png"
                file.parent.mkdir(parents=True, exist_ok=True)
                replace_file(file, png(np.where(masks[item.key], 255, 0).astype(np.uint8)))
                values["mask"] = f"masks/{item.name}.png"
                files.append(file)
            elif not item.uses_file:
                values["mask"] = None
            tables.append((self._table_numbers.get(item.key), values))
            states[item.key] = item
        self._text = layout_text.replace_objects(self._text, tables)
        self.path.parent.mkdir(parents=True, exist_ok=True)
        replace_file(self.path, self._text)
        self._in_file, numbers = states, self._table_numbers
        written = [item.key for item in edited.objects]
        written.sort(key=lambda key: numbers.get(key, len(numbers) + layout_config.MAX_OBJECTS))
        self._table_numbers = {key: k for k, key in enumerate(written)}
        return [*files, self.path]

    def _layout_values(self, edited: EditedObject) -> dict[str, Any]:
        """Return the keys of an object's table, in pixels of the file; None: no such key."""
        factor = self.photo.reduced
        points = [
            [_in_file(x, factor), _in_file(y, factor), *([] if is_object else ["out"])]
            for x, y, is_object in edited.points
        ]
        return {
            "name": edited.name,
            "box": [round(v * factor) for v in edited.box] if edited.box else None,
            "point_prompts": points or None,
            "height": edited.height.strip() or None,
        }

    def _table(self, edited: EditedObject) -> ObjectTable:
        """Return the table of an object as the layout will have it.

        Raises:
            LayoutError: A value is not allowed.
        """
        values = {k: v for k, v in self._layout_values(edited).items() if v is not None}
        try:
            return ObjectTable.model_validate(values)
        except ValidationError as error:
            problems = format_validation_errors(error, ObjectTable)
            message = "; ".join(
                f"{'.'.join(str(p) for p in path)}: {text}" for path, text in problems
            )
            raise LayoutError([message]) from None

    def _with_box(self, edited: EditedObject) -> EditedObject:
        """Return an object with a box that holds its points, if it has points on it."""
        points = [(x, y) for x, y, is_object in edited.points if is_object]
        if edited.uses_file or not points:
            return edited
        height, width = self.photo.rgb.shape[:2]
        box = edited.box if edited.box is not None else self._box_of_point(points[0])
        low, high = np.min(points, axis=0) - POINT_MARGIN, np.max(points, axis=0) + POINT_MARGIN
        left, top, right, bottom = box
        grown = (
            left if left <= low[0] + POINT_MARGIN else max(0, int(low[0])),
            top if top <= low[1] + POINT_MARGIN else max(0, int(low[1])),
            right if right > high[0] - POINT_MARGIN else min(width, int(high[0]) + 1),
            bottom if bottom > high[1] - POINT_MARGIN else min(height, int(high[1]) + 1),
        )
        return edited.model_copy(update={"box": grown})

    def _box_of_point(self, point: tuple[float, float]) -> tuple[int, int, int, int]:
        """Return the box of the smallest salient region around a point, else a square."""
        if self._salient is None:
            self._salient = box_proposals.saliency_boxes(self.photo.rgb)
        x, y = point
        regions = [b for b in self._salient if b.left <= x < b.right and b.top <= y < b.bottom]
        if regions:
            return min(regions, key=lambda b: (b.right - b.left) * (b.bottom - b.top))
        height, width = self.photo.rgb.shape[:2]
        half = CLICK_BOX * max(height, width)
        return (
            max(0, round(x - half)), max(0, round(y - half)),
            min(width, round(x + half)), min(height, round(y + half)),
        )  # fmt: skip


def paint(mask: np.ndarray, strokes: tuple[Stroke, ...]) -> np.ndarray:
    """Return a mask (height, width) bool with strokes added and erased in their order."""
    from PIL import Image, ImageDraw

    if not strokes:
        return mask
    image = Image.fromarray(np.where(mask, 255, 0).astype(np.uint8))
    pen = ImageDraw.Draw(image)
    for stroke in strokes:
        level, r = 0 if stroke.erases else 255, stroke.radius
        if len(stroke.path) > 1:
            pen.line(stroke.path, fill=level, width=max(1, round(2 * r)))
        for x, y in stroke.path:
            pen.ellipse((x - r, y - r, x + r, y + r), fill=level)
    return np.asarray(image) > 127


def png(pixels: np.ndarray) -> bytes:
    """Return a PNG of uint8 pixels (height, width), or with 3 or 4 channels."""
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "png")
    return buffer.getvalue()


def _in_file(value: float, factor: float) -> float | int:
    """Return a coordinate in pixels of the file, a whole number where that is exact."""
    scaled = round(value * factor, 1)
    return int(scaled) if scaled == int(scaled) else scaled

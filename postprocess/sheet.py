"""Pictures of variants on one labelled sheet, each with two details of it enlarged."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy import ndimage

from postprocess.figures import GREY, Regions, grain

COLUMNS = 3
WIDTH = 440  # pixels of a picture on the sheet
PART = 0.2  # of a picture's width and height that a detail shows
GAP, LABEL, SIZE = 8, 26, 17  # pixels; height of a line and of its letters


def sheet(variants: Sequence[Any], where: Regions) -> np.ndarray:
    """A uint8 picture. variants: with `name` and `picture` (height, width, 3), the first one what
    the others are compared with. where: the pixels from which the details are chosen."""
    places = details([one.picture for one in variants], where)
    tiles = [_tile(one.name, one.picture, places) for one in variants]
    blank = np.full_like(tiles[0], 255)
    tiles += [blank] * (-len(tiles) % COLUMNS)
    rows = [np.hstack(tiles[k : k + COLUMNS]) for k in range(0, len(tiles), COLUMNS)]
    return np.vstack(rows)


def details(pictures: list[np.ndarray], where: Regions) -> list[tuple[int, int]]:
    """Upper left corners (row, column) of the parts where the variants differ most: in what is fine
    on fluid, sand and snow, and in anything on solids.

    Each variant counts by its own largest difference, or the strongest would decide alone.
    """
    grey = [one.astype(np.float64) @ GREY for one in pictures]
    fine = [grain(one) for one in grey]
    return [_most(fine, where.loose), _most(grey, where.solid)]


def _most(images: list[np.ndarray], mask: np.ndarray) -> tuple[int, int]:
    height, width = mask.shape
    h, w = _detail_size(height, width)
    total = np.zeros((height, width))
    for one in images[1:]:
        error = np.sqrt(np.abs(one - images[0])) * mask  # many weak ones outweigh one strong edge
        local = ndimage.uniform_filter(error, (h, w), mode="constant")
        if local.max() > 0:
            total += local / local.max()
    row, column = np.unravel_index(np.argmax(total), total.shape)
    low, left = row - h // 2, column - w // 2
    return int(np.clip(low, 0, height - h)), int(np.clip(left, 0, width - w))


def _detail_size(height: int, width: int) -> tuple[int, int]:
    return max(int(PART * height), 1), max(int(PART * width), 1)


def _tile(name: str, picture: np.ndarray, places: list[tuple[int, int]]) -> np.ndarray:
    """A label, the picture, and below it its details."""
    from PIL import Image, ImageDraw, ImageFont

    height, width, _ = picture.shape
    h, w = _detail_size(height, width)
    shown = round(WIDTH * height / width)
    half = (WIDTH - GAP) // 2
    low = round(half * h / w)
    tile = Image.new("RGB", (WIDTH + GAP, LABEL + shown + GAP + low + 2 * GAP), "white")
    whole = Image.fromarray(picture)
    tile.paste(whole.resize((WIDTH, shown), Image.Resampling.LANCZOS), (0, LABEL))
    pen = ImageDraw.Draw(tile)
    pen.text((4, 3), name, fill="black", font=ImageFont.load_default(size=SIZE))
    for k, (row, column) in enumerate(places):
        part = whole.crop((column, row, column + w, row + h))
        x, y = k * (half + GAP), LABEL + shown + GAP
        tile.paste(part.resize((half, low), Image.Resampling.NEAREST), (x, y))
        pen.rectangle((x, y, x + half - 1, y + low - 1), outline=(150, 150, 150))
        corners = [column, row, column + w, row + h]
        scaled = [round(c * WIDTH / width) for c in corners]
        pen.rectangle(
            (scaled[0], LABEL + scaled[1], scaled[2], LABEL + scaled[3]), outline=(150,) * 3
        )
    return np.asarray(tile)

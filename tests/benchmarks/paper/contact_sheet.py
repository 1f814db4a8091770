"""Contact sheet of labeled image variants, each with two enlarged details."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy import ndimage

from tests.benchmarks.paper.image_metrics import GREY, Regions, grain

COLUMNS = 3
WIDTH = 440  # [pixels] width of an image on the sheet
PART = 0.2  # [-] share of width and height that a detail shows
GAP, LABEL, SIZE = 8, 26, 17  # [pixels] gap, height of a label, size of its font


def sheet(variants: Sequence[Any], where: Regions) -> np.ndarray:
    """Return the contact sheet as a uint8 image.

    variants: objects with `name` and `picture` (height, width, 3); the first one is the reference.
    where: regions from which the details are chosen.
    """
    places = details([variant.picture for variant in variants], where)
    tiles = [_tile(variant.name, variant.picture, places) for variant in variants]
    blank = np.full_like(tiles[0], 255)
    tiles += [blank] * (-len(tiles) % COLUMNS)
    rows = [np.hstack(tiles[k : k + COLUMNS]) for k in range(0, len(tiles), COLUMNS)]
    return np.vstack(rows)


def details(pictures: list[np.ndarray], where: Regions) -> list[tuple[int, int]]:
    """Return the upper left corners (row, column) of details where the variants differ most.

    One is by fine structures on fluid, sand and snow, one by all structures on solids. Each variant
    is normalized by its own largest difference, because the strongest would decide alone otherwise.
    """
    luminances = [image.astype(np.float64) @ GREY for image in pictures]
    fine = [grain(image) for image in luminances]
    return [
        _largest_difference(fine, where.granular_or_liquid),
        _largest_difference(luminances, where.solid),
    ]


def _largest_difference(images: list[np.ndarray], mask: np.ndarray) -> tuple[int, int]:
    """Return the corner of the detail with the largest difference to the first image."""
    height, width = mask.shape
    h, w = _detail_size(height, width)
    total = np.zeros((height, width))
    for image in images[1:]:
        # many weak differences outweigh one strong edge
        error = np.sqrt(np.abs(image - images[0])) * mask
        local = ndimage.uniform_filter(error, (h, w), mode="constant")
        if local.max() > 0:
            total += local / local.max()
    row, column = np.unravel_index(np.argmax(total), total.shape)
    top, left = row - h // 2, column - w // 2
    return int(np.clip(top, 0, height - h)), int(np.clip(left, 0, width - w))


def _detail_size(height: int, width: int) -> tuple[int, int]:
    """Return height and width of a detail [pixels]."""
    return max(int(PART * height), 1), max(int(PART * width), 1)


def _tile(name: str, picture: np.ndarray, places: list[tuple[int, int]]) -> np.ndarray:
    """Return a label, an image, and its details below."""
    from PIL import Image, ImageDraw, ImageFont

    height, width, _ = picture.shape
    h, w = _detail_size(height, width)
    picture_height = round(WIDTH * height / width)
    detail_width = (WIDTH - GAP) // 2
    detail_height = round(detail_width * h / w)
    tile = Image.new(
        "RGB", (WIDTH + GAP, LABEL + picture_height + GAP + detail_height + 2 * GAP), "white"
    )
    image = Image.fromarray(picture)
    tile.paste(image.resize((WIDTH, picture_height), Image.Resampling.LANCZOS), (0, LABEL))
    drawing = ImageDraw.Draw(tile)
    drawing.text((4, 3), name, fill="black", font=ImageFont.load_default(size=SIZE))
    for k, (row, column) in enumerate(places):
        part = image.crop((column, row, column + w, row + h))
        x, y = k * (detail_width + GAP), LABEL + picture_height + GAP
        tile.paste(part.resize((detail_width, detail_height), Image.Resampling.NEAREST), (x, y))
        drawing.rectangle(
            (x, y, x + detail_width - 1, y + detail_height - 1), outline=(150, 150, 150)
        )
        corners = [column, row, column + w, row + h]
        scaled = [round(c * WIDTH / width) for c in corners]
        drawing.rectangle(
            (scaled[0], LABEL + scaled[1], scaled[2], LABEL + scaled[3]), outline=(150,) * 3
        )
    return np.asarray(tile)

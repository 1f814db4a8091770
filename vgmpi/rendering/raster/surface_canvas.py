"""Canvas of surfaces that are lit later: color, normal, material and depth of every pixel."""

from typing import NamedTuple

import numpy as np

from vgmpi.runtime.compile_cache import njit_cached

from .tile_blend import TILE, uncleared_canvas

NUMBERS = 11  # of a pixel: transmittance, color, normal, material and median depth
_HALF = np.float32(0.5)


class Surfaces(NamedTuple):
    """Normals, materials and depths of surfaces, whose canvas is cleared where they are drawn.

    Attributes:
        rows: Normals, materials and depths of the Gaussians, shape (n, 7) float32.
        is_drawn: (out) Whether a tile was touched, shape (tiles,) uint8.
        shape: Height and width of the picture [pixels].
    """

    rows: np.ndarray
    is_drawn: np.ndarray
    shape: tuple[int, int]


def surface_canvas(rows: np.ndarray, height: int, width: int) -> tuple[np.ndarray, Surfaces]:
    """Return a canvas that is not cleared yet for surfaces of rows (n, 7), and these."""
    canvas = uncleared_canvas(height, width, NUMBERS)
    return canvas, Surfaces(rows, np.zeros(len(canvas), np.uint8), (height, width))


@njit_cached(nogil=True, error_model="numpy")
def surfaces_of(canvas, is_drawn, pictures, transmittance, median):
    """Write a canvas of surfaces to pictures.

    Args:
        canvas, is_drawn: Canvas, and which of its tiles were drawn.
        pictures: (out) Color, normal and material weighted by opacity, three of zeros, shape
            (height, width, 3).
        transmittance, median: (out) Transmittance, ones, and median depth, infinite where more
            than half of the light passes, shape (height, width).
    """
    height, width = transmittance.shape
    nx = (width + TILE - 1) // TILE
    for t in range(len(canvas)):
        if not is_drawn[t]:
            continue
        left, top, tile = (t % nx) * TILE, (t // nx) * TILE, canvas[t]
        count = min(TILE, width - left)
        for j in range(min(TILE, height - top)):
            start = j * NUMBERS * TILE
            for k in range(count):
                through = abs(tile[start + k])
                transmittance[top + j, left + k] = through
                if through <= _HALF:
                    median[top + j, left + k] = tile[start + 10 * TILE + k]
            for k in range(count):
                for n in range(3):
                    for c in range(3):
                        index = start + (3 * n + c + 1) * TILE + k
                        pictures[n][top + j, left + k, c] = tile[index]

"""Canvas of surfaces that are lit later: color, normal, material and depth of every pixel."""

from typing import NamedTuple

import numpy as np

from vgmpi.gaussians.camera import Camera
from vgmpi.runtime.compile_cache import njit_cached

from .projection import depth_order
from .rasterize import ProjectableGaussians, project_splats
from .tile_blend import TILE, blend_tiles, uncleared_canvas

NUMBERS = 8  # of a pixel: transmittance, color, normal and median depth
MATERIALS = 3  # further numbers of a pixel if the Gaussians are of several materials
_HALF, _ONE = np.float32(0.5), np.float32(1)


class Surfaces(NamedTuple):
    """Normals and depths of surfaces, whose canvas is cleared where they are drawn.

    Attributes:
        rows: Normals and depths of the Gaussians, shape (n, 4) float32.
        is_drawn: (out) Whether a tile was touched, shape (tiles,) uint8.
        shape: Height and width of the picture [pixels].
    """

    rows: np.ndarray
    is_drawn: np.ndarray
    shape: tuple[int, int]


def draw_surfaces(
    splats: ProjectableGaussians, camera: Camera, normal: np.ndarray, material: np.ndarray,
    lowpass: float | None, antialias: bool | None, alpha_min: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """Draw colors, normals, materials and depths in one pass.

    Args:
        splats: The Gaussians.
        camera: Camera of the picture.
        normal, material: Of every Gaussian, shape (n, 3).
        lowpass, antialias, alpha_min: Options of rasterize.render.

    Returns:
        Colors, normals and materials weighted by opacity, shape (height, width, 3),
        transmittance and median depth [m], shape (height, width), float32.
    """
    shape, visible_ids = (camera.height, camera.width), np.empty(len(splats.x), np.int64)
    *rows, z = project_splats(splats, camera, lowpass, antialias, alpha_min, visible_ids)
    visible_ids = visible_ids[: len(z)]
    material = material[visible_ids].astype(np.float32)
    is_mixed = len(material) > 0 and bool((material != material[0]).any())
    only = material[0] if len(material) else np.zeros(3, np.float32)
    canvas, drawn = surface_canvas(normal[visible_ids], z.astype(np.float32), is_mixed, *shape)
    blend_tiles(
        depth_order(z), *rows, canvas, -(-shape[1] // TILE), False, drawn,
        material if is_mixed else None,
    )  # fmt: skip
    pictures = np.zeros((3, *shape, 3), np.float32)
    through, median = (np.full(shape, n, np.float32) for n in (1, np.inf))
    surfaces_of(canvas, drawn.is_drawn, only, pictures, through, median)
    return *pictures, through, median


def surface_canvas(
    normal: np.ndarray, depth: np.ndarray, is_mixed: bool, height: int, width: int
) -> tuple[np.ndarray, Surfaces]:
    """Return a canvas that is not cleared yet, and the surfaces to draw on it.

    Args:
        normal: Of every Gaussian, shape (n, 3).
        depth: Their depths, shape (n,) [m].
        is_mixed: Whether they are of several materials.
        height, width: Size of the picture [pixels].
    """
    rows = np.empty((len(depth), 4), np.float32)
    rows[:, :3], rows[:, 3] = normal, depth
    canvas = uncleared_canvas(height, width, NUMBERS + (MATERIALS if is_mixed else 0))
    return canvas, Surfaces(rows, np.zeros(len(canvas), np.uint8), (height, width))


@njit_cached(nogil=True, error_model="numpy")
def surfaces_of(canvas, is_drawn, only, pictures, transmittance, median):
    """Write a canvas of surfaces to pictures.

    Args:
        canvas, is_drawn: Canvas, and which of its tiles were drawn.
        only: Material of all surfaces if it is one, shape (3,) float32.
        pictures: (out) Color, normal and material weighted by opacity, three of zeros, shape
            (height, width, 3).
        transmittance, median: (out) Transmittance, ones, and median depth, infinite where more
            than half of the light passes, shape (height, width).
    """
    height, width = transmittance.shape
    nx, row = (width + TILE - 1) // TILE, canvas.shape[1] // TILE
    is_mixed, is_zero = row > NUMBERS * TILE, not only.any()
    for t in range(len(canvas)):
        if not is_drawn[t]:
            continue
        left, top, tile = (t % nx) * TILE, (t // nx) * TILE, canvas[t]
        for j in range(min(TILE, height - top)):
            for k in range(min(TILE, width - left)):
                y, x, start = top + j, left + k, j * row + k
                through = abs(tile[start])
                transmittance[y, x] = through
                if through <= _HALF:
                    median[y, x] = tile[start + 7 * TILE]
                for c in range(3):
                    pictures[0, y, x, c] = tile[start + (1 + c) * TILE]
                    pictures[1, y, x, c] = tile[start + (4 + c) * TILE]
                if is_mixed:
                    for c in range(3):
                        pictures[2, y, x, c] = tile[start + (8 + c) * TILE]
                elif not is_zero:
                    for c in range(3):
                        pictures[2, y, x, c] = (_ONE - through) * only[c]

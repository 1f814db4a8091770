"""Triangle mesh in memory, and the colors that mesh files give its points and triangles."""

from dataclasses import dataclass

import numpy as np

from .texture import Textures

COLOR_NAMES = (("red", "green", "blue"), ("diffuse_red", "diffuse_green", "diffuse_blue"))
_EIGHT_BITS, _SIXTEEN_BITS = 255.0, 65535.0  # [-] maximum values of a color in integers


@dataclass(frozen=True)
class Mesh:
    """Triangle mesh.

    points (n, 3) in the file's units, triangles (m, 3) of point numbers, rgb (n, 3) or None;
    triangle_rgb (m, 3), NaN where a triangle has no color, or None. Textures take precedence over
    rgb, rgb over triangle_rgb. has_material_colors: whether triangle_rgb are those of materials,
    which many programs write for every mesh.
    """

    points: np.ndarray
    triangles: np.ndarray
    rgb: np.ndarray | None = None
    textures: Textures | None = None
    triangle_rgb: np.ndarray | None = None
    has_material_colors: bool = False

    def corners(self) -> np.ndarray:
        """Return the corners of every triangle, shape (m, 3 corners, 3)."""
        return self.points[self.triangles]


def unit_colors(values: np.ndarray, is_integer: bool) -> np.ndarray:
    """Return colors 0..1 (n, 3) from the numbers of a file.

    Integers are those of 8 bits, of 16 bits if any is above 255. Other numbers are colors already
    if none is above 1, otherwise they count as integers.

    Args:
        values: Red, green, blue, and perhaps alpha, which is dropped, shape (n, 3 or 4).
        is_integer: Whether the file declares integers.
    """
    rgb = np.asarray(values)[:, :3].astype(np.float64)
    maximum = rgb.max(initial=0.0, where=np.isfinite(rgb))
    if is_integer or maximum > 1.0:
        rgb /= _SIXTEEN_BITS if maximum > _EIGHT_BITS else _EIGHT_BITS
    return np.clip(np.nan_to_num(rgb, nan=0.0), 0.0, 1.0)


def fans(polygons: np.ndarray) -> np.ndarray:
    """Return the triangles (n (k - 2), 3) of polygons (n, k), cut into fans, polygon by polygon."""
    corner_count = polygons.shape[1]
    parts = [polygons[:, (0, k, k + 1)] for k in range(1, corner_count - 1)]
    return np.stack(parts, axis=1).reshape(-1, 3) if parts else np.empty((0, 3), np.int64)

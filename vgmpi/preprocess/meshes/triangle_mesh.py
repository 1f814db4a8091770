"""Triangle mesh in memory, with the colors and textures that mesh files give it.

Materials and images are those of Wavefront files: an image for each face, and its color at points.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from vgmpi.runtime.user_files import MAX_TEXT_BYTES, read_image, read_regular_file

COLOR_NAMES = (("red", "green", "blue"), ("diffuse_red", "diffuse_green", "diffuse_blue"))
MAX_LIBRARIES = 100  # material files that a mesh names
_EIGHT_BITS, _SIXTEEN_BITS = 255.0, 65535.0  # [-] maximum values of a color in integers


class TextureError(ValueError):
    """Error for a texture that cannot be read; one line."""


@dataclass(frozen=True)
class Textures:
    """Images on a mesh of m triangles.

    uv (m, 3, 2): texture coordinates of their corners, from the lower left, repeating beyond 0..1.
    which (m,): row of `images` for each, -1 for none. images: (height, width, 3), 0..1.
    """

    uv: np.ndarray
    which: np.ndarray
    images: list[np.ndarray]

    def color(self, triangle: np.ndarray, weights: np.ndarray, plain: np.ndarray) -> np.ndarray:
        """Return the colors (n, 3) of points on triangles.

        Args:
            triangle: Triangle of each point, shape (n,).
            weights: Barycentric coordinates, shape (n, 3).
            plain: Colors for triangles without an image, shape (n, 3).
        """
        uv = (weights[:, :, None] * self.uv[triangle]).sum(axis=1)
        out = np.array(plain, dtype=np.float64)
        for k, image in enumerate(self.images):
            rows = self.which[triangle] == k
            out[rows] = _sample_bilinear(image, uv[rows])
        return out


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


def _sample_bilinear(image: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Return the colors (n, 3), interpolated between pixel centers."""
    height, width = image.shape[:2]
    x = (uv[:, 0] % 1.0) * width - 0.5
    y = (1.0 - uv[:, 1] % 1.0) * height - 0.5  # rows count from the top
    left, top = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    out = np.zeros((len(uv), 3))
    for row, along in ((top, 1.0 - (y - top)), (top + 1, y - top)):
        for column, across in ((left, 1.0 - (x - left)), (left + 1, x - left)):
            out += (along * across)[:, None] * image[row % height, column % width]
    return out


@dataclass(frozen=True)
class Material:
    """Material of a mesh: its color (Kd) 0..1, and the name of the file of its image (map_Kd)."""

    color: tuple[float, float, float] | None = None
    image: str = ""


def read_materials(path: Path, libraries: list[str]) -> dict[str, Material]:
    """Return the materials in .mtl files of a mesh by their names.

    Raises TextureError.
    """
    materials: dict[str, Material] = {}
    name = ""
    libraries = list(dict.fromkeys(libraries))
    if len(libraries) > MAX_LIBRARIES:
        raise TextureError(f"names {len(libraries):,} material files: allowed {MAX_LIBRARIES}")
    for library in libraries:
        try:
            text = read_regular_file(file_in_mesh_folder(path, library), MAX_TEXT_BYTES).decode(
                errors="replace"
            )
        except OSError as error:
            raise TextureError(f"names {library!r}, which {error.strerror}") from None
        for words in (line.split(maxsplit=1) for line in text.splitlines()):
            if len(words) < 2:
                continue
            if words[0] == "newmtl":
                name = words[1].strip()
                materials[name] = Material()
            elif words[0] == "map_Kd" and name:
                materials[name] = replace(materials[name], image=_last_word(words[1]))
            elif words[0] == "Kd" and name:
                materials[name] = replace(materials[name], color=_color(words[1]))
    return materials


def _color(words: str) -> tuple[float, float, float] | None:
    """Return the color of a Kd statement; None for its rare forms that are no numbers."""
    try:
        red, *others = (min(max(float(word), 0.0), 1.0) for word in words.split()[:3])
    except ValueError:
        return None
    green, blue = others if len(others) == 2 else (red, red)  # one number is a gray
    return red, green, blue


def _last_word(words: str) -> str:
    """Return the file of a map statement, after its options; names may contain blanks."""
    words = words.strip()
    return words.split()[-1] if words.startswith("-") else words


def file_in_mesh_folder(path: Path, name: str) -> Path:
    """Return a file that a mesh names, in its folder or below. Raises TextureError."""
    file = path.parent / name.strip().replace("\\", "/")
    if not file.resolve().is_relative_to(path.parent.resolve()):
        raise TextureError(f"names {name!r}, which lies outside its folder")
    if not file.is_file():
        raise TextureError(f"names {name!r}, which is not there")
    return file


def read_texture(path: Path) -> np.ndarray:
    """Return an image (height, width, 3), 0..1. Raises TextureError."""
    try:
        pixels = read_image(path)
    except ValueError as error:
        raise TextureError(f"its picture {path.name} cannot be read: {error}") from None
    if pixels.ndim == 2:
        pixels = np.repeat(pixels[:, :, None], 3, axis=2)
    if pixels.ndim != 3 or pixels.shape[2] not in (3, 4) or not pixels.size:
        raise TextureError(f"its picture {path.name} has no red, green and blue")
    is_integer = np.issubdtype(pixels.dtype, np.integer)
    maximum = float(np.iinfo(pixels.dtype).max) if is_integer else 1.0
    return np.clip(pixels[:, :, :3].astype(np.float64) / maximum, 0.0, 1.0)


def texture_files(path: Path) -> list[Path]:
    """Return all files that a mesh's colors come from; none if they cannot be read."""
    if path.suffix.lower() != ".obj":
        return []
    with open(path, errors="replace") as file:
        words = (line.split(maxsplit=1) for row in file for line in row.splitlines())
        libraries = [word[1] for word in words if len(word) == 2 and word[0] == "mtllib"]
    try:
        images = [each.image for each in read_materials(path, libraries).values() if each.image]
        return [file_in_mesh_folder(path, name) for name in (*libraries, *images)]
    except TextureError:
        return []

"""Textures of Wavefront meshes: which picture colours a face, and the colour at a point of it."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..inputs import MOST_TEXT, content, picture


class TextureError(ValueError):
    """A texture that cannot be had; one line."""


@dataclass(frozen=True)
class Paint:
    """Pictures on a mesh of m triangles.

    uv (m, 3, 2): texture coordinates of their corners, from the lower left, repeating beyond 0..1.
    which (m,): row of `images` for each, -1 for none. images: (height, width, 3), 0..1.
    """

    uv: np.ndarray
    which: np.ndarray
    images: list[np.ndarray]

    def color(self, triangle: np.ndarray, share: np.ndarray, plain: np.ndarray) -> np.ndarray:
        """Colours (n, 3) of points on triangles (n,), `share` (n, 3) of the way to their corners.

        plain (n, 3): for triangles without a picture.
        """
        at = (share[:, :, None] * self.uv[triangle]).sum(axis=1)
        out = np.array(plain, dtype=np.float64)
        for k, image in enumerate(self.images):
            mine = self.which[triangle] == k
            out[mine] = _looked_up(image, at[mine])
        return out


def _looked_up(image: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Colours (n, 3) between the middles of the pixels (bilinear)."""
    height, width = image.shape[:2]
    x = (uv[:, 0] % 1.0) * width - 0.5
    y = (1.0 - uv[:, 1] % 1.0) * height - 0.5  # rows count from the top
    left, top = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    out = np.zeros((len(uv), 3))
    for row, along in ((top, 1.0 - (y - top)), (top + 1, y - top)):
        for column, across in ((left, 1.0 - (x - left)), (left + 1, x - left)):
            out += (along * across)[:, None] * image[row % height, column % width]
    return out


def pictures(path: Path, libraries: list[str]) -> dict[str, Path]:
    """Files of the pictures (map_Kd) by the names of the materials of .mtl files beside a mesh.

    Raises TextureError.
    """
    found, name = {}, ""
    for library in libraries:
        try:
            text = content(beside(path, library), MOST_TEXT).decode(errors="replace")
        except OSError as error:
            raise TextureError(f"names {library!r}, which {error.strerror}") from None
        for words in (line.split(maxsplit=1) for line in text.splitlines()):
            if len(words) == 2 and words[0] == "newmtl":
                name = words[1].strip()
            elif len(words) == 2 and words[0] == "map_Kd":
                found[name] = beside(path, _last_word(words[1]))
    return found


def _last_word(words: str) -> str:
    """The file of a map statement: what follows its options; names may hold blanks."""
    words = words.strip()
    return words.split()[-1] if words.startswith("-") else words


def beside(path: Path, name: str) -> Path:
    """A file that a mesh names: in its folder or below. Raises TextureError."""
    found = path.parent / name.strip().replace("\\", "/")
    if not found.resolve().is_relative_to(path.parent.resolve()):
        raise TextureError(f"names {name!r}, which lies outside its folder")
    if not found.is_file():
        raise TextureError(f"names {name!r}, which is not there")
    return found


def image(path: Path) -> np.ndarray:
    """A picture (height, width, 3), 0..1. Raises TextureError."""
    try:
        pixels = picture(path)
    except ValueError as error:
        raise TextureError(f"its picture {path.name} cannot be read: {error}") from None
    if pixels.ndim == 2:
        pixels = np.repeat(pixels[:, :, None], 3, axis=2)
    if pixels.ndim != 3 or pixels.shape[2] not in (3, 4) or not pixels.size:
        raise TextureError(f"its picture {path.name} has no red, green and blue")
    whole = np.issubdtype(pixels.dtype, np.integer)
    top = float(np.iinfo(pixels.dtype).max) if whole else 1.0
    return np.clip(pixels[:, :, :3].astype(np.float64) / top, 0.0, 1.0)


def files(path: Path) -> list[Path]:
    """All files beside a mesh that its colours come from; none where they cannot be had."""
    if path.suffix.lower() != ".obj":
        return []
    with open(path, errors="replace") as file:
        words = (line.split(maxsplit=1) for whole in file for line in whole.splitlines())
        libraries = [found[1] for found in words if len(found) == 2 and found[0] == "mtllib"]
    try:
        used = pictures(path, libraries)
        return [*(beside(path, name) for name in libraries), *used.values()]
    except TextureError:
        return []

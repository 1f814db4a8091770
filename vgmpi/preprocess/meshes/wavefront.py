"""Reader of Wavefront .obj meshes: colors of points, materials, texture coordinates.

References: Wavefront Technologies, Object Files (.obj), Advanced Visualizer Manual, appendix B.
"""

import logging
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from . import texture
from .texture import Material, Textures
from .triangle_mesh import Mesh, unit_colors

log = logging.getLogger("vgmpi")

MAX_CORNERS = 10_000  # of one face: each takes some hundred bytes


def read_obj(path: Path) -> Mesh:
    """Return points, their colors, faces and textures of a Wavefront file.

    Raises ValueError, OSError.
    """
    points: list[list[float]] = []
    uv: list[list[float]] = []
    corners: list[tuple[int, int]] = []  # point and texture coordinate (-1: none), 3 per triangle
    materials, libraries, material = [], [], ""
    for line in _lines(path):
        words = line.split()
        match words[:1]:
            case ["v"]:
                points.append([float(word) for word in words[1:]])
            case ["vt"]:
                uv.append([float(word) for word in (*words[1:3], "0")[:2]])
            case ["f"]:
                if (count := len(words) - 1) > MAX_CORNERS:
                    raise ValueError(f"has a face of {count:,} corners: allowed {MAX_CORNERS:,}")
                face = [_corner(word, len(points), len(uv)) for word in words[1:]]
                for k in range(1, len(face) - 1):
                    corners += (face[0], face[k], face[k + 1])
                    materials.append(material)
            case ["mtllib"]:
                libraries.append(line.split(maxsplit=1)[1])
            case ["usemtl"]:
                material = line.split(maxsplit=1)[1].strip() if len(words) > 1 else ""
    colored = bool(points) and all(len(point) >= 6 for point in points)
    rgb = unit_colors(np.array([point[3:6] for point in points]), False) if colored else None
    x = np.array([point[:3] for point in points], dtype=np.float64).reshape(-1, 3)
    index = np.array(corners, dtype=np.int64).reshape(-1, 3, 2)
    properties = _materials(path, libraries)
    textures = _textures(path, properties, materials, uv, index[:, :, 1])
    colors = _material_colors(properties, materials)
    return Mesh(x, index[:, :, 0], rgb, textures, colors, has_material_colors=colors is not None)


def _lines(path: Path) -> Iterator[str]:
    """Yield the lines of a text file; a backslash at the end of a line continues it."""
    line_start = ""
    with open(path, errors="replace") as file:
        for text in file:
            for line in text.splitlines():  # this includes rare line separators
                if line.endswith("\\"):
                    line_start += line[:-1] + " "
                    continue
                yield line_start + line
                line_start = ""
    if line_start:
        yield line_start


def _corner(word: str, points: int, uvs: int) -> tuple[int, int]:
    """Return the numbers of point and texture coordinate of "3", "3/1" or "3/1/2"; -1 for none."""
    point, _, more = word.partition("/")
    uv = more.partition("/")[0]
    # Numbers count from 1; negative ones count from the last.
    first = int(point)
    second = int(uv) if uv else 0
    return (
        first - 1 if first > 0 else points + first if first else -1,
        second - 1 if second > 0 else uvs + second if second else -1,
    )


def _materials(path: Path, libraries: list[str]) -> dict[str, Material]:
    """Return the materials that a mesh names; none if they cannot be read."""
    try:
        return texture.read_materials(path, libraries)
    except texture.TextureError as error:  # many meshes come without their materials
        log.warning("%s: %s: its colors are those of its points or the object", path, error)
        return {}


def _material_colors(properties: dict[str, Material], materials: list[str]) -> np.ndarray | None:
    """Return the colors (Kd) of the triangles' materials, NaN for none; None without any."""
    table = {name: each.color for name, each in properties.items() if each.color is not None}
    if not any(name in table for name in set(materials)):
        return None
    none = (np.nan,) * 3
    return np.array([table.get(name, none) for name in materials], dtype=np.float64)


def _textures(
    path: Path, properties: dict[str, Material], materials, uvs, index: np.ndarray
) -> Textures | None:
    """Return the textures of triangles with given materials and uv numbers `index` (m, 3)."""
    used = sorted({name for name in materials if name in properties and properties[name].image})
    if not used or not uvs:
        return None
    try:
        files = [texture.file_in_mesh_folder(path, str(properties[name].image)) for name in used]
        images = [texture.read_texture(file) for file in files]
    except texture.TextureError as error:  # many meshes come without their images
        log.warning(
            "%s: %s: its colors are those of its materials, points or the object", path, error
        )
        return None
    row = np.array([used.index(name) if name in used else -1 for name in materials])
    if index.max() >= len(uvs):
        raise ValueError("has faces without texture coordinates")
    row[(index < 0).any(axis=1)] = -1
    uv = np.array(uvs, dtype=np.float64)[np.maximum(index, 0)]
    if not np.isfinite(uv).all():
        raise ValueError("has texture coordinates that are not finite")
    return Textures(uv, row, images)

"""Readers of meshes without a library: .ply, .stl and Wavefront's .obj, text and binary.

Colors come from points, from faces, from the two conventions of binary .stl files (VisCAM and
SolidView; Materialise Magics), or from materials and textures. All sizes in the header of a .ply
are compared with the file before anything is allocated.

References:
    Turk, The PLY polygon file format (1994).
    3D Systems, StereoLithography Interface Specification (1989).
    Wavefront Technologies, Object Files (.obj), Advanced Visualizer Manual, appendix B.
"""

import logging
import re
import struct
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vgmpi.gaussians.formats.ply_tables import Layout, read_header

from .triangle_mesh import (
    COLOR_NAMES,
    Material,
    Mesh,
    TextureError,
    Textures,
    fans,
    file_in_mesh_folder,
    read_materials,
    read_texture,
    unit_colors,
)

log = logging.getLogger("vgmpi")

_CORNERS = ("vertex_indices", "vertex_index")
_FORMAT = struct.Struct  # compiled format of one number
_HEADER, _ROW = 84, 50  # [bytes] before the triangles, and of each
_TRIANGLE = np.dtype(
    [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("color", "<u2")]
)  # of a binary file
_VERTEX = re.compile(rb"\bvertex\s+(\S+)\s+(\S+)\s+(\S+)", re.IGNORECASE)
MAX_CORNERS = 10_000  # of one face: each takes some hundred bytes


@dataclass(frozen=True)
class _Property:
    """One property of an element; `count` is the type of a list's length, None for a number."""

    name: str
    kind: str
    count: str | None = None
    is_integer: bool = False


@dataclass(frozen=True)
class _Element:
    """One element of the header."""

    name: str
    count: int
    properties: list[_Property]


class _Rows:
    """Columns of an element by their names; of lists one array (m, k) for each length k."""

    def __init__(self) -> None:
        self.numbers: dict[str, np.ndarray] = {}
        self.lists: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {}  # rows and their entries
        self.is_integer: dict[str, bool] = {}


def read_ply(path: Path) -> Mesh:
    """Return the mesh of a .ply file. Raises ValueError, OSError."""
    tables, comments = _read_tables(path)
    vertex = tables["vertex"]
    points = np.stack([vertex.numbers[axis].astype(np.float64) for axis in "xyz"], axis=1)
    if any(comment.startswith("TextureFile") for comment in comments):
        log.warning("%s: its picture is not read: only .obj meshes have textures", path)
    triangles, row = _triangles(tables.get("face"))
    colors = _colors(tables["face"]) if "face" in tables else None
    return Mesh(points, triangles, _colors(vertex), None, None if colors is None else colors[row])


def read_vertices(path: Path) -> tuple[dict[str, np.ndarray], np.ndarray | None]:
    """Return the numbers of the points of a .ply file by name, and colors 0..1 (n, 3) or None.

    Raises ValueError, OSError.
    """
    vertex = _read_tables(path)[0]["vertex"]
    return vertex.numbers, _colors(vertex)


def _read_tables(path: Path) -> tuple[dict[str, _Rows], tuple[str, ...]]:
    """Return the elements of a .ply file by name, with points, and its comments."""
    with open(path, "rb") as file:
        header = read_header(file)
        file.seek(0)
        data = file.read()
    order, offset = header.order, header.data_start
    elements = [_element(layout) for layout in header.elements]
    if order == "=":  # text: as numbers of eight bytes it is read like the others
        data, order, offset = _numbers_of_text(data[offset:]).tobytes(), "<", 0
        elements = [_as_doubles(element) for element in elements]
    tables: dict[str, _Rows] = {}
    for element in elements:
        tables[element.name], offset = _read_element(data, offset, element, order)
    if "vertex" not in tables or not all(axis in tables["vertex"].numbers for axis in "xyz"):
        raise ValueError("has no points: no element 'vertex' with x, y and z")
    return tables, header.comments


def _element(layout: Layout) -> _Element:
    """Return an element as the header describes it.

    Raises:
        ValueError: If it has no properties.
    """
    if not layout.columns:
        raise ValueError(f"has no properties in element '{layout.name}'")
    properties = []
    for name, column in zip(layout.names, layout.columns, strict=True):
        count = column[0].str[1:] if len(column) > 1 else None
        is_integer = count is None and column[0].kind in "iu"
        properties.append(_Property(name, column[-1].str[1:], count, is_integer))
    return _Element(layout.name, layout.row_count, properties)


def _numbers_of_text(text: bytes) -> np.ndarray:
    """Return all numbers of a text."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)  # NumPy's word for what is no number
        try:
            return np.fromstring(text.decode("ascii"), dtype="<f8", sep=" ")
        except (DeprecationWarning, UnicodeDecodeError):
            raise ValueError("has text that is no number") from None


def _as_doubles(element: _Element) -> _Element:
    """Return an element all of whose numbers, also the lengths of lists, have eight bytes."""
    properties = [
        _Property(each.name, "f8", None if each.count is None else "f8", each.is_integer)
        for each in element.properties
    ]
    return _Element(element.name, element.count, properties)


def _read_element(data: bytes, offset: int, element: _Element, order: str) -> tuple[_Rows, int]:
    """Return the rows of an element that begins at `offset`, and the offset of the next one."""
    smallest = sum(int((each.count or each.kind)[1]) for each in element.properties)
    if element.count * smallest > len(data) - offset:
        raise ValueError(
            f"promises {element.count:,} rows of '{element.name}', but is too short: truncated?"
        )
    out = _Rows()
    out.is_integer = {each.name: each.is_integer for each in element.properties}
    if not element.count:
        return out, offset
    lengths = _list_lengths(data, offset, element, order)
    fields: list[tuple] = []
    for number, each in enumerate(element.properties):
        if each.count is not None:
            fields.append((f"count{number}", order + each.count))
        shape = () if each.count is None else (lengths[number],)
        fields.append((f"value{number}", order + each.kind, shape))
    row = np.dtype(fields)
    is_even = element.count * row.itemsize <= len(data) - offset
    if is_even:  # all lists are as long as those of the first row
        rows = np.frombuffer(data, row, element.count, offset)
        for number, each in enumerate(element.properties):
            if each.count is not None:
                is_even = is_even and (rows[f"count{number}"] == lengths[number]).all()
    if not is_even:
        return _read_uneven(data, offset, element, order, out)
    every = np.arange(element.count)
    for number, each in enumerate(element.properties):
        if each.count is None:
            out.numbers[each.name] = rows[f"value{number}"]
        else:
            out.lists[each.name] = [(every, rows[f"value{number}"])]
    return out, offset + element.count * row.itemsize


def _list_lengths(data: bytes, offset: int, element: _Element, order: str) -> dict[int, int]:
    """Return the lengths of the lists in the row that begins at `offset`, by property."""
    lengths = {}
    for number, each in enumerate(element.properties):
        length = 1
        if each.count is not None:
            length, offset = _read_length(data, offset, np.dtype(order + each.count))
            lengths[number] = length
        offset += length * int(each.kind[1])
        if offset > len(data):
            raise ValueError(f"ends within a row of '{element.name}': truncated?")
    return lengths


def _read_length(data: bytes, offset: int, kind: np.dtype) -> tuple[int, int]:
    """Return the length of a list, and the offset of its first entry."""
    if offset + kind.itemsize > len(data):
        raise ValueError("ends within a list: truncated?")
    length = float(np.frombuffer(data, kind, 1, offset)[0])
    if not 0 <= length <= len(data) or length != int(length):
        raise ValueError(f"has a list of {length:g} entries")
    return int(length), offset + kind.itemsize


def _read_uneven(
    data: bytes, offset: int, element: _Element, order: str, out: _Rows
) -> tuple[_Rows, int]:
    """Return what `_read_element` does, for lists of different lengths: row by row."""
    starts = np.empty((element.count, len(element.properties)), dtype=np.int64)
    lengths = np.ones_like(starts)
    plan = [
        (int(p.kind[1]), None if p.count is None else _FORMAT(order + _CODES[p.count]))
        for p in element.properties
    ]
    end = len(data)
    for k in range(element.count):
        for number, (size, counter) in enumerate(plan):
            length = 1
            if counter is not None:
                if offset + counter.size > end:
                    raise ValueError(f"ends within a row of '{element.name}': truncated?")
                length = counter.unpack_from(data, offset)[0]
                if not 0 <= length <= end or length != int(length):
                    raise ValueError(f"has a list of {length:g} entries")
                length = int(length)
                lengths[k, number] = length
                offset += counter.size
            starts[k, number] = offset
            offset += length * size
        if offset > end:
            raise ValueError(f"ends within a row of '{element.name}': truncated?")
    raw = np.frombuffer(data, np.uint8)
    for number, each in enumerate(element.properties):
        kind = np.dtype(order + each.kind)

        def entries(rows: np.ndarray, length: int, number=number, kind=kind) -> np.ndarray:
            """Return the entries (m, length) of lists of one length."""
            place = starts[rows, number][:, None] + np.arange(length * kind.itemsize)
            return raw[place].view(kind).reshape(len(rows), length)

        if each.count is None:
            out.numbers[each.name] = entries(np.arange(element.count), 1)[:, 0]
        else:
            groups = [(np.flatnonzero(lengths[:, number] == length), int(length))
                      for length in np.unique(lengths[:, number])]  # fmt: skip
            out.lists[each.name] = [(rows, entries(rows, length)) for rows, length in groups]
    return out, offset


_CODES = {"i1": "b", "u1": "B", "i2": "h", "u2": "H", "i4": "i", "u4": "I", "f8": "d"}


def _triangles(face: _Rows | None) -> tuple[np.ndarray, np.ndarray]:
    """Return the triangles (m, 3) of the faces, in order, and the face (m,) of each."""
    corners, rows = [np.empty((0, 3), np.int64)], [np.empty(0, np.int64)]
    lists = [] if face is None else [face.lists[name] for name in _CORNERS if name in face.lists]
    for row, polygons in lists[0] if lists else []:
        if polygons.shape[1] < 3:
            continue
        with np.errstate(invalid="ignore"):
            parts = fans(polygons.astype(np.int64))
        corners.append(parts)
        rows.append(np.repeat(row, polygons.shape[1] - 2))
    face_of = np.concatenate(rows)
    order = np.argsort(face_of, kind="stable")
    return np.concatenate(corners)[order], face_of[order]


def _colors(rows: _Rows) -> np.ndarray | None:
    """Return the colors 0..1 (n, 3) of the rows of an element, or None."""
    for names in COLOR_NAMES:
        if all(name in rows.numbers for name in names):
            values = np.stack([rows.numbers[name] for name in names], axis=1)
            return unit_colors(values, rows.is_integer[names[0]])
    return None


def read_stl(path: Path) -> Mesh:
    """Return the mesh of an .stl file; equal corners are one point. Raises ValueError, OSError."""
    data = path.read_bytes()
    count = int.from_bytes(data[80:84], "little")
    if len(data) >= _HEADER and len(data) == _HEADER + _ROW * count:
        return _binary_stl(data, count)
    if data[:512].lstrip()[:5].lower() == b"solid":
        return _text_stl(data)
    if len(data) < _HEADER:
        raise ValueError("is no .stl file: it neither begins with 'solid' nor has a header")
    if len(data) < _HEADER + _ROW * count:
        raise ValueError(f"promises {count:,} triangles, but is too short: truncated?")
    return _binary_stl(data, count)  # some programs append data of their own


def _binary_stl(data: bytes, count: int) -> Mesh:
    """Return the mesh of a binary file."""
    rows = np.frombuffer(data, _TRIANGLE, count, _HEADER)
    points, triangles = _join_corners(rows["corners"].reshape(-1, 3).astype(np.float64))
    return Mesh(points, triangles, triangle_rgb=_stl_colors(data[:80], rows["color"]))


def _stl_colors(header: bytes, word: np.ndarray) -> np.ndarray | None:
    """Return the colors 0..1 (m, 3) in the words (m,) behind the triangles, NaN for none."""
    is_magics = b"COLOR=" in header
    has_color = (word & 0x8000 == 0) if is_magics else (word & 0x8000 != 0)
    shifts = (0, 5, 10) if is_magics else (10, 5, 0)
    own = np.stack([(word >> shift) & 31 for shift in shifts], axis=1) / 31.0
    if not is_magics and not has_color.any():
        return None
    default = np.full(3, np.nan)
    if is_magics:
        start = header.index(b"COLOR=") + 6
        body_color = np.frombuffer(header[start : start + 3], np.uint8)
        default = body_color / 255.0 if len(body_color) == 3 else default
    return np.where(has_color[:, None], own, default)


def _text_stl(data: bytes) -> Mesh:
    """Return the mesh of a text file."""
    words = _VERTEX.findall(data)
    facets = len(re.findall(rb"\bouter\s+loop\b", data, re.IGNORECASE))
    if not re.search(rb"\bendsolid\b", data, re.IGNORECASE):
        raise ValueError("ends before 'endsolid': truncated?")
    if len(words) != 3 * facets:
        raise ValueError(f"has {len(words):,} corners in {facets:,} triangles")
    try:
        corners = np.array([list(map(float, word)) for word in words], dtype=np.float64)
    except ValueError as error:
        raise ValueError(f"has a corner that is no number: {error}") from None
    return Mesh(*_join_corners(corners.reshape(-1, 3)))


def _join_corners(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the different points (n, 3) of corners (3 m, 3), and the triangles (m, 3) of them."""
    points, index = np.unique(corners + 0.0, axis=0, return_inverse=True)  # -0 is 0
    return points, index.reshape(-1, 3).astype(np.int64)


def read_obj(path: Path) -> Mesh:
    """Return points, their colors, faces and textures of a Wavefront file.

    Raises ValueError, OSError.
    """
    points: list[list[float]] = []
    uv: list[list[float]] = []
    corners: list[tuple[int, int]] = []  # point and texture coordinate (-1: none), 3 per triangle
    materials, libraries, material = [], [], ""
    for line in _obj_lines(path):
        words = line.split()
        match words[:1]:
            case ["v"]:
                points.append([float(word) for word in words[1:]])
            case ["vt"]:
                uv.append([float(word) for word in (*words[1:3], "0")[:2]])
            case ["f"]:
                if (count := len(words) - 1) > MAX_CORNERS:
                    raise ValueError(f"has a face of {count:,} corners: allowed {MAX_CORNERS:,}")
                face = [_obj_corner(word, len(points), len(uv)) for word in words[1:]]
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


def _obj_lines(path: Path) -> Iterator[str]:
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


def _obj_corner(word: str, points: int, uvs: int) -> tuple[int, int]:
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
        return read_materials(path, libraries)
    except TextureError as error:  # many meshes come without their materials
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
        files = [file_in_mesh_folder(path, str(properties[name].image)) for name in used]
        images = [read_texture(file) for file in files]
    except TextureError as error:  # many meshes come without their images
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

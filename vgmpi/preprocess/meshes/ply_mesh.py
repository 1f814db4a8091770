"""Reader of .ply meshes: text and both orders of bytes, colors of points and of faces.

All sizes in a header are compared with the file before anything is allocated.

References: Turk, The PLY polygon file format (1994).
"""

import logging
import struct
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vgmpi.gaussians.formats.ply_tables import Layout, read_header

from .triangle_mesh import COLOR_NAMES, Mesh, fans, unit_colors

log = logging.getLogger("vgmpi")

_CORNERS = ("vertex_indices", "vertex_index")
_FORMAT = struct.Struct  # compiled format of one number


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

"""Reader of .stl meshes: text and binary, with the colors that some programs add to the latter.

References:
    3D Systems, StereoLithography Interface Specification (1989).
    The two conventions of colors are those of VisCAM and SolidView, and of Materialise Magics.
"""

import re
from pathlib import Path

import numpy as np

from .triangle_mesh import Mesh

_HEADER, _ROW = 84, 50  # [bytes] before the triangles, and of each
_TRIANGLE = np.dtype(
    [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("color", "<u2")]
)  # of a binary file
_VERTEX = re.compile(rb"\bvertex\s+(\S+)\s+(\S+)\s+(\S+)", re.IGNORECASE)


def read_stl(path: Path) -> Mesh:
    """Return the mesh of an .stl file; equal corners are one point. Raises ValueError, OSError."""
    data = path.read_bytes()
    count = int.from_bytes(data[80:84], "little")
    if len(data) >= _HEADER and len(data) == _HEADER + _ROW * count:
        return _binary(data, count)
    if data[:512].lstrip()[:5].lower() == b"solid":
        return _text(data)
    if len(data) < _HEADER:
        raise ValueError("is no .stl file: it neither begins with 'solid' nor has a header")
    if len(data) < _HEADER + _ROW * count:
        raise ValueError(f"promises {count:,} triangles, but is too short: truncated?")
    return _binary(data, count)  # some programs append data of their own


def _binary(data: bytes, count: int) -> Mesh:
    """Return the mesh of a binary file."""
    rows = np.frombuffer(data, _TRIANGLE, count, _HEADER)
    points, triangles = _joined(rows["corners"].reshape(-1, 3).astype(np.float64))
    return Mesh(points, triangles, triangle_rgb=_colors(data[:80], rows["color"]))


def _colors(header: bytes, word: np.ndarray) -> np.ndarray | None:
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


def _text(data: bytes) -> Mesh:
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
    return Mesh(*_joined(corners.reshape(-1, 3)))


def _joined(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the different points (n, 3) of corners (3 m, 3), and the triangles (m, 3) of them."""
    points, index = np.unique(corners + 0.0, axis=0, return_inverse=True)  # -0 is 0
    return points, index.reshape(-1, 3).astype(np.int64)

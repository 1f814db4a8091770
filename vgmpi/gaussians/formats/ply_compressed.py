"""SuperSplat's compressed layout of a .ply file: 16 bytes each, bounds per 256 Gaussians."""

import numpy as np

from vgmpi.gaussians.spherical_harmonics import dc_from_rgb

from .ply_columns import integer_columns, join_coefficients, read_columns, read_higher
from .ply_tables import VERTEX, Table
from .validation import Columns, GaussianFileError

PACKED = ("packed_position", "packed_rotation", "packed_scale", "packed_color")
_CHUNK_ROWS = 256  # [Gaussians] that share a row of bounds


def is_compressed(tables: dict[str, Table]) -> bool:
    """Return whether the tables are those of this layout."""
    names = tables[VERTEX].row.names or ()
    return "chunk" in tables or any(name in names for name in PACKED)


def check_tables(tables: dict[str, Table]) -> None:
    """Check that the tables of a compressed file match.

    Raises:
        GaussianFileError: If they do not.
    """
    vertex, chunks, higher = tables[VERTEX], tables.get("chunk"), tables.get("sh")
    if chunks is None or chunks.row_count != -(-vertex.row_count // _CHUNK_ROWS):
        raise GaussianFileError(
            f"has {0 if chunks is None else chunks.row_count:,} chunks for"
            f" {vertex.row_count:,} Gaussians, expected one per {_CHUNK_ROWS}"
        )
    for name in PACKED:
        kind = vertex.row[name] if name in (vertex.row.names or ()) else None
        if kind is None or kind.kind != "u" or kind.itemsize != 4:
            raise GaussianFileError(f"has no 32-bit property {name} in element '{VERTEX}'")
    if higher is not None and higher.row_count != vertex.row_count:
        raise GaussianFileError(
            f"has {higher.row_count:,} rows of 'sh' for {vertex.row_count:,} Gaussians"
        )


def decode_rows(tables: dict[str, Table], start: int, stop: int) -> Columns:
    """Return x, quat, scale, opacity, sh and integer columns of a range of rows.

    Args:
        tables: Tables of the file.
        start: First row, a multiple of 256.
        stop: Row behind the last.
    """
    rows = tables[VERTEX].rows(start, stop)
    chunks = tables["chunk"].rows(start // _CHUNK_ROWS, -(-stop // _CHUNK_ROWS))
    position, rotation, scale, color = (rows[name] for name in PACKED)
    chunk_of = np.arange(len(rows)) // _CHUNK_ROWS

    def between(prefix: str, axes: str, t: np.ndarray) -> np.ndarray:
        """Map numbers in 0..1 to the bounds of their chunk."""
        low = read_columns(chunks, [f"min_{prefix}{axis}" for axis in axes])[chunk_of]
        high = read_columns(chunks, [f"max_{prefix}{axis}" for axis in axes])[chunk_of]
        return low * (1 - t) + high * t

    rgba = np.stack([_bits(color, shift, 8) for shift in (24, 16, 8, 0)], axis=1)
    rgb = rgba[:, :3]
    if "min_r" in (
        chunks.dtype.names or ()
    ):  # files older than SuperSplat 2 have no bounds for colors
        rgb = between("", "rgb", rgb)
    f_rest = read_higher(tables["sh"].rows(start, stop)) if "sh" in tables else None
    if f_rest is not None:  # bytes over -4..4; 0 and 255 are the exact ends
        unit = np.where(f_rest == 0, 0.0, np.where(f_rest == 255, 1.0, (f_rest + 0.5) / 256))
        f_rest = (unit - 0.5) * 8
    return (
        between("", "xyz", _unpack_three(position)),
        _rotation(rotation),
        np.exp(between("scale_", "xyz", _unpack_three(scale))),
        rgba[:, 3],
        join_coefficients(dc_from_rgb(rgb), f_rest),
        integer_columns(rows, PACKED),
    )


def _bits(word: np.ndarray, shift: int, width: int) -> np.ndarray:
    """Return a bit field as a number in 0..1."""
    top = (1 << width) - 1
    return ((word >> np.uint32(shift)) & np.uint32(top)) / float(top)


def _unpack_three(word: np.ndarray) -> np.ndarray:
    """Return three numbers in 0..1 packed as 11, 10 and 11 bits (n, 3)."""
    return np.stack([_bits(word, 21, 11), _bits(word, 11, 10), _bits(word, 0, 11)], axis=1)


def _rotation(word: np.ndarray) -> np.ndarray:
    """Unpack quaternions w, x, y, z: leading axis (2 bits) and the others (10 bits each)."""
    others = np.stack([_bits(word, shift, 10) for shift in (20, 10, 0)], axis=1)
    others = (others - 0.5) * np.sqrt(2)
    leading = np.sqrt(np.maximum(0.0, 1 - (others**2).sum(axis=1)))
    leading_axis = (word >> np.uint32(30)).astype(int)
    quat = np.empty((len(word), 4))
    for axis in range(4):
        mask = leading_axis == axis
        quat[mask] = np.insert(others[mask], axis, leading[mask], axis=1)
    return quat

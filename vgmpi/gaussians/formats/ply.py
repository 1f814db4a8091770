"""Reader and writer of Gaussian .ply files, in the plain and in SuperSplat's compressed layout.

The plain layout has a float of every property: log scales, logit opacities, colors, and labels. The
compressed one has 16 bytes for each Gaussian and bounds per 256; the package gsply writes it. The
header is checked against the file's size before anything is allocated, so a broken or hostile file
costs one line and no memory. Lengths keep the units of the file.

References:
    B. Kerbl et al. 2023 (the layout); B. Huang et al. 2024 (2D Gaussians, which have two scales);
    Z. Yu et al. 2024 (Mip-Splatting, whose files have the column filter_3D).
"""

import re
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from vgmpi.gaussians.cloud import CaptureRecord, GaussianCloud, complete_quaternions
from vgmpi.gaussians.spherical_harmonics import dc_from_rgb, degree_omissions, limit_degree
from vgmpi.runtime.user_files import replace_file

from .ply_tables import (
    ENCODINGS,
    VERTEX,
    Header,
    Table,
    find_render_model,
    open_tables,
    read_header,
    select_comments,
)
from .validation import Columns, GaussianFileError, naming_file, read_validated
from .value_doubts import add_doubts

_POINTS = (
    "is a cloud of points: Gaussians also have the properties scale_0 to scale_2 and rot_0 to"
    " rot_3; train a capture from it, or make a mesh of it and use 'mesh' instead of 'gaussians'"
)
_MESH = "is a mesh, without the properties scale_0 and rot_0 of Gaussians: use 'mesh'"
_MIN_SIZE = np.exp(-20.0)  # [file units] lower bound of scales in a compressed file
_HIGHEST_COUNT = 45  # properties f_rest of degree 3, the highest that a cloud holds
_MIXED_COLORS = (
    "colors above degree 0 may be in a wrong order: gaussforge 0.6.0 writes them coefficient after"
    " coefficient, not channel after channel; convert the capture with another program"
)
_ANTIALIASED = "comment SplatRenderMode: mip\n"  # what Brush, splat-transform and viewers read
_DISC_THICKNESS = 1e-3  # [-] of a 2D Gaussian, relative to its smaller scale
_FILTER = "filter_3D"
_HIGHER_COUNTS = (0, 9, 24, 45, 72)  # properties f_rest of degrees 0 to 4
_CENTER = ["x", "y", "z"]
_CONSTANT = ["f_dc_0", "f_dc_1", "f_dc_2"]
_RGB = ["red", "green", "blue"]
_ROTATION = ["rot_0", "rot_1", "rot_2", "rot_3"]
_SCALES = ["scale_0", "scale_1", "scale_2"]
# integer columns that are no labels
_STANDARD = re.compile(
    r"n?[xyz]|(f_dc|f_rest|scale|rot)_\d+|opacity|red|green|blue|alpha|" + _FILTER
)
# columns that some programs store as floating-point numbers
_LABEL = re.compile(
    r"(labels?|ids?|class|classes|category|object|instance|segment|semantic|cluster|part|group)"
    r"(_?(labels?|ids?|index|indices|class))?",
    re.IGNORECASE,
)
_PACKED = ("packed_position", "packed_rotation", "packed_scale", "packed_color")
_CHUNK_ROWS = 256  # [Gaussians] that share a row of bounds


def read(path: str | Path) -> GaussianCloud:
    """Return the Gaussians of a .ply file: opacity in 0..1, linear scales, unit quaternions.

    Raises:
        GaussianFileError: If the file is not readable.
    """
    with naming_file(path), open(path, "rb") as file:
        header = read_header(file)
        tables = open_tables(file, header)
        if VERTEX not in tables:
            raise GaussianFileError(f"has no element '{VERTEX}'")
        if "sh" in tables and not tables["sh"].row.names:
            del tables["sh"]  # exporters write an empty element for degree 0
        vertex, is_compressed = tables[VERTEX], _is_compressed_layout(tables)
        if is_compressed:
            _check_compressed_tables(tables)
        elif _has_only_points(vertex.row.names or ()):
            has_faces = any(e.name == "face" and e.row_count for e in header.elements)
            raise GaussianFileError(_MESH if has_faces else _POINTS)

        def decoded(start: int, stop: int) -> Columns:
            """Decode a range of rows to columns."""
            if is_compressed:
                return _decode_compressed(tables, start, stop)
            return _decode_plain(vertex.rows(start, stop))

        record = _describe(header, tables, is_compressed)
        cloud = read_validated(vertex.row_count, decoded, record)
        names = vertex.row.names or ()
        is_antialiased = find_render_model(header.comments)[0] and not _is_flat(names)
        return add_doubts(
            replace(cloud, is_antialiased=is_antialiased),
            has_log_scales=not record.has_filter_3d,
            has_logits=not record.has_filter_3d and not is_compressed,
            has_float_rgb=_has_float_rgb(vertex.row),
        )


def write(path: str | Path, cloud: GaussianCloud) -> None:
    """Write `cloud` in the plain layout (float32, little-endian), replacing the file at once.

    Labels follow the standard properties.
    """
    n, k = len(cloud), cloud.sh.shape[1]
    f_rest = [f"f_rest_{i}" for i in range(3 * (k - 1))]
    names = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", *f_rest, "opacity"]
    names += ["scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
    columns = [
        cloud.x,
        np.zeros((n, 3)),
        cloud.sh[:, 0],
        cloud.sh[:, 1:].transpose(0, 2, 1).reshape(n, -1),
        _logit(cloud.opacity)[:, None],
        np.log(np.maximum(cloud.scale, 1e-30)),
        cloud.quat,
    ]
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {n}"]
    header += [f"property float {name}" for name in names]
    rows = np.concatenate(columns, axis=1).astype("<f4")
    if cloud.labels:
        types = {name: _label_type(label) for name, label in cloud.labels.items()}
        header += [f"property {kind} {name}" for name, (kind, _) in types.items()]
        fields = [("", "<f4", (len(names),)), *((name, kind) for name, (_, kind) in types.items())]
        table = np.empty(n, fields)
        table["f0"] = rows
        for name, label in cloud.labels.items():
            table[name] = label
        rows = table
    text = "\n".join([*header, "end_header", ""])
    replace_file(path, _with_render_model(text, cloud), rows.tobytes())


def write_compressed(path: str | Path, cloud: GaussianCloud) -> None:
    """Write `cloud` in SuperSplat's compressed layout: see docs/reference/gaussian-files.md.

    Raises:
        OSError: If the file cannot be written.
        GaussianFileError: If the package gsply is missing.
    """
    try:
        from gsply import compress_to_bytes
    except ImportError:
        message = "a compressed .ply needs the package gsply: pip install 'vgmpi[compressed]'"
        raise GaussianFileError(f"{path}: {message}") from None
    x, scale, quat, opacity, constant, higher = (
        column.astype(np.float32)
        for column in (
            cloud.x,
            np.log(np.maximum(cloud.scale, _MIN_SIZE)),
            cloud.quat,
            _logit(cloud.opacity),
            cloud.sh[:, 0],
            cloud.sh[:, 1:],
        )
    )
    data = compress_to_bytes(x, scale, quat, opacity, constant, higher)
    if cloud.is_antialiased:
        text, end, rows = data.partition(b"\nend_header\n")
        data = _with_render_model(text.decode("ascii"), cloud).encode() + end + rows
    replace_file(path, data)


def _logit(opacity: np.ndarray) -> np.ndarray:
    """Return the logits of opacities."""
    opacity = np.clip(opacity, 1e-7, 1 - 1e-7)  # 0 and 1 have no finite logit
    return np.log(opacity / (1 - opacity))


def _label_type(label: np.ndarray) -> tuple[str, str]:
    """Return the .ply type of a column of integers, and its type in memory."""
    for kind, stored in (("int", "<i4"), ("uint", "<u4")):
        bounds = np.iinfo(stored)
        if label.min(initial=0) >= bounds.min and label.max(initial=0) <= bounds.max:
            return kind, stored
    return "double", "<f8"  # a .ply has no wider integers


def _with_render_model(text: str, cloud: GaussianCloud) -> str:
    """Return a header with the comment on the render model of `cloud`, if it needs one."""
    return text.replace("element", _ANTIALIASED + "element", 1) if cloud.is_antialiased else text


def _describe(header: Header, tables: dict[str, Table], is_compressed: bool) -> CaptureRecord:
    """Return what the header says beside the Gaussians."""
    row = tables[VERTEX].row
    layout = "SuperSplat's compressed layout" if is_compressed else ENCODINGS[header.order]
    if not is_compressed and _is_flat(row.names or ()):
        layout += f", 2D Gaussians made {_DISC_THICKNESS:g} of their smaller scale thick"
    higher = tables["sh"].row if is_compressed and "sh" in tables else row
    by_gaussforge = any("generated by gaussforge" in text.lower() for text in header.comments)
    is_mixed = is_compressed and "sh" in tables and by_gaussforge
    is_truncated = _count_higher(higher) > _HIGHEST_COUNT
    return CaptureRecord(
        encoding=f".ply, {layout}",
        render_model_source=find_render_model(header.comments)[1],
        has_filter_3d=not is_compressed and _FILTER in (row.names or ()),
        comments=select_comments(header.comments),
        doubts=(_MIXED_COLORS,) if is_mixed else (),
        omissions=degree_omissions(4) if is_truncated else (),
    )


def _has_only_points(names: Iterable[str]) -> bool:
    """Return whether columns are those of a cloud of points without sizes and rotations."""
    columns = set(names)
    return columns.issuperset(_CENTER) and columns.isdisjoint((*_SCALES, *_ROTATION))


def _is_flat(names: Iterable[str]) -> bool:
    """Return whether columns are those of 2D Gaussians: two scales instead of three."""
    columns = set(names)
    return "scale_2" not in columns and columns.issuperset(_SCALES[:2])


def _has_float_rgb(row: np.dtype) -> bool:
    """Return whether colors are red, green and blue as floating-point numbers."""
    names = row.names or ()
    return "f_dc_0" not in names and "red" in names and row["red"].kind == "f"


def _read_columns(rows: np.ndarray, names: list[str]) -> np.ndarray:
    """Return the named properties as float64 columns (n, len(names)).

    Raises:
        GaussianFileError: If one is missing.
    """
    present = rows.dtype.names or ()
    missing = [name for name in names if name not in present]
    if missing:
        raise GaussianFileError(f"has no property {', '.join(missing)}: not a cloud of Gaussians?")
    return np.stack([rows[name].astype(np.float64) for name in names], axis=1)


def _count_higher(row: np.dtype) -> int:
    """Return the number of properties f_rest_*.

    Raises:
        GaussianFileError: If it belongs to no degree.
    """
    count = sum(name.startswith("f_rest_") for name in row.names or ())
    if count not in _HIGHER_COUNTS:
        allowed = ", ".join(map(str, _HIGHER_COUNTS[:-1]))
        raise GaussianFileError(
            f"has {count} f_rest properties: allowed are {allowed} or {_HIGHER_COUNTS[-1]}"
        )
    return count


def _read_higher(rows: np.ndarray) -> np.ndarray | None:
    """Return the properties f_rest_* as stored (n, 3 (K - 1)), or None."""
    count = _count_higher(rows.dtype)
    return _read_columns(rows, [f"f_rest_{i}" for i in range(count)]) if count else None


def _join_coefficients(dc: np.ndarray, f_rest: np.ndarray | None) -> np.ndarray:
    """Join constant (n, 3) and channel-major higher coefficients to (n, K, 3), up to degree 3."""
    if f_rest is None:
        return dc[:, None, :]
    higher = f_rest.reshape(len(dc), 3, -1).transpose(0, 2, 1)
    return limit_degree(np.concatenate([dc[:, None, :], higher], axis=1))


def _integer_columns(rows: np.ndarray, others: Iterable[str] = ()) -> dict[str, np.ndarray]:
    """Return the columns of labels by name, in the machine's byte order.

    They are all columns of integers that have no meaning for Gaussians, and columns of
    floating-point numbers with the name of a label, whose values are checked later.

    Args:
        rows: Rows of a file, shape (n,).
        others: Names of further columns that are no labels.
    """
    columns = {}
    for name in rows.dtype.names or ():
        if _STANDARD.fullmatch(name) or name in others:
            continue
        if rows.dtype[name].kind in "iu":
            is_wide = rows.dtype[name].itemsize == 4 and rows.dtype[name].kind == "u"
            columns[name] = rows[name].astype(np.int64 if is_wide else np.int32)
        elif _LABEL.fullmatch(name):
            columns[name] = rows[name].astype(np.float64)
    return columns


def _decode_plain(rows: np.ndarray) -> Columns:
    """Return x, quat, scale, opacity, sh and labels of the plain layout."""
    names = rows.dtype.names or ()
    x = _read_columns(rows, _CENTER)
    quat = _read_columns(rows, _ROTATION)
    flat = _is_flat(names)
    scale = np.exp(_read_columns(rows, _SCALES[:2] if flat else _SCALES))
    opacity = 1 / (1 + np.exp(-_read_columns(rows, ["opacity"])[:, 0]))
    if _FILTER in names:
        scale, opacity = apply_filter(scale, opacity, _read_columns(rows, [_FILTER]))
    if flat:
        thickness = _DISC_THICKNESS * scale.min(axis=1, keepdims=True)
        scale = np.concatenate([scale, thickness], axis=1)
    sh = _join_coefficients(_constant_coefficients(rows), _read_higher(rows))
    return x, quat, scale, opacity, sh, _integer_columns(rows)


def apply_filter(
    scale: np.ndarray, opacity: np.ndarray, size: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return scales and opacities after the 3D smoothing filter of Mip-Splatting.

    scale' = sqrt(scale^2 + size^2), and the opacity is multiplied by the square root of the ratio
    of the determinants of the covariances before and after.

    Args:
        scale: Standard deviations, shape (n, 2) or (n, 3).
        opacity: Opacities, shape (n,).
        size: Standard deviation of the filter, shape (n, 1), in the units of `scale`.
    """
    smoothed = np.hypot(scale, size)
    ratio = np.divide(scale, smoothed, out=np.ones_like(scale), where=smoothed != 0)
    return smoothed, opacity * ratio.prod(axis=1)


def _constant_coefficients(rows: np.ndarray) -> np.ndarray:
    """Return the constant colors (n, 3): f_dc_0..2, or red, green and blue if these are missing.

    Integers count in fractions of the largest of their type, other numbers lie in 0..1.
    """
    names = rows.dtype.names or ()
    if "f_dc_0" in names or not set(_RGB).issubset(names):
        return _read_columns(rows, _CONSTANT)
    rgb = _read_columns(rows, _RGB)
    kinds = [rows.dtype[name] for name in _RGB]
    top = [float(np.iinfo(kind).max) if kind.kind in "iu" else 1.0 for kind in kinds]
    return dc_from_rgb(rgb / top)


def _is_compressed_layout(tables: dict[str, Table]) -> bool:
    """Return whether the tables are those of this layout."""
    names = tables[VERTEX].row.names or ()
    return "chunk" in tables or any(name in names for name in _PACKED)


def _check_compressed_tables(tables: dict[str, Table]) -> None:
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
    for name in _PACKED:
        kind = vertex.row[name] if name in (vertex.row.names or ()) else None
        if kind is None or kind.kind != "u" or kind.itemsize != 4:
            raise GaussianFileError(f"has no 32-bit property {name} in element '{VERTEX}'")
    if higher is not None and higher.row_count != vertex.row_count:
        raise GaussianFileError(
            f"has {higher.row_count:,} rows of 'sh' for {vertex.row_count:,} Gaussians"
        )


def _decode_compressed(tables: dict[str, Table], start: int, stop: int) -> Columns:
    """Return x, quat, scale, opacity, sh and integer columns of a range of rows.

    Args:
        tables: Tables of the file.
        start: First row, a multiple of 256.
        stop: Row behind the last.
    """
    rows = tables[VERTEX].rows(start, stop)
    chunks = tables["chunk"].rows(start // _CHUNK_ROWS, -(-stop // _CHUNK_ROWS))
    position, rotation, scale, color = (rows[name] for name in _PACKED)
    chunk_of = np.arange(len(rows)) // _CHUNK_ROWS

    def between(prefix: str, axes: str, t: np.ndarray) -> np.ndarray:
        """Map numbers in 0..1 to the bounds of their chunk."""
        low = _read_columns(chunks, [f"min_{prefix}{axis}" for axis in axes])[chunk_of]
        high = _read_columns(chunks, [f"max_{prefix}{axis}" for axis in axes])[chunk_of]
        return low * (1 - t) + high * t

    rgba = np.stack([_bits(color, shift, 8) for shift in (24, 16, 8, 0)], axis=1)
    rgb = rgba[:, :3]
    if "min_r" in (
        chunks.dtype.names or ()
    ):  # files older than SuperSplat 2 have no bounds for colors
        rgb = between("", "rgb", rgb)
    f_rest = _read_higher(tables["sh"].rows(start, stop)) if "sh" in tables else None
    if f_rest is not None:  # bytes over -4..4; 0 and 255 are the exact ends
        unit = np.where(f_rest == 0, 0.0, np.where(f_rest == 255, 1.0, (f_rest + 0.5) / 256))
        f_rest = (unit - 0.5) * 8
    return (
        between("", "xyz", _unpack_three(position)),
        _rotation(rotation),
        np.exp(between("scale_", "xyz", _unpack_three(scale))),
        rgba[:, 3],
        _join_coefficients(dc_from_rgb(rgb), f_rest),
        _integer_columns(rows, _PACKED),
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
    return complete_quaternions((word >> np.uint32(30)).astype(int), others)

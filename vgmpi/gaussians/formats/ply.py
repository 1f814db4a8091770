"""Reader and writer of Gaussian .ply files, in the plain and in SuperSplat's compressed layout.

The package gsply writes the compressed layout. The header is checked against the file's size before
anything is allocated, so a broken or hostile file costs one line and no memory. Lengths keep the
units of the file.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from vgmpi.gaussians.capture_record import CaptureRecord
from vgmpi.gaussians.cloud import GaussianCloud
from vgmpi.gaussians.spherical_harmonics import degree_omissions
from vgmpi.runtime.user_files import replace_file

from . import ply_columns, ply_compressed
from .ply_header import ENCODINGS, Header, find_render_model, read_header, select_comments
from .ply_tables import VERTEX, Table, open_tables
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
        vertex, is_compressed = tables[VERTEX], ply_compressed.is_compressed(tables)
        if is_compressed:
            ply_compressed.check_tables(tables)
        elif ply_columns.has_only_points(vertex.row.names or ()):
            has_faces = any(e.name == "face" and e.row_count for e in header.elements)
            raise GaussianFileError(_MESH if has_faces else _POINTS)

        def decoded(start: int, stop: int) -> Columns:
            """Decode a range of rows to columns."""
            if is_compressed:
                return ply_compressed.decode_rows(tables, start, stop)
            return ply_columns.decode_plain(vertex.rows(start, stop))

        record = _describe(header, tables, is_compressed)
        cloud = read_validated(vertex.row_count, decoded, record)
        names = vertex.row.names or ()
        is_antialiased = find_render_model(header.comments)[0] and not ply_columns.is_flat(names)
        return add_doubts(
            replace(cloud, is_antialiased=is_antialiased),
            has_log_scales=not record.has_filter_3d,
            has_logits=not record.has_filter_3d and not is_compressed,
            has_float_rgb=ply_columns.has_float_rgb(vertex.row),
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
    if not is_compressed and ply_columns.is_flat(row.names or ()):
        layout += f", 2D Gaussians made {ply_columns.DISC_THICKNESS:g} of their smaller scale thick"
    higher = tables["sh"].row if is_compressed and "sh" in tables else row
    by_gaussforge = any("generated by gaussforge" in text.lower() for text in header.comments)
    is_mixed = is_compressed and "sh" in tables and by_gaussforge
    is_truncated = ply_columns.count_higher(higher) > _HIGHEST_COUNT
    return CaptureRecord(
        encoding=f".ply, {layout}",
        render_model_source=find_render_model(header.comments)[1],
        has_filter_3d=not is_compressed and ply_columns.FILTER in (row.names or ()),
        comments=select_comments(header.comments),
        doubts=(_MIXED_COLORS,) if is_mixed else (),
        omissions=degree_omissions(4) if is_truncated else (),
    )

"""Reader and writer of Gaussian .ply files, in the plain and in SuperSplat's compressed layout.

The package gsply writes the compressed layout. The header is checked against the file's size before
anything is allocated, so a broken or hostile file costs one line and no memory. Lengths keep the
units of the file.
"""

import os
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np

from vgmpi.gaussians.cloud import GaussianCloud
from vgmpi.gaussians.spherical_harmonics import dc_from_rgb
from vgmpi.runtime.atomic_write import replace_file

from .validation import Columns, GaussianFileError, naming_file, read_validated

_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
_HEADER_LIMIT = 1 << 16  # [bytes] a Gaussian file's header has about 2 KB
_SH_COUNT = {0: 1, 9: 4, 24: 9, 45: 16}  # number of f_rest properties -> SH coefficients
_PACKED = ("packed_position", "packed_rotation", "packed_scale", "packed_color")
_LINE_LIMIT = 200  # [characters] of a header line
_ROW_LIMIT = 4096  # [bytes] of a row; all standard properties take 496
_CHUNK_ROWS = 256  # [Gaussians] that share a row of bounds in a compressed file
_MIN_SIZE = np.exp(-20.0)  # [file units] lower bound of scales in a compressed file


class Element(NamedTuple):
    """Table of a file: rows of `dtype`, the first at byte `start`."""

    count: int  # type: ignore[assignment]  # hides a method of tuple
    dtype: np.dtype
    start: int

    def rows(self, file: BinaryIO, start: int, stop: int) -> np.ndarray:
        """Read rows of the table.

        Args:
            file: Open file.
            start, stop: Range of rows, cut at the end of the table.
        """
        file.seek(self.start + start * self.dtype.itemsize)
        return np.fromfile(file, dtype=self.dtype, count=min(stop, self.count) - start)


def read(path: str | Path) -> GaussianCloud:
    """Return the Gaussians of a .ply file: opacity in 0..1, linear scales, unit quaternions.

    Raises:
        GaussianFileError: If the file is not readable.
    """
    with naming_file(path), open(path, "rb") as file:
        elements = _elements(file)
        if "vertex" not in elements:
            raise GaussianFileError("has no element 'vertex'")
        vertex = elements["vertex"]
        names = vertex.dtype.names or ()
        if "chunk" in elements or any(name in names for name in _PACKED):
            _check_compressed(elements)
            return read_validated(vertex.count, lambda a, b: _compressed(file, elements, a, b))
        return read_validated(vertex.count, lambda a, b: _plain(vertex.rows(file, a, b)))


def write(path: str | Path, cloud: GaussianCloud) -> None:
    """Write `cloud` in the plain layout (float32, little-endian), replacing the file at once."""
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
    header += [f"property float {name}" for name in names] + ["end_header", ""]
    rows = np.concatenate(columns, axis=1).astype("<f4")
    replace_file(path, "\n".join(header).encode("ascii"), rows.tobytes())


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
    replace_file(path, compress_to_bytes(x, scale, quat, opacity, constant, higher))


def _logit(opacity: np.ndarray) -> np.ndarray:
    """Return the logits of opacities."""
    opacity = np.clip(opacity, 1e-7, 1 - 1e-7)  # 0 and 1 have no finite logit
    return np.log(opacity / (1 - opacity))


def _elements(file: BinaryIO) -> dict[str, Element]:
    """Return all elements of a file by name, with their rows inside of the file."""
    size = os.fstat(file.fileno()).st_size
    lines, start = _header_lines(file.read(_HEADER_LIMIT))
    elements = {}
    for name, count, row in _layout(lines):
        elements[name] = Element(count, row, start)
        start += count * row.itemsize
        if start > size:
            raise GaussianFileError(
                f"the header promises {count:,} rows of '{name}', the file is too short"
                f" ({size:,} bytes): truncated?"
            )
    return elements


def _header_lines(head: bytes) -> tuple[list[str], int]:
    """Return the lines of the header after the first, and the offset of the data."""
    if not head.startswith((b"ply\n", b"ply\r\n")):
        raise GaussianFileError("is not a .ply file (it does not begin with 'ply')")
    for terminator in (b"\nend_header\n", b"\nend_header\r\n"):
        offset = head.find(terminator)
        if offset >= 0:
            text = head[:offset].decode("ascii", errors="replace")
            return [line.strip() for line in text.splitlines()[1:]], offset + len(terminator)
    raise GaussianFileError(f"the header has no end within {_HEADER_LIMIT // 1024} KB")


def _layout(lines: list[str]) -> list[tuple[str, int, np.dtype]]:
    """Return name, number of rows and row type of each element."""
    order = None
    elements: list[tuple[str, int, list[tuple[str, str]]]] = []
    for line in lines:
        words = line.split()
        if not words or words[0] in ("comment", "obj_info"):
            continue
        if len(line) > _LINE_LIMIT or not line.isprintable():
            raise GaussianFileError(f"has the unreadable header line {line[:60]!r}")
        if words[0] == "format":
            if words[1:2] not in (["binary_little_endian"], ["binary_big_endian"]):
                raise GaussianFileError(f"has the {' '.join(words)!r}: allowed are the binary ones")
            order = "<" if words[1] == "binary_little_endian" else ">"
        elif words[0] == "element" and len(words) == 3:
            if not words[2].isdecimal() or len(words[2]) > 15:
                raise GaussianFileError(f"has the bad number of rows in {line!r}")
            elements.append((words[1], int(words[2]), []))
        elif words[0] == "property" and elements and words[1:2] == ["list"]:
            raise GaussianFileError(
                f"has lists in element '{elements[-1][0]}': a mesh? Gaussian files have none"
            )
        elif words[0] == "property" and elements and len(words) == 3 and words[1] in _TYPES:
            elements[-1][2].append((words[2], _TYPES[words[1]]))
        else:
            raise GaussianFileError(f"has the unreadable header line {line[:60]!r}")
    if order is None:
        raise GaussianFileError("has no 'format' line")
    layout = []
    for name, count, properties in elements:
        if not properties or len({p for p, _ in properties}) < len(properties):
            raise GaussianFileError(f"has no or repeated properties in element '{name}'")
        row = np.dtype([(p, order + kind) for p, kind in properties])
        if row.itemsize > _ROW_LIMIT:
            raise GaussianFileError(
                f"has rows of {row.itemsize:,} bytes in '{name}': the most is {_ROW_LIMIT:,}"
            )
        layout.append((name, count, row))
    if len({name for name, _, _ in layout}) < len(layout):
        raise GaussianFileError("names an element twice")
    return layout


def _columns(rows: np.ndarray, names: list[str]) -> np.ndarray:
    """Return the named properties as float64 columns (n, len(names))."""
    missing = [name for name in names if name not in (rows.dtype.names or ())]
    if missing:
        raise GaussianFileError(f"has no property {', '.join(missing)}: not a cloud of Gaussians?")
    return np.stack([rows[name].astype(np.float64) for name in names], axis=1)


def _higher_properties(rows: np.ndarray) -> np.ndarray | None:
    """Return the properties f_rest_* as stored (n, 3 (K - 1)), or None."""
    count = sum(name.startswith("f_rest_") for name in rows.dtype.names or ())
    if count not in _SH_COUNT:
        raise GaussianFileError(f"has {count} f_rest properties: allowed are 0, 9, 24 or 45")
    return _columns(rows, [f"f_rest_{i}" for i in range(count)]) if count else None


def _coefficients(dc: np.ndarray, f_rest: np.ndarray | None) -> np.ndarray:
    """Join constant (n, 3) and channel-major higher SH coefficients to (n, K, 3)."""
    if f_rest is None:
        return dc[:, None, :]
    return np.concatenate(
        [dc[:, None, :], f_rest.reshape(len(dc), 3, -1).transpose(0, 2, 1)], axis=1
    )


def _plain(rows: np.ndarray) -> Columns:
    """Return x, quat, scale, opacity, sh of the plain layout (logit opacity, log scales)."""
    x = _columns(rows, ["x", "y", "z"])
    quat = _columns(rows, [f"rot_{i}" for i in range(4)])
    scale = np.exp(_columns(rows, [f"scale_{i}" for i in range(3)]))
    opacity = 1 / (1 + np.exp(-_columns(rows, ["opacity"])[:, 0]))
    dc = _columns(rows, [f"f_dc_{i}" for i in range(3)])
    return x, quat, scale, opacity, _coefficients(dc, _higher_properties(rows))


def _check_compressed(elements: dict[str, Element]) -> None:
    """Check that the tables of a compressed file match.

    Raises:
        GaussianFileError: If they do not.
    """
    vertex, chunks, shared = elements["vertex"], elements.get("chunk"), elements.get("sh")
    if chunks is None or chunks.count != -(-vertex.count // _CHUNK_ROWS):
        raise GaussianFileError(
            f"has {0 if chunks is None else chunks.count:,} chunks for {vertex.count:,} Gaussians,"
            f" expected one per {_CHUNK_ROWS}"
        )
    for name in _PACKED:
        kind = vertex.dtype[name] if name in (vertex.dtype.names or ()) else None
        if kind is None or kind.kind != "u" or kind.itemsize != 4:
            raise GaussianFileError(f"has no 32-bit property {name} in element 'vertex'")
    if shared is not None and shared.count != vertex.count:
        raise GaussianFileError(f"has {shared.count:,} rows of 'sh' for {vertex.count:,} Gaussians")


def _compressed(file: BinaryIO, elements: dict[str, Element], start: int, stop: int) -> Columns:
    """Return x, quat, scale, opacity, sh of SuperSplat's layout: 16 bytes each, bounds per 256.

    start: a multiple of 256.
    """
    rows = elements["vertex"].rows(file, start, stop)
    chunks = elements["chunk"].rows(file, start // _CHUNK_ROWS, -(-stop // _CHUNK_ROWS))
    position, rotation, scale, color = (rows[name] for name in _PACKED)
    chunk_of = np.arange(len(rows)) // _CHUNK_ROWS

    def between(prefix: str, axes: str, t: np.ndarray) -> np.ndarray:
        """Map numbers in 0..1 to the bounds of their chunk."""
        low = _columns(chunks, [f"min_{prefix}{axis}" for axis in axes])[chunk_of]
        high = _columns(chunks, [f"max_{prefix}{axis}" for axis in axes])[chunk_of]
        return low * (1 - t) + high * t

    rgba = np.stack([_bits(color, shift, 8) for shift in (24, 16, 8, 0)], axis=1)
    rgb = rgba[:, :3]
    if "min_r" in (
        chunks.dtype.names or ()
    ):  # files older than SuperSplat 2 have no bounds for colors
        rgb = between("", "rgb", rgb)
    f_rest = (
        _higher_properties(elements["sh"].rows(file, start, stop)) if "sh" in elements else None
    )
    if f_rest is not None:  # bytes over -4..4; 0 and 255 are the exact ends
        unit = np.where(f_rest == 0, 0.0, np.where(f_rest == 255, 1.0, (f_rest + 0.5) / 256))
        f_rest = (unit - 0.5) * 8
    return (
        between("", "xyz", _unpack_three(position)),
        _rotation(rotation),
        np.exp(between("scale_", "xyz", _unpack_three(scale))),
        rgba[:, 3],
        _coefficients(dc_from_rgb(rgb), f_rest),
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

"""Reader and writer of .spz files, the compressed format of Niantic (github.com/nianticlabs/spz).

Numbers are bytes, attribute after attribute. They are read and written as they are: converters
hand over those of a .ply, although the format's pages speak of x right, y up, z back. An extension
record can name the axes; files written here have it.
"""

import struct
from dataclasses import replace
from pathlib import Path

import numpy as np

from vgmpi.gaussians.capture_record import CaptureRecord
from vgmpi.gaussians.cloud import GaussianCloud
from vgmpi.gaussians.coordinate_frames import PLY_FRAME
from vgmpi.gaussians.spherical_harmonics import COEFFICIENTS, degree_omissions, limit_degree
from vgmpi.runtime.user_files import replace_file

from .spz_container import (
    ANTIALIASED,
    EXTENDED,
    Header,
    new_header,
    pack_file,
    pack_record,
    unpack_file,
    unpack_records,
)
from .validation import Columns, GaussianFileError, naming_file, read_validated

WRITTEN_VERSIONS = (3, 4)
DEFAULT_VERSION = 3  # readers of version 4 read it, too, and many viewers read no other

_FRAME_RECORD = 0xADBE0003  # SPZ_ADOBE_coordinate_system: one of these, counted from 1
_FRAMES = (
    ("LDB", "RDB", "LUB", "RUB", "LDF", "RDF", "LUF", "RUF")
    + ("LFD", "RFD", "LFU", "RFU", "LBD", "RBD", "LBU", "RBU")
)  # fmt: skip
_NUMBER = struct.Struct("<I")

_COLOR = 0.15 * 255  # [-] the byte of a constant coefficient c is 127.5 + _COLOR c
_FRACTION_BITS = 16  # [bits] of a written position where 24 bits allow it: 15 micrometers


def read(path: str | Path) -> GaussianCloud:
    """Return the Gaussians of a .spz file of version 1 to 4, numbers as they are.

    Raises:
        GaussianFileError: If the file is not readable.
    """
    with naming_file(path), open(path, "rb") as file:
        header, attributes, records = unpack_file(file)
        columns = [part.reshape(header.count, -1) for part in attributes]
        cloud = read_validated(
            header.count,
            lambda a, b: _decoded(header, *(column[a:b] for column in columns)),
            _capture_record(header, records),
        )
    return replace(cloud, is_antialiased=bool(header.flags & ANTIALIASED))


def write(path: str | Path, cloud: GaussianCloud, version: int = DEFAULT_VERSION) -> None:
    """Write `cloud` in bytes, with a record of its axes: see docs/reference/gaussian-files.md.

    Raises:
        OSError: If the file cannot be written.
        GaussianFileError: If 24 bits cannot hold a position.
        ValueError: If the version is not one of WRITTEN_VERSIONS.
    """
    if version not in WRITTEN_VERSIONS:
        raise ValueError(f"version {version}: allowed: {WRITTEN_VERSIONS}")
    reach = float(np.abs(cloud.x).max(initial=0.0))
    bits = _FRACTION_BITS
    while bits >= 0 and reach * 2**bits > (1 << 23) - 1:
        bits -= 1
    if bits < 0:
        raise GaussianFileError(f"{path}: a .spz cannot hold a position of {reach:g}")
    degree = COEFFICIENTS.index(cloud.sh.shape[1])
    fixed = np.rint(cloud.x * 2**bits).astype("<i4")
    with np.errstate(divide="ignore"):
        scale = 16 * (np.log(cloud.scale) + 10)
    sections = (
        fixed.view("u1").reshape(len(cloud), 3, 4)[..., :3],
        _bytes(255 * cloud.opacity),
        _bytes(127.5 + _COLOR * cloud.sh[:, 0].astype(np.float64)),
        _bytes(scale),
        _packed_rotation(cloud.quat),
        _bytes(128 * cloud.sh[:, 1:].astype(np.float64) + 128),
    )
    flags = ANTIALIASED if cloud.is_antialiased else 0
    header = new_header(version, len(cloud), degree, bits, flags)
    frame = pack_record(_FRAME_RECORD, _NUMBER.pack(_FRAMES.index(PLY_FRAME) + 1))
    replace_file(path, *pack_file(header, [part.tobytes() for part in sections], frame))


def _capture_record(header: Header, data: bytes) -> CaptureRecord:
    """Return what a file says beside its Gaussians; data: its extension records."""
    records, is_complete = unpack_records(data)
    frame, source = "", "taken as in a .ply, the file does not say"
    doubts, omissions = [], list(degree_omissions(header.degree))
    if not is_complete or (header.flags & EXTENDED and not records):
        doubts.append("its extension records are missing or cut off")
    frames = [content for kind, content in records if kind == _FRAME_RECORD]
    if frames:  # the first counts, as in Niantic's program
        number = _NUMBER.unpack_from(frames[0])[0] if len(frames[0]) >= _NUMBER.size else 0
        if 1 <= number <= len(_FRAMES):
            frame, source = _FRAMES[number - 1], "said by the file's record"
        else:
            doubts.append(f"its record of the frame has the unknown number {number}")
    unknown = sorted({kind for kind, _ in records if kind != _FRAME_RECORD})
    if unknown:
        names = ", ".join(f"0x{kind:08X}" for kind in unknown[:3])
        omissions.append(f"extension records are left out ({names})")
    return CaptureRecord(
        encoding=f".spz, version {header.version}",
        frame=frame,
        frame_source=source,
        render_model_source="said by the file's flag" if header.flags & ANTIALIASED else "",
        doubts=tuple(doubts),
        omissions=tuple(omissions),
    )


def _bytes(values: np.ndarray) -> np.ndarray:
    """Round and clip values to bytes."""
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)


def _decoded(header: Header, x, opacity, color, scale, quat, higher) -> Columns:
    """Decode bytes to columns; x (n, 9 or 6), opacity (n, 1), ..., higher (n, 3 (K - 1))."""
    n = len(x)
    if header.version == 1:
        center = x.copy().view("<f2").astype(np.float64)
    else:
        b = x.reshape(n, 3, 3).astype(np.int32)
        fixed = (b[..., 0] | b[..., 1] << 8 | b[..., 2] << 16) << 8 >> 8  # extends the sign
        center = fixed / 2.0**header.fraction_bits
    dc = (color - 127.5) / _COLOR
    sh = (higher.reshape(n, -1, 3) - 128.0) / 128
    return (
        center,
        _rotation(quat),
        np.exp(scale / 16.0 - 10),
        opacity[:, 0] / 255.0,
        limit_degree(np.concatenate([dc[:, None, :], sh], axis=1)),
    )


def _rotation(data: np.ndarray) -> np.ndarray:
    """Decode quaternions w, x, y, z (n, 4) of bytes (n, 3), x, y, z, or (n, 4), smallest three."""
    xyzw = np.empty((len(data), 4))
    if data.shape[1] == 3:
        xyzw[:, :3] = data / 127.5 - 1
        xyzw[:, 3] = np.sqrt(np.maximum(0.0, 1 - (xyzw[:, :3] ** 2).sum(axis=1)))
        return np.roll(xyzw, 1, axis=1)
    word = np.ascontiguousarray(data).view("<u4")[:, 0]
    leading_axis = (word >> 30).astype(int)
    for axis in (3, 2, 1, 0):  # the last axis is in the lowest bits
        stored = np.sqrt(0.5) / 511 * (word & 511) * np.where(word & 512, -1.0, 1.0)
        xyzw[:, axis] = np.where(leading_axis == axis, 0.0, stored)
        word = np.where(leading_axis == axis, word, word >> 10)
    leading = np.sqrt(np.maximum(0.0, 1 - (xyzw**2).sum(axis=1)))
    xyzw[np.arange(len(data)), leading_axis] = leading
    return np.roll(xyzw, 1, axis=1)


def _packed_rotation(quat: np.ndarray) -> np.ndarray:
    """Pack quaternions w, x, y, z (n, 4) into words.

    A word holds the leading axis (2 bits) and sign and size of the others (1 + 9 bits each), in the
    order x, y, z, w.
    """
    xyzw = np.roll(quat, -1, axis=1)
    leading_axis = np.abs(xyzw).argmax(axis=1)
    xyzw = xyzw * np.where(xyzw[np.arange(len(xyzw)), leading_axis] < 0, -1.0, 1.0)[:, None]
    word = leading_axis.astype(np.uint32)
    for axis in range(4):
        size = np.minimum(np.rint(np.abs(xyzw[:, axis]) * np.sqrt(2) * 511), 511).astype(np.uint32)
        signed = size | ((xyzw[:, axis] < 0).astype(np.uint32) << 9)
        word = np.where(leading_axis == axis, word, (word << 10) | signed).astype("<u4")
    return word

"""Reader and writer of .spz files, the compressed format of Niantic (github.com/nianticlabs/spz).

Numbers are bytes, attribute after attribute; versions 1 to 3 are one gzip stream, version 4 is a
plain header and one zstd stream per attribute. The header bounds the unpacked size, which may not
be absurdly larger than the file: decompression bombs are rejected.

A .spz stores x right, y up, z back; here a cloud is what its .ply would hold (x right, y down, z
forward), as in Niantic's own converter: half a turn about x, on reading and on writing.
"""

import logging
import os
import struct
import zlib
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np

from vgmpi.gaussians.cloud import GaussianCloud
from vgmpi.runtime.atomic_write import replace_file

from .validation import (
    Columns,
    GaussianFileError,
    naming_file,
    read_validated,
    validate_count,
)

log = logging.getLogger("vgmpi")

_MAGIC = b"NGSP"
_HEADER = struct.Struct("<4sIIBBBB")  # magic, version, count, degree, fraction bits, flags, streams
_HEADER_4 = struct.Struct("<I12x")  # version 4 only, after _HEADER: offset of the table of streams
_STREAM = struct.Struct("<QQ")  # [bytes] packed, unpacked
_EXTENDED = 2  # flag of a file with vendors' extensions
_HIGHER_COUNT = (0, 3, 8, 15, 24)  # higher coefficients per channel by degree
_READ_COUNT = 15  # [coefficients] per channel that are read; degree 4 is dropped
_FREE, _RATIO = 1 << 23, 200  # [bytes] that any file may expand to; factor for a large file

_COLOR = 0.15 * 255  # [-] the byte of a constant coefficient c is 127.5 + _COLOR c
_FRACTION_BITS = 16  # [bits] of a written position where 24 bits allow it: 15 micrometers
_HALF_TURN = np.array([1.0, -1.0, -1.0])
# sign of coefficients 1..15 under that half turn: odd in (y, z) or not
_HALF_TURN_SH = np.array([-1, -1, 1, -1, 1, 1, -1, 1, -1, 1, -1, -1, 1, -1, 1], dtype=np.float64)


class Header(NamedTuple):
    """First 16 bytes of a file."""

    magic: bytes
    version: int
    count: int  # type: ignore[assignment]  # hides a method of tuple
    degree: int
    fraction_bits: int
    flags: int
    streams: int

    def sizes(self) -> list[int]:
        """Return the bytes of positions, opacities, colors, scales, rotations and harmonics."""
        x = 6 if self.version == 1 else 9
        quat = 4 if self.version >= 3 else 3
        return [
            self.count * row_bytes
            for row_bytes in (x, 1, 3, 3, quat, 3 * _HIGHER_COUNT[self.degree])
        ]


def read(path: str | Path) -> GaussianCloud:
    """Return the Gaussians of a .spz file of version 1 to 4.

    Raises:
        GaussianFileError: If the file is not readable.
    """
    with naming_file(path), open(path, "rb") as file:
        size, start = os.fstat(file.fileno()).st_size, file.read(4)
        file.seek(0)
        if start == _MAGIC:
            header, parts = _unpacked_4(file, size)
        elif start.startswith(b"\x1f\x8b"):
            header, parts = _unpacked_gzip(file, size)
        else:
            raise GaussianFileError("is not a .spz file (neither gzip nor 'NGSP' at its beginning)")
        if header.flags & _EXTENDED:
            log.warning("%s: its extensions are left out, axes are taken as usual", path)
        if header.degree == 4:
            log.warning("%s: colors of degree 4 are left out", path)
        columns = [part.reshape(header.count, -1) for part in parts]
        return read_validated(
            header.count, lambda a, b: _decoded(header, *(column[a:b] for column in columns))
        )


def write(path: str | Path, cloud: GaussianCloud) -> None:
    """Write `cloud` as version 3, whose numbers are bytes: see docs/reference/gaussian-files.md.

    Raises:
        OSError: If the file cannot be written.
        GaussianFileError: If 24 bits cannot hold a position.
    """
    x = cloud.x * _HALF_TURN
    reach = float(np.abs(x).max(initial=0.0))
    bits = _FRACTION_BITS
    while bits >= 0 and reach * 2**bits > (1 << 23) - 1:
        bits -= 1
    if bits < 0:
        raise GaussianFileError(f"{path}: a .spz cannot hold a position of {reach:g}")
    degree = _HIGHER_COUNT.index(cloud.sh.shape[1] - 1)
    fixed = np.rint(x * 2**bits).astype("<i4")
    with np.errstate(divide="ignore"):
        scale = 16 * (np.log(cloud.scale) + 10)
    higher = cloud.sh[:, 1:] * _HALF_TURN_SH[: cloud.sh.shape[1] - 1, None]
    sections = (
        fixed.view("u1").reshape(len(cloud), 3, 4)[..., :3],
        _bytes(255 * cloud.opacity),
        _bytes(127.5 + _COLOR * cloud.sh[:, 0].astype(np.float64)),
        _bytes(scale),
        _packed_rotation(cloud.quat),
        _bytes(128 * higher + 128),
    )
    head = _HEADER.pack(_MAGIC, 3, len(cloud), degree, bits, 0, 0)
    packer = zlib.compressobj(6, zlib.DEFLATED, 31)  # 31: a gzip frame without a time stamp
    packed = [packer.compress(part) for part in (head, *(s.tobytes() for s in sections))]
    replace_file(path, *packed, packer.flush())


def _bytes(values: np.ndarray) -> np.ndarray:
    """Round and clip values to bytes."""
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)


def _header(data: bytes, versions: tuple[int, ...], size: int) -> Header:
    """Decode and check the header of a file of `size` bytes.

    Raises:
        GaussianFileError: If such a file cannot have this header.
    """
    if len(data) < _HEADER.size:
        raise GaussianFileError("ends within its header: truncated?")
    header = Header(*_HEADER.unpack_from(data))
    if header.magic != _MAGIC:
        raise GaussianFileError("is not a .spz file (its header does not begin with 'NGSP')")
    if header.version not in versions:
        allowed = " or ".join(map(str, versions)) if len(versions) == 1 else "1, 2 or 3"
        raise GaussianFileError(
            f"has version {header.version}: allowed in such a file is {allowed}"
        )
    if header.degree >= len(_HIGHER_COUNT):
        raise GaussianFileError(f"has colors of degree {header.degree}: allowed are 0 to 4")
    if header.fraction_bits > 24:
        raise GaussianFileError(f"has {header.fraction_bits} fraction bits: allowed are 0 to 24")
    validate_count(header.count)
    promised = sum(header.sizes())
    if promised > max(_FREE, _RATIO * size):
        raise GaussianFileError(
            f"claims {header.count:,} Gaussians, {promised:,} bytes out of {size:,}: truncated, or"
            " made to fill the memory"
        )
    return header


def _unpacked_gzip(file: BinaryIO, size: int) -> tuple[Header, list[np.ndarray]]:
    """Return header and attributes of versions 1 to 3."""
    unpacker = zlib.decompressobj(31)
    pending = b""

    def take(wanted: int) -> bytearray:
        """Decompress up to `wanted` bytes."""
        nonlocal pending
        out = bytearray()
        while len(out) < wanted and not unpacker.eof:
            pending = pending or file.read(1 << 16)
            if not pending:
                break
            try:
                out += unpacker.decompress(pending, wanted - len(out))
            except zlib.error as error:
                raise GaussianFileError(f"has a broken gzip stream ({error})") from None
            pending = unpacker.unconsumed_tail
        return out

    header = _header(bytes(take(_HEADER.size)), (1, 2, 3), size)
    parts = []
    for expected in header.sizes():
        part = take(expected)
        if len(part) < expected:
            raise GaussianFileError(f"ends before its {header.count:,} Gaussians do: truncated?")
        parts.append(np.frombuffer(part, np.uint8))
    if not header.flags & _EXTENDED and take(1):
        raise GaussianFileError(f"holds more than its {header.count:,} Gaussians: a broken header?")
    return header, parts


def _unpacked_4(file: BinaryIO, size: int) -> tuple[Header, list[np.ndarray]]:
    """Return header and attributes of version 4."""
    head = file.read(_HEADER.size + _HEADER_4.size)
    header = _header(head, (4,), size)
    if len(head) < _HEADER.size + _HEADER_4.size:
        raise GaussianFileError("ends within its header: truncated?")
    sizes = [expected for expected in header.sizes() if expected]
    file.seek(_HEADER_4.unpack_from(head, _HEADER.size)[0])
    table = file.read(header.streams * _STREAM.size)
    if header.streams != len(sizes) or len(table) < header.streams * _STREAM.size:
        raise GaussianFileError(f"has no table of {len(sizes)} streams where it says")
    parts = []
    for (packed, unpacked), expected in zip(_STREAM.iter_unpack(table), sizes):
        if packed > size:
            raise GaussianFileError(f"has a stream of {packed:,} bytes: the file has {size:,}")
        if unpacked != expected:
            raise GaussianFileError(f"has a stream of {unpacked:,} bytes: expected {expected:,}")
        parts.append(np.frombuffer(_zstd(file.read(packed), expected), np.uint8))
    if header.degree == 0:
        parts.append(np.empty(0, np.uint8))
    return header, parts


def _zstd(data: bytes, size: int) -> bytes:
    """Decompress a zstd stream that must hold exactly `size` bytes."""
    try:
        import zstandard
    except ImportError:
        raise GaussianFileError(
            "is of version 4, which needs the package zstandard: pip install 'vgmpi[spz]'"
        ) from None
    window = 1 << max(20, (size - 1).bit_length())  # bounds the memory that a stream may request
    try:
        unpacker = zstandard.ZstdDecompressor(max_window_size=window)
        out = unpacker.stream_reader(data).read(size + 1)
    except zstandard.ZstdError as error:
        raise GaussianFileError(f"has a broken zstd stream ({error})") from None
    if len(out) != size:
        raise GaussianFileError("has a stream of another length than it says: truncated?")
    return out


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
    sh = ((higher.astype(np.float64) - 128) / 128).reshape(n, -1, 3)[:, :_READ_COUNT]
    sh = sh * _HALF_TURN_SH[: sh.shape[1], None]
    return (
        center * _HALF_TURN,
        _rotation(quat) * [1.0, 1.0, -1.0, -1.0],
        np.exp(scale / 16.0 - 10),
        opacity[:, 0] / 255.0,
        np.concatenate([dc[:, None, :], sh], axis=1),
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
    """Pack quaternions w, x, y, z (n, 4) into words after the half turn.

    A word holds the leading axis (2 bits) and sign and size of the others (1 + 9 bits each), in the
    order x, y, z, w.
    """
    xyzw = np.roll(quat * [1.0, 1.0, -1.0, -1.0], -1, axis=1)
    leading_axis = np.abs(xyzw).argmax(axis=1)
    xyzw = xyzw * np.where(xyzw[np.arange(len(xyzw)), leading_axis] < 0, -1.0, 1.0)[:, None]
    word = leading_axis.astype(np.uint32)
    for axis in range(4):
        size = np.minimum(np.rint(np.abs(xyzw[:, axis]) * np.sqrt(2) * 511), 511).astype(np.uint32)
        signed = size | ((xyzw[:, axis] < 0).astype(np.uint32) << 9)
        word = np.where(leading_axis == axis, word, (word << 10) | signed).astype("<u4")
    return word

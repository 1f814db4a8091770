"""Reader and writer of .spz files, the compressed format of Niantic (github.com/nianticlabs/spz).

Numbers are bytes, attribute after attribute. They are read and written as they are: converters
hand over those of a .ply, although the format's pages speak of x right, y up, z back. An extension
record can name the axes; files written here have it.

Versions 1 to 3 are one gzip stream: header, attributes, records. Version 4 is a plain header, plain
records, a table and one zstd stream per attribute. The header bounds the unpacked size, which may
not be absurdly larger than the file: decompression bombs are rejected.

References:
    README.md and extensions/README.md of github.com/nianticlabs/spz.
"""

import os
import struct
import zlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
import zstandard

from vgmpi.gaussians.capture_conventions import PLY_FRAME
from vgmpi.gaussians.cloud import CaptureRecord, GaussianCloud
from vgmpi.gaussians.spherical_harmonics import COEFFICIENTS, degree_omissions, limit_degree
from vgmpi.runtime.user_files import replace_file

from .validation import Columns, GaussianFileError, naming_file, read_validated, validate_count

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
_GZIP_VERSIONS = (1, 2, 3)
_ZSTD_VERSION = 4
_ANTIALIASED, _EXTENDED = 1, 2  # bits of the flags

_MAGIC = b"NGSP"
_HEADER = struct.Struct("<4sIIBBBB")  # magic, version, count, degree, fraction bits, flags, streams
_HEADER_4 = struct.Struct("<I12x")  # version 4 only, after _HEADER: offset of the table of streams
_STREAM = struct.Struct("<QQ")  # [bytes] packed, unpacked
_RECORD = struct.Struct("<II")  # type, [bytes] of the content that follows
_HIGHER_COUNT = (0, 3, 8, 15, 24)  # higher coefficients per channel by degree
_FREE, _RATIO = 1 << 23, 200  # [bytes] that any file may expand to; factor for a large file
_RECORDS_LIMIT = 1 << 20  # [bytes] of extension records that are read; those of the axes take 12
_ZSTD_LEVEL = 12  # as in Niantic's program


class _Header(NamedTuple):
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


class _Content(NamedTuple):
    """Unpacked file: header, bytes of the six attributes, and extension records as one block."""

    header: _Header
    attributes: list[np.ndarray]
    records: bytes


def read(path: str | Path) -> GaussianCloud:
    """Return the Gaussians of a .spz file of version 1 to 4, numbers as they are.

    Raises:
        GaussianFileError: If the file is not readable.
    """
    with naming_file(path), open(path, "rb") as file:
        header, attributes, records = _unpack_file(file)
        columns = [part.reshape(header.count, -1) for part in attributes]
        cloud = read_validated(
            header.count,
            lambda a, b: _decoded(header, *(column[a:b] for column in columns)),
            _capture_record(header, records),
        )
    return replace(cloud, is_antialiased=bool(header.flags & _ANTIALIASED))


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
    flags = _ANTIALIASED if cloud.is_antialiased else 0
    header = _new_header(version, len(cloud), degree, bits, flags)
    frame = _pack_record(_FRAME_RECORD, _NUMBER.pack(_FRAMES.index(PLY_FRAME) + 1))
    replace_file(path, *_pack_file(header, [part.tobytes() for part in sections], frame))


def _capture_record(header: _Header, data: bytes) -> CaptureRecord:
    """Return what a file says beside its Gaussians; data: its extension records."""
    records, is_complete = _unpack_records(data)
    frame, source = "", "taken as in a .ply, the file does not say"
    doubts, omissions = [], list(degree_omissions(header.degree))
    if not is_complete or (header.flags & _EXTENDED and not records):
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
        render_model_source="said by the file's flag" if header.flags & _ANTIALIASED else "",
        doubts=tuple(doubts),
        omissions=tuple(omissions),
    )


def _bytes(values: np.ndarray) -> np.ndarray:
    """Round and clip values to bytes."""
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)


def _decoded(header: _Header, x, opacity, color, scale, quat, higher) -> Columns:
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


def _unpack_file(file: BinaryIO) -> _Content:
    """Return the content of an open file of version 1 to 4.

    Raises:
        GaussianFileError: If it is not readable.
    """
    size, start = os.fstat(file.fileno()).st_size, file.read(4)
    file.seek(0)
    if start == _MAGIC:
        return _unpack_zstd(file, size)
    if start.startswith(b"\x1f\x8b"):
        return _unpack_gzip(file, size)
    raise GaussianFileError("is not a .spz file (neither gzip nor 'NGSP' at its beginning)")


def _pack_file(header: _Header, attributes: Sequence[bytes], records: bytes) -> list[bytes]:
    """Return the parts of a file of version 1 to 4, of which `header` gives magic and version.

    Args:
        header: Header without magic, streams and the flag of extensions.
        attributes: Bytes of the six attributes.
        records: Extension records, see `_pack_record`.
    """
    flags = header.flags | (_EXTENDED if records else 0)
    header = header._replace(magic=_MAGIC, flags=flags)
    if header.version != _ZSTD_VERSION:
        packer = zlib.compressobj(6, zlib.DEFLATED, 31)  # 31: a gzip frame without a time stamp
        parts = (_HEADER.pack(*header._replace(streams=0)), *attributes, records)
        return [*(packer.compress(part) for part in parts), packer.flush()]
    present = [part for part in attributes if part]
    streams = [zstandard.ZstdCompressor(level=_ZSTD_LEVEL).compress(part) for part in present]
    sizes = zip(streams, present, strict=True)
    return [
        _HEADER.pack(*header._replace(streams=len(streams))),
        _HEADER_4.pack(_HEADER.size + _HEADER_4.size + len(records)),
        records,
        *(_STREAM.pack(len(packed), len(part)) for packed, part in sizes),
        *streams,
    ]


def _new_header(version: int, count: int, degree: int, fraction_bits: int, flags: int) -> _Header:
    """Return the header of a file to be written.

    Args:
        version: 1 to 4.
        count: Gaussians.
        degree: Degree of the colors.
        fraction_bits: Bits of positions behind the point.
        flags: Sum of the bits, without _EXTENDED.
    """
    return _Header(_MAGIC, version, count, degree, fraction_bits, flags, 0)


def _pack_record(kind: int, content: bytes) -> bytes:
    """Return one extension record."""
    return _RECORD.pack(kind, len(content)) + content


def _unpack_records(data: bytes) -> tuple[list[tuple[int, bytes]], bool]:
    """Return type and content of the extension records, and whether the block ends with one."""
    records: list[tuple[int, bytes]] = []
    start = 0
    while start + _RECORD.size <= len(data):
        kind, size = _RECORD.unpack_from(data, start)
        start += _RECORD.size + size
        if start > len(data):
            return records, False
        records.append((kind, data[start - size : start]))
    return records, start == len(data)


def _header(data: bytes, versions: tuple[int, ...], size: int) -> _Header:
    """Decode and check the header of a file of `size` bytes.

    Raises:
        GaussianFileError: If such a file cannot have this header.
    """
    if len(data) < _HEADER.size:
        raise GaussianFileError("ends within its header: truncated?")
    header = _Header(*_HEADER.unpack_from(data))
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


def _unpack_gzip(file: BinaryIO, size: int) -> _Content:
    """Return the content of versions 1 to 3."""
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

    header = _header(bytes(take(_HEADER.size)), _GZIP_VERSIONS, size)
    attributes = []
    for expected in header.sizes():
        part = take(expected)
        if len(part) < expected:
            raise GaussianFileError(f"ends before its {header.count:,} Gaussians do: truncated?")
        attributes.append(np.frombuffer(part, np.uint8))
    if header.flags & _EXTENDED:
        return _Content(header, attributes, bytes(take(_RECORDS_LIMIT)))
    if take(1):
        raise GaussianFileError(f"holds more than its {header.count:,} Gaussians: a broken header?")
    return _Content(header, attributes, b"")


def _unpack_zstd(file: BinaryIO, size: int) -> _Content:
    """Return the content of version 4."""
    length = _HEADER.size + _HEADER_4.size
    head = file.read(length)
    header = _header(head, (_ZSTD_VERSION,), size)
    if len(head) < length:
        raise GaussianFileError("ends within its header: truncated?")
    sizes = [expected for expected in header.sizes() if expected]
    (offset,) = _HEADER_4.unpack_from(head, _HEADER.size)
    records = b""
    if header.flags & _EXTENDED and offset > length:
        records = file.read(min(offset - length, _RECORDS_LIMIT))
    file.seek(offset)
    table = file.read(header.streams * _STREAM.size)
    complete = len(table) == header.streams * _STREAM.size and offset >= length
    if header.streams != len(sizes) or not complete:
        raise GaussianFileError(f"has no table of {len(sizes)} streams where it says")
    attributes = []
    for (packed, unpacked), expected in zip(_STREAM.iter_unpack(table), sizes):
        if packed > size:
            raise GaussianFileError(f"has a stream of {packed:,} bytes: the file has {size:,}")
        if unpacked != expected:
            raise GaussianFileError(f"has a stream of {unpacked:,} bytes: expected {expected:,}")
        attributes.append(np.frombuffer(_unpack_stream(file.read(packed), expected), np.uint8))
    if file.read(1):
        raise GaussianFileError("holds more than its streams: a broken table?")
    if header.degree == 0:
        attributes.append(np.empty(0, np.uint8))
    return _Content(header, attributes, records)


def _unpack_stream(data: bytes, size: int) -> bytes:
    """Decompress a zstd stream that must hold exactly `size` bytes."""
    window = 1 << max(20, (size - 1).bit_length())  # bounds the memory that a stream may request
    try:
        unpacker = zstandard.ZstdDecompressor(max_window_size=window)
        out = unpacker.stream_reader(data).read(size + 1)
    except zstandard.ZstdError as error:
        raise GaussianFileError(f"has a broken zstd stream ({error})") from None
    if len(out) != size:
        raise GaussianFileError("has a stream of another length than it says: truncated?")
    return out

"""Files of web viewers: .splat (antimatter15), also written, and .ksplat (mkkellogg), only read.

A row of a .splat, 32 bytes, has three float32 of the center, three of the (linear) scale, red,
green, blue, opacity as bytes, and the quaternion w, x, y, z as bytes 128 q + 128. There is no
header and no view-dependent color.

A .ksplat, version 0.1, is the layout of the viewer GaussianSplats3D. A header of 4,096 bytes is
followed by a header of 1,024 bytes per section and by the sections. A section has buckets of nearby
Gaussians and a row per Gaussian. Level 0 holds float32; levels 1 and 2 hold positions as 16 bits
about the center of a bucket, and sizes and rotations as float16. Colors of degree 0 and opacities
are bytes, and so are colors of degree 1 and 2 at level 2. The axes are those of the file that was
converted.

References:
    github.com/mkkellogg/GaussianSplats3D, src/loaders/SplatBuffer.js
"""

import os
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np

from vgmpi.gaussians.cloud import CaptureRecord, GaussianCloud
from vgmpi.gaussians.spherical_harmonics import dc_from_rgb
from vgmpi.runtime.user_files import replace_file

from .validation import Columns, GaussianFileError, naming_file, read_validated, validate_count
from .value_doubts import add_doubts

_ROW = np.dtype([("x", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("quat", "u1", 4)])
# the format has no magic number: these bytes begin files of other formats
_OTHER_FORMATS = {
    b"ply\n": "a .ply file",
    b"ply\r": "a .ply file",
    b"NGSP": "a .spz file",
    b"\x1f\x8b\x08": "a gzip file (.spz?)",
    b"\x89PNG": "a picture",
    b"PK\x03\x04": "a ZIP archive (.sog?)",
    b"RIFF": "a picture or a sound",
    b"<!DO": "a web page",
    b"<htm": "a web page",
    b"glTF": "a glTF file (.glb?)",
}
_HEADER_BYTES, _SECTION_BYTES = 4096, 1024
_HEADER = struct.Struct("<BBxxIIIIHxx12xff")  # version, sections, counts, level, bounds of colors
_SECTION = struct.Struct("<IIIIfHxxIIIIH")
_BUCKET_BYTES = 12  # [bytes] of a bucket's center
_MAX_SECTIONS = 4096
_MAX_COLOR = 1.5  # [-] bound of coefficients of level 2 where the header has none
_POSITION_STEPS = 32767  # [-] steps of half a block where a section does not say
_TERMS = (0, 3, 8)  # higher coefficients per channel by degree
_LEVELS = (("<f4", "<f4", "<f4"), ("<u2", "<f2", "<f2"), ("<u2", "<f2", "u1"))


def read_splat(path: str | Path) -> GaussianCloud:
    """Return the Gaussians of a .splat file.

    Raises:
        GaussianFileError: If the file is not readable.
    """
    with naming_file(path), open(path, "rb") as file:
        size, beginning = os.fstat(file.fileno()).st_size, file.read(64)
        for magic, kind in _OTHER_FORMATS.items():
            if beginning.startswith(magic):
                raise GaussianFileError(f"is not a .splat file, it begins like {kind}")
        if size and beginning.isascii() and beginning.decode().replace("\n", " ").isprintable():
            raise GaussianFileError("is not a .splat file, it is text")
        if size % _ROW.itemsize:
            raise GaussianFileError(
                f"has {size:,} bytes, no multiple of the {_ROW.itemsize} of a Gaussian: truncated,"
                " or no .splat file?"
            )

        def decoded(start: int, stop: int) -> Columns:
            """Decode a range of rows to columns."""
            file.seek(start * _ROW.itemsize)
            rows = np.fromfile(file, dtype=_ROW, count=stop - start)
            rgba = rows["rgba"] / 255.0
            return (
                rows["x"].astype(np.float64),
                rows["quat"] / 128.0 - 1.0,
                rows["scale"].astype(np.float64),
                rgba[:, 3],
                dc_from_rgb(rgba[:, :3])[:, None, :],
            )

        cloud = read_validated(size // _ROW.itemsize, decoded, CaptureRecord(encoding=".splat"))
        return add_doubts(cloud, has_log_scales=False, has_logits=False)


def write_splat(path: str | Path, cloud: GaussianCloud) -> None:
    """Write `cloud`, in its order, without its view-dependent color.

    Raises:
        OSError: If the file cannot be written.
    """
    rows = np.empty(len(cloud), dtype=_ROW)
    rows["x"], rows["scale"] = cloud.x, cloud.scale
    rows["rgba"][:, :3] = np.rint(255 * cloud.rgb)
    rows["rgba"][:, 3] = np.rint(255 * np.clip(cloud.opacity, 0.0, 1.0))
    rows["quat"] = np.clip(np.rint(128 * cloud.quat + 128), 0, 255)
    replace_file(path, rows.tobytes())


class _Header(NamedTuple):
    """Header of a file; the capacities say how much it could hold."""

    major: int
    minor: int
    section_capacity: int
    section_count: int
    capacity: int
    gaussian_count: int
    level: int
    min_color: float
    max_color: float


class _SectionHeader(NamedTuple):
    """Header of a section."""

    gaussian_count: int
    capacity: int
    bucket_size: int  # [Gaussians] in a full bucket
    bucket_count: int
    block: float  # [file units] edge of the cube of a bucket
    bucket_bytes: int
    steps: int  # of half a block
    section_bytes: int
    full_count: int  # full buckets
    partial_count: int  # other buckets
    degree: int


@dataclass(frozen=True)
class _Section:
    """Section of a file: its rows, and where they and its buckets stand."""

    count: int
    degree: int
    row: np.dtype
    row_start: int  # [bytes] of the first row
    bucket_start: int  # [bytes] of the first center of a bucket
    bucket_ends: np.ndarray  # (b,) rows before the end of each bucket
    step: float  # [file units] of a 16-bit position
    middle: int  # 16-bit position of a bucket's center


def read_ksplat(path: str | Path) -> GaussianCloud:
    """Return the Gaussians of a .ksplat file in the file's order.

    Raises:
        GaussianFileError: If the file is not readable.
    """
    with naming_file(path), open(path, "rb") as file:
        size = os.fstat(file.fileno()).st_size
        head = file.read(_HEADER_BYTES)
        if len(head) < _HEADER_BYTES:
            raise GaussianFileError("ends within its header: truncated, or no .ksplat file?")
        header = _Header(*_HEADER.unpack_from(head))
        version, level = f"{header.major}.{header.minor}", header.level
        if version != "0.1" or level >= len(_LEVELS):
            raise GaussianFileError(
                f"is of version {version} and compression level {level}: allowed are version 0.1"
                " and levels 0 to 2; no .ksplat file?"
            )
        count = validate_count(header.gaussian_count)
        sections = _sections(file, size, header.section_capacity, level)
        total = sum(section.count for section in sections)
        if total != count:
            raise GaussianFileError(f"has {total:,} Gaussians in its sections, {count:,} in all")
        bounds = (header.min_color or -_MAX_COLOR, header.max_color or _MAX_COLOR)
        terms = max(_TERMS[section.degree] for section in sections)
        decoder = _Decoder(file, sections, terms, bounds if level == 2 else None)
        record = CaptureRecord(encoding=f".ksplat, version 0.1, compression level {level}")
        return read_validated(count, decoder, record)


def _sections(file: BinaryIO, size: int, section_count: int, level: int) -> list[_Section]:
    """Return the sections of a file of `size` bytes."""
    start = _HEADER_BYTES + section_count * _SECTION_BYTES
    if not 0 < section_count <= _MAX_SECTIONS or start > size:
        raise GaussianFileError(
            f"claims {section_count:,} sections: allowed are 1 to {_MAX_SECTIONS:,} that are in the"
            " file"
        )
    heads = file.read(section_count * _SECTION_BYTES)
    sections = []
    for k in range(section_count):
        header = _SectionHeader(*_SECTION.unpack_from(heads, k * _SECTION_BYTES))
        section, start = _section(file, size, level, header, start)
        sections.append(section)
    return sections


def _section(
    file: BinaryIO, size: int, level: int, header: _SectionHeader, start: int
) -> tuple[_Section, int]:
    """Return a section that begins at byte `start`, and the byte behind it."""
    count, degree = header.gaussian_count, header.degree
    if degree >= len(_TERMS):
        raise GaussianFileError(f"has colors of degree {degree}: allowed are 0 to 2")
    position, shape, color = _LEVELS[level]
    row = np.dtype(
        [("x", position, 3), ("scale", shape, 3), ("quat", shape, 4), ("rgba", "u1", 4),
         ("sh", color, 3 * _TERMS[degree])]
    )  # fmt: skip
    bucket_start = start + 4 * header.partial_count
    row_start = bucket_start + header.bucket_bytes * header.bucket_count
    end = row_start + row.itemsize * header.capacity
    if count > header.capacity or end > size:
        raise GaussianFileError(
            f"has a section of {count:,} Gaussians that ends at byte {end:,} of {size:,}:"
            " truncated?"
        )
    ends = np.empty(0, np.int64)
    if level > 0 and count:
        ends = _bucket_ends(file, start, header)
    middle = header.steps or _POSITION_STEPS
    step = header.block / 2 / middle
    return _Section(count, degree, row, row_start, bucket_start, ends, step, middle), end


def _bucket_ends(file: BinaryIO, start: int, header: _SectionHeader) -> np.ndarray:
    """Return the rows before the end of each bucket.

    Full buckets come first; the lengths of the others are at byte `start`.
    """
    count, size = header.gaussian_count, header.bucket_size
    full, partial = header.full_count, header.partial_count
    buckets = header.bucket_count
    if header.bucket_bytes != _BUCKET_BYTES or full + partial != buckets or buckets > count:
        raise GaussianFileError(
            f"has {full:,} + {partial:,} of {buckets:,} buckets for {count:,} Gaussians"
        )
    if not np.isfinite(header.block) or header.block <= 0:
        raise GaussianFileError(f"has a block of size {header.block:g}: expected more than 0")
    if full and (not size or full * size > count):
        raise GaussianFileError(
            f"has {full:,} buckets of {size:,} for {count:,} Gaussians in a section"
        )
    file.seek(start)
    total, parts, block = full * size, [], 1 << 16
    for first in range(0, partial, block):  # block by block: an invalid file fails at once
        lengths = np.fromfile(file, "<u4", min(block, partial - first)).astype(np.int64)
        ends = total + np.cumsum(lengths)
        if not lengths.all() or ends[-1] > count:
            break
        total = int(ends[-1])
        parts.append(ends)
    if total != count or sum(map(len, parts)) != partial:
        raise GaussianFileError(
            f"has buckets that do not hold the {count:,} Gaussians of a section"
        )
    return np.concatenate([size * np.arange(1, full + 1, dtype=np.int64), *parts])


class _Decoder:
    """Function of a range of rows of the whole file that returns their columns."""

    def __init__(
        self,
        file: BinaryIO,
        sections: list[_Section],
        terms: int,
        bounds: tuple[float, float] | None,
    ):
        self.file, self.terms, self.bounds = file, terms, bounds
        self.sections = sections

    def __call__(self, start: int, stop: int) -> Columns:
        """Decode a range of rows."""
        parts, first = [], 0
        for section in self.sections:
            low, high = max(start - first, 0), min(stop - first, section.count)
            if low < high:
                parts.append(self._columns(section, low, high))
            first += section.count
        return tuple(np.concatenate(column) for column in zip(*parts))

    def _columns(self, section: _Section, start: int, stop: int) -> Columns:
        """Decode rows of a section."""
        self.file.seek(section.row_start + start * section.row.itemsize)
        rows = np.fromfile(self.file, section.row, stop - start)
        x = rows["x"].astype(np.float64)
        if section.bucket_ends.size:
            bucket = np.searchsorted(section.bucket_ends, np.arange(start, stop), side="right")
            self.file.seek(section.bucket_start + _BUCKET_BYTES * int(bucket[0]))
            centers = np.fromfile(self.file, "<f4", 3 * int(bucket[-1] - bucket[0] + 1))
            centers = centers.reshape(-1, 3).astype(np.float64)
            x = (x - section.middle) * section.step + centers[bucket - bucket[0]]
        rgba = rows["rgba"] / 255.0
        sh = np.zeros((len(rows), 1 + self.terms, 3))
        sh[:, 0] = dc_from_rgb(rgba[:, :3])
        higher = rows["sh"].astype(np.float64)
        if self.bounds is not None:
            higher = self.bounds[0] + (self.bounds[1] - self.bounds[0]) * (higher / 255)
        first = 0
        for degree in range(1, section.degree + 1):  # a degree holds its reds, greens and blues
            width = 2 * degree + 1
            part = higher[:, 3 * first : 3 * (first + width)].reshape(-1, 3, width)
            sh[:, 1 + first : 1 + first + width] = part.transpose(0, 2, 1)
            first += width
        return (
            x,
            rows["quat"].astype(np.float64),
            rows["scale"].astype(np.float64),
            rgba[:, 3],
            sh,
        )

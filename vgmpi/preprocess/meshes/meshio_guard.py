"""Limits on the memory that meshio takes for a file: it trusts all sizes, and unpacks all data."""

import contextlib
import lzma
import math
import mmap
import re
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace

_GRID = re.compile(rb"DIMENSIONS\s+(\d{1,18}(?:\s+\d{1,18}){2})", re.IGNORECASE)
_FREE_GRID_POINTS = 1 << 20  # [points] of a grid that any file may have
_HEADER_BYTES = 1 << 16  # [bytes] in which the header of a .ply must end
_FREE_BYTES, _MAX_RATIO = (
    1 << 26,
    100,
)  # [bytes] unpacked size that any .vtu may have, and ratio for large files


@contextlib.contextmanager
def limited(path: Path) -> Iterator[None]:
    """Permit meshio to read this file within limits, for the duration of the context.

    Raises ValueError, also inside meshio, if the file would take more than its size can explain.
    """
    suffix = path.suffix.lower()
    if suffix == ".ply":
        _check_header(path)
    if suffix == ".vtk":
        _check_grid(path)
    with _unpacking(path) if suffix == ".vtu" else contextlib.nullcontext():
        yield


def _check_header(path: Path) -> None:
    """Refuse a .ply whose header does not end, since meshio would wait for it forever."""
    with open(path, "rb") as file:
        if b"end_header" not in file.read(_HEADER_BYTES):
            raise ValueError("its header has no end")


def _check_grid(path: Path) -> None:
    """Refuse a .vtk grid whose points cannot be in the file."""
    size = path.stat().st_size
    with open(path, "rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as text:
        for match in _GRID.finditer(text):
            points = math.prod(map(int, match[1].split()))
            if points > max(_FREE_GRID_POINTS, size):
                raise ValueError(f"its grid has {points:,} points, the file {size:,} bytes")


@contextlib.contextmanager
def _unpacking(path: Path) -> Iterator[None]:
    """Limit the unpacked size of a .vtu: meshio unpacks any array, by zlib and lzma."""
    from meshio.vtu import _vtu

    size = path.stat().st_size
    remaining = limit = max(_FREE_BYTES, _MAX_RATIO * size)

    def limited(unpacker: Callable) -> SimpleNamespace:
        """Return a stand-in for a packing module, with a limited decompress."""

        def decompress(data: bytes) -> bytes:
            """Unpack data within the limit."""
            nonlocal remaining
            stream = unpacker()
            out = stream.decompress(data, remaining + 1)
            remaining -= len(out)
            if remaining < 0:
                raise ValueError(f"its {size:,} bytes unpack to more than {limit:,}")
            if not stream.eof:
                raise ValueError("a packed array in it is cut off")
            return out

        return SimpleNamespace(decompress=decompress)

    original = _vtu.zlib, _vtu.lzma
    _vtu.zlib, _vtu.lzma = limited(zlib.decompressobj), limited(lzma.LZMADecompressor)
    try:
        yield
    finally:
        _vtu.zlib, _vtu.lzma = original

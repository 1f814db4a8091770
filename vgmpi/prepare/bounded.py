"""Bounds on what meshio makes of a file: it believes all claims, and unpacks what is packed."""

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
_FREE_GRID = 1 << 20  # points of a grid that any file may have
_HEAD = 1 << 16  # bytes in which the header of a .ply ends
_FREE, _RATIO = 1 << 26, 100  # bytes that any .vtu, and how often its size a large one, may become


@contextlib.contextmanager
def bounded(path: Path) -> Iterator[None]:
    """While it lasts meshio may read this file. Raises ValueError, also out of meshio, where the
    file would take more than its size can explain."""
    suffix = path.suffix.lower()
    if suffix == ".ply":
        _check_header(path)
    if suffix == ".vtk":
        _check_grid(path)
    with _unpacking(path) if suffix == ".vtu" else contextlib.nullcontext():
        yield


def _check_header(path: Path) -> None:
    """meshio waits for the end of a header for ever."""
    with open(path, "rb") as file:
        if b"end_header" not in file.read(_HEAD):
            raise ValueError("its header has no end")


def _check_grid(path: Path) -> None:
    """Points of a grid need not be in the file."""
    size = path.stat().st_size
    with open(path, "rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as text:
        for found in _GRID.finditer(text):
            points = math.prod(map(int, found[1].split()))
            if points > max(_FREE_GRID, size):
                raise ValueError(f"its grid has {points:,} points, the file {size:,} bytes")


@contextlib.contextmanager
def _unpacking(path: Path) -> Iterator[None]:
    """Arrays of a .vtu may be packed: meshio unpacks whatever is there, by zlib and lzma."""
    from meshio.vtu import _vtu

    size = path.stat().st_size
    left = most = max(_FREE, _RATIO * size)

    def instead(unpacker: Callable) -> SimpleNamespace:
        def decompress(data: bytes) -> bytes:
            nonlocal left
            stream = unpacker()
            out = stream.decompress(data, left + 1)
            left -= len(out)
            if left < 0:
                raise ValueError(f"its {size:,} bytes unpack to more than {most:,}")
            if not stream.eof:
                raise ValueError("a packed array in it is cut off")
            return out

        return SimpleNamespace(decompress=decompress)

    before = _vtu.zlib, _vtu.lzma
    _vtu.zlib, _vtu.lzma = instead(zlib.decompressobj), instead(lzma.LZMADecompressor)
    try:
        yield
    finally:
        _vtu.zlib, _vtu.lzma = before

"""Compiled functions that are kept on disk, by numba's cache.

numba believes what it finds there. Here what is damaged counts as absent and is compiled anew, and
where no folder can be written nothing is kept.
"""

import functools
import logging
import pickle
import zlib
from collections.abc import Callable
from typing import Any

from numba import njit
from numba.core.caching import IndexDataCacheFile

log = logging.getLogger("vgmpi")

SEAL = 4  # bytes behind what numba writes, where its own readers do not look


def cached(**options: Any) -> Callable[[Callable], Any]:
    """A decorator: `numba.njit` with these options, its machine code kept on disk."""

    def compiled(function: Callable) -> Any:
        try:
            made = njit(cache=True, **options)(function)
        except RuntimeError as error:
            if "no locator available" not in str(error):
                raise
            _tell()
            return njit(**options)(function)
        if hasattr(made, "_cache"):  # without NUMBA_DISABLE_JIT
            made._cache._cache_file.__class__ = _Sealed
        return made

    return compiled


@functools.cache
def _tell() -> None:
    """Once."""
    log.warning(
        "compiled code cannot be kept: no folder for it can be written; every process compiles"
        " for itself (set NUMBA_CACHE_DIR to a folder that can)"
    )


class _Sealed(IndexDataCacheFile):
    """The files of one function's compiled code, each with a CRC-32 at its end."""

    def _load_index(self) -> dict:
        try:
            if not _whole(self._index_path):
                return {}
            return super()._load_index()
        except (FileNotFoundError, pickle.UnpicklingError, EOFError):
            return {}  # an older numba's, or replaced meanwhile

    def _load_data(self, name: str) -> Any:
        path = self._data_path(name)
        if not _whole(path):
            raise OSError(f"{path} is damaged")  # numba then compiles
        return super()._load_data(name)

    def _open_for_write(self, filepath: str) -> Any:
        return _Closing(super()._open_for_write(filepath))


class _Closing:
    """What is written inside the block gets its seal at the end of it."""

    def __init__(self, opened: Any):
        self.opened = opened

    def __enter__(self) -> "_Closing":
        self.file, self.crc = self.opened.__enter__(), 0
        return self

    def write(self, data: bytes) -> int:
        self.crc = zlib.crc32(data, self.crc)
        return self.file.write(data)

    def __exit__(self, kind: Any, error: Any, trace: Any) -> Any:
        if kind is None:
            self.file.write(self.crc.to_bytes(SEAL, "little"))
        return self.opened.__exit__(kind, error, trace)


def _whole(path: str) -> bool:
    with open(path, "rb") as f:
        data = f.read()
    return len(data) > SEAL and zlib.crc32(data[:-SEAL]) == int.from_bytes(data[-SEAL:], "little")

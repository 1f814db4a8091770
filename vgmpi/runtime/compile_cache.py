"""Cache of compiled functions on disk, by numba, with a checksum for every file.

numba trusts the files that it finds. Here a damaged file counts as absent and the function is
compiled again; without a writable folder nothing is cached.
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

CHECKSUM_BYTES = 4  # [bytes] size of the checksum after numba's data, where numba does not read


def njit_cached(**options: Any) -> Callable[[Callable], Any]:
    """Return a decorator: `numba.njit` with these options, and machine code cached on disk."""

    def compiled(function: Callable) -> Any:
        """Compile a function, with a cache if a folder for it is writable."""
        try:
            dispatcher = njit(cache=True, **options)(function)
        except RuntimeError as error:
            if "no locator available" not in str(error):
                raise
            _warn_uncached()
            return njit(**options)(function)
        if hasattr(dispatcher, "_cache"):  # without NUMBA_DISABLE_JIT
            dispatcher._cache._cache_file.__class__ = _ChecksummedCacheFile
        return dispatcher

    return compiled


@functools.cache
def _warn_uncached() -> None:
    """Warn once that compiled code cannot be cached."""
    log.warning(
        "compiled code cannot be kept: no folder for it can be written; every process compiles"
        " for itself (set NUMBA_CACHE_DIR to a folder that can)"
    )


class _ChecksummedCacheFile(IndexDataCacheFile):
    """Cache files of one compiled function, each with a CRC-32 at its end."""

    def _load_index(self) -> dict:
        try:
            if not _checksum_matches(self._index_path):
                return {}
            return super()._load_index()
        except (FileNotFoundError, pickle.UnpicklingError, EOFError):
            return {}  # written by an older numba, or replaced meanwhile

    def _load_data(self, name: str) -> Any:
        path = self._data_path(name)
        if not _checksum_matches(path):
            raise OSError(f"{path} is damaged")  # numba then compiles
        return super()._load_data(name)

    def _open_for_write(self, filepath: str) -> Any:
        return _ChecksumWriter(super()._open_for_write(filepath))


class _ChecksumWriter:
    """Context that appends the checksum of everything written within it."""

    def __init__(self, opened: Any):
        self.opened = opened

    def __enter__(self) -> "_ChecksumWriter":
        self.file, self.crc = self.opened.__enter__(), 0
        return self

    def write(self, data: bytes) -> int:
        """Write data and update the checksum."""
        self.crc = zlib.crc32(data, self.crc)
        return self.file.write(data)

    def __exit__(self, kind: Any, error: Any, trace: Any) -> Any:
        if kind is None:
            self.file.write(self.crc.to_bytes(CHECKSUM_BYTES, "little"))
        return self.opened.__exit__(kind, error, trace)


def _checksum_matches(path: str) -> bool:
    """Return whether a file ends with the checksum of its content."""
    with open(path, "rb") as f:
        data = f.read()
    return len(data) > CHECKSUM_BYTES and zlib.crc32(data[:-CHECKSUM_BYTES]) == int.from_bytes(
        data[-CHECKSUM_BYTES:], "little"
    )

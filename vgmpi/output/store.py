"""The one writer of HDF5 files: parallel where h5py can, through rank 0 elsewhere; complete or not
there at all.

    with store.create(path, ranks) as f:
        f.rows("particles/x", local)        rows of rank 0, then of rank 1, ...
        f.whole("times", array)             from rank 0
        f.text("attrs", "...")
        f.attr("", "schema", 1)             "" is the root group

The file is written under a temporary name, brought to the disk, and then renamed. An error on any
rank (no space left, say) raises the same StoreError on all of them, and the temporary file is
removed.

Row data goes out by independent writes, not collective ones: each rank's piece is one contiguous
range, and a rank that fails in the middle of a collective write would leave the others waiting for
ever.
"""

import contextlib
import errno
import logging
import os
import re
from pathlib import Path

import h5py
import numpy as np

from vgmpi.domain.ranks import Alone

log = logging.getLogger("vgmpi")

PIECE = 1 << 28  # bytes per write or message: MPI counts end at 2^31
_told = False  # the notice about gathering comes once
_abandoned: list[h5py.File] = []


class StoreError(RuntimeError):
    """A file could not be written; one line that names it."""


def gathers(ranks: Alone) -> bool:
    """Whether files go through rank 0: one rank, no parallel h5py, or VGMPI_GATHER=1."""
    forced = os.environ.get("VGMPI_GATHER", "0") not in ("", "0")
    return ranks.size == 1 or ranks.mpi is None or forced or not h5py.get_config().mpi


def agree(ranks: Alone, error: BaseException | None, path: Path, verb: str = "write") -> None:
    """Collective: raise one StoreError on all ranks if any of them has an error."""
    mine = np.array([0 if error is None else ranks.rank + 1], np.int64)
    if ranks.max(mine)[0] == 0:
        return
    text = b"" if error is None else (reason(error, path.parent) + "\n").encode()
    every = bytes(ranks.all_rows(np.frombuffer(text, np.uint8))).decode()
    raise StoreError(f"cannot {verb} {path}: {every.splitlines()[0]}") from error


def reason(error: BaseException, folder: Path | None = None) -> str:
    """One line for an error of the operating system or of HDF5 while writing in `folder`."""
    found = re.search(r"errno = (\d+)", str(error))
    number = getattr(error, "errno", None) or (int(found[1]) if found else None)
    full = folder is not None and not number and _free(folder) < 1 << 20  # MPI-IO loses the number
    if number == errno.ENOSPC or full:
        return "no space left on the disk"
    if number:
        return os.strerror(number)
    return (str(error).splitlines() or [type(error).__name__])[0]


def _free(folder: Path) -> int:
    """Bytes that can still be written there; very many where the system does not say."""
    try:
        disk = os.statvfs(folder)
    except OSError:
        return 1 << 62
    return disk.f_bavail * disk.f_frsize


def fsync_folder(folder: Path) -> None:
    """Bring a rename to the disk."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def replace_text(path: Path, text: str) -> None:
    """Write a small text file so that it is there whole or not at all. Not collective."""
    temporary = temporary_name(path)
    try:
        with open(temporary, "w", encoding="utf-8") as f:
            f.write(text)
            f.flush()
            os.fsync(f.fileno())
        os.replace(temporary, path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
    fsync_folder(path.parent)


def temporary_name(path: Path) -> Path:
    return path.with_name(path.name + ".tmp")


def remove_temporaries(folder: Path) -> None:
    """Remove what a killed run left half written. Not collective."""
    for path in folder.glob("*.tmp"):
        path.unlink(missing_ok=True)


@contextlib.contextmanager
def create(path: str | Path, ranks: Alone):
    """A Store that becomes `path` at the end of the block. Collective."""
    path = Path(path)
    store = Store(path, ranks)
    try:
        yield store
        store.finish()
    except StoreError:
        store.discard()
        raise
    except BaseException:
        store.abandon()
        raise


class Store:
    """An HDF5 file being written; made by `create`. All methods are collective."""

    def __init__(self, path: Path, ranks: Alone):
        self.path, self.ranks = path, ranks
        self.temporary = temporary_name(path)
        self.gather = gathers(ranks)
        self.file: h5py.File | None = None
        self._notice()
        self._do(self._make_folder, only_root=True)
        self._do(self._open, only_root=self.gather)

    def _notice(self):
        global _told
        if self.gather and self.ranks.size > 1 and not _told:
            _told = True
            if self.ranks.rank == 0 and self.ranks.mpi is not None:
                log.warning(
                    "files are gathered on rank 0: no parallel HDF5, or VGMPI_GATHER is set"
                )

    def _make_folder(self):
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self.temporary.unlink(missing_ok=True)

    def _open(self):
        if self.gather:
            self.file = h5py.File(self.temporary, "w")
        else:
            self.file = h5py.File(self.temporary, "w", driver="mpio", comm=self.ranks.mpi)

    def _do(self, action, only_root=False):
        """Run on all ranks (or on rank 0), then agree on the outcome."""
        error = None
        if not only_root or self.ranks.rank == 0:
            try:
                action()
            except Exception as caught:
                error = caught
        agree(self.ranks, error, self.path)

    def _dataset(self, name, shape, dtype):
        """An empty contiguous dataset without fill values: those would be written in vain."""
        return self.file.create_dataset(name, shape, dtype, fill_time="never", track_times=False)

    def rows(self, name: str, local: np.ndarray) -> None:
        """A dataset from the rows of all ranks, in rank order; any rank may have none."""
        local = np.ascontiguousarray(local)
        counts = self.ranks.all_rows(np.array([len(local)], np.int64))
        shape = (int(counts.sum()), *local.shape[1:])
        held = []  # the dataset, where this rank has the file

        row_bytes = local.dtype.itemsize * int(np.prod(local.shape[1:], dtype=np.int64))

        def allocate():
            self._room(shape[0] * row_bytes)
            held.append(self._dataset(name, shape, local.dtype))

        self._do(allocate, only_root=self.gather)
        step = max(1, PIECE // max(1, row_bytes))
        if self.gather:
            error = self._gather_rows(held, local, counts, step)
        else:
            error = _write(held[0], local, int(counts[: self.ranks.rank].sum()), step)
        agree(self.ranks, error, self.path)

    def _room(self, size):
        """Refuse what the disk cannot hold before writing gigabytes of it."""
        free = _free(self.path.parent)
        if size > free:
            raise OSError(errno.ENOSPC, f"{size} bytes, {free} free")

    def _gather_rows(self, held, local, counts, step):
        """Send the rows to rank 0 piece by piece, so that it holds no more than one at a time."""
        error, start = None, 0
        for rank, count in enumerate(counts.tolist()):
            for first in range(0, count, step):
                last = min(first + step, count)
                piece = local[first:last] if rank == self.ranks.rank else local[:0]
                if rank > 0:  # rank 0 has its own rows already
                    piece = self.ranks.root_rows(piece)
                if self.ranks.rank == 0 and error is None:
                    error = _write(held[0], piece, start + first, step)
            start += count
        return error

    def whole(self, name: str, array: np.ndarray | None) -> None:
        """A dataset whose values rank 0 has; the others' argument is ignored."""
        array = self.ranks.bcast(array if self.ranks.rank == 0 else None)
        array = np.ascontiguousarray(array)

        def write():
            dataset = self._dataset(name, array.shape, array.dtype)
            if self.ranks.rank == 0 and array.size:
                dataset[...] = array

        self._do(write, only_root=self.gather)

    def text(self, name: str, text: str) -> None:
        """A text from rank 0, of any length (attributes end at 64 KiB)."""
        data = self.ranks.bcast(text).encode()
        kind = h5py.string_dtype("utf-8", max(1, len(data)))

        def write():
            dataset = self._dataset(name, (), kind)
            if self.ranks.rank == 0:
                dataset[()] = data

        self._do(write, only_root=self.gather)

    def attr(self, where: str, name: str, value) -> None:
        """An attribute of a group (made if not there) or dataset; the value of rank 0 counts."""
        value = self.ranks.bcast(value)

        def write():
            file = self.file
            owner = file[where or "/"] if not where or where in file else file.create_group(where)
            owner.attrs[name] = np.bytes_(value) if isinstance(value, str) else value

        self._do(write, only_root=self.gather)

    def finish(self) -> None:
        """Bring all to the disk, then give the file its name."""
        self._do(self._flush, only_root=self.gather)
        self._do(self._close, only_root=self.gather)
        self._do(self._sync, only_root=self.gather)
        self._do(self._rename, only_root=True)

    def _flush(self):
        self.file.flush()  # where a full disk may show for the first time

    def _close(self):
        file, self.file = self.file, None
        file.close()  # or only here

    def _sync(self):
        handle = os.open(self.temporary, os.O_RDWR)
        try:
            os.fsync(handle)  # on every rank: each machine holds its own unwritten pages
        finally:
            os.close(handle)

    def _rename(self):
        os.replace(self.temporary, self.path)
        fsync_folder(self.path.parent)

    def abandon(self) -> None:
        """Drop the file after an error that the other ranks may not have. Not collective."""
        if self.gather:
            self.discard()
        elif self.file is not None:
            _abandoned.append(self.file)  # closing it would wait for the other ranks

    def discard(self) -> None:
        """Drop the file; errors no longer matter."""
        file, self.file = self.file, None
        if file is not None:
            with contextlib.suppress(Exception):
                file.close()
        if self.ranks.rank == 0:
            with contextlib.suppress(OSError):
                self.temporary.unlink(missing_ok=True)


def _write(dataset, rows, start, step):
    """Write rows from row `start` on, in pieces; returns the error instead of raising it."""
    try:
        for first in range(0, len(rows), step):
            last = min(first + step, len(rows))
            dataset[start + first : start + last] = rows[first:last]
    except Exception as error:
        return error
    return None

"""Crash-safe parallel writer of HDF5 files: a file is complete or absent.

`create` yields a Store, which is filled by `rows`, `whole`, `text`, `attr` and `seal`. At the end
of the block it is written under a temporary name, flushed to the disk, and renamed. An error on any
rank (such as a full disk) raises one StoreError on all and removes the temporary file.

HDF5 (1.10) crashes or hangs when it closes a file whose tables it cannot write. Therefore rank 0
lays the file out in memory, without the rows, and writes that itself; the rows are then written to
the offsets that HDF5 allocated, by MPI-IO or by rank 0. Writes are independent, not collective:
each rank's piece is contiguous, and a rank that fails in a collective write would block the others.
"""

import contextlib
import errno
import io
import json
import logging
import os
import re
import zlib
from pathlib import Path

import h5py
import numpy as np

from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.runtime.command_line import DENIED, FULL
from vgmpi.runtime.user_files import replace_file, sync_folder

from . import checkpoint_manifest, file_layout

log = logging.getLogger("vgmpi")

MAX_WRITE_BYTES = 1 << 28  # [bytes] per write or message: MPI counts end at 2^31
CHUNK_ROWS = 1 << 15  # rows that are compressed together
GZIP_LEVEL = 1  # higher levels take several times as long for some percent
MAX_PATH_BYTES = 220  # [bytes] longest path for Open MPI 4.1, which crashes beyond about 244
_warned = False  # the notice about gathering is logged once


class StoreError(RuntimeError):
    """A file could not be written; the text is one line that names it.

    Attributes:
        is_denied: Whether the file system or its permissions allow no such file.
    """

    is_denied = False


def uses_root_gather(ranks: SerialCommunicator) -> bool:
    """Return True if files go through rank 0: one rank, no parallel h5py, or VGMPI_GATHER=1."""
    forced = os.environ.get("VGMPI_GATHER", "0") not in ("", "0")
    return ranks.size == 1 or ranks.mpi is None or forced or not h5py.get_config().mpi


def raise_on_all_ranks(
    ranks: SerialCommunicator, error: BaseException | None, path: Path, verb: str = "write"
) -> None:
    """Raise one StoreError on all ranks if any of them has an error. Collective.

    Args:
        verb: Action on `path` that failed, for the text.
    """
    mine = np.array([0 if error is None else ranks.rank + 1], np.int64)
    if ranks.max(mine)[0] == 0:
        return
    text = b"" if error is None else (reason(error, path.parent) + "\n").encode()
    every = bytes(ranks.all_rows(np.frombuffer(text, np.uint8))).decode()
    first = every.splitlines()[0]
    failure = StoreError(f"cannot {verb} {path}: {first}")
    failure.is_denied = first in map(os.strerror, DENIED)
    raise failure from error


def reason(error: BaseException, folder: Path | None = None) -> str:
    """Return one line for an error of the system or of HDF5 while writing in `folder`."""
    match = re.search(r"errno = (\d+)", str(error))
    number = getattr(error, "errno", None) or (int(match[1]) if match else None)
    full = folder is not None and not number and _free(folder) < 1 << 20  # MPI-IO drops errno
    if number in FULL or full:
        return "no space left on the disk"
    if number:
        return os.strerror(number)
    return (str(error).splitlines() or [type(error).__name__])[0]


def _free(folder: Path) -> int:
    """Return the bytes that can still be written; very many if the system does not report it."""
    try:
        disk = os.statvfs(folder)
    except OSError:
        return 1 << 62
    return disk.f_bavail * disk.f_frsize


def _check_room(folder: Path, size: int) -> None:
    """Raise an error if the disk cannot hold a file, before gigabytes are written."""
    free = _free(folder)
    if size > free:
        raise OSError(errno.ENOSPC, f"{size} bytes, {free} free")


def replace_text(path: Path, text: str) -> None:
    """Write a small text file whole or not at all. Not collective."""
    replace_file(path, text)


def temporary_name(path: Path) -> Path:
    """Return the temporary name of a file."""
    return path.with_name(path.name + ".tmp")


def remove_temporaries(folder: Path) -> None:
    """Remove the incomplete files of a killed run. Not collective."""
    for path in folder.glob("*.tmp"):
        path.unlink(missing_ok=True)


@contextlib.contextmanager
def create(path: str | Path, ranks: SerialCommunicator, compresses: bool = False):
    """Yield a Store that becomes `path` at the end of the block. Collective there.

    Args:
        path: The file.
        ranks: Communicator.
        compresses: Whether `rows` are compressed; they are gathered on rank 0 then.
    """
    store = Hdf5Writer(Path(path), ranks, compresses)
    yield store
    store.finish()


class Hdf5Writer:
    """HDF5 file to be written; made by `create`. Arrays must not change before the end."""

    def __init__(self, path: Path, ranks: SerialCommunicator, compresses: bool = False):
        self.path, self.ranks, self.compresses = path, ranks, compresses
        self.temporary = temporary_name(path)
        is_long = len(os.fsencode(self.temporary)) > MAX_PATH_BYTES
        self.gather = uses_root_gather(ranks) or is_long or compresses
        self.memory = SparseMemoryFile()
        self.file = h5py.File(self.memory, "w") if ranks.rank == 0 else None
        self._groups: dict[str, h5py.h5g.GroupID] = {}  # those that were opened
        self._rows: list[tuple[str, np.ndarray, np.ndarray]] = []  # name, local rows, all counts
        self._sums: dict[str, int] = {}  # CRC32 of each dataset, of `rows` from `seal` on; rank 0

    def rows(self, name: str, local: np.ndarray) -> None:
        """Add a dataset of the rows of all ranks, in rank order; any may have none. Collective."""
        local = np.ascontiguousarray(local)
        counts = self.ranks.all_rows(np.array([len(local)], np.int64))
        self._rows.append((name, local, counts))
        if self.compresses and counts.sum():
            self._compressed_rows(name, local, counts)
            return
        if self.file is None:
            return
        self._sums[name] = 0
        properties = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        properties.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
        properties.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
        space = h5py.h5s.create_simple((int(counts.sum()), *local.shape[1:]))
        self.dataset(name, local.dtype, space, properties)

    def dataset(
        self, name: str, dtype: np.dtype, space: h5py.h5s.SpaceID, properties: h5py.h5p.PropDCID
    ) -> h5py.h5d.DatasetID:
        """Create a dataset by the low-level interface, on rank 0; objects take twice as long.

        Args:
            name: Its path; groups are created if absent.
            dtype: Type of an element.
            space: Its shape.
            properties: Its creation properties; times of writing are left out of the file.
        """
        assert self.file is not None
        parent, _, last = name.rpartition("/")
        if parent not in self._groups:
            self._groups[parent] = self.file.require_group(parent or "/").id
        properties.set_obj_track_times(False)  # so that the bytes do not depend on them
        kind = h5py.h5t.py_create(np.dtype(dtype), logical=True)
        return h5py.h5d.create(self._groups[parent], last.encode(), kind, space, properties)

    def _compressed_rows(self, name, local, counts):
        """Compress the rows of all ranks into the file in memory; the same bytes on any ranks."""
        pieces = list(self._pieces(local, counts))
        if self.file is None:
            return
        rows = np.concatenate(pieces)
        self._sums[name] = 0
        chunk = (min(len(rows), CHUNK_ROWS), *rows.shape[1:])
        self.file.create_dataset(
            name, data=rows, chunks=chunk, compression="gzip", compression_opts=GZIP_LEVEL,
            shuffle=True, track_times=False,
        )  # fmt: skip

    def root_array(self, name: str, array: np.ndarray | None) -> None:
        """Add a small dataset with the values of rank 0."""
        if self.file is not None:
            values = np.asarray(array, order="C")
            self._sums[name] = checkpoint_manifest.crc(np.ascontiguousarray(values))
            space = h5py.h5s.create_simple(values.shape)
            properties = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
            dataset = self.dataset(name, values.dtype, space, properties)
            dataset.write(h5py.h5s.ALL, h5py.h5s.ALL, values)

    def text(self, name: str, text: str) -> None:
        """Add a text of any length, from rank 0 (attributes end at 64 KiB)."""
        if self.file is not None:
            data = text.encode()
            self._sums[name] = zlib.crc32(data)
            kind = h5py.string_dtype("utf-8", max(1, len(data)))
            self.file.create_dataset(name, (), kind, data=data)

    def seal(self) -> None:
        """Add a text with the CRC32 of all datasets so far, for any number of ranks. Collective."""
        mine = [
            (k, checkpoint_manifest.crc(rows), rows.nbytes)
            for k, (_, rows, _) in enumerate(self._rows)
        ]
        parts = self.ranks.gather_rows(np.array(mine, np.int64).reshape(-1, 3))
        if self.file is not None and parts is not None:
            crcs = checkpoint_manifest.combine_checksums(parts.tolist(), len(mine))
            self._sums |= {name: crc for (name, _, _), crc in zip(self._rows, crcs)}
            self.text(file_layout.CRC, json.dumps(self._sums))

    def attr(self, where: str, name: str, value) -> None:
        """Add an attribute from rank 0.

        Args:
            where: Group (created if absent) or dataset; "" is the root group.
        """
        if self.file is not None:
            file = self.file
            owner = file[where or "/"] if not where or where in file else file.create_group(where)
            owner.attrs[name] = np.bytes_(value) if isinstance(value, str) else value

    def finish(self) -> None:
        """Write everything, flush it to the disk, then rename the file. Collective."""
        self._notice()
        try:
            places = self._lay_out()
            (self._gather_rows if self.gather else self._parallel_rows)(places)
            self._do(self._sync, only_root=self.gather)
            self._do(self._rename, only_root=True)
        except StoreError:
            if self.ranks.rank == 0:
                with contextlib.suppress(OSError):
                    self.temporary.unlink(missing_ok=True)
            raise

    def _notice(self):
        global _warned
        is_forced = self.gather and not self.compresses
        if is_forced and self.ranks.mpi is not None and self.ranks.size > 1 and not _warned:
            _warned = True
            if self.ranks.rank == 0:
                log.warning(
                    "files are gathered on rank 0: no parallel HDF5, or VGMPI_GATHER is set"
                )

    def _do(self, action, only_root=False):
        """Run an action on all ranks (or on rank 0), then agree on the outcome."""
        error = None
        if not only_root or self.ranks.rank == 0:
            try:
                action()
            except Exception as caught:
                error = caught
        raise_on_all_ranks(self.ranks, error, self.path)

    def _lay_out(self):
        """Write all but the rows; return the offset of each dataset's rows on rank 0."""
        places = []

        def write():
            """Write the layout without the rows on rank 0."""
            datasets = (self.file[name] for name, _, _ in self._rows)
            places.extend(d.id.get_offset() for d in datasets)
            self.file.close()
            size = self.memory.size
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self.temporary.unlink(missing_ok=True)
            _check_room(self.path.parent, size)
            with open(self.temporary, "xb", buffering=0) as f:
                for start, data in self.memory.written():
                    _pwrite(f.fileno(), data, start)
                f.truncate(size)

        self._do(write, only_root=True)
        return places

    def _parallel_rows(self, _places):
        """Write the rows of every rank through MPI-IO."""
        opened = []
        self._do(lambda: opened.append(self._open_parallel()))
        error: Exception | None = None
        try:
            for name, local, counts in self._rows:
                _write(opened[0][name], local, int(counts[: self.ranks.rank].sum()))
        except Exception as caught:
            error = caught
        try:
            opened[0].close()  # on all ranks; nothing is left to write, so a full disk is harmless
        except Exception as caught:
            error = error or caught
        raise_on_all_ranks(self.ranks, error, self.path)

    def _open_parallel(self):
        return h5py.File(self.temporary, "r+", driver="mpio", comm=self.ranks.mpi)

    def _gather_rows(self, places):
        """Write all rows on rank 0, which holds at most one piece of others at a time."""
        error: Exception | None = None
        handle = None
        if self.ranks.rank == 0:
            try:
                handle = os.open(self.temporary, os.O_WRONLY | os.O_NOFOLLOW)
            except OSError as caught:
                error = caught
        for number, (_, local, counts) in enumerate(self._rows):
            if self.compresses and counts.sum():
                continue  # written with the layout
            place = places[number] if places else None
            for piece in self._pieces(local, counts):
                if self.ranks.rank == 0 and error is None:
                    try:
                        _pwrite(handle, piece.reshape(-1).view(np.uint8).data, place)
                        place += piece.nbytes
                    except OSError as caught:
                        error = caught  # continue to take part: the others send
        if handle is not None:
            os.close(handle)
        raise_on_all_ranks(self.ranks, error, self.path)

    def _pieces(self, local, counts):
        """Yield the rows of all ranks in order, on rank 0. Collective."""
        step = _piece_rows(local)
        for rank, count in enumerate(counts.tolist()):
            for first in range(0, count, step):
                last = min(first + step, count)
                piece = local[first:last] if rank == self.ranks.rank else local[:0]
                yield (
                    piece if rank == 0 else self.ranks.gather_rows(piece)
                )  # rank 0 has its own rows

    def _sync(self):
        handle = os.open(self.temporary, os.O_RDWR | os.O_NOFOLLOW)
        try:
            os.fsync(handle)  # on every rank: each machine has unwritten pages of its own
        finally:
            os.close(handle)

    def _rename(self):
        os.replace(self.temporary, self.path)
        sync_folder(self.path.parent)


def _piece_rows(rows):
    """Return the number of rows per write or message."""
    row = rows.dtype.itemsize * int(np.prod(rows.shape[1:], dtype=np.int64))
    return max(1, MAX_WRITE_BYTES // max(1, row))  # equal on all ranks, also without rows


def _write(dataset, rows, start):
    step = _piece_rows(rows)
    for first in range(0, len(rows), step):
        last = min(first + step, len(rows))
        dataset[start + first : start + last] = rows[first:last]


def _pwrite(handle, data, start):
    """Write all bytes; the system may accept fewer at a time."""
    view = memoryview(data)
    while view:
        done = os.pwrite(handle, view[:MAX_WRITE_BYTES], start)
        view, start = view[done:], start + done


class SparseMemoryFile(io.RawIOBase):
    """File in memory that holds only the pages written to; the rows are holes in it."""

    PAGE = 1 << 16

    def __init__(self):
        self.pages: dict[int, bytearray] = {}
        self.place, self.size = 0, 0

    def readable(self):
        """Return True."""
        return True

    def writable(self):
        """Return True."""
        return True

    def seekable(self):
        """Return True."""
        return True

    def seek(self, place, whence=io.SEEK_SET):
        """Set and return the position."""
        self.place = place + (0, self.place, self.size)[whence]
        return self.place

    def tell(self):
        """Return the position."""
        return self.place

    def truncate(self, size=None):
        """Set the size, by default to the position."""
        self.size = self.place if size is None else size
        return self.size

    def _ranges(self, count):
        """Yield (page number, first and last byte in it, first byte of the request)."""
        place, end = self.place, self.place + count
        while place < end:
            page, first = divmod(place, self.PAGE)
            last = min(self.PAGE, first + end - place)
            yield page, first, last, place - self.place
            place += last - first

    def readinto(self, buffer):
        """Read bytes from the position on; holes are zeros."""
        view = memoryview(buffer).cast("B")
        count = max(0, min(len(view), self.size - self.place))
        for page, first, last, offset in self._ranges(count):
            data = self.pages.get(page, bytes(self.PAGE))
            view[offset : offset + last - first] = data[first:last]
        self.place += count
        return count

    def write(self, data):
        """Write bytes from the position on."""
        view = memoryview(data).cast("B")
        for page, first, last, offset in self._ranges(len(view)):
            if page not in self.pages:
                self.pages[page] = bytearray(self.PAGE)
            self.pages[page][first:last] = view[offset : offset + last - first]
        self.place += len(view)
        self.size = max(self.size, self.place)
        return len(view)

    def written(self):
        """Yield (position, bytes) of the pages, cut at the end of the file."""
        for page, data in sorted(self.pages.items()):
            start = page * self.PAGE
            if start < self.size:
                yield start, memoryview(data)[: self.size - start]

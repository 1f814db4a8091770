"""Lock on a run folder: one run at a time writes into it, and none replaces another unasked."""

import contextlib
import errno
import fcntl
import itertools
import json
import logging
import os
import socket
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from vgmpi.parallel.communicator import SerialCommunicator

from . import file_layout, hdf5_writer

log = logging.getLogger("vgmpi")

NO_LOCK_ERRNOS = (
    errno.ENOLCK,
    errno.ENOSYS,
    errno.ENOTSUP,
)  # errors of a file system without locks
MAX_TRIES = 1000  # attempts while other processes create and remove the folder


class RunFolderInUseError(RuntimeError):
    """This run may not write into the folder; the text is one line with the reason."""


@contextlib.contextmanager
def run_lock(folder: str | Path, ranks: SerialCommunicator, into: bool) -> Iterator[None]:
    """Lock the folder for this run during the block. Collective.

    The system releases the lock of a process that is killed, so its lock file does not count.

    Args:
        folder: Output folder.
        ranks: Communicator.
        into: Allow a folder that already holds a run.

    Raises:
        RunFolderInUseError: Another run writes there now, or the folder holds one and `into` is
            false; on all ranks.
        StoreError: The folder cannot be created.
    """
    folder, handle, reason, error = Path(folder), None, "", None
    is_new = False
    if ranks.rank == 0:
        try:
            is_new = not folder.exists()
            handle, reason = _acquire(folder / file_layout.LOCK, ranks.size)
            if not reason and not into:
                reason = _existing_run(folder)
        except OSError as caught:
            error = caught
    try:
        hdf5_writer.raise_on_all_ranks(ranks, error, folder)
        reason = ranks.bcast(reason)
        if reason:
            raise RunFolderInUseError(f"{folder}: {reason}")
        yield
    finally:
        if handle is not None:
            (folder / file_layout.LOCK).unlink(missing_ok=True)
            os.close(handle)
            if is_new:
                with contextlib.suppress(OSError):  # the run wrote nothing: no trace remains
                    folder.rmdir()


@contextlib.contextmanager
def file_lock(path: Path) -> Iterator[int | None]:
    """Lock a lock file for this process during the block. Not collective; raises OSError.

    Yields the file handle with the lock, None if another process has it. A child process that
    inherits the handle (pass_fds) holds the lock until it has also ended.
    """
    handle = _acquire(path, 1)[0]
    try:
        yield handle
    finally:
        if handle is not None:
            path.unlink(missing_ok=True)
            os.close(handle)


def _acquire(path: Path, ranks: int) -> tuple[int | None, str]:
    """Lock a file and create its folder.

    Returns (handle with the lock, ""), or (None, the reason why another run has it).
    """
    for tries in itertools.count():
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o644)
        except (FileNotFoundError, FileExistsError):
            if tries == MAX_TRIES:
                raise
            continue  # its owner wrote nothing and removed the folder meanwhile
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            other = _describe_owner(os.read(handle, 1000))
            os.close(handle)
            if tries < 3:
                time.sleep(0.01)
                continue  # `current_writer` may examine it at this moment
            reason = f"another run writes here now ({other}); wait for its end"
            return None, f"{reason}, or -o another folder"
        except OSError as caught:
            if caught.errno not in NO_LOCK_ERRNOS:
                os.close(handle)
                raise
            log.warning("%s: this file system keeps no locks: see to it that one run writes", path)
        with contextlib.suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(handle), os.stat(path, follow_symlinks=False)):
                break
        os.close(handle)  # its owner ended and removed it meanwhile
    now = time.strftime("%Y-%m-%d %H:%M:%S")
    who = {"host": socket.gethostname(), "pid": os.getpid(), "ranks": ranks, "since": now}
    os.ftruncate(handle, 0)
    os.pwrite(handle, json.dumps(who).encode(), 0)
    return handle, ""


class RunWriter(NamedTuple):
    """Process that writes into a run's folder, as its lock file names it."""

    host: str  # name of its machine
    pid: int  # process number of rank 0
    ranks: int
    since: str  # date and time of its start

    def __str__(self) -> str:
        return f"process {self.pid} on {self.host}, {self.ranks} ranks, since {self.since}"


def current_writer(folder: Path) -> str:
    """Return a description of the run that writes into the folder, "" if none or unknown."""
    text = _text_of_locked_file(folder)
    return "" if text is None else _describe_owner(text)


def find_writer(folder: Path) -> RunWriter | None:
    """Return the run that writes into the folder, None if none or unknown."""
    text = _text_of_locked_file(folder)
    return None if text is None else _parse_owner(text)


def _text_of_locked_file(folder: Path) -> bytes | None:
    """Return the text of the lock file if a run holds its lock, else None."""
    try:
        handle = os.open(folder / file_layout.LOCK, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    except OSError:
        return None
    try:
        fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
        return None
    except BlockingIOError:
        return os.read(handle, 1000)
    except OSError:
        return None
    finally:
        os.close(handle)


def _parse_owner(text: bytes) -> RunWriter | None:
    """Return the run of a lock file's text, None if it is not whole."""
    try:
        who = json.loads(text)
        return RunWriter(str(who["host"]), int(who["pid"]), int(who["ranks"]), str(who["since"]))
    except (ValueError, KeyError, TypeError):
        return None


def _describe_owner(text: bytes) -> str:
    """Return the description of a run from the text of its lock file."""
    writer = _parse_owner(text)
    return "it has only begun" if writer is None else str(writer)


def _existing_run(folder: Path) -> str:
    """Return a description of the existing run in the folder and the remedies, "" without one."""
    frames = len(list((folder / file_layout.FRAMES).glob("frame_*.vtkhdf")))
    has_checkpoint = any((folder / file_layout.CHECKPOINTS).glob("checkpoint_*.json"))
    if not frames and not has_checkpoint and not (folder / file_layout.LEDGER).exists():
        return ""
    remedy = "--resume goes on with it, " if has_checkpoint else ""
    return f"a run lies here ({frames} frames); {remedy}--overwrite replaces it, -o takes another"

"""Whose a run folder is: one run at a time writes into it, and none replaces another unasked."""

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

from vgmpi.domain.ranks import Alone
from vgmpi.output import layout, store

log = logging.getLogger("vgmpi")

WITHOUT = (errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP)  # a file system that keeps no locks
TRIES = 1000  # at a folder that others make and remove meanwhile


class FolderError(RuntimeError):
    """This run may not write into the folder; one line that says why."""


@contextlib.contextmanager
def held(folder: str | Path, ranks: Alone, into: bool) -> Iterator[None]:
    """The folder is this run's inside the block. Collective.

    into: also where a run lies in it already. Raises FolderError on all ranks where another run
    writes there now, or one lies there and `into` is false; StoreError where the folder cannot be
    made. The system drops the lock of a process that is killed, so what it leaves does not count.
    """
    folder, handle, said, error = Path(folder), None, "", None
    made = False
    if ranks.rank == 0:
        try:
            made = not folder.exists()
            handle, said = _take(folder / layout.LOCK, ranks.size)
            if not said and not into:
                said = _holds(folder)
        except OSError as caught:
            error = caught
    try:
        store.agree(ranks, error, folder)
        said = ranks.bcast(said)
        if said:
            raise FolderError(f"{folder}: {said}")
        yield
    finally:
        if handle is not None:
            (folder / layout.LOCK).unlink(missing_ok=True)
            os.close(handle)
            if made:
                with contextlib.suppress(OSError):  # the run came to nothing: no trace is left
                    folder.rmdir()


@contextlib.contextmanager
def claimed(path: Path) -> Iterator[int | None]:
    """A lock file of its own is this process's inside the block: the handle that holds it, None
    where another has it. Not collective; raises OSError.

    A child that is given the handle (pass_fds) holds it until it too has ended.
    """
    handle = _take(path, 1)[0]
    try:
        yield handle
    finally:
        if handle is not None:
            path.unlink(missing_ok=True)
            os.close(handle)


def _take(path: Path, ranks: int) -> tuple[int | None, str]:
    """(handle of the lock that is now ours, ""), or (None, who has it). Makes its folder."""
    for tries in itertools.count():
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o644)
        except (FileNotFoundError, FileExistsError):
            if tries == TRIES:
                raise
            continue  # who had it came to nothing and removed the folder meanwhile
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            other = _who(os.read(handle, 1000))
            os.close(handle)
            if tries < 3:
                time.sleep(0.01)
                continue  # `writer` may look at it in this moment
            said = f"another run writes here now ({other}); wait for its end"
            return None, f"{said}, or -o another folder"
        except OSError as caught:
            if caught.errno not in WITHOUT:
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


def writer(folder: Path) -> str:
    """Who writes into the folder now, in words; "" where nobody does or it cannot be told."""
    try:
        handle = os.open(folder / layout.LOCK, os.O_RDONLY | os.O_NOFOLLOW)
    except OSError:
        return ""
    try:
        fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
        return ""
    except BlockingIOError:
        return _who(os.read(handle, 1000))
    except OSError:
        return ""
    finally:
        os.close(handle)


def _who(said: bytes) -> str:
    try:
        who = json.loads(said)
        return f"process {who['pid']} on {who['host']}, {who['ranks']} ranks, since {who['since']}"
    except (ValueError, KeyError, TypeError):
        return "it has only begun"


def _holds(folder: Path) -> str:
    """What of a run lies in the folder, and what can be done about it; "" if nothing does."""
    frames = len(list((folder / layout.FRAMES).glob("frame_*.vtkhdf")))
    kept = any((folder / layout.CHECKPOINTS).glob("checkpoint_*.json"))
    if not frames and not kept and not (folder / layout.LEDGER).exists():
        return ""
    can = "--resume goes on with it, " if kept else ""
    return f"a run lies here ({frames} frames); {can}--overwrite replaces it, -o takes another"

"""Locks by which processes compile nothing twice: one compiles, the others wait for its file.

A process that ends, in whatever way, releases its locks. Where a file system has no locks, or a
process holds one for too long, the others compile for themselves.
"""

import contextlib
import fcntl
import os
import time
from pathlib import Path

PATIENCE = 600.0  # [s] longest wait for another process
_PAUSE = 0.02  # [s]


class FileLock:
    """Lock on the file that is to be written; `release` may be called without a lock."""

    def __init__(self, path: Path):
        self.path = path.with_name(f"{path.name}.lock")
        self.descriptor: int | None = None

    def acquire(self) -> bool:
        """Return whether the lock is held now, after as long as another process has it."""
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            descriptor = os.open(self.path, os.O_RDWR | os.O_CREAT, 0o666)
        except OSError:
            return False
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end:
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                self.descriptor = descriptor
                return True
            except BlockingIOError:
                time.sleep(_PAUSE)
            except OSError:
                break  # a file system without locks
        os.close(descriptor)
        return False

    def exists(self) -> bool:
        """Return whether a process has it, unless one has ended without releasing it."""
        return self.path.exists()

    def release(self) -> None:
        """Let the next process look; what it waited for is there, or is its own to make."""
        if self.descriptor is not None:
            with contextlib.suppress(OSError):
                self.path.unlink()
            os.close(self.descriptor)
            self.descriptor = None

"""Folder of caches, which the program can always create again, and locks on the files in it.

By the locks processes compile nothing twice: one compiles, the others wait for its file. A process
that ends, in whatever way, releases its locks. Where a file system has no locks, or a process holds
one for too long, the others compile for themselves.
"""

import contextlib
import fcntl
import logging
import os
import time
from pathlib import Path

log = logging.getLogger("vgmpi")
PATIENCE = 600.0  # [s] longest wait for another process
ANNOUNCE_SECONDS = 15.0  # [s] of waiting after which a line says for whom, and between such lines
ON_EVERY_RANK = logging.CRITICAL + 1  # level of lines that ranks other than the first log, too
_PAUSE = 0.02  # [s]


def user_folder() -> Path:
    """Return the folder for files that this program can always create again."""
    root = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(root) / "vgmpi"


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
        begun = announced = time.monotonic()
        while (now := time.monotonic()) < begun + PATIENCE:
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                with contextlib.suppress(OSError):
                    os.pwrite(descriptor, f"{os.getpid():<12d}\n".encode(), 0)
                self.descriptor = descriptor
                return True
            except BlockingIOError:
                if now - announced > ANNOUNCE_SECONDS:
                    announced = now
                    log.log(ON_EVERY_RANK, "%s", self._waiting_line(descriptor, now - begun))
                time.sleep(_PAUSE)
            except OSError:
                break  # a file system without locks
        os.close(descriptor)
        return False

    def _waiting_line(self, descriptor: int, waited: float) -> str:
        """Return a line on the process that has the lock; on a stopped one, how it goes on.

        Args:
            descriptor: Handle of the lock file.
            waited: Time waited so far [s].
        """
        kernel = self.path.name.removesuffix(".lock").rpartition("-")[0]
        try:
            holder = int(os.pread(descriptor, 32, 0))
            state = Path(f"/proc/{holder}/stat").read_text().rpartition(")")[2].split()[0]
        except (OSError, ValueError, IndexError):  # of another machine, or it has ended
            return f"waits for another process, which compiles {kernel}: {waited:.0f} s so far"
        stopped = f"; it is stopped: kill -CONT {holder}" if state in "Tt" else ""
        line = f"waits for process {holder}, which compiles {kernel}: {waited:.0f} s so far"
        return f"{line}, at most {PATIENCE:.0f} s{stopped}"

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

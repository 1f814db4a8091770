"""Replacement of files whole or not at all: the one place where files of users are written."""

import contextlib
import os
import secrets
from pathlib import Path

# a name that no other process chooses; a killed process may leave it behind
TEMPORARY_NAME = "{name}.{token}.tmp"


def replace_file(path: str | Path, *parts: bytes | str) -> None:
    """Write a file under a temporary name, flush it to the disk, and rename it.

    Whatever fails, the old file stays as it was, or no file is there if there was none. Several
    processes may write the same file at the same time; the last one wins.

    Args:
        path: The file.
        parts: Its content, one after the other; texts are encoded as UTF-8.

    Raises:
        OSError: The file cannot be written.
    """
    path = Path(path)
    temporary = path.with_name(TEMPORARY_NAME.format(name=path.name, token=secrets.token_hex(4)))
    try:
        with open(temporary, "xb") as file:  # exclusive creation follows no link
            for part in parts:
                file.write(part.encode() if isinstance(part, str) else part)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)
    sync_folder(path.parent)


def sync_folder(folder: Path) -> None:
    """Flush a rename in a folder to the disk, where the file system can."""
    with contextlib.suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)

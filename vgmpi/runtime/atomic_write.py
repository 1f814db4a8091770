"""Atomic replacement of files that several processes of a fit may write at the same time."""

import os
import secrets
from pathlib import Path


def replaced(path: Path, data: bytes) -> None:
    """Write a file atomically.

    Each process writes a temporary file with a name of its own, and renames it.
    """
    temporary = path.with_name(f"{path.name}.{secrets.token_hex(8)}.tmp")
    try:
        temporary.write_bytes(data)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)

"""Files that several processes of one fit may write in the same moment."""

import os
import secrets
from pathlib import Path


def replaced(path: Path, data: bytes) -> None:
    """Write a file that is there whole or not at all, by a temporary one of this process alone."""
    own = path.with_name(f"{path.name}.{secrets.token_hex(8)}.tmp")
    try:
        own.write_bytes(data)
        os.replace(own, path)
    finally:
        own.unlink(missing_ok=True)

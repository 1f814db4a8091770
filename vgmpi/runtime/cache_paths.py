"""Folder of files that the program can always create again."""

import os
from pathlib import Path


def user_folder() -> Path:
    """Return the folder for files that this program can always create again."""
    root = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(root) / "vgmpi"

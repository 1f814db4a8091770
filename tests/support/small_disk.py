"""A small file system in memory that stands for a disk; only root can make one."""

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest


@contextmanager
def small_disk(folder: Path, size: int) -> Iterator[Path]:
    """A disk of so many bytes. Skips where none can be had."""
    folder.mkdir(parents=True, exist_ok=True)
    mount(f"size={size}", folder)
    try:
        yield folder
    finally:
        subprocess.run(["umount", "--lazy", folder], check=True)
        folder.rmdir()


def mount(options: str, folder: Path) -> None:
    """Mount it, or mount it anew with other options."""
    command = ["mount", "-t", "tmpfs", "-o", options, "none", folder]
    try:
        job = subprocess.run(command, capture_output=True, text=True)
    except OSError as error:
        pytest.skip(f"mount: {error.strerror}")
    if job.returncode:
        pytest.skip(f"no small file system can be mounted: {job.stderr.strip()}")

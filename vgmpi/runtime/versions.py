"""Versions of the program and its libraries."""

import platform
import subprocess
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path


def program_version() -> str:
    """Return the version of the program, such as "0.9.0"."""
    try:
        return version("vgmpi")
    except PackageNotFoundError:  # a folder that is on the path and not installed
        return "not installed"


def versions() -> dict[str, str]:
    """Return the versions of the program and its libraries, as files record them."""
    names_to_versions = {"python": platform.python_version()}
    for name in ("vgmpi", "numpy", "numba", "h5py", "mpi4py"):
        try:
            names_to_versions[name] = version(name)
        except PackageNotFoundError:
            names_to_versions[name] = "not installed"
    command = ["git", "-C", str(Path(__file__).parent), "rev-parse", "HEAD"]
    try:
        names_to_versions["commit"] = subprocess.run(
            command, capture_output=True, text=True, check=True
        ).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        names_to_versions["commit"] = "unknown"
    return names_to_versions

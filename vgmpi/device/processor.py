"""What code is compiled for, and whether it is compiled already."""

import hashlib
import pathlib
import zlib

from llvmlite import binding
from numba import config


def processor() -> str:
    """The kind of processor code is compiled for: its name, and a number for its features."""
    name = config.CPU_NAME or binding.get_host_cpu_name()
    features = config.CPU_FEATURES
    if features is None:
        features = binding.get_host_cpu_features().flatten()
    return f"{name} {zlib.crc32(features.encode()):08x}"


def stamp(*kind) -> pathlib.Path:
    """A file that exists where the kernels for `kind`, anything with a fixed text, are compiled."""
    seal = hashlib.sha256(f"{kind} {processor()}".encode()).hexdigest()[:16]
    return pathlib.Path(config.CACHE_DIR) / f"{seal}.compiled"

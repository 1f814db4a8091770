"""Compile options of numba in this package, and the cache folder of compiled code.

The cache folder is named by a hash of the package's sources, because numba does not see an edit in
another file.
"""

import hashlib
import os
import pathlib
import platform
from importlib.metadata import version

import numba
import numba.extending

from .compile_cache import njit_cached

_PACKAGE = pathlib.Path(__file__).resolve().parent.parent
# Whether a product and a sum may become one instruction that rounds once. If switched off, the
# results equal those of a GPU (engines/cuda) bit by bit, and the program is a tenth slower.
FP_CONTRACTION = os.environ.get("VGMPI_CONTRACTION", "on") != "off"
# Folders of all compiled code; tests/docs/test_names_as_data.py checks that none is missing.
COMPILED = (
    "runtime", "gaussians", "rendering", "materials", "planning", "parallel", "kernels",
)  # fmt: skip


def user_folder() -> pathlib.Path:
    """Return the folder for files that this program can always create again."""
    root = os.environ.get("XDG_CACHE_HOME") or pathlib.Path.home() / ".cache"
    return pathlib.Path(root) / "vgmpi"


def cache_folder() -> pathlib.Path:
    """Return the folder of compiled kernels for these sources, this numba and processor."""
    digest = hashlib.sha256()
    for folder in COMPILED:
        sources = sorted((_PACKAGE / folder).rglob("*.py"))
        if not sources:
            raise FileNotFoundError(f"{_PACKAGE / folder}: no sources of compiled code are there")
        for path in sources:
            digest.update(path.name.encode() + path.read_bytes())
    versions = f"{version('numba')} {platform.python_version()} {platform.machine()}"
    digest.update(f"{FP_CONTRACTION} {versions}".encode())
    return user_folder() / digest.hexdigest()[:16]


if "NUMBA_CACHE_DIR" not in os.environ:
    numba.config.CACHE_DIR = str(cache_folder())


# Fastmath stays off: the order of every sum is part of the result.
kernel = njit_cached(nogil=True, error_model="numpy")
device_function = njit_cached(nogil=True, error_model="numpy", inline="never")
# Inlining pays: passing vectors in memory costs more than the arithmetic of some rows.
always_inline = numba.extending.register_jitable(forceinline=True)

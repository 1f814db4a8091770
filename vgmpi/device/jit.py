"""numba as this package uses it: where compiled code is kept, and one set of compile options.

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

from ..caching import cached

_PACKAGE = pathlib.Path(__file__).resolve().parent.parent
# whether a product and a sum may become one instruction that rounds once. Switched off, this
# program's results are those of a card (engines/cuda), bit by bit, and it is slower by a tenth
CONTRACTS = os.environ.get("VGMPI_CONTRACTION", "on") != "off"
# folders of all that is compiled; tests/unit/test_names_as_data.py holds that none lacks
COMPILED = (
    "gaussians", "splatting", "studio", "device", "materials", "couplings", "planning", "domain",
    "lanes", "kernels",
)  # fmt: skip


def user_folder() -> pathlib.Path:
    """Where this program keeps what it can make again."""
    root = os.environ.get("XDG_CACHE_HOME") or pathlib.Path.home() / ".cache"
    return pathlib.Path(root) / "vgmpi"


def cache_folder() -> pathlib.Path:
    """The folder of compiled kernels for these sources, this numba and this kind of processor."""
    seal = hashlib.sha256()
    for folder in COMPILED:
        found = sorted((_PACKAGE / folder).rglob("*.py"))
        if not found:
            raise FileNotFoundError(f"{_PACKAGE / folder}: no sources of compiled code are there")
        for path in found:
            seal.update(path.name.encode() + path.read_bytes())
    seal.update(
        f"{CONTRACTS} {version('numba')} {platform.python_version()} {platform.machine()}".encode()
    )
    return user_folder() / seal.hexdigest()[:16]


if "NUMBA_CACHE_DIR" not in os.environ:
    numba.config.CACHE_DIR = str(cache_folder())


# no fastmath: the order of every sum is part of the result
kernel = cached(nogil=True, error_model="numpy")
inline = cached(nogil=True, error_model="numpy", inline="never")
# in line: vectors handed over in memory cost more than the arithmetic of some rows
within = numba.extending.register_jitable(forceinline=True)

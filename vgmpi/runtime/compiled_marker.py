"""Markers of compiled kernels."""

import hashlib
import os
from pathlib import Path

from .compile_cache import KEPT, cache_folder
from .compile_key import NoKeyError, content_key
from .cpu_features import processor

_PACKAGES = ("vgmpi.kernels.", "vgmpi.parallel.")  # what every step calls


def compiled_marker(*kind) -> Path:
    """Return the path of a file that exists once the kernels for `kind` are compiled.

    Its name changes with the key of the kernels, see runtime/compile_key.py: with a source that
    they or the classes in `kind` can see, and with versions, options and the processor.

    Args:
        *kind: What tells kernels apart, e.g. the classes of laws and the precision.
    """
    modules = [name for name in KEPT if name.startswith(_PACKAGES)]
    try:
        key = content_key((*kind, processor()), modules)
    except NoKeyError:  # nothing is kept, so there is nothing to wait for
        return Path(os.devnull)
    return cache_folder() / f"{hashlib.sha256(key.encode()).hexdigest()[:16]}.compiled"

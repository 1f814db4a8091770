"""Kernels as they are compiled and called.

What is done at the first compilation, marks on disk of kernels that are compiled, and calls without
numba's type check of every argument.
"""

import hashlib
import logging
import os
from collections.abc import Callable
from pathlib import Path

import numba
import numpy as np
from numba.core import event

from .compile_cache import KEPT, cache_folder
from .compile_key import NoKeyError, content_key
from .cpu_features import processor

_PACKAGES = ("vgmpi.kernels.", "vgmpi.parallel.")  # what every step calls
_entries: dict[tuple, Callable] = {}


def call_at_first_compilation(action: Callable[[], object]) -> None:
    """Call a function when numba compiles for the first time from now on; cached code is silent.

    Args:
        action: The function.
    """

    class FirstCompilation(event.Listener):
        """Listener that calls the function at the first compilation."""

        is_called = False

        def on_start(self, _):
            """Call the function unless it was."""
            if not self.is_called:
                self.is_called = True
                action()

        def on_end(self, _):
            """Do nothing."""

    event.register("numba:compile", FirstCompilation())


def announce_compiling(log: logging.Logger, message: str) -> None:
    """Log a message when numba compiles for the first time from now on.

    Args:
        log: The logger.
        message: The message.
    """
    call_at_first_compilation(lambda: log.info("%s", message))


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


def precompiled_entry(function, *arguments) -> Callable:
    """Return the compiled code of a kernel for arguments of the given types.

    It must be called with arguments of these types only: numba inspects every array of every
    argument at each call, which takes five times as long as passing them.

    Args:
        function: Kernel (numba dispatcher). *arguments: Example arguments.
    """
    key = function, _kind(arguments)
    if key not in _entries:
        _entries[key] = function.compile(tuple(numba.typeof(argument) for argument in arguments))
    return _entries[key]


def is_begun(function, *arguments) -> bool:
    """Return whether the code of `precompiled_entry` is on disk, or is being compiled now.

    Args:
        function: Kernel (numba dispatcher). *arguments: Example arguments.
    """
    signature = tuple(numba.typeof(argument) for argument in arguments)
    return function._cache.is_begun(signature, function.targetctx)


def _kind(argument):
    """Return a key that is equal where numba's types are, e.g. dtype and layout of arrays."""
    if isinstance(argument, np.ndarray):
        return argument.dtype.num, argument.ndim, argument.flags.num
    if isinstance(argument, tuple):
        return type(argument), *map(_kind, argument)
    return argument if callable(argument) else type(argument)

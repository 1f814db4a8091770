"""Calls of compiled kernels without numba's type check of every argument."""

from collections.abc import Callable

import numba
import numpy as np

_entries: dict[tuple, Callable] = {}


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

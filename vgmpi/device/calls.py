"""Calls of compiled code without numba's look at every argument."""

from collections.abc import Callable

import numba
import numpy as np

_entries: dict[tuple, Callable] = {}


def entry(given, *arguments) -> Callable:
    """The compiled code of a kernel for arguments of the types of these, to be called with such
    alone: numba looks at every array of every argument anew at each call, which takes five times as
    long as handing them over.
    """
    key = given, _kind(arguments)
    if key not in _entries:
        _entries[key] = given.compile(tuple(numba.typeof(one) for one in arguments))
    return _entries[key]


def _kind(one):
    """Equal where numba's types are: of arrays their dtype, dimensions and layout."""
    if isinstance(one, np.ndarray):
        return one.dtype.num, one.ndim, one.flags.num
    if isinstance(one, tuple):
        return type(one), *map(_kind, one)
    return one if callable(one) else type(one)

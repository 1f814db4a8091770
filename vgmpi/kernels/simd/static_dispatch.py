"""Static dispatch of kernel functions on the type of their first argument.

    @static_dispatch
    def particle_contribution(kind, ...): "Description."

    @particle_contribution.register(Momentum)
    def _(kind, ...): ...

Kinds are NamedTuples. The implementation is selected when a kernel is compiled, so that kernels do
not contain features that a scene does not need.
"""

from typing import NamedTuple

from numba import types

from vgmpi.runtime.jit import inlined_overload


class Both(NamedTuple):
    """Kind of two kinds, the first before the second."""

    first: tuple
    second: tuple


def static_dispatch(stub):
    """Make `stub` callable from kernels; `stub.register(Kind)` adds an implementation."""
    table = {}

    def _register(kind: type):
        def _register_implementation(function):
            if kind in table:
                raise TypeError(f"{stub.__name__} is registered twice for {kind.__name__}")
            table[kind] = function
            return function

        return _register_implementation

    @inlined_overload(stub)
    def _choose(kind, *_):
        return table.get(kind.instance_class) if isinstance(kind, types.BaseNamedTuple) else None

    stub.register, stub.table = _register, table
    return stub

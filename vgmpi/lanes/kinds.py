"""Functions that kernels call by the kind of their first argument, as laws are called by theirs.

    @by_kind
    def contribute(kind, ...): "What it is."

    @contribute.of(Momentum)
    def _(kind, ...): ...

Kinds are NamedTuples. Which function is meant is decided when a kernel is compiled, so that what a
scene does not need is not in its kernels.
"""

from numba import types
from numba.extending import overload


def by_kind(stub):
    """Make `stub` callable from kernels; its implementations are added by `stub.of(Kind)`."""
    table = {}

    def of(kind: type):
        def add(function):
            if kind in table:
                raise TypeError(f"{stub.__name__} is told twice for {kind.__name__}")
            table[kind] = function
            return function

        return add

    @overload(stub, strict=False, jit_options={"forceinline": True})
    def choose(kind, *_):
        return table.get(kind.instance_class) if isinstance(kind, types.BaseNamedTuple) else None

    stub.of, stub.table = of, table
    return stub

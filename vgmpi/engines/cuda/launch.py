"""Kernels as they are launched: a function of the card's (transfer.py, nodes.py) with its arguments
taken apart, since a launch takes arrays and numbers alone.
"""

import os
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numba import cuda

from .program import Program
from .words import SIMULATED, Mode, safe, tree_of

COUNTED = [0]  # launches so far
LAST = ["none"]  # the kernel that was launched last


class Launch(NamedTuple):
    """A kernel for arguments of one form."""

    kernel: Any
    threads: int  # of a block


class Launcher:
    """Kernels of one program, compiled when they are first asked for."""

    def __init__(self, program: Program, threads: int):
        """threads: of a block."""
        self.program, self.threads = program, threads
        self.made: dict[tuple, Launch] = {}

    def launch(self, blocks: int, mode: Mode, function: Callable, *arguments: Any) -> None:
        """function(*arguments) by `blocks` blocks; arrays are the card's."""
        if blocks:
            COUNTED[0], LAST[0] = COUNTED[0] + 1, function.__name__
            found = self.kernel(mode, function, arguments)
            found.kernel[blocks, found.threads](*numbers_of(arguments))

    def kernel(self, mode: Mode, function: Callable, arguments: tuple) -> Launch:
        """The kernel for arguments of these forms."""
        key = function, mode.name, tuple(form_of(one) for one in arguments)
        if key not in self.made:
            self.made[key] = Launch(self._compiled(mode, function, arguments), self.threads)
        return self.made[key]

    def _compiled(self, mode: Mode, function: Callable, arguments: tuple) -> Callable:
        code = function.__code__
        names = code.co_varnames[: code.co_argcount]
        trees = {name: tree_of(one) for name, one in zip(names, arguments, strict=True)}
        trees = {name: tree for name, tree in trees.items() if tree is not None}
        called = self.program.function(function, mode, trees)
        taken: list[str] = []
        given = ", ".join(self._put_together(one, taken) for one in arguments)
        name = f"kernel_{called}"
        text = f"def {name}({', '.join(taken)}):\n    {called}({given})\n"
        exec(compile(text, f"<{name}>", "exec"), self.program.space)
        made = self.program.space[name]
        # no optimisation at link time either: it would contract
        return cuda.jit(made) if SIMULATED else cuda.jit(lto=False)(made)  # type: ignore[call-arg]

    def _put_together(self, one: Any, taken: list[str], inside: bool = False) -> str:
        """The text that makes an argument of what is taken: numbers that are part of a tuple and
        whole are known when the kernel is compiled."""
        if one is None:
            return "None"
        if isinstance(one, tuple):
            parts = [self._put_together(part, taken, True) for part in one]
            if not hasattr(one, "_fields"):
                return f"({', '.join(parts)}{',' if parts else ''})"
            kind = self.program.bind(safe(type(one)), type(one).__name__)
            return f"{kind}({', '.join(parts)})"
        if inside and isinstance(one, bool | int) and not isinstance(one, np.generic):
            return repr(int(one))
        taken.append(f"a{len(taken)}")
        return taken[-1]


def without_contraction() -> None:
    """From now on a product and a sum stay two instructions, as on a processor with
    VGMPI_CONTRACTION=off. numba has no such option: the one of NVVM is added to those it gives."""
    usual = nvvm.compile_ir
    if not hasattr(usual, "usual"):

        def plain(ir: Any, **options: Any) -> Any:
            return usual(ir, **options, fma=0)

        setattr(plain, "usual", usual)  # noqa: B010
        setattr(nvvm, "compile_ir", plain)  # noqa: B010


if not SIMULATED:
    from numba.cuda.cudadrv import nvvm

    if os.environ.get("VGMPI_CARD_CONTRACTION") != "on":  # for comparison alone
        without_contraction()


def form_of(one: Any) -> Any:
    """Equal where one kernel serves."""
    if isinstance(one, tuple):
        return type(one), tuple(_form_inside(part) for part in one)
    return _form(one)


def _form_inside(one: Any) -> Any:
    if isinstance(one, bool | int) and not isinstance(one, np.generic):
        return int, int(one)
    return form_of(one)


def _form(one: Any) -> Any:
    if one is None:
        return None
    if hasattr(one, "dtype") and hasattr(one, "ndim") and one.ndim:
        return np.dtype(one.dtype).str, one.ndim
    return float if isinstance(one, np.float64) else type(one)


def numbers_of(arguments: Any) -> list:
    """Arrays and numbers of arguments in the order in which a kernel takes them."""
    found: list = []
    for one in arguments:
        if isinstance(one, tuple):
            inner = [p for p in one if not isinstance(p, bool | int) or isinstance(p, np.generic)]
            found += numbers_of(inner)
        elif one is not None:  # a plain number is a double also for the simulator
            found.append(np.float64(one) if type(one) is float else one)
    return found

"""Kernel launches: specialization of a function for its arguments.

Arguments are flattened, since a launch takes only arrays and numbers.
"""

import ctypes
import os
import struct
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numba import cuda

from .translation import KernelTranslator
from .translation_types import SIMULATED, TranslationMode, type_tree, without_tuple_methods

LAUNCH_COUNT = [0]  # number of launches
PARAMETER_BYTES = 8  # [bytes] from one parameter to the next, of which a kernel reads what it needs
MAX_TUPLES = 500  # stored arguments of a launcher
FORMS: dict[tuple, int] = {}
LAST = ["none"]  # name of the last launched kernel


class Argument(NamedTuple):
    """Argument of a launch as the launcher passes it."""

    value: Any  # kept, so that its id stays in use
    form: Any  # key that is equal for arguments that one kernel serves
    parameters: bytes  # its parameters, of 8 bytes each; empty in the simulator


class Launch:
    """Compiled kernel for arguments of one form.

    numba prepares the arguments of a launch for a time in which a GPU processes a million
    particles. Only the first launch, which compiles, is numba's.
    """

    def __init__(self, kernel: Any, threads: int):
        """Create a launch; threads: threads of a block."""
        self.kernel, self.threads = kernel, threads
        self.code: Any = None  # the loaded kernel, after the first launch

    def __call__(self, blocks: int, arguments: list[Argument]) -> None:
        """Launch the kernel.

        Args:
            blocks: Number of blocks.
            arguments: Arguments in the order of the kernel's.
        """
        if self.code is None:
            self.kernel[blocks, self.threads](*numbers_of([a.value for a in arguments]))
            if not SIMULATED:
                self._load(sum(len(argument.parameters) for argument in arguments))
            return
        self.parameters.raw = b"".join([argument.parameters for argument in arguments])
        driver.driver.cuLaunchKernel(
            self.code, blocks, 1, 1, self.threads, 1, 1, 0, 0, ctypes.addressof(self.pointers), 0
        )

    def _load(self, size: int) -> None:
        """Take the loaded kernel from numba, and memory for `size` bytes of parameters."""
        (overload,) = self.kernel.overloads.values()
        handle = overload._codelibrary.get_cufunc().kernel.handle
        self.code = driver.binding.CUfunction(int(handle))
        self.parameters = ctypes.create_string_buffer(max(size, 1))
        first = ctypes.addressof(self.parameters)
        places = range(first, first + size, PARAMETER_BYTES)
        self.pointers = (ctypes.c_void_p * len(places))(*places)


class Launcher:
    """Kernels of one translator, compiled at their first launch."""

    def __init__(self, program: KernelTranslator, threads: int):
        """Create a launcher; threads: threads of a block."""
        self.program, self.threads = program, threads
        self.kernels: dict[tuple, Launch] = {}
        self.tuples: dict[int, Argument] = {}  # id of a tuple -> argument, since the last sort

    def launch(
        self, blocks: int, mode: TranslationMode, function: Callable, *arguments: Any
    ) -> None:
        """Launch function(*arguments).

        Args:
            blocks: Number of blocks.
            mode: Translation mode.
            function: Function of the kernel.
            arguments: Numbers, GPU arrays and NamedTuples of them.
        """
        if blocks:
            LAUNCH_COUNT[0], LAST[0] = LAUNCH_COUNT[0] + 1, function.__name__
            passed = [self._argument(argument) for argument in arguments]
            self._kernel(mode, function, arguments, passed)(blocks, passed)

    def kernel(self, mode: TranslationMode, function: Callable, arguments: tuple) -> Launch:
        """Return the kernel for arguments of these forms.

        Args:
            mode: Translation mode.
            function: Function of the kernel.
            arguments: Arguments of the launch.
        """
        passed = [self._argument(argument) for argument in arguments]
        return self._kernel(mode, function, arguments, passed)

    def _kernel(
        self, mode: TranslationMode, function: Callable, arguments: tuple, passed: list[Argument]
    ) -> Launch:
        key = function, mode.name, *[argument.form for argument in passed]
        kernel = self.kernels.get(key)
        if kernel is None:
            kernel = Launch(self._compiled(mode, function, arguments), self.threads)
            self.kernels[key] = kernel
        return kernel

    def _argument(self, value: Any) -> Argument:
        """Return a value as an argument; that of the same tuple is stored until `forget`."""
        if not isinstance(value, tuple):
            return argument_of(value)
        argument = self.tuples.get(id(value))
        if argument is None:
            if len(self.tuples) >= MAX_TUPLES:
                self.tuples.clear()
            argument = self.tuples[id(value)] = argument_of(value)
        return argument

    def forget(self) -> None:
        """Drop the stored arguments, which keep the memory of their arrays."""
        self.tuples.clear()

    def _compiled(self, mode: TranslationMode, function: Callable, arguments: tuple) -> Callable:
        code = function.__code__
        names = code.co_varnames[: code.co_argcount]
        trees = {name: type_tree(argument) for name, argument in zip(names, arguments, strict=True)}
        trees = {name: tree for name, tree in trees.items() if tree is not None}
        called = self.program.function(function, mode, trees)
        parameters: list[str] = []
        expressions = ", ".join(self._expression(argument, parameters) for argument in arguments)
        name = f"kernel_{called}"
        text = f"def {name}({', '.join(parameters)}):\n    {called}({expressions})\n"
        exec(compile(text, f"<{name}>", "exec"), self.program.space)
        kernel = self.program.space[name]
        # Link-time optimization is off as well: it would contract.
        # `cuda.jit(lto=False)` as a decorator loses the flag (numba-cuda 0.30).
        return cuda.jit(kernel) if SIMULATED else cuda.jit(kernel, lto=False)  # type: ignore[call-arg]

    def _expression(self, argument: Any, parameters: list[str], is_member: bool = False) -> str:
        """Return the source text that rebuilds an argument from the parameters of the kernel.

        Integers inside a tuple are known when the kernel is compiled.
        """
        if argument is None:
            return "None"
        if isinstance(argument, tuple):
            members = [self._expression(member, parameters, True) for member in argument]
            if not hasattr(argument, "_fields"):
                return f"({', '.join(members)}{',' if members else ''})"
            class_name = self.program.bind_constant(
                without_tuple_methods(type(argument)), type(argument).__name__
            )
            return f"{class_name}({', '.join(members)})"
        if is_member and isinstance(argument, bool | int) and not isinstance(argument, np.generic):
            return repr(int(argument))
        parameters.append(f"a{len(parameters)}")
        return parameters[-1]


def without_contraction() -> None:
    """Disable floating-point contraction: a product and a sum stay two instructions.

    This equals a processor with VGMPI_CONTRACTION=off. numba has no such option; the option of NVVM
    is added to those it passes.
    """
    usual = nvvm.compile_ir
    if not hasattr(usual, "usual"):

        def _compile(ir: Any, **options: Any) -> Any:
            return usual(ir, **options, fma=0)

        setattr(_compile, "usual", usual)  # noqa: B010
        setattr(nvvm, "compile_ir", _compile)  # noqa: B010


if not SIMULATED:
    from numba.cuda import dispatcher
    from numba.cuda.cudadrv import driver, nvvm

    dispatcher.config.CUDA_LOW_OCCUPANCY_WARNINGS = 0  # for people who choose a grid themselves
    if os.environ.get("VGMPI_CARD_CONTRACTION") != "on":  # for comparison alone
        without_contraction()


def argument_of(value: Any) -> Argument:
    """Return a value as an argument of a launch."""
    if isinstance(value, tuple):
        members = [_member(member) for member in value]
        form = number_of_form((type(value), *[member.form for member in members]))
        return Argument(value, form, b"".join([member.parameters for member in members]))
    if hasattr(value, "dtype") and value.ndim:
        return _array_argument(value)
    if value is None:
        return Argument(None, None, b"")
    if isinstance(value, float):  # a Python float is a double in the simulator too
        return Argument(value, float, struct.pack("<d", value))
    if isinstance(value, np.generic):
        return Argument(value, type(value), value.tobytes().ljust(PARAMETER_BYTES, b"\0"))
    return Argument(value, type(value), struct.pack("<q", value))


def _member(value: Any) -> Argument:
    """Return a member of a tuple as an argument; its integers are known to the kernel."""
    if isinstance(value, bool | int) and not isinstance(value, np.generic):
        return Argument(value, (int, int(value)), b"")
    return argument_of(value)


def _array_argument(array: Any) -> Argument:
    """Return an array of the GPU as an argument, in numba's order; the array keeps the rest."""
    stored = getattr(array, "launch_argument", None)
    if stored is None:
        stored = number_of_form((np.dtype(array.dtype).str, array.ndim)), b""
        if hasattr(array, "device_ctypes_pointer"):
            address = array.device_ctypes_pointer.value or 0
            numbers = array.size, array.dtype.itemsize, address, *array.shape, *array.strides
            stored = stored[0], struct.pack(f"<{2 + len(numbers)}q", 0, 0, *map(int, numbers))
            array.launch_argument = stored
    return Argument(array, *stored)


def number_of_form(form: tuple) -> int:
    """Return the number of a form, so that launches compare numbers."""
    return FORMS.setdefault(form, len(FORMS))


def numbers_of(arguments: Any) -> list:
    """Return the arrays and numbers of arguments in the order of the kernel's parameters."""
    numbers: list = []
    for argument in arguments:
        if isinstance(argument, tuple):
            inner = [
                p for p in argument if not isinstance(p, bool | int) or isinstance(p, np.generic)
            ]
            numbers += numbers_of(inner)
        elif argument is not None:  # a Python float is a double in the simulator too
            numbers.append(np.float64(argument) if type(argument) is float else argument)
    return numbers

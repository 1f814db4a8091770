"""Kernel launches: specialization of a function for its arguments.

Arguments are flattened, since a launch takes only arrays and numbers.
"""

import os
from collections.abc import Callable
from typing import Any

import numpy as np
from numba import cuda

from .translation import KernelTranslator
from .translation_types import SIMULATED, TranslationMode, type_tree, without_tuple_methods

LAUNCH_COUNT = [0]  # number of launches
C_TYPES = {
    np.dtype(kind): np.ctypeslib.as_ctypes_type(kind)
    for kind in (np.float32, np.float64, np.int32, np.int64, np.uint32, np.uint64, np.bool_)
}
LAST = ["none"]  # name of the last launched kernel


class Launch:
    """Compiled kernel for arguments of one form.

    numba prepares the arguments of a launch for a time in which a GPU processes a million
    particles. Only the first launch, which compiles, is numba's.
    """

    def __init__(self, kernel: Any, threads: int):
        """Create a launch; threads: threads of a block."""
        self.kernel, self.threads = kernel, threads
        self.code: Any = None  # the loaded kernel, after the first launch
        self.stream: Any = None

    def __call__(self, blocks: int, numbers: list) -> None:
        """Launch the kernel.

        Args:
            blocks: Number of blocks.
            numbers: Arrays and numbers in the order of the parameters.
        """
        if self.code is None:
            self.kernel[blocks, self.threads](*numbers)
            if not SIMULATED:
                (overload,) = self.kernel.overloads.values()
                self.code = overload._codelibrary.get_cufunc().kernel
                self.stream = dispatcher.driver._to_core_stream(0)
            return
        shape = dispatcher.LaunchConfig(grid=(blocks, 1, 1), block=(self.threads, 1, 1))
        dispatcher.launch(self.stream, shape, self.code, *parameters_of(numbers))


class Launcher:
    """Kernels of one translator, compiled at their first launch."""

    def __init__(self, program: KernelTranslator, threads: int):
        """Create a launcher; threads: threads of a block."""
        self.program, self.threads = program, threads
        self.kernels: dict[tuple, Launch] = {}

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
            self.kernel(mode, function, arguments)(blocks, numbers_of(arguments))

    def kernel(self, mode: TranslationMode, function: Callable, arguments: tuple) -> Launch:
        """Return the kernel for arguments of these forms.

        Args:
            mode: Translation mode.
            function: Function of the kernel.
            arguments: Arguments of the launch.
        """
        key = function, mode.name, tuple(form_of(argument) for argument in arguments)
        if key not in self.kernels:
            self.kernels[key] = Launch(self._compiled(mode, function, arguments), self.threads)
        return self.kernels[key]

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
    from numba.cuda.cudadrv import nvvm

    dispatcher.config.CUDA_LOW_OCCUPANCY_WARNINGS = 0  # for people who choose a grid themselves
    if os.environ.get("VGMPI_CARD_CONTRACTION") != "on":  # for comparison alone
        without_contraction()


def form_of(argument: Any) -> Any:
    """Return a key that is equal for arguments that one kernel serves."""
    if isinstance(argument, tuple):
        return type(argument), tuple(_form_inside(part) for part in argument)
    return _form(argument)


def _form_inside(argument: Any) -> Any:
    if isinstance(argument, bool | int) and not isinstance(argument, np.generic):
        return int, int(argument)
    return form_of(argument)


def _form(argument: Any) -> Any:
    if argument is None:
        return None
    if hasattr(argument, "dtype") and hasattr(argument, "ndim") and argument.ndim:
        return np.dtype(argument.dtype).str, argument.ndim
    return float if isinstance(argument, np.float64) else type(argument)


def parameters_of(numbers: list) -> list:
    """Return the parameters of a kernel, in which numba passes arrays and numbers."""
    parameters: list = []
    for number in numbers:
        if isinstance(number, np.generic):
            parameters.append(C_TYPES[number.dtype](number.item()))
        elif isinstance(number, bool | int):
            parameters.append(number)
        else:
            parameters += _array_parameters(number)
    return parameters


def _array_parameters(array: Any) -> tuple:
    """Return the parameters of an array of the GPU, which the array keeps."""
    parameters = getattr(array, "launch_parameters", None)
    if parameters is None:
        address = array.device_ctypes_pointer.value or 0
        numbers = array.size, array.dtype.itemsize, address, *array.shape, *array.strides
        parameters = array.launch_parameters = 0, 0, *map(int, numbers)
    return parameters


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

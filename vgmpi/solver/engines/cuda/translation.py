"""Source-to-source translation of kernels, laws and layers into GPU functions.

The physics is not written a second time. The source of a function is read and changed in few places
(source_transform.py): the meaning of a name on the GPU (`TranslationMode.stands_in`: a vector of 16
becomes a thread, or a part of a warp), the function that a kind or a law calls, and the precision
of plain numbers where they meet vectors, which is that of the run as on the CPU. Called functions
are treated alike. numba compiles the result, and its simulator runs the same source without a GPU.
"""

import ast
import inspect
import textwrap
from collections.abc import Callable
from types import FunctionType
from typing import Any

import numpy as np
from numba import cuda

from .source_transform import KernelTransformer
from .translation_types import SIMULATED, TranslationMode


class KernelTranslator:
    """GPU functions, made on request, with one set of constants."""

    def __init__(self, real: np.dtype, constants: dict):
        """Create a translator.

        Args:
            real: Precision of the run.
            constants: Values by name for the GPU's own functions.
        """
        self.real = np.dtype(real).type
        self.constants = constants | {"REAL": self.real}
        self.space: dict[str, Any] = {
            "cuda": cuda, "np": np, "REAL": self.real, "__name__": __name__,
        }  # fmt: skip
        self.defined: dict[tuple, str] = {}  # names in the space, by request

    def bind_constant(self, value: Any, hint: str) -> str:
        """Return the name of a value in the space, and add it if needed."""
        key = type(value), repr(value) if isinstance(value, str | int | float) else id(value)
        if key not in self.defined:
            name = f"{hint}_{len(self.defined)}"
            self.space[name], self.defined[key] = value, name
            if not isinstance(value, str | int | float):
                self.space[f"{name}_kept"] = value  # keeps the id in use
        return self.defined[key]

    def function(self, source: Callable, mode: TranslationMode, trees: dict) -> str:
        """Return the name of the GPU function for a function of the CPU or the GPU.

        Args:
            source: Function.
            mode: Translation mode.
            trees: Argument name -> `type_tree`.
        """
        plain: Any = getattr(source, "py_func", source)
        key = plain, mode.name, tuple(sorted(trees.items(), key=lambda pair: pair[0]))
        if key not in self.defined:
            self.defined[key] = f"{plain.__name__}_{len(self.defined)}"
            self._define(plain, mode, trees, self.defined[key])
        return self.defined[key]

    def _define(self, plain: FunctionType, mode: TranslationMode, trees: dict, name: str) -> None:
        tree = ast.parse(textwrap.dedent(inspect.getsource(plain)))
        definition = tree.body[0]
        assert isinstance(definition, ast.FunctionDef)
        definition.name, definition.decorator_list, definition.returns = name, [], None
        if isinstance(definition.body[0], ast.Expr) and isinstance(
            definition.body[0].value, ast.Constant
        ):
            definition.body = definition.body[1:] or [ast.Pass()]
        for argument in (*definition.args.args, *definition.args.kwonlyargs):
            argument.annotation = None
        definition.body = KernelTransformer(self, plain, mode, trees).block(definition.body)
        first = plain.__code__.co_firstlineno - 1
        ast.increment_lineno(ast.fix_missing_locations(tree), first)
        exec(compile(tree, f"{plain.__code__.co_filename}:{name}", "exec"), self.space)
        self.space[name] = on_card(self.space[name])

    def text(self, name: str, text: str) -> str:
        """Define a GPU function from its source text, once, and return its name."""
        if name in self.space:
            return name
        exec(compile(text, f"<{name}>", "exec"), self.space)
        self.space[name] = on_card(self.space[name])
        return name


def on_card(function: Callable) -> Callable:
    """Return a function that kernels can call; the simulator runs it unchanged."""
    if SIMULATED:
        return function
    return cuda.jit(device=True, forceinline=True, lto=False)(function)  # type: ignore[call-arg]

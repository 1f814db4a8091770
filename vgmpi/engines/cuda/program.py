"""Functions of the kernels, laws and layers as functions for a card.

Nothing of the physics is written a second time. The text of a function is read and changed in few
places (text.py): what a name means on a card (`Mode.stands_in`: a vector of 16 is a thread, or a
part of a warp), which function a kind or a law calls, and that a plain number has the precision of
the run where it meets vectors, as it has on the processor. What a function calls is treated alike.
numba compiles what comes out, and its simulator runs the same text without a card.
"""

import ast
import inspect
import textwrap
from collections.abc import Callable
from types import FunctionType
from typing import Any

import numpy as np
from numba import cuda

from .text import Change
from .words import SIMULATED, Mode


class Program:
    """Functions for a card, made when they are asked for, with one set of constants."""

    def __init__(self, real: np.dtype, constants: dict):
        """real: precision of the run; constants: {name: value} of the card's own functions."""
        self.real = np.dtype(real).type
        self.constants = constants | {"REAL": self.real}
        self.space: dict[str, Any] = {
            "cuda": cuda, "np": np, "REAL": self.real, "__name__": __name__,
        }  # fmt: skip
        self.made: dict[tuple, str] = {}  # name in the space of what was asked for

    def bind(self, value: Any, hint: str) -> str:
        """The name of a value in the space."""
        key = type(value), repr(value) if isinstance(value, str | int | float) else id(value)
        if key not in self.made:
            name = f"{hint}_{len(self.made)}"
            self.space[name], self.made[key] = value, name
            if not isinstance(value, str | int | float):
                self.space[f"{name}_kept"] = value  # so that no other has its id
        return self.made[key]

    def function(self, given: Callable, mode: Mode, trees: dict) -> str:
        """The name of a function for the card, of one of the processor's or of the card's own.
        trees: {argument: tree_of}."""
        plain: Any = getattr(given, "py_func", given)
        key = plain, mode.name, tuple(sorted(trees.items(), key=lambda pair: pair[0]))
        if key not in self.made:
            self.made[key] = f"{plain.__name__}_{len(self.made)}"
            self._define(plain, mode, trees, self.made[key])
        return self.made[key]

    def _define(self, plain: FunctionType, mode: Mode, trees: dict, name: str) -> None:
        tree = ast.parse(textwrap.dedent(inspect.getsource(plain)))
        made = tree.body[0]
        assert isinstance(made, ast.FunctionDef)
        made.name, made.decorator_list, made.returns = name, [], None
        if isinstance(made.body[0], ast.Expr) and isinstance(made.body[0].value, ast.Constant):
            made.body = made.body[1:] or [ast.Pass()]
        for one in (*made.args.args, *made.args.kwonlyargs):
            one.annotation = None
        made.body = Change(self, plain, mode, trees).block(made.body)
        first = plain.__code__.co_firstlineno - 1
        ast.increment_lineno(ast.fix_missing_locations(tree), first)
        exec(compile(tree, f"{plain.__code__.co_filename}:{name}", "exec"), self.space)
        self.space[name] = on_card(self.space[name])

    def text(self, name: str, text: str) -> str:
        """Define a function of the card by its text, once; returns its name."""
        if name in self.space:
            return name
        exec(compile(text, f"<{name}>", "exec"), self.space)
        self.space[name] = on_card(self.space[name])
        return name


def on_card(function: Callable) -> Callable:
    """A function that kernels call. The simulator runs it as it is."""
    if SIMULATED:
        return function
    return cuda.jit(device=True, forceinline=True, lto=False)(function)  # type: ignore[call-arg]

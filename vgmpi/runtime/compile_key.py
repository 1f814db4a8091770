"""Keys of compiled code: all that decides what a function is compiled to, as lines of text.

No line has a path, a time or an address, so that equal code has the same key in every copy of the
sources. What cannot be told by its content has no key.
"""

import functools
import hashlib
import os
import platform
import sys
from collections.abc import Callable, Iterable
from importlib.metadata import version
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numba
import numpy as np
from numba import types
from numba.core import config
from numba.core.dispatcher import Dispatcher

from .source_digest import SourceError, sources_seen_by

# Whether a product and a sum may become one instruction that rounds once. If switched off, the
# results equal those of a GPU (engines/cuda) bit by bit, and the program is a tenth slower.
FP_CONTRACTION = os.environ.get("VGMPI_CONTRACTION", "on") != "off"
# settings of numba that reach the machine code
SETTINGS = (
    "OPT", "LOOP_VECTORIZE", "SLP_VECTORIZE", "ENABLE_AVX", "USING_SVML", "BOUNDSCHECK",
    "DEBUGINFO_DEFAULT", "CPU_NAME", "CPU_FEATURES", "LLVM_REFPRUNE_PASS", "LLVM_REFPRUNE_FLAGS",
    "USE_LLVM_LEGACY_PASS_MANAGER",
)  # fmt: skip
_PLAIN = (type(None), type(...), bool, int, float, complex, str, bytes)


class NoKeyError(Exception):
    """Function or value that its content does not tell from others."""


def compile_key(function: Callable, options: dict, signature: tuple, target: tuple) -> str:
    """Return the key of a compiled function, one line for everything that it depends on.

    Args:
        function: The function as Python has it.
        options: Options of the compiler.
        signature: numba types of the arguments, and of the result if it is asked for.
        target: What numba says of the processor for which it compiles.

    Raises:
        NoKeyError: If some of it cannot be told by its content.
    """
    if sys.modules.get(function.__module__) is None:
        raise NoKeyError("it is in no module")
    content = _Content()
    lines = [
        f"function {function.__module__}.{function.__qualname__}",
        f"code {_digest(content.text(function))}",
        f"signature {content.text(signature)}",
        f"options {content.text(options)}",
        f"target {' '.join(map(str, target))}",
        *environment(),
    ]
    return "\n".join([*lines, *_source_lines(frozenset(content.modules))])


def content_key(value: Any, modules: Iterable[str]) -> str:
    """Return the key of a value and of modules, with what is the same for all functions.

    Raises:
        NoKeyError: If some of it cannot be told by its content.
    """
    content = _Content()
    content.modules.update(modules)
    lines = [content.text(value), *environment()]
    return "\n".join([*lines, *_source_lines(frozenset(content.modules))])


def environment() -> list[str]:
    """Return the lines that are the same for all functions of this process."""
    settings = ((name, getattr(config, name, None)) for name in SETTINGS)
    return [
        *_versions(),
        f"python {sys.implementation.cache_tag}{sys.abiflags} {sys.platform} {platform.machine()}",
        f"settings {' '.join(f'{name}={value}' for name, value in settings)}",
        f"contraction {FP_CONTRACTION}",
    ]


def modules_of(key: str) -> set[str]:
    """Return the names of the modules that a key covers."""
    return {line.split()[1] for line in key.splitlines() if line.startswith("source ")}


@functools.cache
def _versions() -> tuple[str, ...]:
    """Return the lines of the packages that make the code, or its constants."""
    llvmlite = version("llvmlite")
    return f"numba {numba.__version__}", f"llvmlite {llvmlite}", f"numpy {np.__version__}"


@functools.cache
def _source_lines(modules: frozenset[str]) -> list[str]:
    try:
        digests = sources_seen_by(modules)
    except SourceError as error:
        raise NoKeyError(str(error)) from error
    return [f"source {name} {digest}" for name, digest in digests.items()]


class _Content:
    """Texts of values by their content, and the modules in which their code is."""

    def __init__(self):
        self.modules: set[str] = set()
        self.begun: set[int] = set()  # functions, which may contain themselves

    def text(self, value: Any) -> str:
        """Return the text of a value."""
        if isinstance(value, _PLAIN):
            return f"{type(value).__name__} {value!r}"
        if isinstance(value, np.dtype):
            return f"dtype {value.descr if value.names else value.str}"
        if isinstance(value, np.generic | np.ndarray) and not value.dtype.hasobject:
            layout = f"{value.shape} {value.flags.c_contiguous} {value.flags.f_contiguous}"
            return f"array {self.text(value.dtype)} {layout} {_digest(value.tobytes())}"
        if isinstance(value, tuple | list):
            return f"{self._class(type(value))}[{self._texts(value)}]"
        if isinstance(value, set | frozenset):
            return f"set{sorted(map(self.text, value))}"
        if isinstance(value, dict):
            return f"dict{sorted(self._texts(item) for item in value.items())}"
        if isinstance(value, types.Type):
            return self._numba_type(value)
        if isinstance(value, Dispatcher):
            return f"compiled {self.text(value.py_func)} {self.text(value.targetoptions)}"
        if isinstance(value, FunctionType):
            return self._function(value)
        if isinstance(value, CodeType):
            return self._code(value)
        if isinstance(value, type):
            return self._class(value)
        if isinstance(value, ModuleType):
            return f"module {value.__name__}"
        raise NoKeyError(f"a value of {type(value)}")

    def _texts(self, values: Iterable) -> str:
        return ", ".join(map(self.text, values))

    def _class(self, cls: type) -> str:
        self._add_module(cls.__module__)
        return f"{cls.__module__}.{cls.__qualname__} {cls.__name__}"

    def _add_module(self, name: str) -> None:
        """Take in the sources of a module that is not of a library."""
        top = name.split(".")[0]
        if top not in sys.stdlib_module_names and top not in ("numba", "numpy", "llvmlite"):
            self.modules.add(name)

    def _numba_type(self, kind: types.Type) -> str:
        """Return the text of a numba type, with the classes and the types that it is made of."""
        if isinstance(kind, types.Dispatcher):
            return self.text(kind.dispatcher)
        if " at 0x" in kind.name:
            raise NoKeyError(f"a value of {kind}")
        return f"{type(kind).__name__} {kind.name} <{self._texts(_inner(kind))}>"

    def _function(self, function: FunctionType) -> str:
        if id(function) in self.begun:
            return f"again {function.__qualname__}"
        self.begun.add(id(function))
        name, code = function.__module__, function.__code__
        try:
            cells = [cell.cell_contents for cell in function.__closure__ or ()]
        except ValueError as error:
            raise NoKeyError(f"{function.__qualname__} closes over what is not there") from error
        globals_used = {}
        if function.__globals__ is getattr(sys.modules.get(name), "__dict__", None):
            self._add_module(name)
        else:  # made by exec, with names of its own
            globals_used = {item: function.__globals__.get(item) for item in sorted(_names(code))}
        return (
            f"function {name}.{function.__qualname__} {_digest(self._code(code))}"
            f" {self.text(function.__defaults__)} {self.text(function.__kwdefaults__)}"
            f" {self._texts(cells)} {self.text(globals_used)}"
        )

    def _code(self, code: CodeType) -> str:
        return (
            f"{code.co_code.hex()} {code.co_exceptiontable.hex()} {code.co_flags}"
            f" {code.co_argcount} {code.co_posonlyargcount} {code.co_kwonlyargcount}"
            f" {code.co_names} {code.co_varnames} {code.co_freevars} {code.co_cellvars}"
            f" {self._texts(code.co_consts)}"
        )


def _inner(kind: types.Type) -> Iterable:
    """Yield the types and classes that are attributes of a numba type, in the order of names."""
    public = ((name, value) for name, value in vars(kind).items() if not name.startswith("_"))
    for _, value in sorted(public, key=lambda item: item[0]):
        for item in value if isinstance(value, tuple) else (value,):
            if isinstance(item, types.Type | type | np.dtype) and item is not kind:
                yield item


def _names(code: CodeType) -> set[str]:
    """Return all global names and attributes that a code and those in it use."""
    inner = (item for item in code.co_consts if isinstance(item, CodeType))
    return set(code.co_names).union(*map(_names, inner))


def _digest(content: str | bytes) -> str:
    raw = content.encode() if isinstance(content, str) else content
    return hashlib.sha256(raw).hexdigest()[:32]

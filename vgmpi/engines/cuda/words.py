"""What the reading of a kernel's text goes by: modes, what is known of arguments, and the classes
that a card can take.
"""

from types import FunctionType, ModuleType
from typing import Any, NamedTuple

from numba import cuda

SIMULATED = bool(cuda.config.ENABLE_CUDASIM)  # type: ignore[attr-defined]
NEVER = "never"  # a tree of what is None


class Mode(NamedTuple):
    """What names mean on a card, for the functions that one thread or one team runs."""

    name: str
    stands_in: dict  # {object of the processor's: object of the card's}
    constants: dict  # {name in any module: its value here}; made by `constants`
    views: frozenset = frozenset()  # functions that return a part of an array


def constants(values: dict, *modules: ModuleType) -> dict:
    """Values by names that one of these modules has. Raises AttributeError where none has one: a
    name that has changed there would keep the processor's value on a card."""
    for name in values:
        if not any(hasattr(module, name) for module in modules):
            raise AttributeError(f"no module of a card's kernels has a constant {name}")
    return values


class Written(NamedTuple):
    """A function of the card's own that is made as text."""

    name: str
    text: str


def tree_of(value: Any) -> Any:
    """What a function's text must know of an argument: the class of a NamedTuple and of those in
    it, or that it is None. Hashable; None of all else."""
    if value is None:
        return NEVER
    if isinstance(value, tuple) and hasattr(value, "_fields"):
        pairs = zip(value._fields, value, strict=True)
        return type(value), tuple((name, tree_of(one)) for name, one in pairs)
    return None


class Unknown:
    """What is not known while a text is read."""


UNSAFE = ("count", "index")  # fields that numba-cuda takes for the methods of a tuple
_SAFE: dict[type, type] = {}
_ORIGINAL: dict[type, type] = {}


def safe(kind: type) -> type:
    """A NamedTuple's class with no field that is called like a method of tuples."""
    fields = kind._fields  # type: ignore[attr-defined]
    if not set(UNSAFE) & set(fields):
        return kind
    if kind not in _SAFE:
        renamed = [(f"{name}_" if name in UNSAFE else name, Any) for name in fields]
        _SAFE[kind] = NamedTuple(kind.__name__, renamed)  # type: ignore
        _ORIGINAL[_SAFE[kind]] = kind
    return _SAFE[kind]


def original(kind: type) -> type:
    return _ORIGINAL.get(kind, kind)


def is_function(value: Any) -> bool:
    plain = getattr(value, "py_func", value)
    return isinstance(plain, FunctionType) and not isinstance(value, type)

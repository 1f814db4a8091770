"""Data types of the kernel translation: modes, and what is known of arguments."""

from types import FunctionType, ModuleType
from typing import Any, NamedTuple

from numba import cuda

SIMULATED = bool(cuda.config.ENABLE_CUDASIM)  # type: ignore[attr-defined]
NONE_ARGUMENT = "never"  # type tree of an argument that is None


class TranslationMode(NamedTuple):
    """Meaning of names on the GPU, for functions run by one thread or one team."""

    name: str
    stands_in: dict  # CPU object -> GPU object
    constants: dict  # name in any module -> GPU value; see `constants`
    views: frozenset = frozenset()  # functions that return a part of an array


def constants(values: dict, *modules: ModuleType) -> dict:
    """Return GPU values by name, checked against the constants of modules.

    A name that has changed in its module would otherwise keep the CPU value on the GPU.

    Args:
        values: Values by name.
        modules: Modules, one of which must have each name.

    Raises:
        AttributeError: No module has a name.
    """
    for name in values:
        if not any(hasattr(module, name) for module in modules):
            raise AttributeError(f"no module of a card's kernels has a constant {name}")
    return values


class SourceFunction(NamedTuple):
    """Function of the GPU that is generated as text."""

    name: str
    text: str


def type_tree(value: Any) -> Any:
    """Return the type tree of an argument: the class of a NamedTuple and of its members.

    It is NONE_ARGUMENT for None, and None for all other values. It can be hashed.
    """
    if value is None:
        return NONE_ARGUMENT
    if isinstance(value, tuple) and hasattr(value, "_fields"):
        pairs = zip(value._fields, value, strict=True)
        return type(value), tuple((name, type_tree(member)) for name, member in pairs)
    return None


class Unknown:
    """Marker of a value that is not known during translation."""


UNSAFE = ("count", "index")  # field names that numba-cuda takes for methods of a tuple
_SAFE: dict[type, type] = {}
_ORIGINAL: dict[type, type] = {}


def without_tuple_methods(kind: type) -> type:
    """Return a NamedTuple class without fields that are named like methods of a tuple."""
    fields = kind._fields  # type: ignore[attr-defined]
    if not set(UNSAFE) & set(fields):
        return kind
    if kind not in _SAFE:
        renamed = [(f"{name}_" if name in UNSAFE else name, Any) for name in fields]
        _SAFE[kind] = NamedTuple(kind.__name__, renamed)  # type: ignore
        _ORIGINAL[_SAFE[kind]] = kind
    return _SAFE[kind]


def original(kind: type) -> type:
    """Return the class from which `without_tuple_methods` made a class."""
    return _ORIGINAL.get(kind, kind)


def is_function(value: Any) -> bool:
    """Return whether a value is a plain or compiled Python function."""
    plain = getattr(value, "py_func", value)
    return isinstance(plain, FunctionType) and not isinstance(value, type)

"""Sizes of files, functions and classes, for the limits of tests/house/ratchets.toml."""

import ast
from collections.abc import Iterator

from tests.house.source_file import FUNCTION, SourceFile, walk

# where nine numbers are the entries of one thing, a 3x3 tensor, row by row
TENSORS = (
    "vgmpi/features/mixtures/gather.py",
    "vgmpi/materials/tensor_math/",
    "vgmpi/kernels/",
    "vgmpi/features/implicit_pressure/pressure_transfer.py",
    "vgmpi/solver/engines/cuda/",
    "vgmpi/gaussians/shape_evolution.py",
    "postprocess/studio/body_normals.py",
    "vgmpi/gaussians/compiled_evolution.py",
)


def count_arguments(function: FUNCTION) -> int:
    """Return the number of arguments; *args and **kwargs are one each."""
    args = function.args
    named = len(args.posonlyargs + args.args + args.kwonlyargs)
    return named + (args.vararg is not None) + (args.kwarg is not None)


def list_tuples(function: FUNCTION) -> list[int]:
    """Return the lengths of the tuples that a function returns or takes apart into names."""
    shown = []
    for node in walk(function):
        shown += [node.value] if isinstance(node, ast.Return) else []
        shown += [node] if isinstance(getattr(node, "ctx", None), ast.Store) else []
    return [len(node.elts) for node in shown if isinstance(node, ast.Tuple)]


def list_fields(cls: ast.ClassDef) -> list[ast.Name]:
    """Return the names that the body of a class declares."""
    targets = []
    for node in cls.body:
        targets += node.targets if isinstance(node, ast.Assign) else []
        targets += [node.target] if isinstance(node, ast.AnnAssign) else []
    return [target for target in targets if isinstance(target, ast.Name)]


def list_attributes(cls: ast.ClassDef) -> set[str]:
    """Return the names that the methods of a class assign to self."""
    return {
        node.attr
        for node in walk(cls)
        if isinstance(node, ast.Attribute)
        and isinstance(node.ctx, ast.Store)
        and getattr(node.value, "id", "") == "self"
    }


def count_members(cls: ast.ClassDef) -> int:
    """Return the number of fields of a NamedTuple or dataclass, or of attributes of a class."""
    parents = [ast.unparse(node) for node in cls.bases + cls.decorator_list]
    is_record = any("NamedTuple" in text or "dataclass" in text for text in parents)
    return max(len(list_fields(cls)) * is_record, len(list_attributes(cls)))


def measure_sizes(file: SourceFile) -> Iterator[tuple[str, str, int]]:
    """Yield limit, name and size of all that a file holds."""
    yield "lines of a file", file.path, len(file.text.splitlines())
    tensor = 9 if file.path.startswith(TENSORS) else 0
    for node in file.functions():
        name = f"{file.path}: {node.name}"
        yield "lines of a function", name, node.end_lineno - node.lineno + 1
        yield "arguments", name, count_arguments(node)
        for length in list_tuples(node):
            if length != tensor:
                yield "values in a row", name, length
    if file.is_of_program:
        for cls in file.classes():
            yield "members", f"{file.path}: {cls.name}", count_members(cls)

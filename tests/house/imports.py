"""Imports between modules, also those inside functions."""

import ast
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from types import MappingProxyType

from tests.house.source_file import SourceFile, name_module


def list_imports(file: SourceFile, is_module: Callable[[str], bool]) -> set[str]:
    """Return the full names of all modules that a file imports, itself apart.

    Args:
        file: File.
        is_module: Whether a full name is that of a module; names in modules are left out.
    """
    return _imported(file, file.nodes, is_module)


def _imported(file: SourceFile, nodes: Iterable, is_module: Callable[[str], bool]) -> set[str]:
    """Return the full names of the modules that some nodes of a file import."""
    package = name_module(f"{file.path.rpartition('/')[0]}/__init__.py").split(".")
    imported = set()
    for node in nodes:
        if isinstance(node, ast.Import):
            imported |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            parents = package[: len(package) - node.level + 1] if node.level else []
            origin = ".".join([*parents, *([node.module] if node.module else [])])
            inner = (f"{origin}.{alias.name}" for alias in node.names)
            imported |= {name if is_module(name) else origin for name in inner}
    return imported - {file.module}


def list_deferred_imports(file: SourceFile, is_module: Callable[[str], bool]) -> set[str]:
    """Return the modules that a file imports in functions alone: they are loaded when needed.

    Args:
        file: File.
        is_module: Whether a full name is that of a module.
    """
    functions = ast.FunctionDef, ast.AsyncFunctionDef
    deferred = {
        id(inner) for node in file.nodes if isinstance(node, functions) for inner in ast.walk(node)
    }
    nodes = [node for node in file.nodes if id(node) not in deferred]
    return list_imports(file, is_module) - _imported(file, nodes, is_module)


def find_single_importers(
    imports: Mapping[str, set[str]], deferred: Mapping[str, set[str]] = MappingProxyType({})
) -> list[str]:
    """Return the modules that exactly one other imports, one of the same folder.

    Args:
        imports: Modules that each module imports, by its name.
        deferred: Those that it imports in functions alone; they are apart for a reason.
    """
    importers = [(name, module) for module, names in imports.items() for name in names]
    count = Counter(name for name, _ in importers)
    return sorted(
        f"{name} <- {module}"
        for name, module in importers
        if count[name] == 1
        and name.rpartition(".")[0] == module.rpartition(".")[0]
        and name not in deferred.get(module, ())
    )

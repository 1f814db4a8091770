"""Imports between modules, also those inside functions."""

import ast
from collections import Counter
from collections.abc import Callable, Mapping

from tests.house.source_file import SourceFile, name_module


def list_imports(file: SourceFile, is_module: Callable[[str], bool]) -> set[str]:
    """Return the full names of all modules that a file imports, itself apart.

    Args:
        file: File.
        is_module: Whether a full name is that of a module; names in modules are left out.
    """
    package = name_module(f"{file.path.rpartition('/')[0]}/__init__.py").split(".")
    imported = set()
    for node in file.nodes:
        if isinstance(node, ast.Import):
            imported |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            parents = package[: len(package) - node.level + 1] if node.level else []
            origin = ".".join([*parents, *([node.module] if node.module else [])])
            inner = (f"{origin}.{alias.name}" for alias in node.names)
            imported |= {name if is_module(name) else origin for name in inner}
    return imported - {file.module}


def find_single_importers(imports: Mapping[str, set[str]]) -> list[str]:
    """Return the modules that exactly one other imports, one of the same folder.

    Args:
        imports: Modules that each module imports, by its name.
    """
    importers = [(name, module) for module, names in imports.items() for name in names]
    count = Counter(name for name, _ in importers)
    return sorted(
        f"{name} <- {module}"
        for name, module in importers
        if count[name] == 1 and name.rpartition(".")[0] == module.rpartition(".")[0]
    )

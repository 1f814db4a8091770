"""Private words as names, and names that only their place tells apart."""

import ast
from collections.abc import Iterator

from tests.house.sizes import list_fields
from tests.house.source_file import SourceFile

# as names these can neither be searched for nor understood without their module
PRIVATE = frozenset(
    "said told tell found given known seen made kept keep keeps held hold holds whole alike beside"
    " beyond apart near off of at here there thing things stuff taste liking room rest way ways one"
    " asked asks feel feels lets gives takes took come comes came went gone born stands standing"
    " lies shown sure far deep most least fewest farthest largest ahead behind around again anew"
    " whose every hues united as_one opens restores shares joins noted spread meets".split()
)
STEP_RESULTS = frozenset(["report", "reports", "maxima", "bounds", "reach"])
ROOMS_OF_THE_STEP = ("vgmpi/solver/", "vgmpi/kernels/", "vgmpi/engines/", "vgmpi/features/")


def find_names(file: SourceFile) -> Iterator[str]:
    """Yield arguments, variables, functions and classes that are private words."""
    fields = {id(target) for cls in file.classes() for target in list_fields(cls)}
    for node in file.functions():
        arguments = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
        names = [node.name, *(argument.arg for argument in arguments)]
        yield from (file.place(node, name) for name in names if name in PRIVATE)
    for node in file.classes():
        if node.name.lower() in PRIVATE:
            yield file.place(node, node.name)
    for node in file.nodes:
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store) and node.id in PRIVATE:
            if id(node) not in fields:
                yield file.place(node, node.id)


def find_fields(file: SourceFile) -> Iterator[str]:
    """Yield the fields of classes that are private words."""
    for cls in file.classes():
        for target in list_fields(cls):
            if target.id in PRIVATE:
                yield file.place(target, f"{cls.name}.{target.id}")


def find_attributes(file: SourceFile) -> Iterator[str]:
    """Yield the uses of attributes that are private words, but not NumPy's `np.add.at`."""
    for node in file.nodes:
        if isinstance(node, ast.Attribute) and node.attr in PRIVATE:
            if not ast.unparse(node).startswith("np."):
                yield file.place(node, f".{node.attr}")


def find_aliases(file: SourceFile) -> Iterator[str]:
    """Yield imports that give another name to what they import from a module, or a private one."""
    for node in file.nodes:
        if isinstance(node, ast.Import | ast.ImportFrom):
            for alias in node.names:
                is_renamed = isinstance(node, ast.ImportFrom) and alias.asname != alias.name
                if alias.asname and (is_renamed or alias.asname in PRIVATE):
                    yield file.place(node, f"{alias.name} as {alias.asname}")


def find_positions(file: SourceFile) -> Iterator[str]:
    """Yield results of a step that are read or written by their position: report[0]."""
    if not file.path.startswith(ROOMS_OF_THE_STEP):
        return
    for node in file.nodes:
        if isinstance(node, ast.Subscript):
            owner = getattr(node.value, "attr", getattr(node.value, "id", ""))
            numbers = [part for part in ast.walk(node.slice) if isinstance(part, ast.Constant)]
            is_number = numbers and not isinstance(node.slice, ast.Tuple)
            if (is_number and owner in STEP_RESULTS) or "MAXIMA_SLICE" in ast.unparse(node.slice):
                yield file.place(node, ast.unparse(node))

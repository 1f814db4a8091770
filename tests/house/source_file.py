"""Python files of the repository with their syntax trees."""

import ast
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
PROGRAM = ("vgmpi", "postprocess")  # vgmpi/postprocess is a link, which nothing here follows
FUNCTION = ast.FunctionDef | ast.AsyncFunctionDef


def walk(tree: ast.AST) -> list[ast.AST]:
    """Return a node and all below it, as `ast.walk` does in three times the time."""
    nodes = [tree]
    for node in nodes:
        for value in vars(node).values():
            if isinstance(value, ast.AST):
                nodes.append(value)
            elif isinstance(value, list):
                nodes += [inner for inner in value if isinstance(inner, ast.AST)]
    return nodes


class SourceFile:
    """Text, syntax tree and all nodes of one file.

    Args:
        path: Path from the root of the repository.
        text: Text of the file; read from the path if it is not given.
    """

    def __init__(self, path: str, text: str | None = None):
        self.path = path
        self.text = (ROOT / path).read_text() if text is None else text
        self.tree = ast.parse(self.text)
        self.nodes = walk(self.tree)

    @property
    def is_of_program(self) -> bool:
        """Whether the file is shipped: not a test, not a made scene."""
        return self.path.startswith(PROGRAM)

    @property
    def module(self) -> str:
        """Name of the module."""
        return name_module(self.path)

    def functions(self) -> Iterator[FUNCTION]:
        """Yield the functions, inner ones too."""
        return (node for node in self.nodes if isinstance(node, FUNCTION))

    def classes(self) -> Iterator[ast.ClassDef]:
        """Yield the classes."""
        return (node for node in self.nodes if isinstance(node, ast.ClassDef))

    def place(self, node: ast.AST, text: str) -> str:
        """Return "file:line: text" for a message."""
        return f"{self.path}:{node.lineno}: {text}"


def name_module(path: str) -> str:
    """Return the name of the module of a file: vgmpi.io for vgmpi/io/__init__.py.

    Modules of postprocess/ begin with vgmpi.postprocess, by the link in vgmpi.
    """
    name = path.removesuffix(".py").replace("/", ".").removesuffix(".__init__")
    return f"vgmpi.{name}" if path.startswith("postprocess/") else name


def list_files(*folders: str) -> list[str]:
    """Return the paths of all Python files in some folders, sorted."""
    files = [path for folder in folders for path in ROOT.glob(f"{folder}/**/*.py")]
    return sorted(str(path.relative_to(ROOT)) for path in files)

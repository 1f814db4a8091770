"""Names in docstrings and comments that name nothing: what they named was moved or renamed.

Three kinds are judged: dotted names (module.function, Class.method, record.field), constants
(MAX_SPEED) and names in backticks. The owner of a member is a folder, a module or a class. Any
other owner is a variable, whose members are all attributes that the program uses. What only tests
define does not count, apart from their modules.
"""

import ast
import builtins
import functools
import keyword
import re
import sys
from collections import defaultdict
from collections.abc import Iterator
from itertools import pairwise

from tests.house.sizes import list_attributes, list_fields
from tests.house.source_file import FUNCTION, PROGRAM, ROOT, SourceFile, name_module

DOTTED = re.compile(r"(?<![\w/.\"'-])[A-Za-z_]\w+(?:\.[A-Za-z_]\w*)++(?![\w/])")
BACKTICKS = re.compile(r"`([A-Za-z_]\w+)(?:\(\))?`")
CONSTANT = re.compile(r"(?<![\w.\"'/<{`-])([A-Z][A-Z0-9_]{2,}+)(?![\w'/`-]|\.\w)")
NAME = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*")
CLASS = re.compile(r"[A-Z]\w")  # or a constant
FILE_ENDING = re.compile(
    r"\.(py|toml|md|h5|csv|ply|obj|json|html|js|txt|log|lock|gz|png|jpg|mp4|usd[acz]?|npz|spz|sog|"
    r"gltf|glb|splat|vtkhdf|svg|exr|hdr|org|com|io|bin|pvd)$"
)
TEXT_OR_COMMENT = re.compile(
    r"\"\"\"[\s\S]*?\"\"\"|\"(?:\\.|[^\"\\\n])*\"|'(?:\\.|[^'\\\n])*'|(#[^\n]*)"
)
LINT_RULE = re.compile(r"^[A-Z]{1,4}\d{3}$")
OUTSIDE = {*sys.stdlib_module_names, *keyword.kwlist, *dir(builtins), "np", "IPython"}
# of other programs, files and systems
ACRONYMS = frozenset(
    "ASCE CIELAB EWA GCI ISPH NUMBA_DISABLE_JIT NVVM OBJ PLY PRIVATE_PARTS PR_SET_PDEATHSIG"
    " PTX RMS SCA SIGPIPE URL XML".split()
)


class Definitions:
    """Names that a set of files defines."""

    def __init__(self) -> None:
        self.members: defaultdict[str, set[str]] = defaultdict(set)  # of folder, module or class
        self.top_level: set[str] = set()  # functions and classes of modules
        self.attributes: set[str] = set()  # of anything, and keys of tables
        self.words: set[str] = set()  # names of any kind
        self.packages: set[str] = set()  # of other people, and what they are imported for

    def add(self, file: SourceFile) -> set[str]:
        """Add what a file defines, and return the variables and keys that it uses."""
        self.add_path(file.path)
        module = file.module.split(".")[-1]
        for node in file.tree.body:
            self.members[module] |= names_of(node)
            if isinstance(node, FUNCTION | ast.ClassDef):
                self.top_level.add(node.name)
        for cls in file.classes():
            methods = {node.name for node in cls.body if isinstance(node, FUNCTION)}
            fields = {target.id for target in list_fields(cls)}
            members = methods | fields | list_attributes(cls)
            self.members[cls.name] |= members
            self.attributes |= members
        for node in file.nodes:
            if isinstance(node, ast.Import):
                self.packages |= {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and not node.level:
                if not node.module.startswith(PROGRAM):
                    self.packages.add(node.module.split(".")[0])
                    self.packages |= {a.name for a in node.names if CLASS.match(a.name)}
        variables, keys = list_variables(file), list_keys(file)
        if file.path.endswith("__init__.py"):
            self.members[module] |= keys  # names that are imported when asked for
        self.attributes |= keys | {n.attr for n in file.nodes if isinstance(n, ast.Attribute)}
        self.words |= variables | keys | self.members[module] | {module}
        return variables | keys

    def list_members(self, owner: str) -> set[str]:
        """Return the members of a folder, module, class, instance named like its class, or any."""
        cls = owner.title().replace("_", "")
        if owner in self.members or cls in self.members:
            return self.members.get(owner, set()) | self.members.get(cls, set())
        return self.attributes

    def add_path(self, path: str) -> None:
        """Add a module, but nothing that it defines, to its folders."""
        for folder, inner in pairwise(name_module(path).split(".")):
            self.members[folder].add(inner)


def names_of(statement: ast.stmt) -> set[str]:
    """Return the names that a statement binds where it stands."""
    if isinstance(statement, FUNCTION | ast.ClassDef):
        return {statement.name}
    if isinstance(statement, ast.Import | ast.ImportFrom):
        return {alias.asname or alias.name for alias in statement.names}
    nodes = [node for node in ast.walk(statement) if isinstance(node, ast.Name)]
    return {node.id for node in nodes if isinstance(node.ctx, ast.Store)}


def list_variables(file: SourceFile) -> set[str]:
    """Return the identifiers that a file uses."""
    names = set()
    for node in file.nodes:
        match node:
            case ast.Name(id=name) | ast.Attribute(attr=name) | ast.arg(arg=name):
                names.add(name)
            case ast.FunctionDef(name=name) | ast.ClassDef(name=name):
                names.add(name)
            case ast.alias():
                names.add(node.asname or node.name)
    return names


def list_keys(file: SourceFile) -> set[str]:
    """Return the names of keyword arguments, and the texts of code that are a name."""
    keys = set()
    for node in file.nodes:
        match node:
            case ast.keyword(arg=str(name)):
                keys.add(name)
            case ast.Constant(value=str(text)) if NAME.fullmatch(text):
                keys.add(text)
    return keys


def read_prose(file: SourceFile) -> Iterator[tuple[int, str]]:
    """Yield the line and the text of each docstring and comment."""
    for node in file.nodes:
        if isinstance(node, FUNCTION | ast.ClassDef | ast.Module):
            text = ast.get_docstring(node, clean=False)
            if text:
                yield node.body[0].lineno, text
    for match in TEXT_OR_COMMENT.finditer(file.text):
        if match[1]:
            yield file.text.count("\n", 0, match.start()) + 1, match[1]


@functools.cache
def list_outside_words() -> frozenset[str]:
    """Return words of Python, ACRONYMS, and the words in capitals that the pages use."""
    pages = [*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")]
    capitals = re.compile(r"\b[A-Z][A-Z0-9_]{2,}\b")
    words = {word for page in pages for word in capitals.findall(page.read_text())}
    return ACRONYMS.union(words, OUTSIDE)


def is_dotted_name_known(name: str, text: str, words: set[str], known: Definitions) -> bool:
    """Return whether a dotted name names something.

    Args:
        name: Dotted name.
        text: Docstrings and comments of the file; their examples have variables of their own.
        words: Variables and keys of the file.
        known: What the files define.
    """
    first, *rest = parts = name.split(".")
    if FILE_ENDING.search(name) or name in words:
        return True
    if first in OUTSIDE or first in known.packages - set(PROGRAM):
        return True
    are_attributes = known.attributes.issuperset(rest) and not any(map(CLASS.match, rest))
    if first in words or re.search(rf"\b(as|for|in) {first}\b|\b{first} =", text):
        if are_attributes:
            return True
    if first in known.members:
        return all(inner in known.list_members(owner) for owner, inner in pairwise(parts))
    return are_attributes and first in known.words and rest[-1] not in known.top_level


def find_ghosts(
    path: str, prose: list[tuple[int, str]], words: set[str], known: Definitions
) -> Iterator[str]:
    """Yield the names in the prose of a file that name nothing.

    Args:
        path: Path of the file.
        prose: Line and text of each docstring and comment.
        words: Variables and keys of the file.
        known: What all files define.
    """
    examples = "\n".join(text for _, text in prose)
    for line, text in prose:
        for match in DOTTED.finditer(text):
            if not is_dotted_name_known(match[0], examples, words, known):
                yield f"{path}:{line + text.count(chr(10), 0, match.start())}: {match[0]}"
        for match in [*CONSTANT.finditer(text), *BACKTICKS.finditer(text)]:
            if match[1] not in known.words and not LINT_RULE.match(match[1]):
                yield f"{path}:{line + text.count(chr(10), 0, match.start())}: {match[1]}"

"""Digests of the sources that compiled code can see: a module and all that it imports.

Modules are followed within their own package and into vgmpi. A name that a module uses in
annotations alone is not followed: compiled code does not see annotations.

A process need not parse what another has parsed: the imports of each source are kept in one file in
the user's cache folder, a line of JSON per source, by the digest of its text, with a checksum. A
damaged line counts as absent; several processes may append at once.
"""

import ast
import functools
import hashlib
import json
import os
import sys
import time
import zlib
from collections.abc import Iterable, Iterator
from pathlib import Path

from .cache_files import user_folder

_OWN = __name__.split(".")[0]
_STARTED = time.time()
Entry = tuple[list[tuple[str, str]], list[str]]  # imports (local, full), names in annotations
MAX_BYTES = 16 << 20  # [bytes] a larger file is begun anew


class SourceError(Exception):
    """Source that cannot be read, or is no longer what this process has imported."""


def sources_seen_by(modules: Iterable[str]) -> dict[str, str]:
    """Return the digests of modules and of all modules that they import, by name.

    Raises:
        SourceError: If one of them has no source, or one that has changed since this process began:
            what is in memory is not what is on disk.
    """
    digests: dict[str, str] = {}
    todo = list(modules)
    while todo:
        name = todo.pop()
        if name not in digests:
            path = module_path(name)
            if path is None:
                raise SourceError(f"module {name} has no source file")
            digests[name] = _parsed(name, path).digest
            todo.extend(_neighbours(name))
    return dict(sorted(digests.items()))


@functools.cache
def module_path(name: str) -> Path | None:
    """Return the source file of a module, or None; the module need not be imported."""
    loaded = getattr(sys.modules.get(name), "__file__", None)
    if loaded is not None:
        return Path(loaded) if loaded.endswith(".py") else None
    top = sys.modules.get(name.split(".")[0])
    below = name.split(".")[1:]
    for folder in getattr(top, "__path__", ()):
        path = Path(folder, *below)
        for file in (path.with_suffix(".py"), path / "__init__.py"):
            if below and file.is_file():
                return file
    return None


class _Parsed:
    """Digest and imports of one source file."""

    def __init__(self, name: str, path: Path):
        try:
            text = path.read_bytes()
            changed = os.stat(path).st_ctime  # not set by copies that keep the time of a file
        except OSError as error:
            raise SourceError(f"{path}: {error.strerror}") from error
        if changed > _STARTED:
            raise SourceError(f"{path} has changed since this process began")
        self.digest = hashlib.sha256(text).hexdigest()[:32]
        package = name.split(".") if path.name == "__init__.py" else name.split(".")[:-1]
        key = f"{self.digest} {'.'.join(package)}"
        entry = _read_entry(key)
        if entry is None:
            try:
                tree = ast.parse(text)
            except (SyntaxError, ValueError) as error:
                raise SourceError(f"{path}: {error}") from error
            names = _Names(package)
            names.visit(tree)
            entry = names.imports, sorted(names.in_annotations - names.elsewhere)
            _write_entry(key, entry)
        self.imports, self.annotated = entry[0], set(entry[1])


@functools.cache
def _parsed(name: str, path: Path) -> _Parsed:
    return _Parsed(name, path)


@functools.cache
def _neighbours(name: str) -> frozenset[str]:
    """Return the modules that a module imports itself, and the packages that it is in."""
    path = module_path(name)
    assert path is not None
    parsed = _parsed(name, path)
    origins = {name}  # and the packages that it is in
    for local, full in parsed.imports:
        if local not in parsed.annotated:
            origins.add(full)
            origins.update(_passed_on(full))
    tops = {_OWN, name.split(".")[0]}
    modules = set()
    for full in origins:
        words = full.split(".")
        if words[0] in tops:
            for length in range(1, len(words) + 1):
                module = ".".join(words[:length])
                if module_path(module) is not None:
                    modules.add(module)
    return frozenset(modules - {name})


def _passed_on(full: str) -> Iterator[str]:
    """Yield the full name of what `full` is in turn, where its module has imported it itself."""
    module, _, name = full.rpartition(".")
    if module.split(".")[0] == _OWN and module_path(full) is None:
        path = module_path(module)
        for local, origin in _parsed(module, path).imports if path is not None else ():
            if local == name and origin != full:
                yield origin
                yield from _passed_on(origin)


class _Names(ast.NodeVisitor):
    """Imports of a module, in functions too, and names that it uses in annotations or elsewhere.

    `imports` has (name in this module, full name).
    """

    def __init__(self, package: list[str]):
        self.package = package
        self.imports: list[tuple[str, str]] = []
        self.elsewhere: set[str] = set()
        self.in_annotations: set[str] = set()
        self.current = self.elsewhere

    def visit_Name(self, node: ast.Name) -> None:
        """Note a name."""
        self.current.add(node.id)

    def visit_Constant(self, node: ast.Constant) -> None:
        """Pass over a constant."""

    def visit_Import(self, node: ast.Import) -> None:
        """Note modules; `import a.b` binds a, and what is used of it is not known."""
        self.imports += ((alias.asname or alias.name, alias.name) for alias in node.names)

    def visit_ImportFrom(self, node: ast.ImportFrom) -> None:
        """Note names of a module."""
        base = self.package[: len(self.package) - node.level + 1] if node.level else []
        origin = ".".join([*base, *([node.module] if node.module else [])])
        self.imports += (
            (alias.asname or alias.name, f"{origin}.{alias.name}") for alias in node.names
        )

    def visit_arg(self, node: ast.arg) -> None:
        """Note the annotation of an argument."""
        self._annotation(node.annotation)

    def visit_FunctionDef(self, node: ast.FunctionDef) -> None:
        """Note the annotation of a result apart from the rest."""
        self._annotation(node.returns)
        for inner in (*node.decorator_list, node.args, *node.body):
            self.visit(inner)

    def visit_AnnAssign(self, node: ast.AnnAssign) -> None:
        """Note the annotation of a variable or a field apart from its value."""
        self._annotation(node.annotation)
        self.visit(node.target)
        if node.value is not None:
            self.visit(node.value)

    def _annotation(self, node: ast.AST | None) -> None:
        if node is not None:
            outer, self.current = self.current, self.in_annotations
            self.visit(node)
            self.current = outer


def store_path() -> Path:
    """Return the path of the store."""
    return user_folder() / "imports.jsonl"


def _read_entry(key: str) -> Entry | None:
    """Return the entry of a key, or None."""
    return _stored_entries().get(key)


def _write_entry(key: str, entry: Entry) -> None:
    """Append an entry; a folder that cannot be written keeps none."""
    _stored_entries()[key] = entry
    text = json.dumps([key, entry[0], entry[1]])
    line = f"{zlib.crc32(text.encode()):08x} {text}\n".encode()
    path = store_path()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.exists() and path.stat().st_size > MAX_BYTES:
            path.unlink()
        handle = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
    except OSError:
        return
    try:
        os.write(handle, line)  # one call: lines of several processes do not mix
    except OSError:
        pass
    finally:
        os.close(handle)


@functools.cache
def _stored_entries() -> dict[str, Entry]:
    """Return the entries on disk, by key."""
    try:
        lines = store_path().read_bytes().splitlines()
    except OSError:
        return {}
    entries: dict[str, Entry] = {}
    for line in lines:
        checksum, _, text = line.partition(b" ")
        if checksum == b"%08x" % zlib.crc32(text):
            key, imports, annotated = json.loads(text)
            entries[key] = [(local, full) for local, full in imports], annotated
    return entries

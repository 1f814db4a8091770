"""Names and docstrings that a stranger of the field can read: CONTRIBUTING.md has the rules."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FILES = sorted(
    str(path.relative_to(ROOT))
    for top in ("vgmpi", "postprocess")
    for path in (ROOT / top).rglob("*.py")
    if "old_paths" not in path.parts
)
# as names these can neither be searched for nor understood without their module
PRIVATE = frozenset(
    "said told tell found given known seen made kept keep held whole alike beside apart near off of"
    " at here there thing things stuff taste liking room rest way ways one asked asks feel feels"
    " lets gives takes took come comes came went gone born stands standing lies shown sure far deep"
    " most least fewest farthest largest ahead behind around again anew".split()
)
# keys of files, fields of records and one method that h5py asks for; none may be added
KEPT_NAMES = 60
OPENING = re.compile(
    r"^(what|of|those|these|that|which|the same|as|also|how|whether|where|from|with|by|told|once"
    r"|per)\b",
    re.IGNORECASE,
)
SECTION = re.compile(r"^\s*(Args|Returns|Attributes|Yields|Raises)\s*:\s*$", re.MULTILINE)
FUNCTION = ast.FunctionDef | ast.AsyncFunctionDef
SECTIONS_MISSING = 20


def trees():
    """Yield every file with its syntax tree."""
    for file in FILES:
        yield file, ast.parse((ROOT / file).read_text())


def private_names(tree):
    """Yield the private words that name arguments, variables, functions and classes."""
    for node in ast.walk(tree):
        if isinstance(node, FUNCTION):
            parameters = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
            yield from (a.arg for a in parameters if a.arg in PRIVATE)
            if node.name in PRIVATE:
                yield node.name
        elif isinstance(node, ast.ClassDef) and node.name.lower() in PRIVATE:
            yield node.name
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store) and node.id in PRIVATE:
            yield node.id


def undocumented(file, tree):
    """Yield what is public and has no docstring."""
    if ast.get_docstring(tree) is None and not file.endswith("__init__.py"):
        yield file
    for node in ast.walk(tree):
        if isinstance(node, FUNCTION | ast.ClassDef) and not node.name.startswith("_"):
            if ast.get_docstring(node) is None:
                yield f"{file}: {node.name}"


def openings(tree):
    """Yield docstrings that open with a pronoun, a preposition or a participle."""
    for node in ast.walk(tree):
        if isinstance(node, FUNCTION | ast.ClassDef) and OPENING.match(
            ast.get_docstring(node) or ""
        ):
            yield ast.get_docstring(node).splitlines()[0]


def without_sections(tree):
    """Yield public functions of more than three arguments that do not explain them."""
    for node in ast.walk(tree):
        if isinstance(node, FUNCTION) and not node.name.startswith("_"):
            documentation = ast.get_docstring(node)
            count = len(node.args.args) + len(node.args.kwonlyargs)
            if documentation and count > 3 and not SECTION.search(documentation):
                yield node.name


def test_names_are_words_of_the_field():
    names = [(file, name) for file, tree in trees() for name in private_names(tree)]
    assert len(names) <= KEPT_NAMES, names


def test_modules_are_not_private_words_and_have_names_of_their_own():
    stems = [Path(file).stem for file in FILES if "__" not in file]
    assert not PRIVATE & set(stems)
    twins = [file for file in FILES if "engines" not in file and "kernels" not in file]
    outside = [Path(file).stem for file in twins if "__" not in file]
    assert [stem for stem in set(outside) if stems.count(stem) > 1] == []


def test_all_that_is_public_has_a_docstring():
    assert [name for file, tree in trees() for name in undocumented(file, tree)] == []


def test_docstrings_open_with_a_verb_or_a_noun():
    assert [line for _, tree in trees() for line in openings(tree)] == []


def test_functions_of_many_arguments_explain_them():
    names = [(file, name) for file, tree in trees() for name in without_sections(tree)]
    assert len(names) <= SECTIONS_MISSING, names


@pytest.mark.parametrize(
    "text, rule",
    [
        ("def f(given): ...", private_names),
        ("for one in x: ...", private_names),
        ("class Known: ...", private_names),
        ("def told(): ...", private_names),
        ("class A:\n    near: int", private_names),
        ('def f():\n    """What it does."""', openings),
        ('class A:\n    """Of what was found."""', openings),
        ('def f(a, b, c, d):\n    """Add."""', without_sections),
        ("def f(): ...", lambda tree: undocumented("made_up.py", tree)),
    ],
)
def test_a_rule_sees_what_breaks_it(text, rule):
    assert list(rule(ast.parse(text)))


def test_a_rule_leaves_good_names_alone():
    body = '    """Add.\n\n    Args:\n        a: Number.\n    """'
    text = f'"""Module."""\n\n\ndef f(a, b, c, d):\n{body}'
    tree = ast.parse(text)
    rules = (private_names, openings, without_sections, lambda tree: undocumented("a.py", tree))
    assert [found for rule in rules for found in rule(tree)] == []

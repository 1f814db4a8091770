"""Names of modules, and docstrings that a stranger of the field can read: CONTRIBUTING.md.

Other names: tests/house/words.py.
"""

import ast
import re
from pathlib import Path

import pytest

from tests.house.source_file import FUNCTION, PROGRAM, ROOT, list_files
from tests.house.words import PRIVATE

FILES = [path for path in list_files(*PROGRAM) if "old_paths" not in path]
OPENING = re.compile(
    r"^(what|of|those|these|that|which|the same|as|also|how|whether|where|from|with|by|told|once"
    r"|per)\b",
    re.IGNORECASE,
)
SECTION = re.compile(r"^\s*(Args|Returns|Attributes|Yields|Raises)\s*:\s*$", re.MULTILINE)
SECTIONS_MISSING = 20


def trees():
    """Yield every file with its syntax tree."""
    for file in FILES:
        yield file, ast.parse((ROOT / file).read_text())


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
    rules = (openings, without_sections, lambda tree: undocumented("a.py", tree))
    assert [found for rule in rules for found in rule(tree)] == []

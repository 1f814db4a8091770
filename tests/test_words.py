"""Names of modules, and docstrings that a stranger of the field can read: CONTRIBUTING.md.

Other names: tests/house/words.py.
"""

import ast
import functools
import re
from pathlib import Path

import pytest

from tests.house.source_file import PROGRAM, SourceFile, list_files
from tests.house.words import PRIVATE

FILES = list_files(*PROGRAM)
OPENING = re.compile(
    r"^(what|of|those|these|that|which|the same|as|also|how|whether|where|from|with|by|told|once"
    r"|per)\b",
    re.IGNORECASE,
)
SECTION = re.compile(r"^\s*(Args|Returns|Attributes|Yields|Raises)\s*:\s*$", re.MULTILINE)
SECTIONS_MISSING = 20


def undocumented(file):
    """Yield what is public and has no docstring."""
    if ast.get_docstring(file.tree) is None and not file.path.endswith("__init__.py"):
        yield file.path
    for node in [*file.functions(), *file.classes()]:
        if not node.name.startswith("_") and ast.get_docstring(node) is None:
            yield file.place(node, node.name)


def openings(file):
    """Yield docstrings that open with a pronoun, a preposition or a participle."""
    for node in [*file.functions(), *file.classes()]:
        text = ast.get_docstring(node) or ""
        if OPENING.match(text):
            yield file.place(node, text.splitlines()[0])


def without_sections(file):
    """Yield public functions of more than three arguments that do not explain them."""
    for node in file.functions():
        documentation = ast.get_docstring(node)
        count = len(node.args.args) + len(node.args.kwonlyargs)
        is_judged = documentation and count > 3 and not node.name.startswith("_")
        if is_judged and not SECTION.search(documentation):
            yield file.place(node, node.name)


RULES = (undocumented, openings, without_sections)


@functools.cache
def places():
    """Return what each rule finds; each file is read once."""
    found = {rule: [] for rule in RULES}
    for path in FILES:
        file = SourceFile(path)
        for rule in RULES:
            found[rule] += rule(file)
    return found


def test_modules_are_not_private_words_and_have_names_of_their_own():
    # files of features have the same names, which say their parts: feature, plan, coupling
    files = [file for file in FILES if "__" not in file and "vgmpi/features/" not in file]
    stems = [Path(file).stem for file in files]
    assert not PRIVATE & set(stems)
    outside = [Path(file).stem for file in files if "engines" not in file and "kernels" not in file]
    assert [stem for stem in set(outside) if stems.count(stem) > 1] == []


def test_all_that_is_public_has_a_docstring():
    assert places()[undocumented] == []


def test_docstrings_open_with_a_verb_or_a_noun():
    assert places()[openings] == []


def test_functions_of_many_arguments_explain_them():
    assert len(places()[without_sections]) <= SECTIONS_MISSING, places()[without_sections]


@pytest.mark.parametrize(
    "text, rule",
    [
        ('def f():\n    """What it does."""', openings),
        ('class A:\n    """Of what was found."""', openings),
        ('def f(a, b, c, d):\n    """Add."""', without_sections),
        ("def f(): ...", undocumented),
    ],
)
def test_a_rule_sees_what_breaks_it(text, rule):
    assert list(rule(SourceFile("made_up.py", text)))


def test_a_rule_leaves_good_names_alone():
    body = '    """Add.\n\n    Args:\n        a: Number.\n    """'
    text = f'"""Module."""\n\n\ndef f(a, b, c, d):\n{body}'
    assert [found for rule in RULES for found in rule(SourceFile("a.py", text))] == []

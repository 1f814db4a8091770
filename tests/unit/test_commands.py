"""The commands that an installation puts on the path."""

import ast
import importlib
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SCRIPTS = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]
# python -m postprocess.bench measures, for docs/rendering.md only
NO_COMMAND = {"postprocess/bench.py"}


def test_every_program_has_a_command():
    programs = [
        ROOT / "vgmpi" / of / "__main__.py"
        for of in (".", "bench", "convert", "fit", "images", "study")
    ]
    for path in (ROOT / "postprocess").glob("*.py"):
        tree = ast.parse(path.read_text())
        if any(isinstance(n, ast.If) and "__name__" in ast.unparse(n.test) for n in tree.body):
            programs.append(path)
    wanted = {str(path.relative_to(ROOT)) for path in programs} - NO_COMMAND
    modules = {target.partition(":")[0] for target in SCRIPTS.values()}
    files = {f"{module.replace('.', '/')}.py" for module in modules}
    assert files == wanted


@pytest.mark.parametrize("name", SCRIPTS)
def test_a_command_says_its_help(name, monkeypatch, capsys):
    monkeypatch.setattr("gc.freeze", lambda: None)  # for a process of its own
    monkeypatch.setattr(sys, "argv", [name, "--help"])
    module, _, function = SCRIPTS[name].partition(":")
    command = getattr(importlib.import_module(module), function)
    try:
        code = command()
    except SystemExit as end:
        code = end.code
    said = capsys.readouterr()
    assert not code and len(said.out) > 200 and said.err == ""

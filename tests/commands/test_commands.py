"""The command `vgmpi`: its subcommands and their help."""

import importlib
import tomllib
from pathlib import Path

import pytest

from vgmpi.commands import command_table

ROOT = Path(__file__).parents[2]
SCREEN = 60  # lines of help


def test_an_installation_has_one_command():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert project["scripts"] == {"vgmpi": "vgmpi.__main__:main"}


def test_help_lists_all_commands(capsys):
    assert command_table.main(["--help"]) == 0
    text = capsys.readouterr().out
    assert all(f"\n  {name} " in text for name in command_table.COMMANDS)
    assert len(text.splitlines()) <= 40


@pytest.mark.parametrize("name", command_table.COMMANDS)
def test_a_command_prints_its_help(name, monkeypatch, capsys):
    monkeypatch.setattr("gc.freeze", lambda: None)  # for a process of its own
    try:
        code = command_table.main([name, "--help"])
    except SystemExit as end:
        code = end.code
    printed = capsys.readouterr()
    assert not code and len(printed.out) > 200 and printed.err == ""
    assert len(printed.out.splitlines()) <= SCREEN


def test_a_command_that_lacks_a_package_says_which(monkeypatch, capsys):
    def absent(name):
        raise ModuleNotFoundError("No module named 'viser'", name="viser")

    monkeypatch.setattr(importlib, "import_module", absent)
    assert command_table.main(["live"]) == 2
    assert capsys.readouterr().err == "vgmpi live: the package viser is not installed\n"


def test_what_is_no_command_is_a_scene(tmp_path, capsys):
    assert command_table.main([str(tmp_path / "none.toml"), "--check"]) == 2
    assert "none.toml" in capsys.readouterr().err
    assert command_table.main(["check", str(tmp_path / "none.toml")]) == 2
    assert "none.toml" in capsys.readouterr().err

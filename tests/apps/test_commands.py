"""The command `vgmpi`: its subcommands, their help, and the paths of earlier releases."""

import importlib
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from tests.support.launch import run
from vgmpi.apps import commands

ROOT = Path(__file__).parents[2]
SCREEN = 60  # lines of help


def test_an_installation_has_one_command():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert project["scripts"] == {"vgmpi": "vgmpi.__main__:main"}


def test_help_lists_all_commands(capsys):
    assert commands.main(["--help"]) == 0
    text = capsys.readouterr().out
    assert all(f"\n  {name} " in text for name in commands.COMMANDS)
    assert len(text.splitlines()) <= 40


@pytest.mark.parametrize("name", commands.COMMANDS)
def test_a_command_prints_its_help(name, monkeypatch, capsys):
    monkeypatch.setattr("gc.freeze", lambda: None)  # for a process of its own
    try:
        code = commands.main([name, "--help"])
    except SystemExit as end:
        code = end.code
    printed = capsys.readouterr()
    assert not code and len(printed.out) > 200 and printed.err == ""
    assert len(printed.out.splitlines()) <= SCREEN


def test_a_command_that_lacks_a_package_says_which(monkeypatch, capsys):
    def absent(name):
        raise ModuleNotFoundError("No module named 'viser'", name="viser")

    monkeypatch.setattr(importlib, "import_module", absent)
    assert commands.main(["replay"]) == 2
    assert capsys.readouterr().err == "vgmpi replay: the package viser is not installed\n"


def test_what_is_no_command_is_a_scene(tmp_path, capsys):
    assert commands.main([str(tmp_path / "none.toml"), "--check"]) == 2
    assert "none.toml" in capsys.readouterr().err
    assert commands.main(["check", str(tmp_path / "none.toml")]) == 2
    assert "none.toml" in capsys.readouterr().err


@pytest.mark.parametrize("old, new", [("fit", "fit"), ("images", "photo"), ("study", "tradeoff")])
def test_the_modules_of_earlier_releases_run_and_name_the_command(old, new):
    done = run([sys.executable, "-m", f"vgmpi.{old}", "--help"], cwd=ROOT)
    assert done.returncode == 0 and len(done.stdout) > 100
    assert done.stderr == f"python -m vgmpi.{old} is now: vgmpi {new}\n"


@pytest.mark.parametrize("old, new", [("read", "run_reader"), ("layout", "file_layout")])
def test_the_imports_of_earlier_releases_work_and_name_the_module(old, new):
    names = "public = [n for n in dir(b) if n[0] != '_']; print(all(hasattr(a, n) for n in public))"
    code = f"import vgmpi.output.{old} as a, vgmpi.io.{new} as b; {names}"
    command = [sys.executable, "-W", "always::DeprecationWarning", "-c", code]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.stdout == "True\n"
    assert f"vgmpi.output.{old} is now vgmpi.io.{new}" in done.stderr

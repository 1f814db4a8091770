"""Names that are data: what is looked up by the name of a module, a folder or a file is there.

What moves or is called otherwise would else be missed in silence: other rounding on a card,
a table that is not in the wheel, a command that a page names in vain.
"""

import fnmatch
import importlib.util
import re
import subprocess
import tomllib
from pathlib import Path

import pytest

from vgmpi import materials
from vgmpi.materials import couplings

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())


def tracked():
    """Files of the repository, as paths from its root."""
    listed = subprocess.run(
        ["git", "ls-files", "-co", "--exclude-standard"], cwd=ROOT, capture_output=True, text=True
    )
    return [name for name in listed.stdout.splitlines() if (ROOT / name).is_file()]


FILES = tracked()
TEXTS = (".py", ".md", ".toml", ".yml", ".sh", ".sbatch", ".def", "Makefile", ".ci/run")
# these tests make up files
BUT = ("test_house.py", "test_ratchets.py", "test_validation.py")
PAGES = [name for name in FILES if name.endswith(TEXTS) and not name.endswith(BUT)]


def test_kinds_come_in_an_order_of_their_own():
    """That of files would decide which of two kinds has a preset, and the order of pages."""
    for registry in (materials.registry, couplings.registry):
        assert list(registry) == sorted(registry)
    assert len(materials.registry) == 9 and len(couplings.registry) == 5


def test_what_is_no_python_is_in_the_wheel():
    named = PROJECT["tool"]["setuptools"]["package-data"]["vgmpi"]
    data = [
        name.removeprefix("vgmpi/")
        for name in FILES
        if name.startswith(("vgmpi/", "postprocess/")) and not name.endswith((".py", ".md"))
    ]
    assert data and all(any(fnmatch.fnmatch(one, some) for some in named) for one in data)
    assert all(any(fnmatch.fnmatch(one, some) for one in data) for some in named)


def paths_of_the_project():
    """Paths and modules that pyproject.toml names."""
    tools = PROJECT["tool"]
    yield from tools["ruff"]["lint"]["per-file-ignores"]
    yield from tools["mypy"]["files"]
    for one in tools["mypy"]["overrides"]:
        for module in one["module"]:
            if module.startswith("vgmpi"):
                yield module.replace(".", "/") + ".py"


@pytest.mark.parametrize("path", list(paths_of_the_project()))
def test_the_project_names_files_that_are_there(path):
    assert list(ROOT.glob(path))


@pytest.mark.parametrize("name", PAGES)
def test_commands_and_files_that_a_text_names_are_there(name):
    text = (ROOT / name).read_text()
    modules = set(re.findall(r"-m ((?:vgmpi|postprocess|tests)(?:\.\w+)*)", text))
    assert [one for one in modules if not is_module(one)] == []
    files = set(re.findall(r"(?<![\w/.-])(?:vgmpi|postprocess|tests)/[\w/]+\.(?:py|csv)\b", text))
    assert [one for one in files if not (ROOT / one).exists()] == []


def is_module(name):
    if name.startswith("postprocess"):
        return False  # its name is vgmpi.postprocess
    try:
        return importlib.util.find_spec(name) is not None
    except ModuleNotFoundError:
        return False

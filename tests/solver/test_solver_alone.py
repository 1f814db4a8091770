"""The solver needs neither the tools nor the renderer: a copy of the program without them runs."""

import shutil
import sys
from pathlib import Path

import pytest

import vgmpi
from tests.support import launch
from tests.support.small_scenes import PEBBLE
from vgmpi.io.run_reader import RunReader

PACKAGE = Path(vgmpi.__file__).parent
ABSENT = ("tools", "postprocess")
# an installed program would stand in for what the copy lacks
ALONE = f"""
import importlib, pkgutil, runpy, sys
for name in {ABSENT}:
    sys.modules["vgmpi." + name] = None
import vgmpi
"""
IMPORT_ALL = """
for found in pkgutil.walk_packages(vgmpi.__path__, "vgmpi."):
    if not found.name.endswith("__main__"):
        try:
            importlib.import_module(found.name)
        except ModuleNotFoundError as error:
            if error.name.startswith("vgmpi"):
                print(found.name)
"""
RUN = """
sys.argv[0] = "vgmpi"
runpy.run_module("vgmpi", run_name="__main__", alter_sys=True)
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Folder with a copy of the package in which the tools and the renderer are absent."""
    folder = tmp_path_factory.mktemp("alone")

    def skipped(where, names):
        return {"__pycache__", *(ABSENT if Path(where) == PACKAGE else ())}.intersection(names)

    shutil.copytree(PACKAGE, folder / "vgmpi", ignore=skipped)
    return folder


def call(folder, program, *words):
    """Run a program of Python with the copy."""
    program = ALONE + f"assert vgmpi.__path__ == [{str(folder / 'vgmpi')!r}]\n" + program
    command = [sys.executable, "-c", program, *words]
    job = launch.run(command, env={"PYTHONPATH": str(folder)}, cwd=folder)
    assert job.returncode == 0, job.stderr
    return job.stdout


def test_only_pruning_and_tools_import_the_renderer(folder):
    assert call(folder, IMPORT_ALL).split() == ["vgmpi.preprocess.pruning.image_similarity"]


def test_a_scene_runs(folder):
    (folder / "scene.toml").write_text(PEBBLE.replace("end = 0.1", "end = 0.004\nframes = 2"))
    call(folder, RUN, "scene.toml", "-o", "out", "-q")
    assert len(RunReader(folder / "out")) == 2

"""Every scene in runs/ is right as it stands, with the files that its error says how to make."""

import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from vgmpi.preprocess.scene_builder import build_scene
from vgmpi.runtime.config.schema import SceneError
from vgmpi.scene.loader import load

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = sorted(p.parent.name for p in (ROOT / "runs").glob("*/scene.toml"))
MADE = ("ablation", "balls_duck", "capture", "faucet", "faucet_ducks", "splash")  # with Gaussians
FEWER = ("--gaussians", "12000")  # enough to see that a scene is right


@pytest.fixture(scope="module")
def clone(tmp_path_factory):
    """A folder with runs/ as it comes: without what was made there."""
    folder = tmp_path_factory.mktemp("clone of it")
    left_out = shutil.ignore_patterns("out", "assets", "__pycache__")
    for name in EXAMPLES:
        shutil.copytree(ROOT / "runs" / name, folder / "runs" / name, ignore=left_out)
    (folder / "runs" / "assets").mkdir()
    shutil.copy(ROOT / "runs" / "assets" / "make_assets.py", folder / "runs" / "assets")
    return folder


def command(line):
    """The words of the command that an error names; it begins with python."""
    said = line.partition("; ")[2]
    assert said.startswith("python ") and said.endswith(" makes it"), line
    return shlex.split(said.removesuffix(" makes it"))


def refused(path, overrides=()):
    with pytest.raises(SceneError) as caught:
        load(path, overrides)
    return caught.value.lines


@pytest.mark.parametrize("name", EXAMPLES)
def test_a_fresh_clone_is_told_how_to_make_what_its_scenes_need(clone, monkeypatch, name):
    monkeypatch.chdir(clone)
    path = Path("runs", name, "scene.toml")
    if name in MADE:
        lines = refused(path)
        made = {tuple(command(line)) for line in lines}
        assert len(made) == 1 and all("gaussians: there is no file" in line for line in lines)
        (words,) = made
        assert words[:3] == ("python", "runs/assets/make_assets.py", f"runs/{name}/assets")
        assert " ".join(words) in path.with_name("README.md").read_text() or words[3:] == ()
        here = {**os.environ, "PYTHONPATH": str(ROOT)}
        subprocess.run([sys.executable, *words[1:], *FEWER], check=True, env=here)
    assert len(build_scene(load(path)).x)


def test_the_command_holds_from_any_folder_for_what_it_makes(clone, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    path = clone / "runs" / "splash" / "scene.toml"
    folder = clone / "runs" / "splash" / "other"
    (line,) = refused(path, ["object.duck.gaussians=other/duck.ply"])
    script = clone / "runs" / "assets" / "make_assets.py"
    assert command(line) == ["python", str(script), str(folder)]
    (line,) = refused(path, ["object.duck.gaussians=other/dukc.ply"])
    assert line.endswith(f"there is no file {folder / 'dukc.ply'}")

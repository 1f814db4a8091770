"""Files of another schema: each command refuses them with one line and exit code 2."""

import json

import h5py
import pytest

from tests.support import damaged_files
from tests.support.small_scenes import PEBBLE, write
from vgmpi.commands import command_table
from vgmpi.io import file_layout

OTHER = file_layout.SCHEMA + 1
SAID = f"its schema is {OTHER}, this program's {file_layout.SCHEMA}"
FRAMES = [f"frames/frame_{k:05d}.vtkhdf" for k in range(damaged_files.FRAMES)]


@pytest.fixture
def out(tmp_path):
    """A run of another schema, and the scene beside it."""
    write(tmp_path, PEBBLE)
    folder = damaged_files.write(tmp_path / "out")
    for name in (file_layout.GAUSSIANS, file_layout.SERIES, *FRAMES):
        with h5py.File(folder / name, "r+") as f:
            f.attrs["schema"] = OTHER
    for path in (folder / file_layout.CHECKPOINTS).glob("*.json"):
        path.write_text(json.dumps(json.loads(path.read_text()) | {"schema": OTHER}))
    return folder


def refusal(capsys, caplog, *words):
    """The only line of a command that ends with exit code 2."""
    assert command_table.main([*map(str, words)]) == 2
    (line,) = (capsys.readouterr().err + caplog.text).splitlines()
    return line


@pytest.mark.parametrize("name", [file_layout.GAUSSIANS, file_layout.SERIES, *FRAMES[:1]])
def test_a_file_is_not_described(out, capsys, caplog, name):
    assert refusal(capsys, caplog, "inspect", out / name) == f"vgmpi: {out / name}: {SAID}"


@pytest.mark.parametrize("command, end", [("render", ".mp4"), ("view", ".png"), ("export", "")])
def test_a_run_is_not_shown(out, tmp_path, capsys, caplog, command, end):
    words = (command, out, "-o", tmp_path / f"shown{end}")
    assert refusal(capsys, caplog, *words).endswith(f"{out / file_layout.SERIES}: {SAID}")
    caplog.clear()
    (out / file_layout.SERIES).unlink()
    line = refusal(capsys, caplog, *words)
    assert f"{out}/" in line and line.endswith(SAID)
    assert not (tmp_path / f"shown{end}").exists()


@pytest.mark.parametrize("named", [False, True])
def test_a_run_does_not_go_on(out, tmp_path, capsys, caplog, named):
    newest = out / "checkpoints" / "checkpoint_000000200.h5"
    words = ["--resume", newest] if named else ["--resume"]
    line = refusal(capsys, caplog, tmp_path / "scene.toml", "-o", out, "-q", *words)
    assert newest.name in line and SAID in line

"""A stand-in for a generator goes the whole way: its axes, scale and turn are found; what goes
wrong with it is one line, and the next start goes on from there."""

import json
import os
import signal
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from tests.support import drawn_photograph, duck_photograph
from tests.support.launch import ROOT, finish, start, until
from vgmpi.tools.photo import body_sources, external_generators
from vgmpi.tools.photo import layout_config as layouts
from vgmpi.tools.photo.__main__ import main
from vgmpi.tools.photo.layout_config import BodiesTable

pytest.importorskip("cv2", reason="no OpenCV: pip install 'vgmpi[images]'")

KNOWN = 'up = "-y"\nyaw = 40'  # for tests that are of other things
STANDIN = """
import argparse, shutil, sys, time
from pathlib import Path
parser = argparse.ArgumentParser()
parser.add_argument("--image"); parser.add_argument("--output"); parser.add_argument("--seed")
given = parser.parse_args()
here = Path(__file__).parent
head = Path(given.image).read_bytes()[:26]
assert head[:4] == b"\\x89PNG" and head[25] == 6, "not a PNG with transparency"
with open(here / "calls.txt", "a") as calls:
    calls.write(Path(given.image).stem + " " + given.seed + "\\n")
ACT
shutil.copy(here / "made.ply", given.output)
"""


def standin(folder, act="", up="-y", yaw=0.0):
    """A program that gives a duck, and the head of a layout that names it."""
    duck_photograph.write_duck(folder / "made.ply", up, yaw)
    (folder / "standin.py").write_text(STANDIN.replace("ACT", act))
    program = f'script = "standin.py"\npython = "{sys.executable}"\nseed = 7'
    return f'[bodies]\nmethod = "program"\n{program}'


def go(folder):
    return main([str(folder / "photo.png"), str(folder / "layout.toml"), "-o", str(folder / "out")])


def calls(folder):
    path = folder / "calls.txt"
    return path.read_text().splitlines() if path.exists() else []


def alive(pid):
    """Whether a process runs: one that ended may wait for somebody to ask how."""
    try:
        return "State:\tZ" not in Path(f"/proc/{pid}/status").read_text()
    except FileNotFoundError:
        return False


@pytest.mark.parametrize("yaw, up, own", [(40, "-y", 0.0), (300, "x", -20.0)])
def test_axes_scale_and_turn_are_found(tmp_path, yaw, up, own):
    """own: how the file itself is turned."""
    duck_photograph.put(tmp_path, yaw, standin(tmp_path, up=up, yaw=own))
    assert go(tmp_path) == 0
    assert calls(tmp_path) == ["duck 7"]
    told = layouts.read(tmp_path / "layout.toml").layout.object[0]
    assert told.up == up
    off = (told.yaw - (yaw - own) + 180) % 360 - 180
    found = drawn_photograph.corners(tmp_path / "out", "duck") + drawn_photograph.eye_of(
        tmp_path / "out"
    )
    truth = duck_photograph.placed_duck(yaw).x
    size = np.ptp(found, axis=0) / np.ptp(truth, axis=0) - 1
    print(f"turn off by {off:.1f} deg, sizes by {size.round(3)}")
    assert abs(off) <= 10
    assert abs(size[2]) <= 0.03


def test_a_second_start_makes_nothing_anew(tmp_path, capsys):
    duck_photograph.put(tmp_path, 40, standin(tmp_path), 'up = "-y"')
    assert go(tmp_path) == 0
    text = (tmp_path / "layout.toml").read_text()
    assert "yaw = " in text
    capsys.readouterr()
    assert go(tmp_path) == 0
    assert calls(tmp_path) == ["duck 7"] and "was made before" in capsys.readouterr().out
    assert (tmp_path / "layout.toml").read_text() == text
    (tmp_path / "layout.toml").write_text(text.replace("seed = 7", "seed = 8"))
    assert go(tmp_path) == 0
    assert calls(tmp_path) == ["duck 7", "duck 8"]


def test_a_crash_half_way_keeps_what_was_made(tmp_path, capsys):
    """Two objects; the second one's program crashes, and is mended."""
    crash = 'if Path(given.image).stem == "two": raise RuntimeError("no luck today")'
    head = standin(tmp_path, crash)
    duck_photograph.put(tmp_path, 40, head, KNOWN)
    layout = tmp_path / "layout.toml"
    first = layout.read_text().replace('"duck"', '"one"')
    second = first[first.index("[[object]]") :].replace('"one"', '"two"') + "support = 0.2\n"
    layout.write_text(first + second)
    assert go(tmp_path) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "object.two" in line and "no luck today" in line and "the next start" in line
    assert not (tmp_path / "out" / "scene.toml").exists()
    assert sorted(p.name for p in (tmp_path / "out" / "bodies").iterdir()) == [
        "one.json", "one.ply", "one.png", "two.png",
    ]  # fmt: skip
    noted = (tmp_path / "out" / "bodies" / "one.json").read_bytes()
    script = (tmp_path / "standin.py").read_text()
    (tmp_path / "standin.py").write_text(script.replace("raise RuntimeError", "print"))
    # the mended program is another one: of its own making is what it has made before
    assert json.loads(noted)["seed"] == 7
    assert go(tmp_path) == 0
    assert calls(tmp_path) == ["one 7", "two 7", "one 7", "two 7"]
    assert go(tmp_path) == 0 and len(calls(tmp_path)) == 4


def test_a_killed_run_goes_on_where_it_was(tmp_path):
    """SIGKILL while the second object's program works: the first one's body is not made again."""
    wait = 'import os; (here / "pid").write_text(str(os.getpid()))\n'
    wait += 'while Path(given.image).stem == "two" and not (here / "go").exists(): time.sleep(.05)'
    duck_photograph.put(tmp_path, 40, standin(tmp_path, wait), KNOWN)
    layout = tmp_path / "layout.toml"
    first = layout.read_text().replace('"duck"', '"one"')
    layout.write_text(
        first + first[first.index("[[object]]") :].replace('"one"', '"two"') + "support = 0.2\n"
    )
    command = [sys.executable, "-m", "vgmpi.tools.photo", tmp_path / "photo.png", layout]
    begun = start([*command, "-o", tmp_path / "out"], cwd=ROOT)
    until(lambda: "two 7" in calls(tmp_path), "the second object's program starts")
    os.kill(begun.pid, signal.SIGKILL)
    begun.wait()
    child = int((tmp_path / "pid").read_text())
    until(lambda: not alive(child), "what it had started is gone too")
    (tmp_path / "go").touch()
    assert not (tmp_path / "out" / "scene.toml").exists()
    ended = finish(start([*command, "-o", tmp_path / "out"], cwd=ROOT))
    assert ended.returncode == 0, ended.stderr
    assert "'one': its body was made before" in ended.stdout
    assert calls(tmp_path) == ["one 7", "two 7", "two 7"]
    assert not [path for path in (tmp_path / "out" / "bodies").iterdir() if path.is_dir()]
    assert (tmp_path / "out" / "scene.toml").exists()


def test_ctrl_c_ends_the_program_too(tmp_path):
    wait = 'import os; (here / "pid").write_text(str(os.getpid())); time.sleep(600)'
    duck_photograph.put(tmp_path, 40, standin(tmp_path, wait), KNOWN)
    command = [sys.executable, "-m", "vgmpi.tools.photo", tmp_path / "photo.png"]
    begun = start([*command, tmp_path / "layout.toml", "-o", tmp_path / "out"], cwd=ROOT)
    until(lambda: (tmp_path / "pid").exists() and (tmp_path / "pid").read_text(), "it starts")
    child = int((tmp_path / "pid").read_text())
    begun.send_signal(signal.SIGINT)
    assert finish(begun).returncode == 130
    assert not alive(child)
    assert sorted(p.name for p in (tmp_path / "out" / "bodies").iterdir()) == ["duck.png"]


WRONG = {
    "no interpreter": ("", "/opt/no/such/python", "bodies.python: /opt/no/such/python: no interp"),
    "no program": ("", "/etc/passwd", "no interpreter: Permission denied"),
    "missing": ("import trelliss", None, "has no package 'trelliss'"),
    "gated": (
        'raise OSError("You are trying to access a gated repo. https://huggingface.co/a/b-c/x")',
        None, "its weights are gated: ask for them at https://huggingface.co/a/b-c, then",
    ),
    "card": ('raise RuntimeError("CUDA out of memory. Tried 4 GiB")', None, "card's memory"),
    "killed": ("import os, signal; os.kill(os.getpid(), 9)", None, "was ended by SIGKILL"),
    "silent": ("sys.exit(3)", None, "ended with code 3: and said nothing"),
    "nothing": ("sys.exit(0)", None, "it ended well, but wrote no body.ply"),
    "rubbish": (
        "Path(given.output).write_bytes(b'hello'); sys.exit(0)", None, "what it wrote: is not a",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_what_goes_wrong_is_one_line(tmp_path, name, capsys):
    act, python, needle = WRONG[name]
    head = standin(tmp_path, act)
    duck_photograph.put(tmp_path, 40, head.replace(sys.executable, python) if python else head)
    text = (tmp_path / "layout.toml").read_text()
    assert go(tmp_path) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1 and needle in lines[0] and "layout.toml:" in lines[0], lines
    assert (tmp_path / "layout.toml").read_text() == text
    assert not (tmp_path / "out" / "scene.toml").exists()
    assert not list((tmp_path / "out").rglob("*.ply"))


@pytest.mark.parametrize(
    "kind, package",
    [("trellis", "trellis"), ("triposplat", "triposplat"), ("sam3d", "inference")],
)
def test_those_that_are_known_say_what_their_interpreter_lacks(tmp_path, kind, package):
    """The scripts themselves start; what they import is not here."""
    asked = BodiesTable(method=kind, python=sys.executable)
    duck_photograph.put(tmp_path, 40)
    crop = (tmp_path / "photo.png").read_bytes()
    with pytest.raises(external_generators.GeneratorError) as error:
        external_generators.make("duck", crop, asked, tmp_path, tmp_path / "out")
    assert f"has no package '{package}'" in str(error.value)
    assert external_generators.KINDS[kind].page in str(error.value)


def test_a_folder_of_bodies_goes_before(tmp_path):
    (tmp_path / "mine").mkdir()
    duck_photograph.write_duck(tmp_path / "mine" / "duck.ply")
    duck_photograph.put(tmp_path, 40, '[bodies]\nfolder = "mine"', 'up = "-y"')
    assert go(tmp_path) == 0
    told = layouts.read(tmp_path / "layout.toml").layout.object[0]
    assert abs((told.yaw - 40 + 180) % 360 - 180) <= 10


def test_a_glb_beside_a_mesh_is_not_taken_for_gaussians(tmp_path):
    """Generators write meshes as .glb, too."""
    layout = SimpleNamespace(bodies=SimpleNamespace(folder="mine"))
    loaded = SimpleNamespace(layout=layout, path=lambda name: tmp_path)
    duck = SimpleNamespace(name="duck", body=None, reconstruction=None, multi_view=None)
    for suffix in (".glb", ".obj", ".ksplat", ".ply"):
        (tmp_path / f"duck{suffix}").touch()
        assert body_sources._body_file(duck, loaded) == tmp_path / f"duck{suffix}"

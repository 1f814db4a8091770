"""What a checkpoint holds is looked at before a kernel sees it, whatever its checksums say."""

import json

import h5py
import numpy as np
import pytest

from tests.solver.test_run_folder import SCENE, files
from tests.support.damaged_files import forge
from tests.support.small_scenes import write
from vgmpi.commands import cli
from vgmpi.io import checkpoint, file_layout

SCENE = SCENE.replace('"single"', '"double"') + (
    """
[[probe]]
name = "tap"
velocity = [0.1, 0.1, 0.1]
sampling_rate = "1 kHz"
"""
)


@pytest.fixture(scope="module")
def stopped(tmp_path_factory):
    scene = write(tmp_path_factory.mktemp("stopped"), SCENE)
    assert run(scene, "--stop-after", "3 steps") == 75
    path = checkpoint.latest_valid(scene.parent / "out" / file_layout.CHECKPOINTS)
    return scene, path, [p.read_bytes() for p in (path, path.with_suffix(".json"))]


@pytest.fixture
def forged(stopped):
    """A scene and its one checkpoint, to be changed."""
    scene, path, content = stopped
    yield scene, path
    for place, data in zip((path, path.with_suffix(".json")), content, strict=True):
        place.write_bytes(data)


def run(scene, *flags):
    return cli.main([str(scene), "-q", "--engine", "numpy", *flags])


def put(name, row, value):
    def change(f):
        f[f"group_000/{name}"][row] = value

    return change


def replaced(name, make):
    def change(f):
        old = f[f"group_000/{name}"][()]
        del f[f"group_000/{name}"]
        if make is not None:
            f[f"group_000/{name}"] = make(old)

    return change


def three_cells_off(f):
    """From the middle of its block, and still in the domain of 10 cells: 3 x 3 x 3 blocks."""
    far = f["group_000/block"][0] // 9 == 2
    f["group_000/x"][0, 0] = (-3 if far else 3) << 52


ROWS = {  # what is forged, and what is said of it
    "x beyond all": (put("x", 5, 1 << 62), "group_000/x: row 5: "),
    "x below all": (put("x", 5, -(1 << 63)), "group_000/x: row 5: "),
    "x beyond the reach": (three_cells_off, "group_000/x: row 0: "),
    "v is nan": (put("v", 7, np.nan), "group_000/v: row 7: cannot be"),
    "C is endless": (put("C", 0, np.inf), "group_000/C: row 0: cannot be"),
    "no volume": (put("vol0", 1, 0.0), "group_000/vol0: row 1: cannot be"),
    "state is nan": (put("state", 2, np.nan), "group_000/state: row 2: cannot be"),
    "id beyond all": (put("id", 3, 1 << 40), "group_000/id: row 3: "),
    "id below all": (put("id", 3, -1), "group_000/id: row 3: -1 is no particle of it"),
    "id twice": (replaced("id", lambda i: np.where(i == 4, 9, i)), "particle 9 is in it twice"),
    "block beyond all": (put("block", -1, 1 << 60), "group_000/block: names blocks outside"),
    "block below all": (put("block", 0, -1), "group_000/block: names blocks outside"),
    "blocks not in order": (replaced("block", lambda b: b[::-1]), "group_000/block: is not in the"),
    "a block twice": (put("block", 1, 0), "group_000/block: "),
    "count of more": (put("count", 0, 1 << 62), "group_000/count: is not one of particles"),
    "count below none": (put("count", 0, -1), "group_000/count: is not one of particles"),
    "count of others": (put("count", 0, 1), "group_000/count: they are not the particles' sum"),
    "v is gone": (replaced("v", None), "group_000 holds C, block, count"),
    "v in single": (replaced("v", lambda v: v.astype("f4")), "group_000/v is float32"),
    "x as floats": (replaced("x", lambda x: x.astype("f8")), "group_000/x is float64"),
    "wider state": (replaced("state", lambda s: np.repeat(s, 2, 1)), "carries 2 numbers"),
    "one group more": (lambda f: f.copy("group_000", f, "group_001"), "holds attrs, group_000, gr"),
    "no group": (lambda f: f.move("group_000", "group_100"), "holds attrs, group_100"),
}  # fmt: skip


@pytest.mark.parametrize("what", ROWS)
def test_rows_that_cannot_be_are_one_line(forged, capsys, what):
    """And nothing is written."""
    scene, path = forged
    change, said = ROWS[what]
    forge(path, change)
    checkpoint.verify(path)
    before = files(scene.parent / "out")
    assert run(scene, "--resume") == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert str(path) in line and said in line
    assert files(scene.parent / "out") == before


ATTRS = {
    "time": (None, "now", float("nan"), -1.0, float("inf"), [1.0], True),
    "rate": ("fast", float("nan"), float("inf"), -1.0, None),
    "reach": (3, ["a"], [float("nan")] * 5, [-1.0] * 5),
    "frame": (-1, 1.5, "one", 1 << 40, None),
    "scene": ([], None, "a scene"),
    "resume_history": ("none", 3),
}


@pytest.mark.parametrize("name, value", [(k, v) for k, values in ATTRS.items() for v in values])
def test_attrs_that_cannot_be_are_one_line(forged, capsys, name, value):
    scene, path = forged
    said = json.loads(path.with_suffix(".json").read_text())
    forge(path, lambda f: None, {name: value})
    if name == "time":  # the manifest tells it too
        said = json.loads(path.with_suffix(".json").read_text()) | {"time": value}
        path.with_suffix(".json").write_text(json.dumps(said))
    assert run(scene, "--resume") == 2
    line = capsys.readouterr().err.splitlines()[-1]
    assert path.name in line or "no valid checkpoint" in line
    if name != "time":
        assert f"attrs: {name} cannot be" in line


def test_what_a_checkpoint_lacks_is_one_line(forged, capsys):
    scene, path = forged
    with h5py.File(path) as f:
        attrs = json.loads(f["attrs"][()])
    for name in ("rate", "frame", "scene", "precision"):
        forge(path, lambda f: None, {k: None if k == name else v for k, v in attrs.items()})
        assert run(scene, "--resume") == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert name in line


@pytest.mark.parametrize("name", ["ledger.csv", "probe_tap.csv"])
def test_a_damaged_table_ends_a_resume_before_anything_is_written(forged, capsys, name):
    scene, _ = forged
    path = scene.parent / "out" / name
    text = path.read_text()
    try:
        path.write_text(text.replace(",0,", ",?,", 1))
        before = files(scene.parent / "out")
        assert run(scene, "--resume") == 1
        (line,) = capsys.readouterr().err.splitlines()
        assert f"{path}:2: damaged: this row is not what was written; to go on, put" in line
        assert files(scene.parent / "out") == before
    finally:
        path.write_text(text)


def test_what_was_not_forged_goes_on(forged):
    scene, path = forged
    assert run(scene, "--resume", "--stop-after", "1 step") == 75

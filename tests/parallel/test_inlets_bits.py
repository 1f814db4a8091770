"""Inlets and outlets do not touch the promise: the same bits in every file for any number of ranks
and threads, and after a restart in the middle of a layer."""

import csv

import h5py
import pytest

from tests.support.file_digests import (
    RANKS_AND_THREADS,
    assert_same_files,
    digests,
    run_on_one_rank,
)
from tests.support.simulated_runs import run_here
from tests.support.small_scenes import MIXED, write

# one that pours aslant, later than the start and not to the end, one that always pours, onto bodies
# of all kinds; outlets where what falls and what flows comes by
SCENE = (
    MIXED.replace("PRECISION", "double")
    + """
[[inlet]]
name = "spout"
material = "oil"
disc = { center = [0.06, 0.04, 0.18], radius = 0.022 }
direction = [1, 0.2, -1]
speed = 1.5
particles_per_cell = 27
start_time = "11 ms"
end_time = "47 ms"
[[inlet]]
name = "tap"
material = "water"
rectangle = { center = [0.3, 0.2, 0.16], width = 0.04, height = 0.03 }
direction = [0, 0, -1]
mass_flow_rate = 1
[[outlet]]
name = "hole"
shape = { sphere = { center = [0.24, 0.05, 0.02], radius = 0.04 } }
[[outlet]]
name = "tray"
shape = { box = [[0.26, 0.16, 0], [0.36, 0.24, 0.05]] }
"""
)

# two that mix and flow into an outlet, so that segments of either are empty when it stops
EMPTIES = """
[accuracy]
pressure = "explicit"
precision = "double"
[domain]
size = [0.4, 0.2, 0.4]
cell = 0.02
[time]
end = 0.06
frames = 3
[material.water]
kind = "fluid"
tait_coefficient = 2e4
[material.oil]
kind = "fluid"
density = 900
tait_coefficient = 2e4
[[coupling]]
kind = "mixing"
between = ["water", "oil"]
[[object]]
name = "pool"
material = "water"
velocity = [2, 0, 0]
shape = { box = [[0, 0, 0], [0.14, 0.2, 0.04]] }
[[object]]
name = "oil"
material = "oil"
velocity = [1.5, 0, 0]
shape = { box = [[0, 0, 0.04], [0.14, 0.2, 0.08]] }
[[outlet]]
name = "hole"
shape = { box = [[0.155, 0, 0], [0.4, 0.2, 0.4]] }
"""


@pytest.fixture(scope="module")
def one(tmp_path_factory):
    folder = tmp_path_factory.mktemp("inlets")
    return *run_on_one_rank(folder, SCENE), folder / "one"


def fluid(folder):
    """Rows of the ledger of what flows."""
    with open(folder / "ledger.csv", newline="") as f:
        return [row for row in csv.DictReader(f) if row["phase"] == "fluid"]


def test_something_comes_and_goes(one):
    _, _, out = one
    rows = fluid(out)
    came, went = ([int(row[key]) for row in rows] for key in ("particles_in", "particles_out"))
    assert came == sorted(set(came)) and came[-1] - came[0] > 150
    assert went[0] == 0 and went[-1] > 50
    for row in rows:
        assert int(row["particles_in"]) - int(row["particles_out"]) == int(row["particles"])
        left = float(row["mass_in"]) - float(row["mass_out"]) - float(row["mass"])
        assert abs(left) < 1e-14 * float(row["mass_in"])


@RANKS_AND_THREADS
def test_ranks_and_threads(one, start, ranks, flags, tmp_path):
    scene, want, _ = one
    assert_same_files(scene, want, tmp_path, start, ranks, *flags)


def test_stop_and_resume(one, tmp_path):
    """Stopped on three ranks while both pour, then on with two: the rest of the frames, the ledger
    and the last checkpoint."""
    scene, want, _ = one
    stop = int(fluid(one[2])[-1]["step"]) // 2 + 1
    run_here(scene, tmp_path, 3, "--stop-after", f"{stop} steps", code=75)
    run_here(scene, tmp_path, 2, "--resume")
    found = digests(tmp_path)
    last = max(name.partition(".")[0] for name in want if "checkpoint_" in name)
    same = ("frame_", "ledger", "gaussians", last)
    kept = {name: sha for name, sha in want.items() if any(word in name for word in same)}
    assert len(kept) >= 7
    assert {name: found.get(name) for name in kept} == kept


def test_resume_where_segments_are_empty(tmp_path):
    """An outlet emptied segments since the last sort: what follows from where these are does not
    change."""
    scene = write(tmp_path, EMPTIES)
    run_here(scene, tmp_path / "one", 1)
    want, out = digests(tmp_path / "one"), tmp_path / "stopped"
    run_here(scene, out, 2, "--stop-after", "49 steps", code=75)
    with h5py.File(max((out / "checkpoints").glob("*.h5"))) as f:
        assert any((f[group]["count"][:] == 0).any() for group in f if group.startswith("group"))
    run_here(scene, out, 1, "--resume")
    found, last = digests(out), max(name.partition(".")[0] for name in want if "checkpoint" in name)
    kept = {k: v for k, v in want.items() if any(w in k for w in ("frame_", "ledger", last))}
    assert len(kept) >= 7 and {name: found.get(name) for name in kept} == kept

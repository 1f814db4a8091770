"""Loads, probes and gravity that turns do not touch the promise: the same bits in every file for
any number of ranks, and after a restart in the middle of a ramp and of the turn."""

import csv

import pytest

from tests.support.file_digests import (
    RANKS_AND_THREADS,
    assert_same_files,
    digests,
    run_on_one_rank,
)
from tests.support.simulated_runs import run_here
from tests.support.small_scenes import MIXED
from vgmpi.io import csv_log, file_layout
from vgmpi.parallel.communicator import SerialCommunicator

# loads on part of a body, on two bodies of one phase, on a face; all kinds of probes, one of them
# at every step
SCENE = (
    MIXED.replace("PRECISION", "double").replace(
        "cell = 0.02\n",
        """cell = 0.02
gravity_keyframes = [
  { time = "5 ms", gravity = [0, 0, -9.8] },
  { time = "40 ms", gravity = [4.9, 1, -8] },
]
""",
    )
    + """
[[load]]
object = "ball"
region = { box = [[0, 0, 0], [0.36, 0.12, 0.24]] }
force = [0.3, 0, 0.1]
ramp_time = "30 ms"
[[load]]
object = ["pool", "slick"]
acceleration = [2, 1, 0]
start_time = "11 ms"
end_time = "41 ms"
[[load]]
object = "cube"
pressure = "100 Pa"
face = "east"
[[load]]
object = "ball"
delta_angular_velocity = [5, 0, 9]
start_time = "23 ms"
[[probe]]
name = "deep"
sampling_interval = "7 ms"
pressure = [0.08, 0.12, 0.02]
[[probe]]
name = "gauge"
sampling_interval = "7 ms"
surface_height = [0.1, 0.1]
[[probe]]
name = "stream"
sampling_rate = 300
velocity = [0.12, 0.12, 0.04]
[[probe]]
name = "cube"
sampling_interval = "1 us"
object = "cube"
[[probe]]
name = "slick"
sampling_interval = "9 ms"
object = "slick"
[[probe]]
name = "walls"
sampling_interval = "7 ms"
wall = "all"
"""
)


@pytest.fixture(scope="module")
def one(tmp_path_factory):
    folder = tmp_path_factory.mktemp("loads")
    scene, found = run_on_one_rank(folder, SCENE)
    assert sum(name.startswith("probe_") for name in found) == 6
    return scene, found, folder / "one"


def rows(folder, name):
    with open(folder / f"probe_{name}.csv", newline="") as f:
        return list(csv.DictReader(f))


def test_there_is_something_to_measure(one):
    """Numbers everywhere, but for the first force; they change."""
    _, _, out = one
    for name in ("deep", "gauge", "stream", "cube", "slick", "walls"):
        found = rows(out, name)
        assert len(found) > 5 and "" not in found[-1].values()
        assert all("nan" not in row.values() for row in found[1:]), name
        columns = [set(row[key] for row in found) for key in found[0] if key not in ("mass",)]
        assert all(len(values) > 3 for values in columns), name
    assert len(rows(out, "cube")) == 1 + int(rows(out, "cube")[-1]["step"])


@RANKS_AND_THREADS
def test_ranks_and_threads(one, start, ranks, flags, tmp_path):
    scene, want, _ = one
    assert_same_files(scene, want, tmp_path, start, ranks, *flags)


def test_stop_and_resume(one, tmp_path):
    """Stopped on three ranks while loads grow and gravity turns, then on with two. What was written
    behind the checkpoint is written anew."""
    scene, want, out = one
    stop = int(rows(out, "cube")[-1]["step"]) // 3
    assert 0.012 < float(rows(out, "cube")[stop]["time"]) < 0.028
    run_here(scene, tmp_path, 3, "--stop-after", f"{stop} steps", code=75)
    # a kill after the checkpoint
    columns = file_layout.PROBE_COLUMNS["object"]
    table = csv_log.CsvLog(
        tmp_path / "probe_cube.csv", columns, SerialCommunicator(), last_step=stop
    )
    table.append([{d.name: 1.0 for d in columns} | {"time": 0.05, "step": stop + 1}])
    with open(table.path, "a") as f:
        f.write("0.05,99")
    run_here(scene, tmp_path, 2, "--resume")
    found = digests(tmp_path)
    same = ("frame_", "ledger", "probe_")
    frames = {name: sha for name, sha in want.items() if any(word in name for word in same)}
    assert {name: found.get(name) for name in frames} == frames

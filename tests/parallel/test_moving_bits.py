"""Colliders that move, and what they and the walls give, have the same bits in every file for any
number of ranks and threads, and after a restart in the middle of a motion."""

import csv

import h5py
import numpy as np
import pytest

from tests.support.file_digests import (
    RANKS_AND_THREADS,
    assert_same_files,
    digests,
    frame_digests,
    run_on_one_rank,
)
from tests.support.simulated_runs import run_here
from tests.support.small_scenes import MIXED
from vgmpi.scene.probes import WALL_NAMES

COLLIDERS = ("post", "paddle", "roller")
SCENE = (
    MIXED.replace("PRECISION", "single")
    + """
[[object]]
name = "paddle"
role = "scenery"
collider = true
friction = 0.3
shape = { box = [[0.26, 0.04, 0.01], [0.31, 0.2, 0.12]] }
motion = { axis = [1, 2, 0], keyframes = [
  { time = "20 ms", translation = [-0.03, 0, 0] },
  { time = "55 ms", translation = [0.01, 0, 0.02], angle = "25 deg" },
] }
[[object]]
name = "roller"
role = "scenery"
collider = true
shape = { cylinder = { endpoints = [[0.06, 0.02, 0.13], [0.06, 0.22, 0.13]], radius = 0.03 } }
motion = { angular_velocity = "300 rpm", axis = "y", velocity = [0.2, 0, 0], end_time = "40 ms" }
"""
    + "".join(
        f'[[probe]]\nname = "{name}"\nsampling_rate = "200 Hz"\n{key} = "{name}"\n'
        for key, names in (("wall", ("all", *WALL_NAMES)), ("collider", COLLIDERS))
        for name in names
    )
)


@pytest.fixture(scope="module")
def one(tmp_path_factory):
    folder = tmp_path_factory.mktemp("moving")
    return *run_on_one_rank(folder, SCENE), folder / "one"


def poses(folder, number):
    with h5py.File(folder / "frames" / f"frame_{number:05d}.vtkhdf") as f:
        return f["poses"][()], f["VTKHDF/FieldData/step"][0]


def test_they_move(one):
    _, _, out = one
    first, last = poses(out, 0)[0], poses(out, 3)[0]
    assert first.shape[1:] == (4, 4) and np.allclose(first, np.eye(4))
    assert np.allclose(last[-2, :3, 3] - (np.eye(3) - last[-2, :3, :3]) @ [0.285, 0.12, 0.065],
                       [0.01, 0, 0.02], atol=1e-12)  # fmt: skip
    assert np.arccos((np.trace(last[-2, :3, :3]) - 1) / 2) == pytest.approx(np.radians(25))


def column(folder, name, key):
    with open(folder / f"probe_{name}.csv") as f:
        return np.array([float(row[key]) for row in csv.DictReader(f)])


def test_forces_are_felt(one):
    """In single precision all together are the balance to its digits."""
    _, _, out = one
    assert np.abs(column(out, "paddle", "cumulative_work")[-1]) > 1e-3
    assert np.abs(column(out, "roller", "torque_y")[1:]).max() > 1e-3
    for axis in "xyz":
        key = f"force_{axis}"
        together = sum(column(out, name, key)[1:] for name in (*WALL_NAMES, *COLLIDERS))
        balance = column(out, "all", key)[1:]
        assert np.abs(together - balance).max() < 1e-5 * np.abs(balance).max()


@RANKS_AND_THREADS
def test_ranks_and_threads(one, start, ranks, flags, tmp_path):
    scene, want, _ = one
    assert_same_files(scene, want, tmp_path, start, ranks, *flags)


def test_stop_and_resume(one, tmp_path):
    """Stopped on three ranks in the middle of both motions and between two rows of the probes, then
    on with two: what was given since the last row is in the checkpoint."""
    scene, want, out = one
    stop = int(column(out, "paddle", "step")[-1]) // 2 + 1
    run_here(scene, tmp_path, 3, "--stop-after", f"{stop} steps", code=75)
    run_here(scene, tmp_path, 2, "--resume")
    found = digests(tmp_path)
    rows = [name for name in want if name.startswith("probe_")]
    assert len(rows) == 10
    assert [name for name in rows if found[name] != want[name]] == []
    assert frame_digests(found) == frame_digests(want)

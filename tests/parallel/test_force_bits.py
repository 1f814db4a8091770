"""What colliders and walls give is summed on any number of ranks and threads to the same bits, also
across a restart."""

import csv

import numpy as np
import pytest

from tests.parallel.test_moving_bits import SCENE
from tests.support.file_digests import (
    RANKS_AND_THREADS,
    assert_same_files,
    digests,
    run_on_one_rank,
)
from tests.support.simulated_runs import run_here
from vgmpi.scene.probes import WALL_NAMES

COLLIDERS = ("post", "paddle", "roller")
ASKED = SCENE + "".join(
    f'[[probe]]\nname = "{name}"\nsampling_rate = "200 Hz"\n{key} = "{name}"\n'
    for key, names in (("wall", ("all", *WALL_NAMES)), ("collider", COLLIDERS))
    for name in names
)


@pytest.fixture(scope="module")
def one(tmp_path_factory):
    folder = tmp_path_factory.mktemp("forces")
    return *run_on_one_rank(folder, ASKED), folder / "one"


def column(folder, name, key):
    with open(folder / f"probe_{name}.csv") as f:
        return np.array([float(row[key]) for row in csv.DictReader(f)])


def test_they_are_felt(one):
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
    """Between two rows: what was given since the last one is in the checkpoint."""
    scene, want, out = one
    stop = int(column(out, "paddle", "step")[-1]) // 2 + 1
    run_here(scene, tmp_path, 2, "--stop-after", f"{stop} steps", code=75)
    run_here(scene, tmp_path, 1, "--resume")
    found = digests(tmp_path)
    rows = [name for name in want if name.startswith("probe_")]
    assert len(rows) == 10
    assert [name for name in rows if found[name] != want[name]] == []

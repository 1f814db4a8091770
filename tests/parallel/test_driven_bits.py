"""Bodies that are driven, those that are let go, and a wall that vanishes keep the promise: the
same bits in every file for any number of ranks and threads, and after a restart between two layers
that are let go, when the wall is gone."""

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
from vgmpi.io import checkpoint
from vgmpi.io.csv_log import read_rows
from vgmpi.solver.restart.checkpoint_validation import Mismatch, check_attrs

SCENE = (
    MIXED.replace("PRECISION", "single")
    .replace("friction = 0.2 }", 'friction = 0.2, removal_time = "18 ms" }')
    .replace(
        "velocity = [-2, 0, 0]\nangular_velocity = [0, 5, 0]",
        'motion = { velocity = [-2, 0, -1], angular_velocity = "300 rpm", axis = [1, 2, 0],'
        ' end_time = "25 ms" }',
    )
    + """
[material.sand]
kind = "sand"
youngs_modulus = 2e5
[[object]]
name = "castle"
material = "sand"
shape = { box = [[0.24, 0.15, 0], [0.36, 0.24, 0.1]] }
release_time = "15 ms"
release_order = "top-down"
release_end_time = "35 ms"
"""
)


@pytest.fixture(scope="module")
def one(tmp_path_factory):
    folder = tmp_path_factory.mktemp("driven")
    return *run_on_one_rank(folder, SCENE), folder / "one"


def test_they_are_let_go(one):
    rows = read_rows(one[2] / "ledger.csv")
    count = {(row["phase"], round(1e3 * row["time"])): row["particles"] for row in rows}
    whole = count["castle (frozen)", 0]
    assert whole > 1000 and count["sand", 0] == count["cube", 0] == 0
    assert 0 < count["sand", 20] < whole and count["cube (driven)", 20] > 0
    assert count["castle (frozen)", 40] == 0 and count["cube (driven)", 40] == 0
    steps = {row["step"] for row in rows}
    mass = {t: sum(r["mass"] + r["mass_out"] - r["mass_in"] for r in rows if r["step"] == t)
            for t in steps}  # fmt: skip
    assert np.abs(list(mass.values())).max() < 1e-14 and len(mass) == 4
    gone = {r["step"]: r["particles_out"] for r in rows if r["phase"] == "castle (frozen)"}
    assert gone[max(steps)] > 0 == gone[min(steps)]  # over to the sand, and through the wall
    assert count["sand", 60] < whole


@RANKS_AND_THREADS
def test_ranks_and_threads(one, start, ranks, flags, tmp_path):
    scene, want, _ = one
    assert_same_files(scene, want, tmp_path, start, ranks, *flags)


def test_stop_and_resume(one, tmp_path):
    """Stopped on three ranks while half of the layers are let go, then on with two."""
    scene, want, out = one
    steps = {row["step"]: row["time"] for row in read_rows(out / "ledger.csv")}
    stop = next(step for step, time in steps.items() if time > 0.019)
    run_here(scene, tmp_path, 3, "--stop-after", f"{stop + 7} steps", code=75)
    path = max((tmp_path / "checkpoints").glob("*.h5"))
    with checkpoint.open(path) as saved:
        assert 0 < saved.attrs["since"] < saved.attrs["step"]
        with pytest.raises(Mismatch, match="since cannot be -1"):
            check_attrs(path, saved.attrs | {"since": -1})
    run_here(scene, tmp_path, 2, "--resume")
    assert frame_digests(digests(tmp_path)) == frame_digests(want)

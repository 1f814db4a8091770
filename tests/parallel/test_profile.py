"""`--profile` on two ranks: a row per rank, and nothing of it without the flag."""

import csv

import pytest

from tests.support.launch import mpirun
from tests.support.small_scenes import MIXED, write

pytestmark = pytest.mark.mpi


def test_profile_has_a_row_per_rank(tmp_path):
    scene = write(tmp_path, MIXED.replace("PRECISION", "single"))
    flags = ("-o", tmp_path / "out", "--stop-after", "120 steps")
    job = mpirun(2, "-m", "vgmpi", scene, *flags, "--profile")
    assert job.returncode == 75, job.stderr
    rows = list(csv.DictReader(open(tmp_path / "out" / "profile.csv")))
    assert [row["rank"] for row in rows] == ["0", "1"]
    assert sum(int(row["particles"]) for row in rows) == 4724
    assert sum(float(row["work"]) for row in rows) == pytest.approx(2.0, abs=1e-4)
    for row in rows:
        assert all(float(row[stage]) > 0 for stage in ("p2g", "halo", "grid", "g2p", "wait"))
        assert int(row["neighbours"]) == 1 and 1e4 < float(row["sent"]) < 1e7
        assert 0 < float(row["startup"]) < 240
    assert "work: largest over mean" in job.stdout and "profile.csv" in job.stdout


def test_no_profile_unless_asked_for(tmp_path):
    scene = write(tmp_path, MIXED.replace("PRECISION", "single"))
    job = mpirun(2, "-m", "vgmpi", scene, "-o", tmp_path / "out", "--stop-after", "1 step")
    assert job.returncode == 75, job.stderr
    assert not (tmp_path / "out" / "profile.csv").exists()
    assert "largest over mean" not in job.stdout.replace("predicted work over the mean", "")

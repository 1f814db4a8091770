"""Ranks that a plain start of the program begins by itself: bits, output, signals, exit codes."""

import os
import signal
import subprocess
import sys
import uuid

import pytest

from tests.campaigns import kills
from tests.support.file_digests import files
from tests.support.launch import PATIENCE, ROOT, until
from tests.support.small_scenes import MIXED, write
from vgmpi.commands import rank_supervisor

pytestmark = pytest.mark.mpi
LONG = ("--set", "time.end=100", "--set", "time.frames=2")


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    if rank_supervisor.find_mpirun() is None:
        pytest.skip("no mpirun")
    return write(tmp_path_factory.mktemp("scene"), MIXED.replace("PRECISION", "single"))


def begin(scene, out, *flags, mark=""):
    """Start the program as a user does: without what tests tell Open MPI."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("OMPI_", "PRTE_"))}
    environment |= {"PYTHONPATH": str(ROOT), kills.MARK: mark}
    return subprocess.Popen(
        [sys.executable, "-m", "vgmpi", scene, "-o", out, *flags],
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def end(process):
    out, err = process.communicate(timeout=PATIENCE)
    return process.returncode, out, err


def test_two_ranks_write_the_bits_of_one(scene, tmp_path):
    outcomes = [end(begin(scene, tmp_path / n, "--ranks", n)) for n in ("1", "2")]
    for code, _, err in outcomes:
        assert code == 0, err
    assert "on 1 rank(s)" in outcomes[0][1] and "on 2 rank(s)" in outcomes[1][1]
    assert "2 ranks on" in outcomes[1][2]
    assert files(tmp_path / "1") == files(tmp_path / "2")


def test_a_small_scene_runs_on_one_rank_and_says_why(scene, tmp_path):
    code, out, err = end(begin(scene, tmp_path / "out"))
    assert code == 0 and "on 1 rank(s)" in out, err
    if len(os.sched_getaffinity(0)) > 1:
        assert "cores: the scene is too small for more (plan)" in err


@pytest.mark.parametrize(
    "name, ranks",
    [("SIGHUP", "1"), ("SIGXCPU", "1"), ("SIGHUP", "2"), ("SIGTERM", "2"), ("SIGINT", "2")],
)
def test_a_signal_stops_with_a_checkpoint(scene, name, ranks, tmp_path):
    process = begin(scene, tmp_path / "out", "--ranks", ranks, *LONG)
    first = tmp_path / "out" / "frames" / "frame_00000.vtkhdf"
    until(lambda: first.exists() or process.poll() is not None, "the first frame")
    until(lambda: has_handler(process.pid), "the run steps")
    process.send_signal(getattr(signal, name))
    code, out, err = end(process)
    assert code == 75, err
    assert "stopped; go on with --resume" in out
    assert len(list((tmp_path / "out" / "checkpoints").glob("*.h5"))) == 1
    assert "Primary job" not in err and "MPI_ABORT" not in err


def has_handler(pid):
    with open(f"/proc/{pid}/status") as status:
        (mask,) = [line.split()[1] for line in status if line.startswith("SigCgt:")]
    return int(mask, 16) >> (signal.SIGINT - 1) & 1


def test_errors_of_the_scene_come_through(scene, tmp_path):
    flags = ("--ranks", "2", "--set", "material.water.density=-1")
    code, _, err = end(begin(scene, tmp_path / "out", *flags))
    assert code == 2
    assert [line for line in err.splitlines() if "density" in line] and "mpirun" not in err
    assert "Primary job" not in err


def test_no_rank_outlives_a_parent_that_is_killed(scene, tmp_path):
    mark = uuid.uuid4().hex
    process = begin(scene, tmp_path / "out", "--ranks", "2", *LONG, mark=mark)
    frame = tmp_path / "out" / "frames" / "frame_00000.vtkhdf"
    until(lambda: frame.exists() or process.poll() is not None, "the first frame")
    assert len(kills._marked(mark)) >= 4  # parent, mpirun and two ranks
    process.kill()
    until(lambda: not kills.is_left(set(), mark), "all processes of it end")
    process.communicate()


def test_a_killed_rank_ends_all_and_is_told(scene, tmp_path):
    mark = uuid.uuid4().hex
    process = begin(scene, tmp_path / "out", "--ranks", "2", *LONG, mark=mark)
    frame = tmp_path / "out" / "frames" / "frame_00000.vtkhdf"
    until(lambda: frame.exists() or process.poll() is not None, "the first frame")
    os.kill(kills._marked(mark)[-1], signal.SIGKILL)
    code, _, err = end(process)
    assert code == 137
    assert "a rank was ended by SIGKILL; all ranks end" in err

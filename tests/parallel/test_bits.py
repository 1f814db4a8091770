"""The promise: the same bits in every file for any number of ranks and threads, and after a
restart.

The scene has walls of every kind, three phases in contact and a collider, sorts several times, and
sends particles from rank to rank.
"""

import signal

import pytest

from tests.support.file_digests import assert_same_files, digests, frame_digests, run_on_one_rank
from tests.support.launch import finish, go, on_ranks, start, until
from tests.support.small_scenes import MIXED

pytestmark = pytest.mark.mpi

SINGLE = pytest.mark.parametrize("one", ["single"], indirect=True, scope="module")


@pytest.fixture(scope="module")
def one(request, tmp_path_factory):
    """The scene in a precision, and the digests of its files when run on one rank."""
    folder = tmp_path_factory.mktemp(request.param)
    scene, found = run_on_one_rank(folder, MIXED.replace("PRECISION", request.param))
    assert sum("frame_" in name for name in found) > 20
    assert sum("checkpoint_" in name for name in found) > 20
    return scene, found


@pytest.mark.parametrize(
    "one, n",
    [("single", n) for n in (2, 3, 7)]
    + [("double", 3)]
    + [
        pytest.param(precision, n, marks=pytest.mark.slow)
        for precision, n in (("single", 4), *(("double", n) for n in (2, 4, 7)))
    ],
    indirect=["one"],
    scope="module",
)
def test_ranks(one, n, tmp_path):
    scene, want = one
    assert_same_files(scene, want, tmp_path, go, n)


@SINGLE
def test_threads(one, tmp_path):
    scene, want = one
    assert_same_files(scene, want, tmp_path, go, 1, "--threads", 2)


@SINGLE
def test_stop_between_two_sorts_and_resume(one, tmp_path):
    """USR1 on three ranks, then on with two. The signal comes when it comes: nearly every step lies
    between two sorts.
    """
    scene, want = one
    flags = ("-o", tmp_path, "--set", "output.checkpoint_interval_steps=0")
    running = start(on_ranks(3, "-m", "vgmpi", scene, *flags))
    frame = tmp_path / "frames" / "frame_00001.vtkhdf"
    until(lambda: frame.exists() or running.poll() is not None, "no first frame")
    running.send_signal(signal.SIGUSR1)  # mpirun passes it on to the ranks
    job = finish(running)
    assert job.returncode == 75, job.stderr
    assert not (tmp_path / "frames" / "frame_00003.vtkhdf").exists(), (
        "stopped too late to test anything"
    )
    assert "stopped" in job.stdout
    assert f"to stop with a checkpoint: kill -USR1 {running.pid}; after Ctrl-C, Open" in job.stderr
    go(scene, tmp_path, 2, "--resume")
    found = digests(tmp_path)
    frames = frame_digests(want)
    assert {name: found.get(name) for name in frames} == frames
    last = {name: sha for name, sha in want.items() if "checkpoint_" in name and ".h5" in name}
    assert {name: found.get(name) for name in last if "attrs" not in name} == {
        name: sha for name, sha in last.items() if "attrs" not in name
    }

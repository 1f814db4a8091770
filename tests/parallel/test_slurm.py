"""slurm/vgmpi.sbatch in a real SLURM: two nodes on this machine
(tests/support/slurm_cluster.py)."""

import os
import signal
import sys

import pytest

from tests.support.file_digests import digests
from tests.support.fit_scenes import BALL, FIT, bits, go, reference, write_fit
from tests.support.launch import ROOT, run
from tests.support.slurm_cluster import Cluster, Unable, missing
from tests.support.small_scenes import MIXED, write
from vgmpi.io.run_reader import RunReader

pytestmark = [
    pytest.mark.mpi,
    pytest.mark.slurm,
    pytest.mark.skipif(bool(missing()), reason=missing() or "all is there"),
]

SCRIPT = ROOT / "slurm" / "vgmpi.sbatch"
CHECKPOINT = "checkpoint_000000040.h5"


@pytest.fixture(scope="module")
def cluster():
    try:
        made = Cluster()
    except Unable as error:
        pytest.skip(f"SLURM does not start here: {error}")
    yield made
    made.close()


@pytest.fixture(scope="module")
def one(tmp_path_factory):
    """The scene, and the digests of its files when one rank runs it without SLURM."""
    folder = tmp_path_factory.mktemp("one")
    scene = write(folder, MIXED.replace("PRECISION", "double"))
    job = run([sys.executable, "-m", "vgmpi", scene, "-q", "-o", folder / "one"])
    assert job.returncode == 0, job.stderr
    return scene, digests(folder / "one")


@pytest.fixture
def submit(cluster, one, tmp_path):
    """Returns submit(flags of sbatch, flags of vgmpi, **environment) -> the job's number.

    Files go to tmp_path / "out".
    """

    def submit(flags=(), more=(), **environment):
        environment = {"PYTHON": sys.executable, "OUT": str(tmp_path / "out"), **environment}
        return cluster.submit(*flags, SCRIPT, one[0], *more, cwd=tmp_path, **environment)

    return submit


@pytest.fixture
def lingering(tmp_path):
    """A stand-in for Python: the program takes long at its first start."""
    path = tmp_path / "python"
    path.write_text(
        f'#!/bin/sh\nshift 2\nexec {sys.executable} -m tests.parallel.broken_job linger "$@"\n'
    )
    path.chmod(0o755)
    return str(path)


def said(folder, job):
    return (folder / f"vgmpi-{job}.out").read_text()


@pytest.mark.parametrize(
    "flags, environment",
    [
        ((), {}),
        (("--nodes=2", "--ntasks-per-node=1"), {}),
        (("--nodes=2", "--ntasks-per-node=1"), {"MPI": "mpirun"}),
    ],
)
def test_a_job(cluster, submit, one, tmp_path, flags, environment):
    job = submit(flags, **environment)
    ended = cluster.until_ended(job)
    assert (ended["JobState"], ended["NumNodes"]) == ("COMPLETED", "2" if flags else "1"), said(
        tmp_path, job
    )
    assert "on 2 rank(s)" in said(tmp_path, job)
    assert digests(tmp_path / "out") == one[1]


def test_tasks_that_do_not_find_each_other(cluster, submit, tmp_path):
    """Nothing is written by two that believe they are alone; Open MPI itself may refuse that."""
    job = submit(MPI="none")
    assert cluster.until_ended(job)["JobState"] == "FAILED"
    text = said(tmp_path, job)
    assert "SLURM started 2 tasks but MPI sees 1" in text or "direct launched" in text
    assert not (tmp_path / "out").exists()


def test_an_array(cluster, submit, one, tmp_path):
    """The task's number is a value of the scene, and each has its folder."""
    job = submit(("--array=2,4",), ("--set", "time.frames={task}"))
    for task in (2, 4):
        assert cluster.until_ended(f"{job}_{task}")["JobState"] == "COMPLETED"
        assert len(RunReader(tmp_path / f"out-{task}").times) == task
    assert not (tmp_path / "out").exists()
    # checkpoints hold the scene's text, in which a value was set
    want = {name: sha for name, sha in one[1].items() if "checkpoints" not in name}
    found = digests(tmp_path / "out-4")
    assert {name: found[name] for name in want} == want


def test_a_fit_as_an_array(cluster, tmp_path):
    """Three jobs on two nodes share its runs, with the same bits as one process."""
    short = BALL.replace("end = 0.06", "end = 0.02").replace("frames = 7", "frames = 3")
    scene, file = write_fit(tmp_path, short, FIT.replace("runs = 40", "runs = 14"))
    reference(tmp_path, short)
    done = go(scene, file, tmp_path / "alone")
    assert done.returncode == 0, done.stderr
    words = (ROOT / "slurm" / "fit.sbatch", scene, file, "-o", tmp_path / "fit")
    job = cluster.submit("--array=1-3", *words, cwd=tmp_path, PYTHON=sys.executable)
    for task in (1, 2, 3):
        ended = cluster.until_ended(f"{job}_{task}")
        text = said(tmp_path, f"fit-{ended['JobId']}")
        assert ended["JobState"] == "COMPLETED" and "report.md" in text, text
    assert bits(tmp_path / "fit") == bits(tmp_path / "alone")
    assert not list(tmp_path.glob("fit/**/*.lock"))


def test_the_time_limit(cluster, submit, lingering, one, tmp_path):
    """A job on two nodes and a task of an array: each hears of its limit, writes a checkpoint,
    queues itself again and ends with the same bytes.
    """
    limit = ("--time=3", "--signal=B:USR1@135")  # heard 15 to 45 s after the start
    jobs = [
        submit((*limit, "--nodes=2", "--ntasks-per-node=1"), PYTHON=lingering),
        submit((*limit, "--array=7"), PYTHON=lingering) + "_7",
    ]
    for job in jobs:
        cluster.until_ended(job, or_restarted=True)
        cluster.say("scontrol", "update", f"job={job}", "timelimit=60")  # once is enough
    for job, folder in zip(jobs, ("out", "out-7")):
        ended = cluster.until_ended(job)
        text = said(tmp_path, ended["JobId"])
        assert ended["JobState"] == "COMPLETED" and int(ended["Restarts"]) > 0, text
        assert "USR1 at" in text and "start 1" in text and "--resume" in text
        assert digests(tmp_path / folder) == one[1]


@pytest.mark.parametrize("nodes", [1, 2])
def test_a_rank_that_is_killed(cluster, submit, lingering, one, tmp_path, nodes):
    """The others do not wait for it up to the time limit; the run goes on from its checkpoint."""
    spread = (f"--nodes={nodes}", f"--ntasks-per-node={2 // nodes}")
    job = submit(spread, PYTHON=lingering, SLURM_WAIT="2")
    there = tmp_path / "out" / "checkpoints" / CHECKPOINT.replace("h5", "json")
    cluster.until(there.exists, "checkpoint")
    os.kill(cluster.tasks(job)[1], signal.SIGKILL)
    ended = cluster.until_ended(job)
    text = said(tmp_path, job)
    assert (ended["JobState"], ended["Restarts"]) == ("FAILED", "0"), text
    assert "RESUME=1 with the same command goes on" in text
    assert not cluster.tasks(job)
    job = submit(spread, RESUME="1")
    assert cluster.until_ended(job)["JobState"] == "COMPLETED", said(tmp_path, job)
    assert digests(tmp_path / "out") == one[1]


def test_scancel_ends_it_for_good(cluster, submit, lingering, tmp_path):
    """With a checkpoint; it does not queue itself again."""
    job = submit(PYTHON=lingering)
    checkpoints = tmp_path / "out" / "checkpoints"
    cluster.until((checkpoints / CHECKPOINT.replace("h5", "json")).exists, "checkpoint")
    cluster.say("scancel", job)
    cluster.until(lambda: not cluster.tasks(job), f"end of the tasks of {job}")
    cluster.until(lambda: cluster.say("sinfo", "-h", "-o", "%T") == "idle\n", "idle nodes")
    ended = cluster.until_ended(job)
    assert (ended["JobState"], ended["Restarts"]) == ("CANCELLED", "0"), said(tmp_path, job)
    assert len(list(checkpoints.glob("*.json"))) == 2


def test_a_stop_by_the_live_page_ends_the_job(cluster, submit, lingering, one, tmp_path):
    """The page sends USR1 to rank 0: a checkpoint, no other start, and RESUME=1 goes on."""
    job = submit(PYTHON=lingering)
    there = tmp_path / "out" / "checkpoints" / CHECKPOINT.replace("h5", "json")
    cluster.until(there.exists, "checkpoint")
    os.kill(cluster.tasks(job)[0], signal.SIGUSR1)
    ended = cluster.until_ended(job)
    text = said(tmp_path, job)
    assert (ended["JobState"], ended["Restarts"]) == ("FAILED", "0"), text
    assert "stopped with a checkpoint on request" in text and "USR1 at" not in text
    job = submit(RESUME="1")
    assert cluster.until_ended(job)["JobState"] == "COMPLETED", said(tmp_path, job)
    assert digests(tmp_path / "out") == one[1]

"""What goes wrong while a run is on its way ends it on all ranks, soon, and says what it was."""

import re
import sys

import pytest

from tests.support.damaged_files import forge
from tests.support.launch import ROOT, mpirun, run
from tests.support.simulated_runs import run_here
from tests.support.small_scenes import MIXED, write
from vgmpi.io.run_reader import RunReader

pytestmark = pytest.mark.mpi

SCENE = MIXED.replace("PRECISION", "double")
JOB = ("-m", "tests.parallel.broken_job")


@pytest.fixture(scope="module", autouse=True)
def compiled(tmp_path_factory):
    """Compile once, so that the time limits below hold."""
    folder = tmp_path_factory.mktemp("warm")
    run_here(write(folder, SCENE), folder / "out", 1, "--stop-after", "1 step", code=75)


def test_an_exception_on_one_rank_ends_all(tmp_path):
    job = mpirun(3, *JOB, "raise_on_rank_1", write(tmp_path, SCENE), "-q")
    assert job.returncode == 1
    assert "rank 1 of 3 failed; all ranks end" in job.stderr
    assert "ValueError: a fault on purpose" in job.stderr
    assert "broken_job.py" in job.stderr, "no traceback"
    assert "please report it" in job.stderr


def test_a_blow_up_names_who_and_when(tmp_path):
    """The same words on one rank and on three, and the earlier frames can be read."""
    found = []
    for n in (1, 3):
        out = tmp_path / str(n) / "out"
        out.parent.mkdir()
        scene = write(out.parent, SCENE)
        job = mpirun(n, *JOB, "step_too_large", scene, "-q", "-o", out)
        assert job.returncode == 3, job.stderr
        assert "Traceback" not in job.stderr
        said = re.findall(
            r"blow-up: (object (\w+), particle (\d+), step (\d+), time \S+ s: .*)", job.stderr
        )
        assert len(said) == 1, job.stderr
        words, name, particle, step = said[0]
        assert int(step) > 80
        known = RunReader(out)
        thing = next(o for o in known.objects if o["name"] == name)
        assert 0 <= int(particle) - thing["first_row"] < thing["row_count"]
        assert len(known.times) >= 2
        total = sum(o["row_count"] for o in known.objects if o["material"])
        assert [len(known.frame(k)["positions"]) for k in range(len(known.times))] == [total] * len(
            known.times
        )
        found.append(words.replace(str(out), "OUT"))
    assert found[0] == found[1]


def test_a_particle_outside_is_never_lost_in_silence(tmp_path):
    job = mpirun(2, *JOB, "leave_the_domain", write(tmp_path, SCENE), "-q")
    assert job.returncode == 3, job.stderr
    assert "object pool, particle 7, step 6" in job.stderr
    assert "left the domain" in job.stderr


def test_slurm_started_tasks_that_are_alone(tmp_path):
    scene = write(tmp_path, SCENE)
    flags = (sys.executable, "-m", "vgmpi", scene, "-q", "-o", tmp_path / "out")
    job = run(flags, env={"SLURM_NTASKS": "4"})
    assert job.returncode == 2
    lines = [line for line in job.stderr.splitlines() if "SLURM" in line]
    assert len(lines) == 1 and "4 tasks" in lines[0] and "MPI sees 1" in lines[0]
    assert not (tmp_path / "out").exists()
    job = run([*flags, "--plan"], env={"SLURM_NTASKS": "1"})
    assert job.returncode == 0, job.stderr


def test_ranks_of_mpirun_in_a_job_of_slurm(tmp_path):
    """On all nodes but the first they have the environment of mpirun's daemons, a task per node."""
    scene = write(tmp_path, SCENE)
    alone = {"SLURM_NTASKS": "1", "SLURM_STEP_NUM_TASKS": "1"}
    job = mpirun(2, "-m", "vgmpi", scene, "--plan", env=alone)
    assert job.returncode == 0, job.stderr


def test_stop_after_steps(tmp_path):
    scene = write(tmp_path, SCENE)
    job = mpirun(2, "-m", "vgmpi", scene, "-o", tmp_path / "out", "--stop-after", "13 steps")
    assert job.returncode == 75, job.stderr
    assert "stopped; go on with --resume" in job.stdout
    assert [p.name for p in (tmp_path / "out" / "checkpoints").glob("*.h5")] == [
        "checkpoint_000000013.h5"
    ]
    job = mpirun(
        1, "-m", "vgmpi", scene, "-o", tmp_path / "out", "--resume", "--stop-after", "4 steps"
    )
    assert job.returncode == 75, job.stderr
    assert (tmp_path / "out" / "checkpoints" / "checkpoint_000000017.h5").exists()


def test_a_forged_checkpoint_ends_all_ranks_with_one_line(tmp_path):
    """Its checksums are right, and what is wrong lies in the last rank's share."""
    scene = write(tmp_path, SCENE)
    flags = ("-m", "vgmpi", scene, "-q", "-o", tmp_path / "out")
    assert mpirun(2, *flags, "--stop-after", "2 steps").returncode == 75
    path = tmp_path / "out" / "checkpoints" / "checkpoint_000000002.h5"

    def beyond(f):
        f["group_001/x"][-1] = 1 << 62

    forge(path, beyond)
    job = mpirun(3, *flags, "--resume")
    assert job.returncode == 2, job.stderr
    (line,) = [line for line in job.stderr.splitlines() if path.name in line]
    assert f"{path}: group_001/x: row " in line and "outside its block or the domain" in line
    assert "Traceback" not in job.stderr and "ignal" not in job.stderr


@pytest.mark.parametrize(
    "raises",
    ["ImportError('libmpi.so.40: cannot open')", "RuntimeError('cannot load MPI library')"],
)
def test_without_mpi_it_runs_on_one_rank(raises, tmp_path):
    """A stand-in for an mpi4py that finds no MPI library."""
    stub = tmp_path / "stub" / "mpi4py"
    stub.mkdir(parents=True)
    (stub / "__init__.py").touch()
    (stub / "MPI.py").write_text(f"raise {raises}\n")
    scene = write(tmp_path, SCENE)
    flags = ("-o", tmp_path / "out", "--stop-after", "2 steps")
    path = f"{stub.parent}:{ROOT}"
    job = run([sys.executable, "-m", "vgmpi", scene, *flags], env={"PYTHONPATH": path})
    assert job.returncode == 75, job.stderr
    lines = [line for line in job.stderr.splitlines() if "MPI" in line]
    assert len(lines) == 1 and "running on one rank" in lines[0], job.stderr
    assert "on 1 rank(s)" in job.stdout

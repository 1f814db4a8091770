"""slurm/vgmpi.sbatch without SLURM: srun and scontrol are stand-ins that write down what they are
told."""

import os
import signal
import subprocess

import pytest

from tests.support.launch import PATIENCE, ROOT, until

SCRIPT = ROOT / "slurm" / "vgmpi.sbatch"
SRUN = """#!/bin/bash
echo "$@" >> "$LOG/srun"
echo "$SLURM_WAIT $SLURM_KILL_BAD_EXIT" > "$LOG/patience"
trap 'echo USR1 >> "$LOG/heard"; sleep 0.3; exit 75' USR1
touch "$LOG/running"
for i in $(seq 100); do [ -e "$LOG/end" ] && exit "$(cat "$LOG/end")"; sleep 0.05; done
exit 99
"""
SCONTROL = """#!/bin/bash
echo "$@" >> "$LOG/scontrol"
"""


@pytest.fixture
def job(tmp_path):
    """Starts the script; returns a function job(*arguments, **environment)."""
    for name, text in {"srun": SRUN, "mpirun": SRUN, "scontrol": SCONTROL}.items():
        (tmp_path / "bin").mkdir(exist_ok=True)
        (tmp_path / "bin" / name).write_text(text)
        (tmp_path / "bin" / name).chmod(0o755)
    started = []

    def start(*arguments, **environment):
        env = {**os.environ, "PATH": f"{tmp_path}/bin:{os.environ['PATH']}", "LOG": str(tmp_path)}
        env |= {"SLURM_JOB_ID": "42", "PYTHON": "python", **environment}
        process = subprocess.Popen(
            ["bash", SCRIPT, *arguments],
            env=env,
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        started.append(process)
        return process

    yield start
    for process in started:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()


def test_the_script_is_bash():
    assert subprocess.run(["bash", "-n", SCRIPT]).returncode == 0
    text = SCRIPT.read_text()
    for line in ("--signal=B:USR1@120", "--requeue", "--open-mode=append"):
        assert f"#SBATCH {line}\n" in text


def test_usr1_reaches_the_step_and_the_job_queues_itself(job, tmp_path):
    process = job("runs/a/scene.toml", "--set", "time.end=1")
    until((tmp_path / "running").exists, "the step does not run")
    process.send_signal(signal.SIGUSR1)  # the batch shell alone, as --signal=B: does
    out, _ = process.communicate(timeout=PATIENCE)
    assert process.returncode == 75
    assert (tmp_path / "heard").read_text() == "USR1\n"
    assert (tmp_path / "scontrol").read_text() == "requeue 42\n"
    words = (
        "--mpi=pmix python -m vgmpi runs/a/scene.toml -o runs/a/out --threads 1 --set time.end=1"
    )
    assert (tmp_path / "srun").read_text() == words + "\n"
    assert "queues itself again" in out


def test_a_run_that_was_asked_to_stop_ends_the_job(job, tmp_path):
    """The button of the live page asks the ranks themselves: the job does not queue itself."""
    (tmp_path / "end").write_text("75")
    process = job("scene.toml")
    out, _ = process.communicate(timeout=PATIENCE)
    assert process.returncode == 75 and not (tmp_path / "scontrol").exists()
    assert "stopped with a checkpoint on request; RESUME=1 with the same command" in out


@pytest.mark.parametrize("code", [0, 1, 2, 3])
def test_other_ends_are_ends(job, tmp_path, code):
    (tmp_path / "end").write_text(str(code))
    process = job("scene.toml")
    process.communicate(timeout=PATIENCE)
    assert process.returncode == code
    assert not (tmp_path / "scontrol").exists()


@pytest.mark.parametrize(
    "there, environment, resumes",
    [
        (True, {"SLURM_RESTART_COUNT": "1"}, True),
        (False, {"SLURM_RESTART_COUNT": "1"}, False),
        (True, {}, False),
        (True, {"RESUME": "1"}, True),
    ],
)
def test_a_restarted_job_resumes_if_there_is_a_checkpoint(
    job, tmp_path, there, environment, resumes
):
    (tmp_path / "end").write_text("0")
    folder = tmp_path / "my out" / "checkpoints"
    folder.mkdir(parents=True)
    if there:
        (folder / "checkpoint_000000007.json").touch()
    job("scene.toml", OUT=str(folder.parent), **environment).communicate(timeout=PATIENCE)
    said = (tmp_path / "srun").read_text()
    assert f"-o {folder.parent} " in said
    assert ("--resume" in said) == resumes


@pytest.mark.parametrize("name", ["[1]", "a\\b", "-n", "two words", "*"])
def test_folders_of_any_name(job, tmp_path, monkeypatch, name):
    """It finds the checkpoint in each, and none is a flag."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "end").write_text("0")
    checkpoints = tmp_path / name / "checkpoints"
    checkpoints.mkdir(parents=True)
    (checkpoints / "checkpoint_000000007.json").touch()
    job("scene.toml", OUT=name, SLURM_RESTART_COUNT="1").communicate(timeout=PATIENCE)
    said = (tmp_path / "srun").read_text()
    assert "--resume" in said and f"-o {'./' if name[0] == '-' else ''}{name} " in said


def test_a_node_that_broke_before_the_first_checkpoint(job, tmp_path):
    """What the job before wrote is replaced."""
    (tmp_path / "end").write_text("0")
    job("scene.toml", OUT=str(tmp_path), SLURM_RESTART_COUNT="1").communicate(timeout=PATIENCE)
    assert "--overwrite" in (tmp_path / "srun").read_text()


def test_tasks_of_an_array_have_their_own(job, tmp_path):
    array = {"SLURM_ARRAY_JOB_ID": "40", "SLURM_ARRAY_TASK_ID": "3", "MPI": "pmi2"}
    process = job("a/scene.toml", "--set", "seed={task}", **array)
    until((tmp_path / "running").exists, "the step does not run")
    process.send_signal(signal.SIGUSR1)
    process.communicate(timeout=PATIENCE)
    said = (tmp_path / "srun").read_text()
    assert "--mpi=pmi2 " in said and "-o a/out-3 " in said and said.endswith("--set seed=3\n")
    assert (tmp_path / "scontrol").read_text() == "requeue 40_3\n"


@pytest.mark.parametrize("environment, seconds", [({}, 30), ({"SLURM_WAIT": "7"}, 7)])
def test_ranks_that_are_left_over_end(job, tmp_path, environment, seconds):
    """But not those that end with the first to stop with a checkpoint."""
    (tmp_path / "end").write_text("137")
    process = job("scene.toml", **environment)
    out, _ = process.communicate(timeout=PATIENCE)
    assert (tmp_path / "patience").read_text() == f"{seconds} 0\n"
    assert process.returncode == 137
    assert "ended by signal 9; RESUME=1 with the same command goes on" in out


def test_mpirun_instead_of_srun(job, tmp_path):
    (tmp_path / "end").write_text("0")
    job("scene.toml", MPI="mpirun").communicate(timeout=PATIENCE)
    assert (tmp_path / "srun").read_text().startswith("--bind-to none python -m vgmpi scene.toml")


def test_without_a_scene_it_says_how(job):
    process = job()
    process.communicate(timeout=PATIENCE)
    assert process.returncode != 0

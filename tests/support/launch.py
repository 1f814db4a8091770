"""Start programs from a test, also on MPI ranks, with a time limit that leaves nothing running.

There is one limit for all of them. It finds what hangs and says nothing about how fast a machine
is; a machine that is busier yet sets VGMPI_PATIENCE [s].
"""

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PATIENCE = float(os.environ.get("VGMPI_PATIENCE", "1200"))  # seconds
OPEN_MPI = {  # as root, and with more ranks than cores
    "OMPI_ALLOW_RUN_AS_ROOT": "1",
    "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
    "OMPI_MCA_rmaps_base_oversubscribe": "1",
    "OMPI_MCA_hwloc_base_binding_policy": "none",
    "OMPI_MCA_btl_vader_single_copy_mechanism": "none",
    "OMPI_MCA_mpi_yield_when_idle": "1",  # other tests run beside it on the same cores
}


def start(command, env=None, cwd=ROOT) -> subprocess.Popen:
    """Start a command in a process group of its own; output as text."""
    return subprocess.Popen(
        [str(word) for word in command],
        cwd=cwd,
        env={**os.environ, **OPEN_MPI, "PYTHONPATH": str(ROOT), **(env or {})},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def finish(process: subprocess.Popen) -> subprocess.CompletedProcess:
    """Wait for its end; its process group is killed when patience is over."""
    try:
        out, err = process.communicate(timeout=PATIENCE)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        out, err = process.communicate()
        pytest.fail(f"no end within {PATIENCE} s: {process.args}\n{out}\n{err}")
    return subprocess.CompletedProcess(process.args, process.returncode, out, err)


def until(there: Callable[[], bool], what: str) -> None:
    """Wait until something is there; the test fails when patience is over."""
    end = time.monotonic() + PATIENCE
    while not there():
        if time.monotonic() > end:
            pytest.fail(f"within {PATIENCE} s: {what}")
        time.sleep(0.01)


def run(command, env=None, cwd=ROOT) -> subprocess.CompletedProcess:
    """Run a command to its end."""
    return finish(start(command, env, cwd))


def on_ranks(n, *arguments) -> list:
    """The command `mpirun -n N python ARGUMENTS`; the test is skipped where there is no mpirun."""
    if shutil.which("mpirun") is None:
        pytest.skip("no mpirun")
    return ["mpirun", "-n", n, sys.executable, *arguments]


def mpirun(n, *arguments, env=None, cwd=ROOT) -> subprocess.CompletedProcess:
    """Run python ARGUMENTS on n ranks."""
    return run(on_ranks(n, *arguments), env, cwd)


def go(scene, out, n, *flags, code=0) -> subprocess.CompletedProcess:
    """Run a scene into the folder `out` on n ranks; it ends with this exit code."""
    job = mpirun(n, "-m", "vgmpi", scene, "-q", "-o", out, *flags)
    assert job.returncode == code, job.stderr
    return job

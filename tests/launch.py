"""Start programs on MPI ranks from a test, with an outer time limit that leaves nothing running."""

import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
OPEN_MPI = {  # as root, and with more ranks than cores
    "OMPI_ALLOW_RUN_AS_ROOT": "1",
    "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
    "OMPI_MCA_rmaps_base_oversubscribe": "1",
    "OMPI_MCA_hwloc_base_binding_policy": "none",
    "OMPI_MCA_btl_vader_single_copy_mechanism": "none",
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


PATIENCE = 8  # limits are there to find what hangs, not machines that do other things as well


def finish(process: subprocess.Popen, timeout=120) -> subprocess.CompletedProcess:
    """Wait for its end; its process group is killed when the time is over."""
    try:
        out, err = process.communicate(timeout=PATIENCE * timeout)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        out, err = process.communicate()
        pytest.fail(f"no end within {PATIENCE * timeout} s: {process.args}\n{out}\n{err}")
    return subprocess.CompletedProcess(process.args, process.returncode, out, err)


def run(command, timeout=120, env=None, cwd=ROOT) -> subprocess.CompletedProcess:
    """Run a command to its end."""
    return finish(start(command, env, cwd), timeout)


def on_ranks(n, *arguments) -> list:
    """The command `mpirun -n N python ARGUMENTS`; the test is skipped where there is no mpirun."""
    if shutil.which("mpirun") is None:
        pytest.skip("no mpirun")
    return ["mpirun", "-n", n, sys.executable, *arguments]


def mpirun(n, *arguments, timeout=120, env=None, cwd=ROOT) -> subprocess.CompletedProcess:
    """Run python ARGUMENTS on n ranks."""
    return run(on_ranks(n, *arguments), timeout, env, cwd)

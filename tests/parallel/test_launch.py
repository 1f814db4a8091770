"""How a run of several ranks is stopped, and that it leaves nothing to MPI at its end."""

import os
import re
import subprocess
import sys

import pytest

from tests.support.launch import mpirun
from tests.support.small_scenes import write
from vgmpi.parallel.launch import describe_stop, find_launcher

SCENE = """
[domain]
size = [0.4, 0.4, 0.4]
cell = 0.05
[time]
end = 0.01
frames = 2
[material.water]
kind = "fluid"
[[object]]
name = "pool"
material = "water"
shape = { box = [[0, 0, 0], [0.4, 0.4, 0.15]] }
"""
ENDING = """
import atexit
import os

from mpi4py import MPI
from vgmpi.parallel import communicator

requests = []
begin = communicator._MpiLink.__init__


def record(self, *arguments):
    begin(self, *arguments)
    requests.extend(self._requests)


@atexit.register  # runs last, since it is registered first
def report():
    freed = [request == MPI.REQUEST_NULL for request in requests]
    os.write(1, f"{len(freed)} requests, {sum(freed)} freed\\n".encode())  # one write, one line


communicator._MpiLink.__init__ = record
from vgmpi.commands.cli import main

raise SystemExit(main([%r, "-q", "-o", %r]))
"""


def test_all_persistent_requests_are_freed_at_the_end(tmp_path):
    """MPICH 5.0.2 prints a line for each that is not, after the result of the run."""
    scene = write(tmp_path, SCENE)
    (tmp_path / "run.py").write_text(ENDING % (str(scene), str(tmp_path / "out")))
    job = mpirun(2, tmp_path / "run.py")
    assert job.returncode == 0, job.stderr
    told = re.findall(r"(\d+) requests, (\d+) freed", job.stdout)
    assert len(told) == 2
    for count, freed in told:
        assert int(count) > 0 and count == freed


@pytest.mark.parametrize(
    "library, launcher, job, line",
    [
        (
            "Open MPI v5.0.11, package: Open MPI",
            71,
            None,
            "kill -USR1 71; after Ctrl-C, Open MPI 5.0.11 ends the ranks within 0.25 s",
        ),
        (
            "Open MPI v4.1.4, package: Debian",
            None,
            None,
            "kill -USR1 PID of mpirun; after Ctrl-C, Open MPI 4.1.4 ends the ranks within 1 s",
        ),
        ("MPICH Version:      5.0.2", 71, None, "Ctrl-C, or kill -USR1 71"),
        ("MPICH Version:      5.0.2", 71, "38", "scancel --batch --signal=USR1 38"),
    ],
)
def test_the_line_names_the_signal(library, launcher, job, line):
    assert describe_stop(library, launcher, job) == f"to stop with a checkpoint: {line}"


def test_the_launcher_is_an_ancestor(tmp_path):
    """Of a rank of MPICH it is the parent of the parent; names may hold parentheses."""

    def process(number, name, parent):
        folder = tmp_path / str(number)
        folder.mkdir()
        (folder / "comm").write_text(f"{name}\n")
        (folder / "stat").write_text(f"{number} ({name}) S {parent} 1 1 0 -1")

    process(os.getppid(), "proxy) 3 (", 7_000_001)
    assert find_launcher(tmp_path) is None
    process(7_000_001, "mpirun", 1)
    assert find_launcher(tmp_path) == 7_000_001


@pytest.mark.parametrize("given, expected", [(None, "1"), ("0", "0")])
def test_ranks_that_wait_leave_their_core_unless_the_user_says_otherwise(given, expected):
    name = "OMPI_MCA_mpi_yield_when_idle"
    environment = {key: value for key, value in os.environ.items() if key != name}
    if given is not None:
        environment[name] = given
    code = f"""
import os, sys
from vgmpi.parallel.communicator import init_communicator
assert "mpi4py.MPI" not in sys.modules  # Open MPI reads it when it starts
init_communicator()
print(os.environ[{name!r}])
"""
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == [expected]

"""A killed run and a full disk leave the previous checkpoint valid and say what happened."""

import logging
import signal
import sys

import pytest

from tests.parallel.fault_job import PLACES, state
from tests.support.launch import mpirun, run
from tests.support.small_disk import small_disk
from vgmpi.io import checkpoint
from vgmpi.parallel.communicator import SerialCommunicator

FIRST, SECOND = "checkpoint_000000001.h5", "checkpoint_000000002.h5"


@pytest.mark.parametrize("place", PLACES)
def test_kill_during_a_checkpoint(place, tmp_path, caplog):
    job = run([sys.executable, "-m", "tests.parallel.fault_job", tmp_path, "kill", place])
    assert job.returncode == -signal.SIGKILL, job.stderr
    finished = place == "clean-up"
    with caplog.at_level(logging.WARNING):
        found = checkpoint.latest_valid(tmp_path)
    assert found.name == (SECOND if finished else FIRST)
    said = [r.getMessage() for r in caplog.records]
    if finished:
        assert said == []
    else:
        assert len(said) == 1 and "\n" not in said[0]
        assert SECOND in said[0] and "not finished" in said[0]
    with checkpoint.open(found) as c:
        x = c.read_rows("particles/x", 0, 1000)
        assert (x == c.attrs["step"] + 0.5).all()
    checkpoint.write(tmp_path, SerialCommunicator(), state(3, 10))  # what is left over does no harm
    assert checkpoint.latest_valid(tmp_path).name == "checkpoint_000000003.h5"
    left = sorted(p.name for p in tmp_path.iterdir())
    assert left == [
        found.name,
        found.name.replace(".h5", ".json"),
        "checkpoint_000000003.h5",
        "checkpoint_000000003.json",
    ]


@pytest.fixture
def disk(tmp_path):
    """A disk of 4 MB."""
    with small_disk(tmp_path / "disk", 4 << 20) as folder:
        yield folder


def check_full(job, folder, caplog):
    """One line about the disk, nothing half written, and the first checkpoint still good."""
    assert job.returncode == 5, job.stderr
    lines = job.stdout.splitlines()
    assert len(lines) == 1
    assert SECOND in lines[0] and f"{FIRST} is still valid" in lines[0]
    (folder / "filler").unlink(missing_ok=True)
    assert sorted(p.name for p in folder.iterdir()) == [FIRST, FIRST.replace(".h5", ".json")]
    with caplog.at_level(logging.WARNING):
        assert checkpoint.latest_valid(folder).name == FIRST
    assert caplog.records == []
    return lines[0]


@pytest.mark.mpi
@pytest.mark.parametrize(
    "fault, rows, n, gather",
    [
        ("full", 70_000, 1, 0),  # the second dataset does not fit
        ("full", 70_000, 2, 0),
        ("full", 500_000, 2, 1),  # nor does the first
        ("fills while writing", 200_000, 1, 0),
        ("fills while writing", 200_000, 2, 0),
        ("fills while writing", 200_000, 2, 1),
        ("fills before layout", 1_000, 2, 0),
        ("fills before rows", 20_000, 2, 0),
    ],
)
def test_full_disk(fault, rows, n, gather, disk, caplog):
    job = mpirun(
        n,
        *("-m", "tests.parallel.fault_job", disk, fault, rows * 2 // n),
        env={"VGMPI_GATHER": str(gather)},
    )
    assert "no space left on the disk" in check_full(job, disk, caplog)


def test_file_size_limit(tmp_path, caplog):
    """The same without root: the system refuses files above 1 MB."""
    job = run([sys.executable, "-m", "tests.parallel.fault_job", tmp_path, "size limit", 100_000])
    assert "File too large" in check_full(job, tmp_path, caplog)

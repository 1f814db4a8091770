"""Files have the same bytes for any number of ranks, written in parallel or gathered."""

import h5py
import pytest

from tests.parallel import files_job
from tests.support.file_digests import digests
from tests.support.launch import mpirun
from tests.support.simulated_ranks import run as simulate
from vgmpi.io import checkpoint
from vgmpi.parallel.communicator import SerialCommunicator

pytestmark = pytest.mark.mpi


@pytest.fixture(scope="module")
def want(tmp_path_factory):
    """What one rank writes."""
    folder = tmp_path_factory.mktemp("one")
    files_job.write_all(folder, SerialCommunicator())
    found = digests(folder)
    assert len(found) > 50
    assert not any(".tmp" in name for name in found)
    return found


@pytest.mark.parametrize("n, gather", [(1, 0), (2, 0), (2, 1), (3, 0), (3, 1)])
def test_any_number_of_ranks(n, gather, want, tmp_path):
    job = mpirun(
        n,
        "-m",
        "tests.parallel.files_job",
        tmp_path,
        env={"VGMPI_GATHER": str(gather)},
    )
    assert job.returncode == 0, job.stderr
    parallel = h5py.get_config().mpi
    assert job.stderr.count("gathered on rank 0") == (n > 1 and (gather or not parallel))
    found = digests(tmp_path)
    assert found == want
    assert checkpoint.latest_valid(tmp_path / "checkpoints").name == "checkpoint_000000150.h5"


@pytest.mark.parametrize("n", [2, 5])
def test_simulated_ranks(n, want, tmp_path):
    simulate(n, lambda ranks: files_job.write_all(tmp_path, ranks))
    assert digests(tmp_path) == want
    path = tmp_path / "checkpoints" / "checkpoint_000000100.h5"
    simulate(n, lambda ranks: checkpoint.verify(path, ranks))
    with h5py.File(path, "r+") as f:
        f["particles/x"][-1, 0] += 1e-12
    with pytest.raises(checkpoint.CheckpointError, match="checksum of particles/x"):
        simulate(n, lambda ranks: checkpoint.verify(path, ranks))


@pytest.mark.parametrize("length", [180, 245, 300])
def test_long_paths(length, want, tmp_path):
    """Open MPI ends the program where a path has more than about 244 bytes."""
    folder = tmp_path
    while len(str(folder)) < length:
        folder /= "d" * min(60, length - len(str(folder)))
    folder.mkdir(parents=True)
    job = mpirun(2, "-m", "tests.parallel.files_job", folder)
    assert job.returncode == 0, job.stderr
    assert digests(folder) == want

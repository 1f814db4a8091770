"""Files have the same bytes for any number of ranks, written in parallel or gathered."""

import hashlib

import h5py
import pytest

from tests.launch import mpirun
from tests.parallel import files_job
from tests.simulated import run as simulate
from vgmpi.domain.ranks import Alone
from vgmpi.output import checkpoint

pytestmark = pytest.mark.mpi


def digests(folder) -> dict[str, str]:
    """sha256 of every dataset of every HDF5 file, and of every other file."""
    found = {}
    for path in sorted(folder.rglob("*")):
        name = str(path.relative_to(folder))
        if path.suffix in (".h5", ".vtkhdf"):
            with h5py.File(path) as f:
                f.visititems(
                    lambda key, item, f=f, name=name: found.update(
                        {f"{name}:{key}": _sha(item[()])} if isinstance(item, h5py.Dataset) else {}
                    )
                )
        elif path.is_file():
            found[name] = _sha(path.read_bytes())
    return found


def _sha(value):
    data = value if isinstance(value, bytes) else value.tobytes()
    return hashlib.sha256(data).hexdigest()


@pytest.fixture(scope="module")
def want(tmp_path_factory):
    """What one rank writes."""
    folder = tmp_path_factory.mktemp("one")
    files_job.write_all(folder, Alone())
    found = digests(folder)
    assert len(found) > 50
    assert not any(".tmp" in name for name in found)
    return found


@pytest.mark.parametrize("gather", [0, 1])
@pytest.mark.parametrize("n", [1, 2, 3])
def test_any_number_of_ranks(n, gather, want, tmp_path):
    job = mpirun(
        n,
        "-m",
        "tests.parallel.files_job",
        tmp_path,
        env={"VGMPI_GATHER": str(gather)},
        timeout=100,
    )
    assert job.returncode == 0, job.stderr
    parallel = h5py.get_config().mpi
    assert job.stderr.count("gathered on rank 0") == (n > 1 and (gather or not parallel))
    found = digests(tmp_path)
    assert found == want
    assert checkpoint.latest(tmp_path / "checkpoints").name == "checkpoint_000000150.h5"


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

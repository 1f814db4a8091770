"""What the files of a run hold: their bytes, or one sha256 per dataset."""

import hashlib

import h5py
import pytest

from tests.support.launch import go
from tests.support.simulated_runs import run_here
from tests.support.small_scenes import write

# Ways to run a scene beside one rank with one thread: on simulated ranks that have several of both,
# and on those of mpirun where time does not count. tests/parallel/test_bits.py and test_bits_all.py
# have mpirun always. A restart (assert_same_after_stop) goes from two ranks to three.
RANKS_AND_THREADS = pytest.mark.parametrize(
    "start, ranks, flags",
    [
        (run_here, 3, ("--threads", "2")),
        *(
            pytest.param(go, ranks, flags, marks=(pytest.mark.slow, pytest.mark.mpi))
            for flags in ((), ("--threads", "2"))
            for ranks in ((1, 3) if flags else (2, 3, 4, 7))
        ),
    ],
)


def files(folder) -> dict[str, bytes]:
    """Every file below a folder and its bytes."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


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


def frame_digests(found: dict[str, str]) -> dict[str, str]:
    """Those of the frames and the ledger: a restart has checkpoints of its own."""
    return {name: sha for name, sha in found.items() if "frame_" in name or "ledger" in name}


def run_on_one_rank(folder, text):
    """(scene, digests of the files) of a run of a scene's text, in `folder`/one."""
    scene = write(folder, text)
    run_here(scene, folder / "one", 1)
    return scene, digests(folder / "one")


def assert_same_files(scene, expected, folder, start, ranks, *flags):
    """A run on so many ranks writes the files of `expected`, to the bit.

    start: `go` for ranks of mpirun, `run_here` for simulated ones.
    """
    start(scene, folder, ranks, *flags)
    assert digests(folder) == expected


def assert_same_after_stop(scene, expected, folder, steps):
    """A run that stops on two ranks after some steps and goes on with three has the same frames."""
    run_here(scene, folder, 2, "--stop-after", f"{steps} steps", code=75)
    run_here(scene, folder, 3, "--resume")
    assert frame_digests(digests(folder)) == frame_digests(expected)

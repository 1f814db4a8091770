"""Writes a good checkpoint, then one that meets a fault.

python -m tests.parallel.fault_job FOLDER kill PLACE      dies by kill -9 at PLACE of the second one
mpirun -n N python -m tests.parallel.fault_job FOLDER FAULT ROWS   the second one has ROWS rows per
rank, and there is no room for them; see FAULTS
"""

import contextlib
import logging
import os
import resource
import signal
import sys
from pathlib import Path

import numpy as np

from vgmpi.io import checkpoint, hdf5_writer
from vgmpi.parallel.communicator import init_communicator


def state(step: int, rows: int) -> dict:
    x = np.full((rows, 3), step + 0.5)
    return {"attrs": {"step": step, "time": 0.0}, "groups": {"particles": {"x": x, "v": -x}}}


def die(*_):
    os.kill(os.getpid(), signal.SIGKILL)


PLACES = {  # what is replaced by death
    "rows": (hdf5_writer.Hdf5Writer, "_gather_rows"),
    "sync": (hdf5_writer.Hdf5Writer, "_sync"),
    "rename": (hdf5_writer.Hdf5Writer, "_rename"),
    "manifest": (hdf5_writer, "replace_text"),
    "clean-up": (checkpoint, "_remove_old"),
}


def see_nothing():
    """The look at the free space beforehand finds enough: another program takes it afterwards."""
    hdf5_writer._check_room = lambda *_: None


def fill_before(step: str):
    """Another program fills the disk just before this step of writing."""
    inner = getattr(hdf5_writer.Hdf5Writer, step)

    def full(self, *arguments):
        if self.ranks.rank == 0:
            with open(self.path.parent / "filler", "wb", buffering=0) as f:
                with contextlib.suppress(OSError):
                    while f.write(bytes(4096)):
                        pass
        self.ranks.barrier()
        return inner(self, *arguments)

    setattr(hdf5_writer.Hdf5Writer, step, full)


def limit_size():
    """Files end at 1 MB."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 20, 1 << 20))


FAULTS = {
    "full": lambda: None,
    "fills while writing": see_nothing,
    "fills before layout": lambda: (see_nothing(), fill_before("_lay_out")),
    "fills before rows": lambda: [fill_before(w) for w in ("_gather_rows", "_parallel_rows")],
    "size limit": limit_size,
}


def main(folder: Path, fault: str, detail: str) -> int:
    logging.basicConfig(format="%(message)s")
    ranks = init_communicator()
    checkpoint.write(folder, ranks, state(1, 1000))
    if fault == "kill":
        setattr(*PLACES[detail], die)
        rows = 1000
    else:
        FAULTS[fault]()
        rows = int(detail)
    try:
        checkpoint.write(folder, ranks, state(2, rows))
    except hdf5_writer.StoreError as error:
        if ranks.rank == 0:
            print(error, flush=True)
        return 5
    return 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), sys.argv[2], sys.argv[3]))

"""The live page of a run as a process of its own: `vgmpi scene.toml --live`."""

import logging
import os
import subprocess
import sys
from pathlib import Path

log = logging.getLogger("vgmpi")

LINGER = 600  # [s] after the end of the run without viewers when the page ends
LOG_NAME = "live.log"  # messages of the page, in the folder of the run
# variables by which MPI would take the page for a rank of the run
RANK_VARIABLES = ("OMPI_", "PMIX_", "PMI_", "PRTE_", "MPI_LOCALRANKID", "SLURM_PROCID")


def start_live_page(folder: Path, port: int) -> None:
    """Start the live page of a run that writes into a folder; the run goes on without it.

    The page prints its address, or one line about what is wrong. It survives the run.

    Args:
        folder: Output folder of the run.
        port: Port of the page; 0 is any free one.
    """
    words = ["live", folder, "--port", port, "--linger", LINGER, "--log", folder / LOG_NAME]
    environment = {
        name: value for name, value in os.environ.items() if not name.startswith(RANK_VARIABLES)
    }
    # a page that shares the processor with the run takes one thread
    environment |= {"NUMBA_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    try:
        subprocess.Popen(
            [sys.executable, "-m", "vgmpi", *map(str, words)],
            env=environment,
            stdin=subprocess.DEVNULL,
            start_new_session=True,  # Ctrl-C is for the run
        )
    except OSError as error:
        log.warning("no live page: %s", error.strerror)

"""The live page of a run as a process of its own, beside a run or for a notebook."""

import logging
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

log = logging.getLogger("vgmpi")

LINGER = 600  # [s] after the end of the run without viewers when the page ends
LOG_NAME = "live.log"  # messages of the page, in the folder of the run
# variables by which MPI would take the page for a rank of the run
RANK_VARIABLES = (
    "OMPI_",
    "PMIX_",
    "PMI_",
    "PRTE_",
    "MPI_LOCALRANKID",
    "SLURM_PROCID",
    "VGMPI_SUPERVISOR",
)


def start_live_page(folder: Path, port: int) -> None:
    """Start the live page of a run that writes into a folder; the run goes on without it.

    The page prints its address, or one line about what is wrong. It survives the run.

    Args:
        folder: Output folder of the run.
        port: Port of the page; 0 is any free one.
    """
    try:
        launch_page(folder, "--port", port, "--log", folder / LOG_NAME)
    except OSError as error:
        log.warning("no live page: %s", error.strerror)


def launch_page(folder: Path, *flags: object, **options: Any) -> subprocess.Popen:
    """Return the process of a live page that ends LINGER after the run, once nobody watches.

    Args:
        folder: Output folder of the run.
        flags: Further words of `vgmpi live`.
        options: Further options of subprocess.Popen.
    """
    environment = {
        name: value for name, value in os.environ.items() if not name.startswith(RANK_VARIABLES)
    }
    # a page that shares the processor with the run takes one thread
    environment |= {"NUMBA_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    words = ["live", folder, "--linger", LINGER, *flags]
    return subprocess.Popen(
        [sys.executable, "-m", "vgmpi", *map(str, words)],
        env=environment,
        stdin=subprocess.DEVNULL,
        start_new_session=True,  # Ctrl-C is for the run, or for the cell of a notebook
        **options,
    )

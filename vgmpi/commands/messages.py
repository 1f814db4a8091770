"""What commands on a scene print besides results: the log, refusals and errors of one line."""

import argparse
import logging
import os
import sys
import traceback
from pathlib import Path

from vgmpi.io.checkpoint import CheckpointError
from vgmpi.io.hdf5_writer import StoreError
from vgmpi.io.run_lock import RunFolderInUseError
from vgmpi.io.run_reader import RunError
from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.runtime import process_limits
from vgmpi.runtime.cache_files import ON_EVERY_RANK
from vgmpi.runtime.command_line import EXIT_USAGE
from vgmpi.runtime.config.schema import SceneError
from vgmpi.solver.run_outcome import BLEW_UP, BlowUp, InvalidRunOptions

log = logging.getLogger("vgmpi")

ONE_LINE_ERRORS = (
    SceneError, InvalidRunOptions, BlowUp, StoreError, RunFolderInUseError, CheckpointError,
    RunError,
)  # fmt: skip


def log_to_stderr(args: argparse.Namespace, first: bool) -> None:
    """Log to stderr, from the first rank alone: all ranks come to the same conclusions."""
    level = logging.ERROR if args.quiet else logging.DEBUG if args.verbose else logging.INFO
    log.handlers.clear()
    handler = logging.StreamHandler()
    handler.setFormatter(logging.Formatter("vgmpi: %(message)s"))
    log.addHandler(handler)
    log.propagate = False
    # every rank comes to the same conclusions; one logs them
    log.setLevel(level if first else ON_EVERY_RANK)


def print_error(error: Exception, args: argparse.Namespace, ranks: SerialCommunicator) -> int:
    """Print one of ONE_LINE_ERRORS on rank 0; return the exit code."""
    if isinstance(error, SceneError):
        return refuse(error.lines, ranks)
    if isinstance(error, InvalidRunOptions):
        return refuse([f"--{error}"], ranks)
    if isinstance(error, BlowUp):  # before the first frame
        log.error("blow-up: %s", error)
        return BLEW_UP
    if ranks.rank == 0:
        if args.verbose:
            traceback.print_exception(error)
        print(f"vgmpi: {error}", file=sys.stderr)
    is_usage_error = isinstance(error, CheckpointError | RunFolderInUseError) or getattr(
        error, "is_denied", False
    )
    return EXIT_USAGE if is_usage_error else 1


def refuse(lines: list[str], ranks: SerialCommunicator) -> int:
    """Print the lines on rank 0; return the exit code for wrong input."""
    if ranks.rank == 0:
        for line in lines:
            print(line, file=sys.stderr)
    return EXIT_USAGE


def memory_refusal(needed: int, ranks: SerialCommunicator) -> str:
    """Return one line if the run needs more than 90 % of the machine's free memory, else ""."""
    share = needed * ranks.local_size / ranks.size
    available = process_limits.available_memory()
    if available and share > 0.9 * available:
        return (
            f"needs about {share / 2**30:.1f} GiB on this machine, which has"
            f" {available / 2**30:.1f} GiB free (90 % may be used)"
        )
    return ""


def folder_refusal(folder: Path) -> str:
    """Return one line if the output folder is something else, else ""."""
    if folder.is_dir() or not os.path.lexists(folder):
        return ""
    what = "a file" if folder.exists() else "a link to nothing"
    return f"{folder}: is {what}, a folder is needed (-o, or output.folder of the scene)"


def rank_refusal(args: argparse.Namespace, ranks: SerialCommunicator) -> str:
    """Return one line if there are other ranks than SLURM or the flag says, else "".

    SLURM's tasks may not find each other. If they do, SLURM's number means nothing: mpirun starts
    its daemons as tasks, one per node. One rank plans for all.
    """
    tasks = os.environ.get("SLURM_STEP_NUM_TASKS") or os.environ.get("SLURM_NTASKS")
    if ranks.size == 1 and tasks and tasks.isdigit() and int(tasks) > 1:
        return (
            f"SLURM started {tasks} tasks but MPI sees {ranks.size}:"
            " use srun with another --mpi, or mpirun (docs/how-to/run-on-a-cluster.md)"
        )
    if args.ranks in (None, ranks.size) or (args.plan and ranks.size == 1):
        return ""
    return f"--ranks {args.ranks}: this program was started on {ranks.size} rank(s); leave it out"


def card_module(ranks: SerialCommunicator):
    """Return the module of GPUs; exit with code 2 if the extra for them is not installed."""
    try:
        from vgmpi.solver.engines.cuda import graphics_card
    except ImportError as error:
        message = f"--engine cuda needs `pip install 'vgmpi[cuda]'`: {error}"
        raise SystemExit(refuse([message], ranks)) from None
    return graphics_card

"""Command line of a scene: what is asked for, exit codes, and everything that is printed."""

import argparse
import logging
import os
import sys
import traceback
from pathlib import Path

from vgmpi.io import checkpoint, file_layout, hdf5_writer, run_lock, run_reader
from vgmpi.parallel.communicator import SerialCommunicator, init_communicator
from vgmpi.planning.plan import FLOAT_TYPES
from vgmpi.runtime import process_limits
from vgmpi.runtime.cache_files import ON_EVERY_RANK
from vgmpi.runtime.command_line import EXIT_USAGE
from vgmpi.runtime.config.schema import SceneError
from vgmpi.scene.loader import load
from vgmpi.scene.scene import Scene
from vgmpi.solver.stop_requests import (
    EndedBySignalError,
    signals_heard,
    take_ending_signals,
)

from .flags import parse_arguments

log = logging.getLogger("vgmpi")


def main(argv: list[str] | None = None) -> int:
    """Run the command; return the exit code."""
    args = parse_arguments(argv)
    if args.inspect is not None:
        return _inspect(args.inspect)
    log_to_stderr(args, first=True)
    if not is_run(args):
        return _reported(args, SerialCommunicator() if args.check else init_communicator())
    ranks = SerialCommunicator()
    with signals_heard():
        try:
            ranks = init_communicator()
            return _reported(args, ranks)
        except EndedBySignalError as end:
            log.error("%s", end.line)
            if ranks.size > 1:
                ranks.abort(end.exit_code)  # the others may wait for this one
            return end.exit_code


def is_run(args: argparse.Namespace) -> bool:
    """Return whether the flags ask for a run of a scene."""
    is_other = args.check or args.plan or args.prepare or args.inspect is not None
    return args.scene is not None and not is_other


def _reported(args: argparse.Namespace, ranks: SerialCommunicator) -> int:
    """Run the command and print errors of its input; return the exit code."""
    log_to_stderr(args, first=ranks.rank == 0)
    take_ending_signals()
    try:
        return _command(args, ranks)
    except SceneError as error:
        return refuse(error.lines, ranks)
    except (
        hdf5_writer.StoreError, run_lock.RunFolderInUseError, checkpoint.CheckpointError,
        run_reader.RunError
    ) as error:  # fmt: skip
        if ranks.rank == 0:
            if args.verbose:
                traceback.print_exc()
            print(f"vgmpi: {error}", file=sys.stderr)
        is_usage_error = isinstance(
            error, checkpoint.CheckpointError | run_lock.RunFolderInUseError
        ) or getattr(error, "is_denied", False)
        return EXIT_USAGE if is_usage_error else 1


def _command(args: argparse.Namespace, ranks: SerialCommunicator) -> int:
    """Run the command on a scene, or the calibration; return the exit code."""
    if args.scene is None:
        return _calibrate(ranks)
    scene = load(args.scene, args.set)
    folder = args.output or scene.folder / scene.output.folder
    if args.check:
        from .check_command import check_scene

        return check_scene(scene)
    refusal = _slurm_mismatch(ranks) or _rank_mismatch(args, ranks)
    refusal = refusal or (_engine_refusal(args, scene) if args.plan else _folder_problem(folder))
    if refusal:
        return refuse([refusal], ranks)
    if not (args.plan or args.prepare):
        from .run_command import run_scene  # imports numba

        return run_scene(scene, folder, args, ranks)
    if args.prepare:
        from vgmpi.solver import initial_particles  # imported late, so that --check stays quick

        with run_lock.run_lock(folder, ranks, into=args.overwrite):
            summary = initial_particles.prepare(scene, ranks, folder)
            initial_particles.write_initial_particles(scene, summary, ranks, folder)
        if ranks.rank == 0:
            print(f"{sum(summary.count):,} particles in {folder / file_layout.GAUSSIANS}")
        return 0
    from .plan_command import describe_plan

    text, needed = describe_plan(scene, folder, args, ranks)
    if text:
        print(text)
    refusal = memory_refusal(needed, ranks)
    return refuse([refusal], ranks) if refusal and not args.force else 0


def _engine_refusal(args: argparse.Namespace, scene: Scene) -> str:
    """Return one line if the scene has what the engine lacks, else ""."""
    from vgmpi.solver.run_options import InvalidRunOptions, check_engine

    try:
        check_engine(args.engine, scene)
    except InvalidRunOptions as error:
        return f"--{error}"
    return ""


def card_module(ranks: SerialCommunicator):
    """Return the module of GPUs; exit with code 2 if the extra for them is not installed."""
    try:
        from vgmpi.solver.engines.cuda import graphics_card
    except ImportError as error:
        message = f"--engine cuda needs `pip install 'vgmpi[cuda]'`: {error}"
        raise SystemExit(refuse([message], ranks)) from None
    return graphics_card


def _calibrate(ranks: SerialCommunicator) -> int:
    """Measure this processor in every precision; return the exit code."""
    from vgmpi.solver.estimates import calibration

    for precision in FLOAT_TYPES if ranks.rank == 0 else ():
        pace = calibration.host_throughput(precision, remeasure=True)
        print(
            f"{precision:6s}  {pace.fluid:.1f} ns per particle and step of a fluid,"
            f" {pace.elastic:.1f} elastic: {pace.origin}"
        )
    return 0


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


def _folder_problem(folder: Path) -> str:
    """Return one line if the output folder is something else, else ""."""
    if folder.is_dir() or not os.path.lexists(folder):
        return ""
    what = "a file" if folder.exists() else "a link to nothing"
    return f"{folder}: is {what}, a folder is needed (-o, or output.folder of the scene)"


def _slurm_mismatch(ranks: SerialCommunicator) -> str:
    """Return one line if SLURM started tasks that do not find each other, else "".

    If they do, SLURM's number means nothing: mpirun starts its daemons as tasks, one per node.
    """
    tasks = os.environ.get("SLURM_STEP_NUM_TASKS") or os.environ.get("SLURM_NTASKS")
    if ranks.size > 1 or not tasks or not tasks.isdigit() or int(tasks) <= 1:
        return ""
    return (
        f"SLURM started {tasks} tasks but MPI sees {ranks.size}:"
        " use srun with another --mpi, or mpirun (docs/how-to/run-on-a-cluster.md)"
    )


def _rank_mismatch(args: argparse.Namespace, ranks: SerialCommunicator) -> str:
    """Return one line if there are other ranks than the flag says, else ""; one plans for all."""
    if args.ranks in (None, ranks.size) or (args.plan and ranks.size == 1):
        return ""
    return f"--ranks {args.ranks}: this program was started on {ranks.size} rank(s); leave it out"


def _inspect(path: Path) -> int:
    """Print what a file holds; return the exit code."""
    from vgmpi.preprocess import inspect_file  # a run does not need it

    try:
        print(
            inspect_file.describe_file(path)
            if inspect_file.is_inspectable(path)
            else run_reader.inspect(path)
        )
    except (run_reader.RunError, inspect_file.GaussianFileError, inspect_file.MeshError) as error:
        print(f"vgmpi: {error}", file=sys.stderr)
        return EXIT_USAGE
    return 0


def refuse(lines: list[str], ranks: SerialCommunicator) -> int:
    """Print the lines on rank 0; return the exit code for wrong input."""
    if ranks.rank == 0:
        for line in lines:
            print(line, file=sys.stderr)
    return EXIT_USAGE


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

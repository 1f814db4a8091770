"""Command line: flags, exit codes, and everything that is printed."""

import argparse
import logging
import math
import os
import re
import signal
import sys
import traceback
from pathlib import Path

from vgmpi.io import checkpoint, file_layout, hdf5_writer, run_lock, run_reader
from vgmpi.parallel.communicator import SerialCommunicator, init_communicator
from vgmpi.planning.cost.plan_report import format_plan
from vgmpi.planning.cost.run_estimate import pours_onto_bodies
from vgmpi.planning.plan import FLOAT_TYPES
from vgmpi.runtime import memory_budget
from vgmpi.runtime.config.schema import SceneError
from vgmpi.scene.loader import load
from vgmpi.scene.resume_rules import with_accuracy_of_run
from vgmpi.scene.scene import Scene
from vgmpi.solver.stop_requests import install_signal_handlers

log = logging.getLogger("vgmpi")

EXIT_USAGE = 2
# [s] --plan makes a pilot run that is shorter, also where inlets pour onto bodies
PILOT_SECONDS, POURING_PILOT_SECONDS = 5.0, 20.0
EXIT_CODES = """exit codes: 0 done, 1 unexpected error or a full disk, 2 something in the scene or
the flags is wrong or the output is read-only, 3 the simulation blew up (what was written before
is whole), 75 stopped with a checkpoint (also by the first Ctrl-C once steps are made), 130
interrupted"""


def _parser() -> argparse.ArgumentParser:
    """Return the parser of what to do and with which scene."""
    parser = argparse.ArgumentParser(
        prog="vgmpi",
        description="Multiphase physics on 3D Gaussians."
        " On several ranks: mpirun -n 2 python -m vgmpi scene.toml",
        epilog=EXIT_CODES,
    )
    parser.add_argument("scene", nargs="?", type=Path, help="scene file (TOML)")
    action = parser.add_mutually_exclusive_group()
    action.add_argument(
        "--check", action="store_true", help="check the scene, list all errors, write nothing"
    )
    action.add_argument(
        "--plan", action="store_true", help="estimate memory and time, write nothing"
    )
    action.add_argument(
        "--prepare", action="store_true", help="generate the particles (gaussians.h5) and stop"
    )
    inspect_help = "describe and verify an output file, a Gaussian file or a mesh"
    action.add_argument("--inspect", type=Path, metavar="FILE", help=inspect_help)
    parser.add_argument(
        "--pilot",
        action="store_true",
        help="simulate the scene in coarser cells first (about a tenth of the work), so that the"
        " time estimate of --plan or of a run includes contact and motion; --plan does it by itself"
        f" where it takes less than {PILOT_SECONDS:g} s, or {POURING_PILOT_SECONDS:g} s where"
        " inlets pour onto bodies",
    )
    parser.add_argument(  # name of earlier releases
        "--rehearse", dest="pilot", action="store_true", help=argparse.SUPPRESS
    )
    parser.add_argument(
        "--calibrate",
        action="store_true",
        help="measure the speed of this processor again; --plan measures once and caches it",
    )
    return parser


def _add_flags_of_a_run(parser: argparse.ArgumentParser) -> None:
    """Add the flags of a run."""
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="override a key of the scene, such as domain.cell='1 cm'; repeatable",
    )
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        metavar="DIR",
        help="output folder; default: output.folder of the scene",
    )
    parser.add_argument(
        "--resume",
        nargs="?",
        const="",
        metavar="FILE",
        help="resume from a checkpoint; default: the latest valid one",
    )
    parser.add_argument(
        "--change",
        action="store_true",
        help="with --resume: allow changed keys; checkpoints record the changes",
    )
    parser.add_argument(
        "--overwrite", action="store_true", help="replace an existing run in the output folder"
    )
    parser.add_argument(
        "--stop-after",
        default="",
        metavar="AMOUNT",
        help='stop with a checkpoint after "500 steps", or "90 s", "10 min", "2 h" of wall time',
    )


def _add_flags_of_execution(parser: argparse.ArgumentParser) -> None:
    """Add the flags that say how a run computes and what it shows."""
    parser.add_argument("--threads", type=int, default=1, metavar="N", help="threads per rank")
    parser.add_argument(
        "--engine",
        choices=("cpu", "cuda", "numpy"),
        default="cpu",
        help="cpu: this processor; cuda: one GPU per rank (docs/benchmarks/cuda.md); numpy: slow"
        " reference engine on one rank",
    )
    parser.add_argument(
        "--profile",
        action="store_true",
        help="report the stage times of each rank at the end (profile.csv)",
    )
    parser.add_argument(
        "--live",
        nargs="?",
        type=int,
        const=8080,
        metavar="PORT",
        help="show the run in a browser while it goes on: starts `vgmpi live` beside it [8080]",
    )
    parser.add_argument(
        "--force", action="store_true", help="run even if the estimated memory does not fit"
    )
    parser.add_argument("-q", "--quiet", action="store_true", help="errors only")
    parser.add_argument(
        "-v",
        "--verbose",
        action="store_true",
        help="print the details of the plan, and the traceback of an error",
    )


def parse_arguments(argv: list[str] | None) -> argparse.Namespace:
    """Parse the flags; exit with code 2 if they contradict each other."""
    parser = _parser()
    _add_flags_of_a_run(parser)
    _add_flags_of_execution(parser)
    args = parser.parse_args(argv)
    if args.inspect is None and args.scene is None and not args.calibrate:
        parser.error("give a scene file, --inspect FILE or --calibrate")
    if args.scene is None and (args.check or args.plan or args.prepare):
        parser.error("give a scene file")
    if args.pilot and (args.check or args.prepare or args.resume is not None):
        parser.error("--pilot is for a run from the start, or for --plan")
    if args.live is not None and (args.check or args.plan or args.prepare):
        parser.error("--live is for a run")
    if args.live is not None and not 0 <= args.live <= 65535:
        parser.error(f"--live: a port is a number from 0 to 65535; got {args.live}")
    if args.change and args.resume is None:
        parser.error("--change is for --resume")
    if args.overwrite and args.resume is not None:
        parser.error("--overwrite replaces a run, --resume goes on with it: give one of them")
    if args.threads < 1:
        parser.error(f"--threads: must be at least 1; got {args.threads}")
    try:
        args.stop_steps, args.stop_seconds = _amount(args.stop_after)
    except ValueError as error:
        parser.error(f"--stop-after: {error}")
    return args


def _amount(text: str) -> tuple[int, float]:
    """Return (steps, seconds) of "500 steps", "90 s", "10 min", "2 h"; else raise ValueError."""
    if not text:
        return 0, 0.0
    match = re.fullmatch(r"\s*(\d+(?:\.\d*)?)\s*(steps?|s|min|h)\s*", text)
    if not match or float(match[1]) <= 0:
        raise ValueError(f"must be like '500 steps', '90 s', '10 min' or '2 h'; got {text!r}")
    if match[2].startswith("step"):
        if "." in match[1]:
            raise ValueError(f"steps must be a whole number; got {text!r}")
        return int(match[1]), 0.0
    return 0, float(match[1]) * {"s": 1.0, "min": 60.0, "h": 3600.0}[match[2]]


def main(argv: list[str] | None = None) -> int:
    """Run the command; return the exit code."""
    args = parse_arguments(argv)
    if args.inspect is not None:
        return _inspect(args.inspect)
    _log_to_stderr(args, first=True)
    if args.scene is not None and not (args.check or args.plan or args.prepare):
        install_signal_handlers(signal.SIGUSR1, signal.SIGTERM)
    ranks = SerialCommunicator() if args.check else init_communicator()
    _log_to_stderr(args, first=ranks.rank == 0)
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
    refusal = _slurm_mismatch(ranks)
    refusal = refusal or (_engine_refusal(args, scene) if args.plan else _folder_problem(folder))
    if refusal:
        return refuse([refusal], ranks)
    if not (args.plan or args.prepare):
        from .run_command import run_scene  # imports numba

        return run_scene(scene, folder, args, ranks)
    from vgmpi.solver import initial_particles  # imported late, so that --check stays quick

    if args.prepare:
        with run_lock.run_lock(folder, ranks, into=args.overwrite):
            summary = initial_particles.prepare(scene, ranks, folder)
            initial_particles.write_initial_particles(scene, summary, ranks, folder)
        if ranks.rank == 0:
            print(f"{sum(summary.count):,} particles in {folder / file_layout.GAUSSIANS}")
        return 0
    start_time = 0.0
    if args.resume is not None:
        from vgmpi.solver.run import resolve_checkpoint

        attrs = resolve_checkpoint(args.resume, folder, ranks)[1]
        start_time, scene = attrs["time"], with_accuracy_of_run(scene, attrs["scene"])
    summary = initial_particles.prepare(scene, ranks, None)
    plan = initial_particles.plan_for(scene, summary)
    if ranks.rank == 0:
        from vgmpi.solver.compile_kernels import is_compiled
        from vgmpi.solver.estimates import calibration
        from vgmpi.solver.estimates.pilot_run import pilot_run, pilot_seconds

        pace = calibration.host_throughput(scene.accuracy.precision, remeasure=args.calibrate)
        most = POURING_PILOT_SECONDS if pours_onto_bodies(scene, plan) else PILOT_SECONDS
        is_short = start_time == 0 and pilot_seconds(scene, plan, pace) < most
        is_quick = is_short and is_compiled(plan)
        is_wanted = args.pilot or is_quick
        limit = math.inf if args.pilot else most  # estimates may be wrong
        pilot = pilot_run(scene, plan, summary, not args.pilot, limit) if is_wanted else None
        print(format_plan(scene, plan, ranks.size, start_time, pace, pilot, args.verbose))
        if args.engine == "cuda":
            print(card_module(ranks).memory_report(plan, ranks.size))
    refusal = memory_refusal(plan.bytes(), ranks)
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
            f" {pace.elastic:.1f} elastic: {pace.of}"
        )
    return 0


def memory_refusal(needed: int, ranks: SerialCommunicator) -> str:
    """Return one line if the run needs more than 90 % of the machine's free memory, else ""."""
    share = needed * ranks.here / ranks.size
    available = memory_budget.available_memory()
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


def _log_to_stderr(args: argparse.Namespace, first: bool) -> None:
    """Log to stderr, from the first rank alone: all ranks come to the same conclusions."""
    level = logging.ERROR if args.quiet else logging.DEBUG if args.verbose else logging.INFO
    log.handlers.clear()
    handler = logging.StreamHandler()
    handler.setFormatter(logging.Formatter("vgmpi: %(message)s"))
    log.addHandler(handler)
    log.propagate = False
    # every rank comes to the same conclusions; one logs them
    log.setLevel(level if first else logging.CRITICAL + 1)

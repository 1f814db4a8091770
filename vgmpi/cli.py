"""The command line: flags, exit codes, and all that is printed."""

import argparse
import logging
import os
import re
import signal
import sys
import traceback
from pathlib import Path

from . import room
from .domain.ranks import Alone, world
from .output import checkpoint, layout, owner, read, store
from .planning.pace import ASSUMED
from .planning.plan import REALS, Plan
from .planning.price import describe
from .scene.reader import load
from .scene.scene import Scene
from .solver.requests import listen
from .tables import SceneError

log = logging.getLogger("vgmpi")

WRONG = 2
EXIT_CODES = """exit codes: 0 done, 1 unexpected error, 2 something in the scene or the flags is
wrong, 3 the simulation blew up (what was written before is whole), 75 stopped with a checkpoint
(also by the first Ctrl-C once steps are made), 130 interrupted"""


def _parser() -> argparse.ArgumentParser:
    """What to do, and with which scene."""
    parser = argparse.ArgumentParser(
        prog="python -m vgmpi",
        description="Multiphase physics on 3D Gaussians."
        " On several ranks: mpirun -n 2 python -m vgmpi scene.toml",
        epilog=EXIT_CODES,
    )
    parser.add_argument("scene", nargs="?", type=Path, help="scene file (TOML)")
    what = parser.add_mutually_exclusive_group()
    what.add_argument(
        "--check", action="store_true", help="read the scene, say what is wrong, write nothing"
    )
    what.add_argument(
        "--plan", action="store_true", help="say what the scene will cost, write nothing"
    )
    what.add_argument(
        "--prepare", action="store_true", help="make the particles (gaussians.h5) and stop"
    )
    said = "say what an output file, a Gaussian file or a mesh holds"
    what.add_argument("--inspect", type=Path, metavar="FILE", help=said)
    parser.add_argument(
        "--rehearse",
        action="store_true",
        help="play the scene in coarser cells first, some tenth of the work, so that --plan, or a"
        " run, tells its time by where things go",
    )
    parser.add_argument(
        "--calibrate",
        action="store_true",
        help="measure anew how fast this processor is, which --plan does once and keeps",
    )
    return parser


def _add_flags_of_a_run(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="override a key of the scene, such as domain.cell='1 cm'",
    )
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        metavar="DIR",
        help="output folder; default: what the scene says",
    )
    parser.add_argument(
        "--resume",
        nargs="?",
        const="",
        metavar="FILE",
        help="go on from a checkpoint; default: the latest valid one",
    )
    parser.add_argument(
        "--change",
        action="store_true",
        help="with --resume: go on although the scene has changed; the run's history says how",
    )
    parser.add_argument(
        "--overwrite", action="store_true", help="replace a run that lies in the output folder"
    )
    parser.add_argument(
        "--stop-after",
        default="",
        metavar="AMOUNT",
        help='stop with a checkpoint after "500 steps", or "90 s", "10 min", "2 h" of wall time',
    )
    parser.add_argument(
        "--threads", type=int, default=1, metavar="N", help="threads per rank, default 1"
    )
    parser.add_argument(
        "--engine",
        choices=("cpu", "cuda", "numpy"),
        default="cpu",
        help="what computes: this processor, a graphics card for each rank (docs/cuda.md), or plain"
        " numpy: slow, on one rank, for comparison",
    )
    parser.add_argument(
        "--profile", action="store_true", help="say at the end what each rank did (profile.csv)"
    )
    parser.add_argument(
        "--force", action="store_true", help="run even if the memory looks too small"
    )
    parser.add_argument("-q", "--quiet", action="store_true", help="errors only")
    parser.add_argument(
        "-v", "--verbose", action="store_true", help="show where an error came from"
    )


def arguments(argv: list[str] | None) -> argparse.Namespace:
    """The flags as given; exits with code 2 where they make no sense."""
    parser = _parser()
    _add_flags_of_a_run(parser)
    given = parser.parse_args(argv)
    if given.inspect is None and given.scene is None and not given.calibrate:
        parser.error("give a scene file, --inspect FILE or --calibrate")
    if given.scene is None and (given.check or given.plan or given.prepare):
        parser.error("give a scene file")
    if given.rehearse and (given.check or given.prepare or given.resume is not None):
        parser.error("--rehearse is for a run from the start, or for --plan")
    if given.change and given.resume is None:
        parser.error("--change is for --resume")
    if given.overwrite and given.resume is not None:
        parser.error("--overwrite replaces a run, --resume goes on with it: give one of them")
    if given.threads < 1:
        parser.error(f"--threads: must be at least 1; got {given.threads}")
    try:
        given.stop_steps, given.stop_seconds = _amount(given.stop_after)
    except ValueError as error:
        parser.error(f"--stop-after: {error}")
    return given


def _amount(text: str) -> tuple[int, float]:
    """(steps, seconds) of "500 steps", "90 s", "10 min", "2 h"; raises ValueError."""
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
    """Run the command; returns the exit code."""
    given = arguments(argv)
    if given.inspect is not None:
        return _inspect(given.inspect)
    _log_to_stderr(given, first=True)
    if given.scene is not None and not (given.check or given.plan or given.prepare):
        listen(signal.SIGUSR1, signal.SIGTERM)
    ranks = Alone() if given.check else world()
    _log_to_stderr(given, first=ranks.rank == 0)
    try:
        return _command(given, ranks)
    except SceneError as error:
        return _refuse(error.lines, ranks)
    except (
        store.StoreError, owner.FolderError, checkpoint.CheckpointError, read.RunError
    ) as error:  # fmt: skip
        if ranks.rank == 0:
            if given.verbose:
                traceback.print_exc()
            print(f"vgmpi: {error}", file=sys.stderr)
        asked = isinstance(error, checkpoint.CheckpointError | owner.FolderError)
        return WRONG if asked else 1


def _command(given: argparse.Namespace, ranks: Alone) -> int:
    if given.scene is None:
        return _calibrate(ranks)
    scene = load(given.scene, given.set)
    folder = given.output or scene.folder / scene.output.folder
    if given.check:
        from .prepare.build import build

        build(scene)  # files that cannot be read and bodies outside the domain show only here
        print(f"{given.scene}: nothing is wrong with it")
        return 0
    refusal = _slurm_mismatch(ranks)
    if refusal:
        return _refuse([refusal], ranks)
    if not (given.plan or given.prepare):
        return _run(scene, folder, given, ranks)
    from .solver import prepared  # --check stays quick

    if given.prepare:
        with owner.held(folder, ranks, into=given.overwrite):
            known = prepared.prepare(scene, ranks, folder)
            prepared.keep(scene, known, ranks, folder)
        if ranks.rank == 0:
            print(f"{sum(known.count):,} particles in {folder / layout.GAUSSIANS}")
        return 0
    reached = 0.0
    if given.resume is not None:
        from .solver.run import goes_on_from

        reached = goes_on_from(given.resume, folder, ranks)[1]["time"]
    known = prepared.prepare(scene, ranks, None)
    plan = prepared.plan_for(scene, known)
    if ranks.rank == 0:
        from .solver import calibrate
        from .solver.rehearse import rehearse

        pace = calibrate.pace(scene.accuracy.precision, anew=given.calibrate)
        seen = rehearse(scene, plan, known) if given.rehearse else None
        print(describe(scene, plan, ranks.size, reached, pace, seen))
        if given.engine == "cuda":
            print(_card(ranks).told(plan, ranks.size))
    refusal = too_large(plan.bytes(), ranks)
    return _refuse([refusal], ranks) if refusal and not given.force else 0


def _card(ranks: Alone):
    """What knows of cards. Exits with code 2 where the extra for them is not installed."""
    try:
        from .engines.cuda import card
    except ImportError as error:
        said = f"--engine cuda needs `pip install 'vgmpi[cuda]'`: {error}"
        raise SystemExit(_refuse([said], ranks)) from None
    return card


def _calibrate(ranks: Alone) -> int:
    """Measure this processor in every precision."""
    from .solver import calibrate

    for precision in REALS if ranks.rank == 0 else ():
        pace = calibrate.pace(precision, anew=True)
        print(
            f"{precision:6s}  {pace.fluid:.1f} ns per particle and step of a fluid,"
            f" {pace.elastic:.1f} elastic: {pace.of}"
        )
    return 0


def _run(scene: Scene, folder: Path, given: argparse.Namespace, ranks: Alone) -> int:
    from .solver import calibrate, report  # numba comes in here
    from .solver import run as runs
    from .solver.advice import Seen, advice
    from .solver.left import Left
    from .solver.prepared import Known
    from .solver.rehearse import rehearse
    from .solver.step import BlowUp

    left = None

    def approve(plan: Plan, reached: float, known: Known) -> None:
        nonlocal left
        refusal = too_large(plan.bytes(), ranks)
        if given.engine == "cuda":
            refusal = refusal or _card(ranks).too_large(plan, ranks)
        if refusal and not given.force:
            raise SceneError([refusal + "; --force runs it anyway"])
        if ranks.rank == 0 and not given.quiet:
            how = scene.accuracy.precision
            pace = calibrate.pace(how, anew=True) if given.calibrate else calibrate.kept(how)
            seen = rehearse(scene, plan, known) if given.rehearse else None
            if seen is not None:
                left = Left(*seen.ahead(scene, plan, pace or ASSUMED[how]))
            print(describe(scene, plan, ranks.size, reached, pace, seen), flush=True)

    options = runs.Options(
        folder, given.threads, given.engine, given.resume, given.stop_steps, given.stop_seconds,
        given.overwrite, given.change,
    )  # fmt: skip
    try:
        with runs.started(scene, ranks, options, approve) as run:
            clock = run.simulation.clock = report.Clock()
            progress = report.Progress(run, given.quiet, left)
            seen = Seen()
            options.listeners += [progress, seen.step]
            options.watchers.append(lambda run: seen.frame(run.latest))
            if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:  # as behind a script's &
                listen(signal.SIGINT)
            code = run.go()
            progress.close()
            said = [report.table(run, clock)]
            if code == runs.DONE and run.first_step == 0:  # all of the run was seen
                said += advice(scene, run.plan, seen)
            if given.profile:
                said.append(report.profile(run, clock))
    except runs.Unfit as error:
        return _refuse([f"--{error}"], ranks)
    except BlowUp as error:  # before the first frame
        log.error("blow-up: %s", error)
        return runs.BLEW_UP
    if ranks.rank == 0 and not given.quiet:
        print("\n".join(said))
        ended = {0: "done", 3: "blew up", 75: "stopped; go on with --resume"}[code]
        print(f"{ended}: {folder}", flush=True)
    return code


def too_large(needed: int, ranks: Alone) -> str:
    """One line if the run needs more than 90 % of the machine's memory, else ""."""
    share = needed * ranks.here / ranks.size
    have = room.free()
    if have and share > 0.9 * have:
        return (
            f"needs about {share / 2**30:.1f} GiB on this machine, which has"
            f" {have / 2**30:.1f} GiB free (90 % may be used)"
        )
    return ""


def _slurm_mismatch(ranks: Alone) -> str:
    """One line if SLURM started tasks that do not find each other, else "". Where they do, SLURM's
    number says nothing: mpirun starts its daemons as tasks, one for each node.
    """
    tasks = os.environ.get("SLURM_STEP_NUM_TASKS") or os.environ.get("SLURM_NTASKS")
    if ranks.size > 1 or not tasks or not tasks.isdigit() or int(tasks) <= 1:
        return ""
    return (
        f"SLURM started {tasks} tasks but MPI sees {ranks.size}:"
        " use srun with another --mpi, or mpirun (slurm/README.md)"
    )


def _inspect(path: Path) -> int:
    from .prepare import inspect  # a run has no need of it

    try:
        print(inspect.inspect(path) if inspect.known(path) else read.inspect(path))
    except (read.RunError, inspect.GaussianFileError, inspect.MeshError) as error:
        print(f"vgmpi: {error}", file=sys.stderr)
        return WRONG
    return 0


def _refuse(lines: list[str], ranks: Alone) -> int:
    if ranks.rank == 0:
        for line in lines:
            print(line, file=sys.stderr)
    return WRONG


def _log_to_stderr(given: argparse.Namespace, first: bool) -> None:
    level = logging.ERROR if given.quiet else logging.DEBUG if given.verbose else logging.INFO
    log.handlers.clear()
    handler = logging.StreamHandler()
    handler.setFormatter(logging.Formatter("vgmpi: %(message)s"))
    log.addHandler(handler)
    log.propagate = False
    # every rank comes to the same conclusions; one says them
    log.setLevel(level if first else logging.CRITICAL + 1)

"""Flags of the commands on a scene."""

import argparse
import re
from pathlib import Path

from vgmpi.runtime.command_line import ArgumentParser

EXIT_CODES = """exit codes: 0 done, 1 unexpected error or a full disk, 2 something in the scene or
the flags is wrong or the output is read-only, 3 the simulation blew up (what was written before
is whole), 75 stopped with a checkpoint (also by the first Ctrl-C once steps are made), 130
interrupted"""


def _parser() -> argparse.ArgumentParser:
    """Return the parser of what to do and with which scene."""
    parser = ArgumentParser(
        prog="vgmpi",
        description="Multiphase physics on 3D Gaussians. On several nodes:"
        " mpirun -n 64 python -m vgmpi scene.toml",
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
        " for up to 20 s of processor time",
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
    parser.add_argument(
        "--ranks",
        type=int,
        metavar="N",
        help="MPI ranks on this machine, which this command starts by itself; 1: none; default: as"
        " many as there are cores and as the work pays for",
    )
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
    if args.ranks is not None and args.ranks < 1:
        parser.error(f"--ranks: must be at least 1; got {args.ranks}")
    if args.threads < 1:
        parser.error(f"--threads: must be at least 1; got {args.threads}")
    try:
        args.stop_steps, args.stop_seconds = _amount(args.stop_after)
    except ValueError as error:
        parser.error(f"--stop-after: {error}")
    return args


def is_run(args: argparse.Namespace) -> bool:
    """Return whether the flags ask for a run of a scene."""
    is_other = args.check or args.plan or args.prepare or args.inspect is not None
    return args.scene is not None and not is_other


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

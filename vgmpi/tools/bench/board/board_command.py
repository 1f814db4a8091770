"""`vgmpi bench board`: error against seconds of this program and its rivals on the same cases."""

import argparse
import json
import os
import subprocess
import sys
import time
import venv
from pathlib import Path
from typing import Any

from vgmpi.runtime.user_files import replace_file

from ..benchmark_case import BenchError, WorkerError
from ..subcommands import print_progress
from .board_cases import CASES
from .board_plot import draw_board
from .board_results import format_csv, format_tables, mark_front, read_results, run_key
from .board_settings import RIVAL_PACKAGES, RUNS

PACKAGE = Path(__file__).parents[4]  # the folder of the package vgmpi
RIVALS = ("newton", "genesis")
LIMIT_SECONDS = 1800  # of a run, with what it compiles


def flags(parser: argparse.ArgumentParser) -> None:
    """Add the flags of the command."""
    say = parser.add_argument
    say("--only", nargs="+", choices=CASES, metavar="CASE", help=f"any of {', '.join(CASES)}")
    say("--solvers", nargs="+", choices=("vgmpi", *RIVALS), metavar="SOLVER", help="vgmpi, newton,"
        " genesis; default: all that are installed")  # fmt: skip
    say("--setup", action="store_true", help="install the rivals in an environment of their own"
        f" ({', '.join(RIVAL_PACKAGES)}: 7 GB)")  # fmt: skip
    say("--environment", type=Path, metavar="FOLDER", help="environment of the rivals; default:"
        " rivals in the output folder")  # fmt: skip
    say("-o", "--output", type=Path, default=Path("board"), metavar="FOLDER",
        help="folder of results and of the board as .md, .csv, .png; default: board")  # fmt: skip
    say(
        "--again",
        dest="repeats",
        action="store_true",
        help="measure runs again whose results are there",
    )


def install_rivals(environment: Path) -> None:
    """Make the environment of the rivals.

    Raises:
        WorkerError: If a package cannot be installed.
    """
    print_progress(f"installing {', '.join(RIVAL_PACKAGES)} in {environment}")
    venv.create(environment, with_pip=True)
    command = [str(environment / "bin" / "python"), "-m", "pip", "install", "-q", *RIVAL_PACKAGES]
    if subprocess.run(command).returncode:
        raise WorkerError(f"{environment}: the rivals cannot be installed: pip's lines say why")


def installed_solvers(environment: Path) -> dict[str, str]:
    """Return the interpreter of each solver that is installed, and name those that are not."""
    interpreters, python = {"vgmpi": sys.executable}, environment / "bin" / "python"
    for name in RIVALS:
        probe = [str(python), "-c", f"import importlib.util as u; u.find_spec({name!r}) or exit(1)"]
        if python.exists() and subprocess.run(probe).returncode == 0:
            interpreters[name] = str(python)
        else:
            print_progress(f"{name} is not installed in {environment}: left out (--setup)")
    return interpreters


def make_run(interpreter: str, case: str, words: tuple[str, ...]) -> dict[str, Any]:
    """Make a run in a process of its own and return its results, or the reason of its failure."""
    solver, *options = words
    command = [interpreter, "-m", "vgmpi.tools.bench.board.board_run", solver, case, *options]
    env = os.environ | {"PYTHONPATH": str(PACKAGE)}
    failure = {"case": case, "solver": solver, "options": options}
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, env=env, timeout=LIMIT_SECONDS
        )
    except subprocess.TimeoutExpired:
        return failure | {"failure": f"no end within {LIMIT_SECONDS} s"}
    try:
        return failure | json.loads(done.stdout.strip().splitlines()[-1])
    except (ValueError, IndexError):
        lines = done.stderr.strip().splitlines() or [f"exit code {done.returncode}"]
        return failure | {"failure": lines[-1]}


def run_board(args: argparse.Namespace) -> int:
    """Make the runs that are missing, and write table, CSV and picture."""
    environment = args.environment or args.output / "rivals"
    try:
        args.output.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError):
        raise BenchError(f"{args.output}: is a file, a folder is needed") from None
    if args.setup:
        install_rivals(environment)
    interpreters = installed_solvers(environment)
    solvers = [name for name in args.solvers or interpreters if name in interpreters]
    path = args.output / "results.jsonl"
    results = {run_key(result): result for result in read_results(path)}
    for case in args.only or RUNS:
        for words in RUNS[case]:
            key = (case, *words)
            if words[0] not in solvers or (key in results and not args.repeats):
                continue
            print_progress(f"{case}: {' '.join(words)}")
            start = time.monotonic()
            result = make_run(interpreters[words[0]], case, words)
            results[key] = result | {"elapsed": time.monotonic() - start}
            with open(path, "a") as file:
                file.write(json.dumps(results[key]) + "\n")
    order = [(case, *words) for case, runs in RUNS.items() for words in runs]
    marked = mark_front([results[key] for key in order if key in results])
    tables = format_tables(marked)
    replace_file(args.output / "board.md", tables + "\n")
    replace_file(args.output / "board.csv", format_csv(marked))
    print(tables)
    try:
        draw_board(args.output / "board.png", marked)
    except ImportError:
        print_progress("no picture: not installed: pip install 'vgmpi[validate]'")
    return 1 if any("failure" in result for result in marked) else 0
